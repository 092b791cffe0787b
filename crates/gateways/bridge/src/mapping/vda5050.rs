//! The energy forecast in a vehicle's state by VDA 5050. Its array `information` is for
//! visualization and debugging: a master may not control by it.

use serde_json::{Value, json};

use crate::mapping::outgoing::{Object, What};

/// Name of the information.
const TYPE: &str = "joulebus.outlook";
const DESCRIPTION: &str =
    "Energy that the vehicle will draw if it goes on as it does (J), and time to empty (s)";
/// Values that say of whom and when, which the state has already.
const NOT_INFORMATION: [&str; 2] = ["robot", "name"];

/// Adds the outlook of a vehicle to the information of its state, if it is known. Other members of
/// the state stay as they are.
pub(crate) fn add_outlook(state: &mut Value, values: &Object) {
    let names = What::Outlook.usual().iter().filter(|name| !NOT_INFORMATION.contains(name));
    let known = names.filter_map(|name| Some((name, values.get(*name)?.as_f64()?)));
    let references: Vec<Value> = known
        .map(|(name, value)| json!({"referenceKey": name, "referenceValue": value.to_string()}))
        .collect();
    let is_known = references.iter().any(|it| it["referenceKey"] == "energy_1s_j");
    let Value::Object(state) = state else { return };
    let information = state.entry("information").or_insert_with(|| json!([]));
    if let (Value::Array(information), true) = (information, is_known) {
        information.push(json!({
            "infoType": TYPE,
            "infoReferences": references,
            "infoDescription": DESCRIPTION,
            "infoLevel": "INFO",
        }));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn values(value: &Value) -> Object {
        value.as_object().cloned().unwrap_or_default()
    }

    #[test]
    fn an_outlook_is_one_more_information_and_an_unknown_one_is_none() {
        let known = values(
            &json!({"robot": 7, "name": "0001", "energy_1s_j": 40.5, "energy_60s_hi_j": null}),
        );
        let other = json!({"infoType": "other", "infoLevel": "DEBUG"});
        let mut state = json!({"orderId": "a", "information": [other]});
        add_outlook(&mut state, &known);
        assert_eq!((&state["orderId"], &state["information"][0]), (&json!("a"), &other));
        let added = &state["information"][1];
        let references = json!([{"referenceKey": "energy_1s_j", "referenceValue": "40.5"}]);
        assert_eq!((&added["infoReferences"], &added["infoLevel"]), (&references, &json!("INFO")));
        let mut state = json!({"orderId": "a"});
        add_outlook(&mut state, &values(&json!({"usable_j": 7.0})));
        assert_eq!(state, json!({"orderId": "a", "information": []}));
        for mut odd in [json!([1]), json!({"information": "text"})] {
            let before = odd.clone();
            add_outlook(&mut odd, &known);
            assert_eq!(odd, before);
        }
    }
}
