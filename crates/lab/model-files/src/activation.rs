//! The activation that a file states.

use super::names::tokens;
use super::{Entry, EntryValue, FindError};
use joulebus_predictor::Activation;

/// The statement of one entry.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Stated {
    /// GELU, of either form.
    AnyGelu,
    One(Activation),
}

/// The activation of the hidden layers, if the file states one: the class of its layers, their
/// setting `approximate`, or an entry such as `activation`, `config.act_fn` or `activations.0`.
pub(super) fn stated(entries: &[Entry]) -> Result<Option<Activation>, FindError> {
    let mut found: Option<(&Entry, Stated)> = None;
    for entry in entries {
        let Some(stated) = statement(entry)? else {
            continue;
        };
        found = match found {
            None => Some((entry, stated)),
            Some((first, one)) => match (one, stated) {
                (one, other) if one == other => Some((first, one)),
                (Stated::AnyGelu, Stated::One(other)) if other != Activation::Relu => {
                    Some((entry, stated))
                }
                (Stated::One(one), Stated::AnyGelu) if one != Activation::Relu => {
                    Some((first, Stated::One(one)))
                }
                _ => {
                    return Err(FindError::ActivationsDiffer {
                        first: shown(first),
                        second: shown(entry),
                    });
                }
            },
        };
    }
    Ok(found.map(|(_, stated)| match stated {
        // GELU alone is by the error function, as in PyTorch.
        Stated::AnyGelu => Activation::GeluErf,
        Stated::One(activation) => activation,
    }))
}

fn shown(entry: &Entry) -> String {
    match &entry.value {
        EntryValue::Text(text) => format!("{:?} is {text:?}", entry.path),
        _ => format!("{:?}", entry.path),
    }
}

/// The statement of an entry, if it is about the activation of hidden layers.
fn statement(entry: &Entry) -> Result<Option<Stated>, FindError> {
    let path = entry.path.as_str();
    let unsupported =
        |found: &str| FindError::Activation { path: path.to_owned(), found: found.to_owned() };
    let class = path.rsplit_once("(activation.").and_then(|(_, class)| class.strip_suffix(')'));
    if let Some(class) = class {
        return named(class).map(Some).ok_or_else(|| unsupported(class));
    }
    let last = path.rsplit('.').find(|part| part.parse::<usize>().is_err());
    let words = tokens(last.unwrap_or_default());
    let word = |known: &[&str]| words.iter().any(|word| known.contains(&word.as_str()));
    let EntryValue::Text(found) = &entry.value else {
        return Ok(None);
    };
    if words == ["approximate"] {
        return match found.as_str() {
            "none" => Ok(Some(Stated::One(Activation::GeluErf))),
            "tanh" => Ok(Some(Stated::One(Activation::GeluTanh))),
            _ => Err(unsupported(found)),
        };
    }
    if !word(&["activation", "activations", "act", "nonlinearity", "nonlinearities"]) {
        return Ok(None);
    }
    if word(&["output", "out", "final", "last"]) {
        return match found.to_lowercase().as_str() {
            "identity" | "linear" | "none" | "" => Ok(None),
            _ => Err(FindError::OutputActivation { path: path.to_owned(), found: found.clone() }),
        };
    }
    named(found).map(Some).ok_or_else(|| unsupported(found))
}

/// The activation of this name: as in configurations, as a class, or as a call of one.
fn named(text: &str) -> Option<Stated> {
    let words = tokens(text);
    let words: Vec<&str> = words
        .iter()
        .map(String::as_str)
        .filter(|word| {
            let places =
                ["torch", "nn", "modules", "activation", "functional", "f", "jax", "class"];
            !places.contains(word)
        })
        .collect();
    let one = |activation| Some(Stated::One(activation));
    match words.as_slice() {
        ["gelu"] => Some(Stated::AnyGelu),
        ["gelu", "erf" | "exact" | "none" | "python"]
        | ["gelu", "approximate", "none" | "false"] => one(Activation::GeluErf),
        ["gelu", "tanh" | "new" | "fast" | "approx" | "approximate"]
        | ["gelu", "pytorch", "tanh"]
        | ["gelu", "approximate", "tanh" | "true"] => one(Activation::GeluTanh),
        ["relu"] | ["relu", "inplace", _] => one(Activation::Relu),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn text(path: &str, value: &str) -> Entry {
        Entry { path: path.to_owned(), value: EntryValue::Text(value.to_owned()) }
    }

    #[test]
    fn every_usual_spelling_of_an_activation_is_understood() {
        use Activation::{GeluErf, GeluTanh, Relu};
        for (path, value, expected) in [
            ("activation", "relu", Relu),
            ("config.activation", "ReLU", Relu),
            ("hidden_act", "nn.ReLU(inplace=True)", Relu),
            ("activations.0", "torch.nn.functional.relu", Relu),
            ("act_fn", "gelu", GeluErf),
            ("activation", "GELU(approximate='none')", GeluErf),
            ("activation", "gelu_erf", GeluErf),
            ("meta.activation_function", "gelu_tanh", GeluTanh),
            ("hidden_act", "gelu_new", GeluTanh),
            ("nonlinearity", "gelu_pytorch_tanh", GeluTanh),
            ("net.1.approximate", "tanh", GeluTanh),
        ] {
            let found = stated(&[text(path, value)]);
            assert_eq!(found.expect("known"), Some(expected), "{path}: {value}");
        }
        let none = stated(&[text("output_activation", "linear"), text("action", "tanh")]);
        assert_eq!(none.expect("about something else"), None);
    }

    #[test]
    fn what_cannot_run_is_refused_by_name_and_never_replaced() {
        for value in
            ["tanh", "Tanh()", "sigmoid", "silu", "leaky_relu", "relu6", "quick_gelu", "elu"]
        {
            let error = stated(&[text("activation", value)]).expect_err(value).to_string();
            assert!(error.contains(value) && error.contains("gelu_tanh, relu"), "{error}");
        }
        let error = stated(&[text("output_activation", "relu")]).expect_err("no such output");
        assert!(error.to_string().contains("output"), "{error}");
    }

    #[test]
    fn statements_must_agree_and_the_more_exact_one_counts() {
        let both = stated(&[text("activation", "gelu"), text("net.1.approximate", "tanh")]);
        assert_eq!(both.expect("they agree"), Some(Activation::GeluTanh));
        let both = stated(&[text("net.1.approximate", "tanh"), text("activation", "gelu")]);
        assert_eq!(both.expect("they agree"), Some(Activation::GeluTanh));
        for other in ["relu", "gelu_tanh"] {
            let differ = stated(&[text("a.activation", "gelu_erf"), text("activation", other)]);
            let error = differ.expect_err("they differ").to_string();
            assert!(error.contains("a.activation") && error.contains(other), "{error}");
        }
    }
}
