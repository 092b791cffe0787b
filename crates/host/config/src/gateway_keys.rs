//! Keys of the files of bridges, links and webhooks.

use crate::key::DefaultValue::{Flag, Integer, Number, Required, Text, Unset};
use crate::key::File::{Bridge, Link, Webhooks};
use crate::key::{DefaultValue, Key, TextRule, ValueKind};
use crate::keys::{int, key, num, of};

#[rustfmt::skip]
const fn bridge(path: &'static str, kind: ValueKind, unit: &'static str, default: DefaultValue, doc: &'static str) -> Key {
    of(Bridge, key(path, kind, unit, default, doc))
}

#[rustfmt::skip]
const fn link(path: &'static str, kind: ValueKind, unit: &'static str, default: DefaultValue, doc: &'static str) -> Key {
    of(Link, key(path, kind, unit, default, doc))
}

#[rustfmt::skip]
const fn hook(path: &'static str, kind: ValueKind, default: DefaultValue, doc: &'static str) -> Key {
    of(Webhooks, key(path, kind, "", default, doc))
}

const fn any(words: &'static str) -> ValueKind {
    ValueKind::Text(TextRule::Any(words))
}

const fn texts(rule: TextRule, min: usize, max: usize) -> ValueKind {
    ValueKind::Texts { rule, min, max }
}

const FILE: ValueKind = ValueKind::Text(TextRule::File);
const LINK_NAME: ValueKind = ValueKind::Text(TextRule::Link);
const WEB: ValueKind = ValueKind::Text(TextRule::Web);
const TOPIC: ValueKind = any("topic like \"fleet/{robot}/power\"");
const UNIT: ValueKind = any("unit like \"mW\"");
const VALUE: ValueKind = any("name of a value like \"power_w\"");
const HOLDS_S: ValueKind = num(0.01..=3_600.0);
const EVERY_S: ValueKind = num(0.02..=3_600.0);
const CURRENT: ValueKind = ValueKind::Choice(&["discharge_negative", "discharge_positive"]);
const POWER_OF: ValueKind = ValueKind::Choice(&["load", "battery"]);
const ADDRESSES: ValueKind =
    texts(TextRule::Any("\"tls/host:port\" or \"tcp/host:port\""), 0, usize::MAX);

