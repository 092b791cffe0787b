//! The subset of ONNX's format (onnx.proto3, IR version 8) that a dense network needs.

use std::f32::consts::{FRAC_1_SQRT_2, PI};

use joulebus_predictor::{Activation, FEATURE_NAMES, Network};
use prost::Message;

const PRODUCER: &str = "joulebus";
/// Property with the model file's metadata.
const METADATA: &str = "joulebus_metadata";
const IR_VERSION: i64 = 8;
const OPSET: i64 = 17;
const FLOAT: i32 = 1;
/// Kinds of attributes: a single integer.
const INTEGER: i32 = 2;

#[derive(Clone, PartialEq, Message)]
pub(super) struct Model {
    #[prost(int64, tag = "1")]
    ir_version: i64,
    #[prost(string, tag = "2")]
    producer_name: String,
    #[prost(string, tag = "3")]
    producer_version: String,
    #[prost(message, optional, tag = "7")]
    graph: Option<Graph>,
    #[prost(message, repeated, tag = "8")]
    opset_import: Vec<Opset>,
    #[prost(message, repeated, tag = "14")]
    metadata_props: Vec<Property>,
}

#[derive(Clone, PartialEq, Message)]
struct Opset {
    #[prost(string, tag = "1")]
    domain: String,
    #[prost(int64, tag = "2")]
    version: i64,
}

#[derive(Clone, PartialEq, Message)]
struct Property {
    #[prost(string, tag = "1")]
    key: String,
    #[prost(string, tag = "2")]
    value: String,
}

#[derive(Clone, PartialEq, Message)]
struct Graph {
    #[prost(message, repeated, tag = "1")]
    node: Vec<Node>,
    #[prost(string, tag = "2")]
    name: String,
    #[prost(message, repeated, tag = "5")]
    initializer: Vec<Tensor>,
    #[prost(string, tag = "10")]
    doc_string: String,
    #[prost(message, repeated, tag = "11")]
    input: Vec<ValueInfo>,
    #[prost(message, repeated, tag = "12")]
    output: Vec<ValueInfo>,
}

#[derive(Clone, PartialEq, Message)]
struct Node {
    #[prost(string, repeated, tag = "1")]
    input: Vec<String>,
    #[prost(string, repeated, tag = "2")]
    output: Vec<String>,
    #[prost(string, tag = "3")]
    name: String,
    #[prost(string, tag = "4")]
    op_type: String,
    #[prost(message, repeated, tag = "5")]
    attribute: Vec<Attribute>,
}

#[derive(Clone, PartialEq, Message)]
struct Attribute {
    #[prost(string, tag = "1")]
    name: String,
    #[prost(int64, tag = "3")]
    i: i64,
    #[prost(int32, tag = "20")]
    r#type: i32,
}

#[derive(Clone, PartialEq, Message)]
struct Tensor {
    #[prost(int64, repeated, tag = "1")]
    dims: Vec<i64>,
    #[prost(int32, tag = "2")]
    data_type: i32,
    #[prost(string, tag = "8")]
    name: String,
    #[prost(bytes = "vec", tag = "9")]
    raw_data: Vec<u8>,
}

#[derive(Clone, PartialEq, Message)]
struct ValueInfo {
    #[prost(string, tag = "1")]
    name: String,
    #[prost(message, optional, tag = "2")]
    r#type: Option<Type>,
}

#[derive(Clone, PartialEq, Message)]
struct Type {
    #[prost(message, optional, tag = "1")]
    tensor_type: Option<TensorType>,
}

#[derive(Clone, PartialEq, Message)]
struct TensorType {
    #[prost(int32, tag = "1")]
    elem_type: i32,
    #[prost(message, optional, tag = "2")]
    shape: Option<Shape>,
}

#[derive(Clone, PartialEq, Message)]
struct Shape {
    #[prost(message, repeated, tag = "1")]
    dim: Vec<Dimension>,
}

#[derive(Clone, PartialEq, Message)]
struct Dimension {
    #[prost(oneof = "Size", tags = "1, 2")]
    value: Option<Size>,
}

#[derive(Clone, PartialEq, prost::Oneof)]
enum Size {
    #[prost(int64, tag = "1")]
    Fixed(i64),
    #[prost(string, tag = "2")]
    Any(String),
}

