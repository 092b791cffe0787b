//! Messages of hosts that are no links or are not trusted: they are refused, counted and harmless.

use zenoh::Wait as _;

use crate::host::{FOLLOW, Host, free_address, of_other, of_worker};

pub(crate) fn session(connect: &[&str], listen: &[&str]) -> zenoh::Session {
    let mut config = zenoh::Config::default();
    for (key, value) in [
        ("mode", "\"peer\"".to_owned()),
        ("connect/endpoints", format!("{connect:?}")),
        ("listen/endpoints", format!("{listen:?}")),
        ("scouting/multicast/enabled", "false".to_owned()),
        ("scouting/gossip/enabled", "false".to_owned()),
    ] {
        config.insert_json5(key, &value).unwrap();
    }
    zenoh::open(config).wait().unwrap()
}

/// Keys of a real stream, of a stream without a sender, and of one without a receiver.
const STRANGE: [&str; 3] = [
    "joulebus/lab/outputs/base/desk",
    "joulebus/lab/samples/edge/base",
    "joulebus/lab/ask/outputs/base/nobody",
];

/// Forgeries that resemble a real message more and more.
fn forgeries(real: &[u8]) -> Vec<Vec<u8>> {
    let mut all = vec![
        vec![],
        vec![0; 64],
        vec![0xff; 5_000],
        real[..real.len() - 1].to_vec(),
        real.to_vec(),
    ];
    for at in [0, 8, 12, 16, 32, 40, 48, 56, 64, 68, 80, 88, 96, 112, 130, 200] {
        let mut forged = real.to_vec();
        if let Some(byte) = forged.get_mut(at) {
            *byte ^= 0x80;
        }
        all.push(forged);
    }
    all.push([real, &vec![7; 100_000][..]].concat());
    all
}

#[test]
fn damaged_repeated_and_foreign_messages_are_counted_and_the_stream_goes_on() {
    let (here, there) = (Host::new(), Host::new());
    let address = free_address();
    let _worker = here.worker();
    let _robots = here.robots(&["--robots", "3"]);
    let mut base = here.link(&of_worker(&address, &["edge"]));
    // Peers do not forward messages, so the stranger connects to both.
    let of_desk = free_address();
    let listen = format!("[network]\nlisten = [\"{of_desk}\"]");
    let text = of_other("desk", &address, FOLLOW).replacen("[network]", &listen, 1);
    let mut desk = there.link(&text);
    let stranger = session(&[&address, &of_desk], &[]);
    // Real messages of the stream, recorded and sent again, damaged and intact.
    let intercepted = stranger.declare_subscriber("joulebus/lab/**").wait().unwrap();
    let mut planner = there.planner();
    let mut real = Vec::new();
    while real.len() < 60 {
        let sample = intercepted.recv().unwrap();
        real.push((
            sample.key_expr().as_str().to_owned(),
            sample.payload().to_bytes().into_owned(),
        ));
        planner.frame();
    }
    // The recorder would receive its own messages.
    drop(intercepted);
    let mut last = (0, 0);
    for (key, real) in real.iter().cycle().take(150) {
        for forged in forgeries(real) {
            stranger.put(key, forged).wait().unwrap();
        }
        for key in STRANGE {
            stranger.put(key, vec![1, 2, 3]).wait().unwrap();
        }
        let frame = planner.frame();
        assert!((frame.epoch, frame.tick) > last, "backwards: {last:?}");
        last = (frame.epoch, frame.tick);
    }
    drop(stranger);
    planner.fresh();
    planner.leave();
    let desk = desk.end();
    assert_eq!(desk.code(), Some(3), "refused messages are reported: {desk:?}");
    let taken = desk.json()["taken"][0].clone();
    assert!(taken["refused"]["wrong length"].as_u64().unwrap() > 10, "{taken}");
    assert!(taken["refused"]["another release"].as_u64().unwrap() > 1, "{taken}");
    assert!(taken["refused"]["another fleet"].as_u64().unwrap() > 1, "{taken}");
    let base = base.end();
    assert_eq!(base.code(), Some(3), "{base:?}");
}