/// Every key of a bridge's file.
#[rustfmt::skip]
pub(crate) const BRIDGE: &[Key] = &[
    bridge("bridge.name", ValueKind::Text(TextRule::Source), "", Text("bridge"), "Name of the source, stable over restarts."),
    bridge("bridge.command_holds_s", HOLDS_S, "s", Number(0.5), "Time for which a command applies if no other one comes."),
    bridge("bridge.command_expired", ValueKind::Choice(&["unknown", "stops"]), "", Text("unknown"),
        "What a robot does when its command has expired: its controller stops it, or nobody knows."),
    bridge("bridge.reading_holds_s", HOLDS_S, "s", Number(2.0), "Time for which a reading is repeated if no other one comes."),
    bridge("bridge.silent_after_s", HOLDS_S, "s", Number(3.0), "Silence after which nothing is published of a robot."),
    bridge("bridge.accept", texts(TextRule::Findings, 0, usize::MAX), "", Unset, "Implausible findings that are not told."),
    bridge("robots.*", ValueKind::Ids, "", Required, "Id of the robot of this name, or a range of ids with {id} in the name."),
    bridge("mqtt.broker", any("host:port"), "", Required, "Host and port of the broker."),
    bridge("mqtt.client_id", ValueKind::Text(TextRule::Level), "", Unset,
        "Client id. Without it joulebus-FLEET-NAME. Two clients of one id throw each other out."),
    bridge("mqtt.username", any("user name"), "", Unset, "User name of the broker, with password_file."),
    bridge("mqtt.password_file", FILE, "", Unset, "File with the password, mode 0600."),
    bridge("mqtt.version", ValueKind::Choice(&["3.1.1", "5"]), "", Unset,
        "Version of MQTT. Without it 5, and 3.1.1 with a broker that does not know 5."),
    bridge("mqtt.tls.ca", FILE, "", Required, "Certificate authorities of the broker, PEM. The key turns TLS on."),
    bridge("mqtt.tls.certificate", FILE, "", Unset, "Certificate that the bridge shows the broker, PEM."),
    bridge("mqtt.tls.key", FILE, "", Unset, "Key of the certificate, mode 0600."),
    bridge("mqtt.keep_alive_s", int(5..=3_600), "s", Integer(10), "Keep-alive interval of the connection."),
    bridge("mqtt.max_payload_bytes", int(1..=8 << 20), "bytes", Integer(65_536), "Longest payload that is read. Longer ones are counted."),
    bridge("mqtt.read.topic", TOPIC, "", Required, "Topic to read, with {robot} or robot_at. The characters + and # are wildcards."),
    bridge("mqtt.read.robot_at", any("JSON pointer or name"), "", Unset, "Where the document names the robot."),
    bridge("mqtt.read.fields.v|vy|omega|power|voltage|current|soc.at", any("JSON pointer or name"), "", Required,
        "Where the number stands in the document. Empty means the whole payload."),
    bridge("mqtt.read.fields.v|vy|omega|power|voltage|current|soc.unit", UNIT, "", Unset, "Unit of the number. Without it the unit of the SI."),
    bridge("mqtt.read.fields.v|vy|omega|power|voltage|current|soc.negate", ValueKind::Flag, "", Flag(false), "Turns the sign."),
    bridge("mqtt.read.fields.v|vy|omega|power|voltage|current|soc.unknown", ValueKind::Scalars, "", Unset, "Values that mean \"not known\"."),
    bridge("mqtt.read.fields.charging|full|swapped|off.at", any("JSON pointer or name"), "", Required, "Where the state stands in the document."),
    bridge("mqtt.read.fields.charging|full|swapped|off.is", ValueKind::Scalars, "", Unset, "Values that mean yes. Without it true."),
    bridge("mqtt.read.fields.charging|full|swapped|off.unknown", ValueKind::Scalars, "", Unset, "Values that mean \"not known\"."),
    bridge("mqtt.read.fields.power_of", POWER_OF, "", Text("load"), "What the power is: what the robot consumes, or what its battery gives."),
    bridge("mqtt.read.fields.power_of_current", ValueKind::Flag, "", Flag(false), "The power is voltage times current."),
    bridge("mqtt.vda5050.topic", TOPIC, "", Required, "Topic of the state by VDA 5050."),
    bridge("mqtt.vda5050.current", CURRENT, "", Text("discharge_positive"), "Sign of batteryCurrent, which the standard does not state."),
    bridge("mqtt.write.what", ValueKind::Choice(&["forecast", "budget", "outlook", "alarms", "alarm_changes", "status"]), "", Required, "What is written."),
    bridge("mqtt.write.topic", TOPIC, "", Required, "Topic to write, with {fleet} and {robot}."),
    bridge("mqtt.write.every_s", EVERY_S, "s", Unset, "Time between two messages. Without it 1, of budgets 5."),
    bridge("mqtt.write.retain", ValueKind::Flag, "", Unset, "Whether the broker keeps the newest. Without it budgets, alarms and status."),
    bridge("ros2.domain_id", int(0..=232), "", Unset, "ROS domain. Without it the variable ROS_DOMAIN_ID, else 0."),
    bridge("ros2.networks", texts(TextRule::Any("IPv4 address"), 0, usize::MAX), "", Unset, "Addresses of this host that DDS uses. Without it all."),
    bridge("ros2.use_sim_time", ValueKind::Flag, "", Flag(false), "Whether samples have the time of a simulation, as /clock states it."),
    bridge("ros2.what_if", any("service like \"/joulebus/what_if\""), "", Unset,
        "Service that answers questions about plans. Without it there is none."),
    bridge("ros2.acknowledge", any("service like \"/joulebus/acknowledge\""), "", Unset,
        "Service that acknowledges alarms. Without it there is none."),
    bridge("ros2.read.topic", TOPIC, "", Required, "Topic to read, absolute, with {robot}."),
    bridge("ros2.read.type", any("type like \"sensor_msgs/msg/BatteryState\""), "", Required, "Type of its messages."),
    bridge("ros2.read.current", CURRENT, "", Unset, "Sign of a battery's current. Without it discharge_negative, as the message is defined."),
    bridge("ros2.read.percentage_unit", UNIT, "", Unset, "Unit of a battery's percentage: share, or % for drivers that count to 100."),
    bridge("ros2.read.power_of", POWER_OF, "", Unset, "What voltage times current is. Without it battery."),
    bridge("ros2.read.power_of_current", ValueKind::Flag, "", Unset, "Whether voltage times current is read. Without it true."),
    bridge("ros2.read.says", ValueKind::Choice(&["off", "swapped"]), "", Unset, "Of a std_msgs/msg/Bool: the robot is switched off, or its battery was exchanged."),
    bridge("ros2.read.pack_wh", num(0.001..=1e9), "Wh", Unset, "Where a robot has several packs: the energy of this one from full to empty. Topics with it are summed."),
    bridge("ros2.write.what", ValueKind::Choice(&["forecast", "budget", "outlook", "value", "diagnostics"]), "", Required, "What is written."),
    bridge("ros2.write.topic", TOPIC, "", Unset, "Topic to write. Without it the usual topic."),
    bridge("ros2.write.every_s", EVERY_S, "s", Number(1.0), "Time between two messages."),
    bridge("ros2.write.value", VALUE, "", Unset, "With what = \"value\": the value."),
];