/// The network as a graph from raw features to power in W.
pub(super) fn model(network: &Network, metadata: &str) -> Model {
    let parameters = network.parameters();
    let set = parameters.feature_set;
    let normalisation = &parameters.normalisation;
    let mut builder = Builder::default();
    let inverse = |std: f32| if std > 0.0 { 1.0 / std } else { 0.0 };
    let features = set.range();
    let mean = &normalisation.feature_mean[features.clone()];
    let inverse: Vec<f32> =
        normalisation.feature_std[features.clone()].iter().map(|std| inverse(*std)).collect();
    let inputs = set.inputs() as i64;
    builder.constant("feature_mean", &[inputs], mean);
    builder.constant("feature_inverse_std", &[inputs], &inverse);
    builder.constant("half", &[], &[0.5]);
    builder.constant("one", &[], &[1.0]);
    match parameters.activation {
        Activation::GeluErf => builder.constant("sqrt_half", &[], &[FRAC_1_SQRT_2]),
        Activation::GeluTanh => {
            let linear = (2.0 / PI).sqrt();
            builder.constant("linear", &[], &[linear]);
            builder.constant("cubic", &[], &[linear * 0.044715]);
        }
        Activation::Relu => {}
    }
    builder.constant("power_mean_w", &[], &[normalisation.power_mean_w]);
    builder.constant("power_std_w", &[], &[normalisation.power_std_w]);

    let centred = builder.node("Sub", &["features", "feature_mean"], "centred");
    let mut values = builder.node("Mul", &[&centred, "feature_inverse_std"], "normalised");
    for (number, layer) in parameters.layers.iter().enumerate() {
        let (weight, bias) = (format!("layers.{number}.weight"), format!("layers.{number}.bias"));
        let outputs = layer.bias.len();
        let inputs = layer.weights.len() / outputs;
        builder.constant(&weight, &[outputs as i64, inputs as i64], &layer.weights);
        builder.constant(&bias, &[outputs as i64], &layer.bias);
        values = builder.dense(&[&values, &weight, &bias], &format!("dense.{number}"));
        if number + 1 < parameters.layers.len() {
            values = match parameters.activation {
                Activation::GeluErf => builder.gelu(&values, number),
                Activation::GeluTanh => builder.gelu_tanh(&values, number),
                Activation::Relu => builder.node("Relu", &[&values], &format!("relu.{number}")),
            };
        }
    }
    let scaled = builder.node("Mul", &[&values, "power_std_w"], "scaled");
    builder.node("Add", &[&scaled, "power_mean_w"], "power_w");

    let names = FEATURE_NAMES[features].join(", ");
    let property = |key: &str, value: String| Property { key: key.to_owned(), value };
    Model {
        ir_version: IR_VERSION,
        producer_name: PRODUCER.to_owned(),
        producer_version: env!("CARGO_PKG_VERSION").to_owned(),
        graph: Some(Graph {
            node: builder.nodes,
            name: network.card().name.clone(),
            initializer: builder.constants,
            doc_string: format!("features, in SI units: {names}; output: power in watt"),
            input: vec![value("features", inputs)],
            output: vec![value("power_w", 1)],
        }),
        opset_import: vec![Opset { domain: String::new(), version: OPSET }],
        metadata_props: vec![
            property("joulebus_hash", format!("{:016x}", network.hash())),
            property(METADATA, metadata.to_owned()),
        ],
    }
}

#[derive(Default)]
struct Builder {
    nodes: Vec<Node>,
    constants: Vec<Tensor>,
}

impl Builder {
    fn constant(&mut self, name: &str, dims: &[i64], values: &[f32]) {
        self.constants.push(Tensor {
            dims: dims.to_vec(),
            data_type: FLOAT,
            name: name.to_owned(),
            raw_data: values.iter().flat_map(|value| value.to_le_bytes()).collect(),
        });
    }

    /// Adds a node. Returns the name of its output.
    fn node(&mut self, op_type: &str, inputs: &[&str], output: &str) -> String {
        self.nodes.push(Node {
            input: inputs.iter().map(ToString::to_string).collect(),
            output: vec![output.to_owned()],
            name: format!("make_{output}"),
            op_type: op_type.to_owned(),
            attribute: Vec::new(),
        });
        output.to_owned()
    }

    fn dense(&mut self, inputs: &[&str], output: &str) -> String {
        let output = self.node("Gemm", inputs, output);
        if let Some(node) = self.nodes.last_mut() {
            node.attribute.push(Attribute { name: "transB".to_owned(), i: 1, r#type: INTEGER });
        }
        output
    }

    /// x·½·(1 + erf(x/√2)).
    fn gelu(&mut self, input: &str, number: usize) -> String {
        let name = |part: &str| format!("{part}.{number}");
        let argument = self.node("Mul", &[input, "sqrt_half"], &name("argument"));
        let erf = self.node("Erf", &[&argument], &name("erf"));
        self.half_above(input, &erf, number)
    }

    /// x·½·(1 + tanh(x·(linear + cubic·x²))).
    fn gelu_tanh(&mut self, input: &str, number: usize) -> String {
        let name = |part: &str| format!("{part}.{number}");
        let square = self.node("Mul", &[input, input], &name("square"));
        let bent = self.node("Mul", &[&square, "cubic"], &name("bent"));
        let slope = self.node("Add", &[&bent, "linear"], &name("slope"));
        let argument = self.node("Mul", &[input, &slope], &name("argument"));
        let tanh = self.node("Tanh", &[&argument], &name("tanh"));
        self.half_above(input, &tanh, number)
    }

    /// x·½·(1 + share).
    fn half_above(&mut self, input: &str, share: &str, number: usize) -> String {
        let name = |part: &str| format!("{part}.{number}");
        let above = self.node("Add", &[share, "one"], &name("above"));
        let doubled = self.node("Mul", &[input, &above], &name("doubled"));
        self.node("Mul", &[&doubled, "half"], &name("gelu"))
    }
}

fn value(name: &str, width: i64) -> ValueInfo {
    let dim = [Size::Any("n".to_owned()), Size::Fixed(width)];
    let dim = dim.map(|value| Dimension { value: Some(value) });
    ValueInfo {
        name: name.to_owned(),
        r#type: Some(Type {
            tensor_type: Some(TensorType {
                elem_type: FLOAT,
                shape: Some(Shape { dim: dim.to_vec() }),
            }),
        }),
    }
}

