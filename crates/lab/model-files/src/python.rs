//! Exports a model as one Python file that needs NumPy only.

use std::fmt::Write as _;

use joulebus_predictor::Network;

use crate::arrays::{Array, CONSTANT_WEIGHT, arrays};
use crate::export::ExportError;

/// The module, with placeholders for the parts that differ between models.
const FILE: &str = include_str!("predictor.py");
/// Bytes of the model in a line of the file.
const LINE_BYTES: usize = 48;

/// The model as a Python module with the class `EnergyPredictor(path, period_s)`.
///
/// The period is that of the model's training data. One whose file does not state it demands it.
/// `reset`, `step` and `step_with_correction` work in mW and have the names of the paper's module
/// (arXiv 2603.13908). `predict` takes rows in SI units. It computes in double precision, so
/// forecasts differ by rounding.
///
/// # Errors
/// [`ExportError::ReadingAge`]: the network reads the readings' age, which the interface does not
/// have.
pub fn to_python(network: &Network) -> Result<String, ExportError> {
    let set = network.feature_set();
    if set.needs_freshness() {
        return Err(ExportError::ReadingAge);
    }
    let (mut shapes, mut hex, mut bytes) = ("{\n".to_owned(), String::new(), 0usize);
    for Array { name, shape, values } in arrays(network) {
        if name == CONSTANT_WEIGHT {
            continue;
        }
        let shape = shape.iter().map(|size| format!("{size},")).collect::<Vec<_>>().join(" ");
        // Writing to a string never fails.
        let _ = writeln!(shapes, "    \"{name}\": ({shape}),");
        for byte in values.iter().flat_map(|value| value.to_le_bytes()) {
            if bytes > 0 && bytes.is_multiple_of(LINE_BYTES) {
                hex.push('\n');
            }
            let _ = write!(hex, "{byte:02x}");
            bytes += 1;
        }
    }
    shapes.push('}');
    // A name may contain anything: it must not end the text that it stands in.
    let name: String = network
        .card()
        .name
        .chars()
        .filter(|c| c.is_ascii_graphic() && !"\\\"@".contains(*c))
        .collect();
    let period_s = network.card().period_s();
    let period_s = period_s.map_or("None".to_owned(), |period_s| period_s.to_string());
    let filled = [
        ("@NAME@", name),
        ("@HASH@", format!("{:016x}", network.hash())),
        ("@PERIOD_S@", period_s),
        ("@ACTIVATION@", network.parameters().activation.name().to_owned()),
        ("@INPUTS@", set.inputs().to_string()),
        ("@SHAPES@", shapes),
        ("@MODEL@", hex),
    ];
    let text = FILE.to_owned();
    Ok(filled.into_iter().fold(text, |text, (place, value)| text.replace(place, &value)))
}