/// Every key of a link's file.
#[rustfmt::skip]
pub(crate) const LINK: &[Key] = &[
    link("name", LINK_NAME, "", Required, "Name of this host's link, unique in the fleet. With TLS it is the common name in the certificate."),
    link("workers", texts(TextRule::Link, 2, 4), "", Unset,
        "With standbys: names of the links of all workers, the same on all hosts, the preferred leader first."),
    link("network.mode", ValueKind::Choice(&["peer", "client"]), "", Text("peer"), "Whether the link meets other links, or a zenoh router."),
    link("network.connect", ADDRESSES, "", Unset, "Addresses of other links, or of a router."),
    link("network.listen", ADDRESSES, "", Unset, "Addresses that this host listens on. Without it nothing listens."),
    link("network.unencrypted", ValueKind::Flag, "", Flag(false), "Allows addresses of other hosts without TLS: everybody on that network can read and forge."),
    link("network.tls.ca", FILE, "", Required, "Certificate of the fleet's own certificate authority."),
    link("network.tls.certificate", FILE, "", Required, "Certificate of this host."),
    link("network.tls.key", FILE, "", Required, "Private key of this host, mode 0600."),
    link("worker.take.from", LINK_NAME, "", Required, "Name of the link whose samples are taken."),
    link("worker.take.robots", ValueKind::Robots, "ids", Unset, "Robots that it speaks for. Without it all."),
    link("samples.to", LINK_NAME, "", Unset, "Name of the worker's link. With standbys workers names them."),
    link("follow.worker", LINK_NAME, "", Unset, "Name of the worker's link. With standbys workers names them."),
    link("follow.services", ValueKind::Words(&["diagnostics", "budgets", "plan_states", "outlooks", "ticks"]), "", Unset,
        "Services besides forecasts. Without it all but ticks."),
    link("follow.every", int(1..=3_600), "ticks", Integer(1), "The frames of every n-th tick are taken."),
    link("follow.robots", ValueKind::Robots, "ids", Unset, "Robots to follow. Without it all."),
    link("lease.endpoints", texts(TextRule::Any("\"https://host:port\""), 1, 16), "", Required, "Addresses of the members of etcd."),
    link("lease.ttl_s", int(2..=60), "s", Integer(3), "Time without a sign of life after which a host has lost its lease."),
    link("lease.prefix", ValueKind::Text(TextRule::Prefixes), "", Text("joulebus/"), "Prefix of the keys in etcd."),
    link("lease.ca", FILE, "", Unset, "Certificate of etcd's authority. Without it the authority of [network]."),
    link("lease.certificate", FILE, "", Unset, "Certificate of this host, with key."),
    link("lease.key", FILE, "", Unset, "Private key of this host, mode 0600."),
    link("lease.user", any("user name"), "", Unset, "Name of etcd's user, with password."),
    link("lease.password", FILE, "", Unset, "File with the password of etcd's user, mode 0600."),
];

/// Every key of a file of webhooks.
#[rustfmt::skip]
pub(crate) const WEBHOOKS: &[Key] = &[
    hook("webhook.address", WEB, Unset, "Address that alarms are posted to."),
    hook("webhook.address_file", FILE, Unset, "Instead of address: file with it, mode 0600. Addresses of chats are secret."),
    hook("webhook.ca", FILE, Unset, "Authorities that the receiver's certificate may be of, PEM. Without it Mozilla's."),
    hook("webhook.page", WEB, Unset, "Address of the page of joulebus serve --http, as its readers reach it: texts link to it."),
    hook("webhook.secret_file", FILE, Unset,
        "File with a secret, mode 0600: requests are signed with it as Standard Webhooks says. Base64 of 24 to 64 bytes."),
];
