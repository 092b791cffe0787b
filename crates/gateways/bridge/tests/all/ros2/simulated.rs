//! A simulation whose time passes at another rate, stands, and begins anew, with each peer.

use joulebus_testkit::{Child, free_port};
use serde_json::{Value, json};

use super::peer::{Peer, RosDomain, cyclonedds};
use super::{
    BATTERY, COMMANDS, DIAGNOSTICS, FORECAST, discharging, file_with, keys, lines_of, rmw, status,
    twist,
};
use crate::fleet::Fleet;

const METERED_S: &str = "what = \"value\"\nvalue = \"metered_s\"";

fn file(keys: &str) -> String {
    let keys = format!("{keys}\nuse_sim_time = true");
    file_with(&keys, &[BATTERY, COMMANDS], &[FORECAST, METERED_S, DIAGNOSTICS])
}

/// Time of the header, s.
fn stamp_s(message: &Value) -> i64 {
    message["header"]["stamp"]["sec"].as_i64().unwrap()
}

/// Runs the robot r1 through a simulation, and ends the bridge.
fn simulation(peer: &mut Peer, bridge: &mut Child) {
    let (forecast, metered) = ("/r1/joulebus/forecast", "/r1/joulebus/metered_s");
    let battery = "/fleet/r1/battery_state";
    peer.subscribe(forecast, "BatteryState");
    peer.subscribe(metered, "Float64");
    peer.subscribe("/diagnostics", "DiagnosticArray");
    let stamped = json!({
        "say": battery, "type": "BatteryState", "fields": discharging(), "stamped": true,
    });
    peer.order(&stamped);
    peer.publish("/fleet/r1/cmd_vel", "Twist", &twist());
    bridge.wait_for_line("no message of /clock in 5 s, and without simulated time no samples");
    let is_reported = |array: &Value, text: &str| {
        let worker = status(array, "joulebus: worker of lab");
        worker["message"].as_str().is_some_and(|message| message.ends_with(text))
            && worker["level"] == 1
    };
    let early = peer.wait_for("/diagnostics", 0, |array| is_reported(array, ", no /clock"));
    assert_eq!(stamp_s(&early), 0, "{early}");
    let mut forecasts = 0;
    peer.each(forecast, |_| forecasts += 1);
    assert_eq!(forecasts, 0);

    peer.order(&json!({"clock": 3.0, "from_s": 1_000.0, "type": "Clock"}));
    bridge.wait_for_line("the simulated time goes on at 10");
    peer.wait_for(forecast, 0, |forecast| {
        stamp_s(forecast) >= 1_010 && forecast["current"].is_number()
    });
    peer.wait_for(metered, 0, |metered| {
        metered["data"].as_f64().is_some_and(|metered_s| metered_s > 5.0)
    });

    peer.order(&json!({"clock": 0.0, "type": "Clock"}));
    bridge.wait_for_line("the simulated time stands at 1");
    peer.wait_for("/diagnostics", 0, |array| is_reported(array, ", /clock stands"));
    let stood = peer.wait_for(metered, peer.received(), |metered| metered["data"].is_number());
    let again = peer.wait_for(metered, peer.received() + 5, |metered| metered["data"].is_number());
    assert_eq!(stood["data"], again["data"], "a pause takes no energy");

    let from = peer.received();
    peer.order(&json!({"clock": 1.0, "type": "Clock"}));
    peer.wait_for(forecast, from, |forecast| forecast["current"].is_number());
    peer.order(&json!({"clock": 1.0, "from_s": 5.0, "type": "Clock"}));
    bridge.wait_for_line("what robots said before is dropped");
    peer.wait_for(forecast, from, |forecast| {
        (5..1_000).contains(&stamp_s(forecast)) && forecast["current"].is_number()
    });
    // A driver by its wall clock. Of r1 a message may have come before the clock's own reset.
    let fields = json!({"header": {"stamp": {"sec": 1_700_000_000}}, "voltage": 4.0});
    peer.publish("/fleet/r2/battery_state", "BatteryState", &fields);
    bridge.wait_for_line("wrong_stamp: r2");
    let report = bridge.end().json();
    let wrong = lines_of(&report, "wrong_stamp")[0]["names"].as_array().cloned();
    assert!(wrong.is_some_and(|names| names.contains(&json!("r2"))), "{report}");
}

#[test]
fn samples_have_the_time_of_a_simulation_of_cyclone_dds() {
    let Some(python) = cyclonedds() else { return };
    let (fleet, domain) = (Fleet::new(), RosDomain::take());
    let mut worker = fleet.worker();
    let mut bridge = fleet.bridge(&file(&keys(&domain)), "7 topics read");
    let mut peer = Peer::start(&python, &domain);
    simulation(&mut peer, &mut bridge);
    worker.stop();
}

#[test]
fn samples_have_the_time_of_a_simulation_over_zenoh() {
    let Some(python) = cyclonedds() else { return };
    let (fleet, address) = (Fleet::new(), format!("tcp/127.0.0.1:{}", free_port()));
    let mut worker = fleet.worker();
    let mut peer = Peer::within(&python, &address);
    let mut bridge = rmw::bridge(&fleet, &address, &file("domain_id = 7"), "7 topics read");
    simulation(&mut peer, &mut bridge);
    worker.stop();
}
