//! The energy forecast in a vehicle's state by VDA 5050. Its array `information` is for
//! visualization and debugging: a master may not control by it.

use serde_json::{Value, json};

use crate::mapping::outgoing::{Object, What};

const TYPE: &str = "joulebus.outlook";
const DESCRIPTION: &str =
    "Energy that the vehicle will draw if it goes on as it does (J), and time to empty (s)";
/// Values that identify the robot and the time, which the state has already.
const NOT_INFORMATION: [&str; 2] = ["robot", "name"];

/// Adds the outlook of a vehicle to the information of its state, if it is known. Other members of
/// the state stay as they are.
pub(crate) fn add_outlook(state: &mut Value, values: &Object) {
    let names = What::Outlook.usual().filter(|name| !NOT_INFORMATION.contains(name));
    // As digits of JSON: a stamp keeps its nanoseconds, and a tiny energy has no 300 zeros.
    let known = names.filter_map(|name| Some((name, values.get(name)?.as_number()?)));
    let references: Vec<Value> = known
        .map(|(name, value)| json!({"referenceKey": name, "referenceValue": value.to_string()}))
        .collect();
    let is_known = references.iter().any(|reference| reference["referenceKey"] == "energy_1s_j");
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
    use joulebus_plausibility::Expired;

    use super::*;
    use crate::mapping::intake::{Holds, Intake};
    use crate::mapping::route::State;
    use crate::shared::{MAX_STATES, Shared};

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

    /// By the schemas of versions 1 to 3, which limit no length.
    #[test]
    fn an_information_is_short_whatever_the_robot_and_its_values() {
        let known = |value: f64| {
            let names = What::Outlook.usual();
            let mut known: Object = names.map(|name| ((*name).to_owned(), json!(value))).collect();
            known.insert("name".to_owned(), json!("n".repeat(128)));
            known
        };
        for value in [0.0, -0.0, 1e-300, f64::MAX, f64::MIN, 1.0 / 3.0] {
            let mut state = json!({});
            add_outlook(&mut state, &known(value));
            let [added] = state["information"].as_array().unwrap().as_slice() else {
                panic!("{state}")
            };
            let members: Vec<&String> = added.as_object().unwrap().keys().collect();
            let allowed = ["infoDescription", "infoLevel", "infoReferences", "infoType"];
            assert_eq!(members, allowed);
            assert!(added["infoType"].is_string() && added["infoDescription"].is_string());
            let references = added["infoReferences"].as_array().unwrap();
            assert_eq!(references.len(), 12 + 4 + 1, "energies, budget and stamp: {state}");
            for reference in references {
                assert_eq!(reference.as_object().unwrap().len(), 2, "{reference}");
                assert!(reference["referenceKey"].is_string(), "{reference}");
                let found: f64 = reference["referenceValue"].as_str().unwrap().parse().unwrap();
                assert_eq!(found.to_bits(), value.to_bits(), "{reference}");
            }
            assert!(state.to_string().len() < 2_000, "{state}");
        }
        let mut stamped = known(1.0);
        stamped.insert("stamp_unix_ns".to_owned(), json!(1_795_752_489_493_637_967_u64));
        let mut state = json!({});
        add_outlook(&mut state, &stamped);
        let first = &state["information"][0]["infoReferences"][0];
        assert_eq!(first["referenceValue"], "1795752489493637967");
        // JSON has neither: the values count as unknown.
        for value in [f64::NAN, f64::INFINITY] {
            let mut state = json!({});
            add_outlook(&mut state, &known(value));
            assert_eq!(state, json!({"information": []}));
        }
    }

    #[test]
    fn a_thousand_states_wait_and_what_is_dropped_beyond_them_is_reported() {
        let holds = Holds { command_ns: 1, expired: Expired::Unknown, reading_ns: 1, silent_ns: 1 };
        let shared = Shared::new(Intake::new(holds, false, []), None);
        let states = |robots: std::ops::Range<usize>| {
            let of = |robot| State {
                robot: robot as u32,
                topic: "state".to_owned(),
                document: json!({"headerId": robot}),
            };
            robots.map(of).collect::<Vec<_>>()
        };
        assert_eq!(shared.add_states(states(0..MAX_STATES)), 0);
        assert_eq!(shared.add_states(states(MAX_STATES..MAX_STATES + 7)), 7);
        let kept = shared.take_states();
        assert_eq!((kept.len(), kept[0].robot), (MAX_STATES, 7));
    }
}
