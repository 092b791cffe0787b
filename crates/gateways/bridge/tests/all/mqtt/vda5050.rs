//! Vehicles of VDA 5050, and the master that gets their states with the energy forecast.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use rumqttc::QoS;
use serde_json::{Value, json};

use super::broker::{Broker, mosquitto};
use crate::fleet::Fleet;

fn state(number: u64) -> Value {
    json!({
        "headerId": number, "version": "3.0.0", "serialNumber": "r1", "orderId": "order 7",
        "velocity": {"vx": 0.1, "omega": 0.2},
        "powerSupply": {
            "stateOfCharge": 80, "batteryVoltage": 4.0, "charging": false,
            "batteryCurrent": 1.1 + (number % 5) as f64 * 1e-3,
        },
        "information": [{"infoType": "load", "infoLevel": "DEBUG"}],
    })
}

/// The information that the bridge has added to a state.
fn added(state: &Value) -> Option<&Value> {
    let mut information = state["information"].as_array()?.iter();
    information.find(|information| information["infoType"] == "joulebus.outlook")
}

#[test]
fn a_master_gets_each_state_with_the_energy_forecast_in_its_information() {
    let Some(program) = mosquitto() else { return };
    let (fleet, broker) = (Fleet::new(), Broker::start(&program, "allow_anonymous true"));
    let mut worker = fleet.worker();
    let address = broker.address();
    let text = format!(
        r#"
        [robots]
        "r{{id}}" = "1-3"
        [mqtt]
        broker = "{address}"
        [[mqtt.vda5050]]
        topic = "vehicles/v3/KIT/{{robot}}/state"
        pass_on = "uagv/v3/KIT/{{robot}}/state"
        "#
    );
    let refused = text.replace("uagv/v3", "vehicles/v3");
    let mut check = fleet.command(&refused);
    check.arg("--check");
    let checked = joulebus_testkit::Child::spawn("bridge", check).wait();
    assert_eq!(checked.exit_code(), 2, "{checked:?}");
    assert!(checked.errors().contains("reads it too"), "{checked:?}");

    let mut bridge = fleet.bridge(&text, "connected to ");
    let master = broker.client("master", "uagv/#");
    let vehicle = broker.client("vehicle", "nothing").client;
    let stop = Arc::<AtomicBool>::default();
    let stopped = Arc::clone(&stop);
    let driving = std::thread::spawn(move || {
        let numbers = (1..).take_while(|_| !stopped.load(Ordering::Relaxed));
        for number in numbers {
            let topic = "vehicles/v3/KIT/r1/state";
            let _ = vehicle.try_publish(topic, QoS::AtMostOnce, false, state(number).to_string());
            std::thread::sleep(Duration::from_millis(33));
        }
    });
    let topic = "uagv/v3/KIT/r1/state";
    master.wait_for(topic, |passed| added(passed).is_some());
    let messages = master.messages();
    let passed = messages.iter().rfind(|message| message.topic == topic).unwrap().json();
    let number = passed["headerId"].as_u64().unwrap();
    let mut same = passed.clone();
    same["information"].as_array_mut().unwrap().pop();
    assert_eq!(same, state(number), "nothing else changes");
    let added = added(&passed).unwrap();
    assert_eq!(added["infoLevel"], "INFO");
    let references = added["infoReferences"].as_array().unwrap().iter();
    let joules =
        references.clone().find(|reference| reference["referenceKey"] == "energy_60s_j").unwrap();
    let joules: f64 = joules["referenceValue"].as_str().unwrap().parse().unwrap();
    assert!((10.0..1_000.0).contains(&joules), "{added}");
    // Without a worker the master gets the states as they are.
    worker.kill();
    master.forget();
    master.wait_for(topic, |passed| {
        passed["information"] == json!([{"infoType": "load", "infoLevel": "DEBUG"}])
    });
    stop.store(true, Ordering::Relaxed);
    driving.join().unwrap();
    let report = bridge.stop().json();
    assert_eq!(report["not_written"], 0, "{report}");
    let mut worker = fleet.worker();
    worker.stop();
    assert_eq!(fleet.stale_files(), Vec::<PathBuf>::new());
}