#[cfg(test)]
mod tests {
    use std::collections::HashMap;

    use super::*;
    use joulebus_predictor::Features;
    use joulebus_testkit_fleets::exact;

    fn shipped(name: &str) -> Network {
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../configs/models");
        let bytes = std::fs::read(format!("{folder}/{name}.safetensors")).expect("it ships");
        Network::from_safetensors(&bytes).expect("it ships")
    }

    fn floats(tensor: &Tensor) -> Vec<f64> {
        let (words, _) = tensor.raw_data.as_chunks::<4>();
        let floats = words.iter().map(|word| f64::from(f32::from_le_bytes(*word)));
        floats.collect()
    }

    /// Evaluates a graph for one row, operator by operator as ONNX defines them.
    fn run(graph: &Graph, row: Vec<f64>) -> f64 {
        let constants = graph.initializer.iter();
        let mut values: HashMap<&str, Vec<f64>> =
            constants.map(|tensor| (tensor.name.as_str(), floats(tensor))).collect();
        values.insert("features", row);
        for node in &graph.node {
            let inputs: Vec<&Vec<f64>> = node.input.iter().map(|name| &values[&**name]).collect();
            // The second operand has the length of the first, or is a scalar.
            let each = |operation: fn(f64, f64) -> f64| {
                let second = inputs[1].iter().cycle();
                let pairs = inputs[0].iter().zip(second);
                pairs.map(|(a, b)| operation(*a, *b)).collect()
            };
            let output = match node.op_type.as_str() {
                "Sub" => each(|a, b| a - b),
                "Mul" => each(|a, b| a * b),
                "Add" => each(|a, b| a + b),
                "Tanh" => inputs[0].iter().map(|x| libm::tanh(*x)).collect(),
                "Relu" => inputs[0].iter().map(|x| x.max(0.0)).collect(),
                "Erf" => inputs[0].iter().map(|x| libm::erf(*x)).collect(),
                "Gemm" => {
                    assert_eq!(node.attribute[0].name, "transB");
                    let rows = inputs[1].chunks(inputs[0].len()).zip(inputs[2]);
                    let dot = |row: &[f64]| -> f64 {
                        row.iter().zip(inputs[0]).map(|(w, x)| w * x).sum()
                    };
                    rows.map(|(row, bias)| dot(row) + bias).collect()
                }
                other => panic!("{other}"),
            };
            values.insert(&node.output[0], output);
        }
        let [power_w] = values["power_w"][..] else { panic!("one number a row") };
        power_w
    }

    #[test]
    fn the_graph_gives_the_forecasts_of_the_network() {
        for (name, activation) in [
            ("gternal-sim", Activation::GeluErf),
            ("gternal-sim-power", Activation::GeluErf),
            ("gternal-sim", Activation::GeluTanh),
            ("gternal-sim", Activation::Relu),
        ] {
            let shipped = shipped(name);
            let mut parameters = shipped.parameters().clone();
            parameters.activation = activation;
            let network = Network::new(parameters, shipped.card().clone()).expect("still sound");
            let bytes = model(&network, "{}").encode_to_vec();
            let graph = Model::decode(&*bytes).expect("own bytes").graph.expect("a graph");
            let (min, max) = {
                let range = &network.card().training_range;
                (range.min, range.max)
            };
            for step in 0..20_u16 {
                let share = |feature: usize| f32::from((step * 7 + feature as u16 * 3) % 20) / 20.0;
                let row: Features = std::array::from_fn(|feature| {
                    min[feature] + (max[feature] - min[feature]) * share(feature)
                });
                let read = &row[network.feature_set().range()];
                let by_graph = run(&graph, read.iter().map(|x| f64::from(*x)).collect());
                let slow = exact::forecast_w(&network, &row);
                assert!((by_graph - slow).abs() < 1e-6, "{name}: {by_graph} {slow}");
            }
        }
    }
}
