//! Safetensors of other programs: a PyTorch state dict with optional metadata.

use super::element::Element;
use super::entries::MAX_ENTRIES;
use super::{Container, Entry, EntryValue, ReadError, Tensor};
use safetensors::SafeTensors;
use safetensors::tensor::Dtype;

/// Maximum number of characters of a text that are kept.
const MAX_TEXT: usize = 200;

/// The tensors, and the metadata: numbers and lists of numbers as such, the rest as text.
pub(super) fn entries(bytes: &[u8]) -> Result<Vec<Entry>, ReadError> {
    let bad = |part: String, detail: String| ReadError::Part {
        container: Container::StateDict,
        part,
        detail,
    };
    let header = || format!("header, bytes 0 to {}", super::own::header_end(bytes));
    let read =
        SafeTensors::read_metadata(bytes).map_err(|error| bad(header(), error.to_string()))?;
    let file = SafeTensors::deserialize(bytes).map_err(|error| bad(header(), error.to_string()))?;
    let mut entries = Vec::new();
    for (path, text) in read.1.metadata().iter().flatten() {
        entries.push(Entry { path: path.clone(), value: stated(text) });
    }
    for (path, view) in file.iter() {
        let value = match element(view.dtype()) {
            Some(element) => EntryValue::Tensor(Tensor::dense(
                view.shape().to_vec(),
                element,
                view.data(),
                false,
                false,
            )),
            None => EntryValue::Other("a tensor of an element type that is not read"),
        };
        entries.push(Entry { path: path.to_owned(), value });
    }
    if entries.len() > MAX_ENTRIES {
        let found = entries.len();
        let detail = format!("found {found} entries, allowed: {MAX_ENTRIES}");
        return Err(bad(header(), detail));
    }
    // The order of the header's table varies from run to run.
    entries.sort_by(|a, b| a.path.cmp(&b.path));
    Ok(entries)
}

fn element(dtype: Dtype) -> Option<Element> {
    Some(match dtype {
        Dtype::F16 => Element::F16,
        Dtype::BF16 => Element::BF16,
        Dtype::F32 => Element::F32,
        Dtype::F64 => Element::F64,
        Dtype::I8 => Element::I8,
        Dtype::I16 => Element::I16,
        Dtype::I32 => Element::I32,
        Dtype::I64 => Element::I64,
        Dtype::U8 => Element::U8,
        Dtype::U16 => Element::U16,
        Dtype::U32 => Element::U32,
        Dtype::U64 => Element::U64,
        Dtype::BOOL => Element::Bool,
        _ => return None,
    })
}

fn stated(text: &str) -> EntryValue {
    match serde_json::from_str::<serde_json::Value>(text) {
        Ok(serde_json::Value::Number(number)) => match number.as_f64() {
            Some(number) => EntryValue::Number(number),
            None => EntryValue::Text(text.to_owned()),
        },
        Ok(serde_json::Value::Array(items)) => {
            let numbers: Option<Vec<f64>> = items.iter().map(serde_json::Value::as_f64).collect();
            match numbers {
                Some(numbers) if !numbers.is_empty() => {
                    EntryValue::Tensor(Tensor::from_numbers(vec![numbers.len()], numbers))
                }
                _ => EntryValue::Text(text.chars().take(MAX_TEXT).collect()),
            }
        }
        _ => EntryValue::Text(text.chars().take(MAX_TEXT).collect()),
    }
}
