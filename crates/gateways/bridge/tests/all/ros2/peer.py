"""A participant of ROS 2's DDS by Eclipse Cyclone DDS, or of its zenoh by Eclipse zenoh, told by lines of JSON what to say. Prints what it hears.

Of zenoh it speaks as rmw_zenoh_cpp does in ROS domain 7, and also prints the tokens of the graph.

    peer.py DOMAIN|tcp/HOST:PORT|to/HOST:PORT < {"say": topic, "type": name, "fields": {...}, "hz": 30} | {"hush": topic} | {"hear": topic, "type": name}
        | {"call": service, "type": name, "fields": {...}}: twice a second, until "hush"
        | {"clock": rate, "from_s": time}: a simulated clock, 100 steps of rate / 100 s a second

A battery's state whose order has "stamped" has the simulated time in its header.
"""

import dataclasses
import json
import math
import struct
import sys
import threading
import time

import zenoh
import zenoh.ext
from cyclonedds.core import Qos, Policy
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import array, float32, float64, int32, int64, sequence, uint8, uint32, uint64
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from dataclasses import dataclass


@dataclass
class Time_(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):
    sec: int32 = 0
    nanosec: uint32 = 0


@dataclass
class Header_(IdlStruct, typename="std_msgs::msg::dds_::Header_"):
    stamp: Time_ = dataclasses.field(default_factory=Time_)
    frame_id: str = ""


@dataclass
class Clock_(IdlStruct, typename="rosgraph_msgs::msg::dds_::Clock_"):
    clock: Time_ = dataclasses.field(default_factory=Time_)


@dataclass
class BatteryState_(IdlStruct, typename="sensor_msgs::msg::dds_::BatteryState_"):
    header: Header_ = dataclasses.field(default_factory=Header_)
    voltage: float32 = math.nan
    temperature: float32 = math.nan
    current: float32 = math.nan
    charge: float32 = math.nan
    capacity: float32 = math.nan
    design_capacity: float32 = math.nan
    percentage: float32 = math.nan
    power_supply_status: uint8 = 0
    power_supply_health: uint8 = 0
    power_supply_technology: uint8 = 0
    present: bool = True
    cell_voltage: sequence[float32] = dataclasses.field(default_factory=list)
    cell_temperature: sequence[float32] = dataclasses.field(default_factory=list)
    location: str = ""
    serial_number: str = ""


@dataclass
class Vector3_(IdlStruct, typename="geometry_msgs::msg::dds_::Vector3_"):
    x: float64 = 0.0
    y: float64 = 0.0
    z: float64 = 0.0


@dataclass
class Twist_(IdlStruct, typename="geometry_msgs::msg::dds_::Twist_"):
    linear: Vector3_ = dataclasses.field(default_factory=Vector3_)
    angular: Vector3_ = dataclasses.field(default_factory=Vector3_)


@dataclass
class TwistStamped_(IdlStruct, typename="geometry_msgs::msg::dds_::TwistStamped_"):
    header: Header_ = dataclasses.field(default_factory=Header_)
    twist: Twist_ = dataclasses.field(default_factory=Twist_)


@dataclass
class Quaternion_(IdlStruct, typename="geometry_msgs::msg::dds_::Quaternion_"):
    x: float64 = 0.0
    y: float64 = 0.0
    z: float64 = 0.0
    w: float64 = 1.0


@dataclass
class Pose_(IdlStruct, typename="geometry_msgs::msg::dds_::Pose_"):
    position: Vector3_ = dataclasses.field(default_factory=Vector3_)
    orientation: Quaternion_ = dataclasses.field(default_factory=Quaternion_)


def nothing():
    return [0.0] * 36


@dataclass
class PoseWithCovariance_(IdlStruct, typename="geometry_msgs::msg::dds_::PoseWithCovariance_"):
    pose: Pose_ = dataclasses.field(default_factory=Pose_)
    covariance: array[float64, 36] = dataclasses.field(default_factory=nothing)


@dataclass
class TwistWithCovariance_(IdlStruct, typename="geometry_msgs::msg::dds_::TwistWithCovariance_"):
    twist: Twist_ = dataclasses.field(default_factory=Twist_)
    covariance: array[float64, 36] = dataclasses.field(default_factory=nothing)


@dataclass
class Odometry_(IdlStruct, typename="nav_msgs::msg::dds_::Odometry_"):
    header: Header_ = dataclasses.field(default_factory=Header_)
    child_frame_id: str = "base_link"
    pose: PoseWithCovariance_ = dataclasses.field(default_factory=PoseWithCovariance_)
    twist: TwistWithCovariance_ = dataclasses.field(default_factory=TwistWithCovariance_)


@dataclass
class Float64_(IdlStruct, typename="std_msgs::msg::dds_::Float64_"):
    data: float64 = 0.0


@dataclass
class KeyValue_(IdlStruct, typename="diagnostic_msgs::msg::dds_::KeyValue_"):
    key: str = ""
    value: str = ""


@dataclass
class DiagnosticStatus_(IdlStruct, typename="diagnostic_msgs::msg::dds_::DiagnosticStatus_"):
    level: uint8 = 0
    name: str = ""
    message: str = ""
    hardware_id: str = ""
    values: sequence[KeyValue_] = dataclasses.field(default_factory=list)


@dataclass
class DiagnosticArray_(IdlStruct, typename="diagnostic_msgs::msg::dds_::DiagnosticArray_"):
    header: Header_ = dataclasses.field(default_factory=Header_)
    status: sequence[DiagnosticStatus_] = dataclasses.field(default_factory=list)


@dataclass
class Gid_(IdlStruct, typename="rmw_dds_common::msg::dds_::Gid_"):
    data: array[uint8, 16] = dataclasses.field(default_factory=lambda: [0] * 16)


@dataclass
class NodeEntitiesInfo_(IdlStruct, typename="rmw_dds_common::msg::dds_::NodeEntitiesInfo_"):
    node_namespace: str = ""
    node_name: str = ""
    reader_gid_seq: sequence[Gid_] = dataclasses.field(default_factory=list)
    writer_gid_seq: sequence[Gid_] = dataclasses.field(default_factory=list)


@dataclass
class ParticipantEntitiesInfo_(IdlStruct, typename="rmw_dds_common::msg::dds_::ParticipantEntitiesInfo_"):
    gid: Gid_ = dataclasses.field(default_factory=Gid_)
    node_entities_info_seq: sequence[NodeEntitiesInfo_] = dataclasses.field(default_factory=list)


@dataclass
class Outlook_(IdlStruct, typename="joulebus_msgs::msg::dds_::Outlook_"):
    header: Header_ = dataclasses.field(default_factory=Header_)
    horizon_s: array[float32, 4] = dataclasses.field(default_factory=lambda: [0.0] * 4)
    energy_j: array[float32, 4] = dataclasses.field(default_factory=lambda: [0.0] * 4)
    energy_lo_j: array[float32, 4] = dataclasses.field(default_factory=lambda: [0.0] * 4)
    energy_hi_j: array[float32, 4] = dataclasses.field(default_factory=lambda: [0.0] * 4)
    usable_j: float32 = 0.0
    time_to_empty_s: float32 = 0.0
    time_to_empty_lo_s: float32 = 0.0
    time_to_empty_hi_s: float32 = 0.0
    capacity_j: float32 = 0.0
    capacity_sd_j: float32 = 0.0
    time_to_80_s: float32 = 0.0
    time_to_full_s: float32 = 0.0


@dataclass
class Answer_(IdlStruct, typename="joulebus_msgs::msg::dds_::Answer_"):
    robot: str = ""
    verdict: uint8 = 0
    reason: str = ""
    duration_s: float32 = 0.0
    energy_j: float32 = 0.0
    energy_lo_j: float32 = 0.0
    energy_hi_j: float32 = 0.0
    left_j: float32 = 0.0
    left_lo_j: float32 = 0.0
    probability: float32 = 0.0
    margin_j: float32 = 0.0
    limiting_leg: int32 = 0
    turn_back_s: float32 = 0.0
    caveats: str = ""


# Requests and responses begin with the header that rmw_cyclonedds_cpp adds.
@dataclass
class WhatIf_Request_(IdlStruct, typename="joulebus_msgs::srv::dds_::WhatIf_Request_"):
    guid: uint64 = 0
    number: int64 = 0
    robots: sequence[str] = dataclasses.field(default_factory=list)
    coverage: float32 = 0.9
    path: sequence[Vector3_] = dataclasses.field(default_factory=list)
    speed_mps: sequence[float64] = dataclasses.field(default_factory=list)
    dwell_s: sequence[float64] = dataclasses.field(default_factory=list)
    load_w: sequence[float64] = dataclasses.field(default_factory=list)
    time_s: sequence[float64] = dataclasses.field(default_factory=list)
    return_to_start: bool = False
    idle_s: float32 = 0.0
    candidates: uint32 = 1
    period_s: float32 = 0.0
    v_mps: sequence[float32] = dataclasses.field(default_factory=list)
    omega_radps: sequence[float32] = dataclasses.field(default_factory=list)


@dataclass
class WhatIf_Response_(IdlStruct, typename="joulebus_msgs::srv::dds_::WhatIf_Response_"):
    guid: uint64 = 0
    number: int64 = 0
    refused: str = ""
    tick: uint64 = 0
    age_s: float32 = 0.0
    answers: sequence[Answer_] = dataclasses.field(default_factory=list)


@dataclass
class Acknowledge_Request_(IdlStruct, typename="joulebus_msgs::srv::dds_::Acknowledge_Request_"):
    guid: uint64 = 0
    number: int64 = 0
    robot: str = ""
    alarm: str = ""
    by: str = ""


@dataclass
class Acknowledge_Response_(IdlStruct, typename="joulebus_msgs::srv::dds_::Acknowledge_Response_"):
    guid: uint64 = 0
    number: int64 = 0
    success: bool = False
    message: str = ""


# What is no battery's state, though its name says so: it ends too early, and it has a text of 4 GB.
@dataclass
class Truncated_(IdlStruct, typename="sensor_msgs::msg::dds_::BatteryState_"):
    header: Header_ = dataclasses.field(default_factory=Header_)
    voltage: float32 = 24.0


@dataclass
class Huge_(IdlStruct, typename="sensor_msgs::msg::dds_::BatteryState_"):
    stamp: Time_ = dataclasses.field(default_factory=Time_)
    length: uint32 = 0xFFFFFFFF
    voltage: float32 = 24.0


TYPES = {
    name.rstrip("_"): found
    for name, found in list(globals().items())
    if isinstance(found, type) and issubclass(found, IdlStruct) and found is not IdlStruct
}


def made(kind, fields):
    """A message of these fields. Others have their defaults. A text that says nan is NaN."""
    inner = {field.name: field.type for field in dataclasses.fields(kind)}

    def value(name, found):
        if isinstance(found, dict):
            return made(inner[name], found)
        if isinstance(found, list) and found and isinstance(found[0], dict):
            return [made(Vector3_, point) for point in found]
        return float(found) if found in ("nan", "inf", "-inf") else found

    return kind(**{name: value(name, found) for name, found in fields.items()})


def plain(found):
    """As JSON: NaN is null, and bytes are their digits."""
    if isinstance(found, bytes):
        return found.hex()
    if dataclasses.is_dataclass(found):
        return {field.name: plain(getattr(found, field.name)) for field in dataclasses.fields(found)}
    if isinstance(found, (list, tuple)):
        return [plain(one) for one in found]
    return None if isinstance(found, float) and not math.isfinite(found) else found


TELLING = threading.Lock()


def tell(found):
    """One line, whichever thread has it."""
    with TELLING:
        print(json.dumps(found), flush=True)


def qos(order):
    reliable = Policy.Reliability.Reliable(1_000_000_000)
    return Qos(
        Policy.Reliability.BestEffort if order.get("best_effort") else reliable,
        Policy.Durability.TransientLocal if order.get("transient_local") else Policy.Durability.Volatile,
        Policy.History.KeepLast(order.get("depth", 10)),
    )


class Dds:
    def __init__(self, domain):
        self.participant = DomainParticipant(int(domain))

    def topic(self, name, kind, order):
        name = "rt" + name if name.startswith("/") else name
        return Topic(self.participant, name, kind, qos=qos(order))

    def writer(self, name, kind, order):
        return DataWriter(self.participant, self.topic(name, kind, order), qos=qos(order))

    def reader(self, name, kind, order):
        return DataReader(self.participant, self.topic(name, kind, order), qos=qos(order))

    def caller(self, name, request, response, _):
        """Calls the service, and prints responses to these calls."""
        writer = self.writer(f"rq{name}Request", request, {})
        reader = self.reader(f"rr{name}Reply", response, {})
        ours, asked = id(writer), 0

        def call(message):
            nonlocal asked
            for heard in reader.take(100):
                if dataclasses.is_dataclass(heard) and heard.guid == ours and 0 < heard.number <= asked:
                    tell({"topic": name, "message": plain(heard)})
            asked += 1
            writer.write(dataclasses.replace(message, guid=ours, number=asked))

        return call


class Zenoh:
    """Keys, tokens and attachments as rmw_zenoh_cpp's design and sources have them."""

    def __init__(self, address):
        config = zenoh.Config()
        listens = address.startswith("tcp/")
        config.insert_json5("listen/endpoints" if listens else "connect/endpoints", json.dumps(["tcp" + address[address.index("/") :]]))
        config.insert_json5("scouting/multicast/enabled", "false")
        self.session = zenoh.open(config)
        self.count = 0

        def change(token):
            is_alive = token.kind == zenoh.SampleKind.PUT
            tell({"topic": "@", "message": {"token": str(token.key_expr), "alive": is_alive}})

        self.kept = [self.session.liveliness().declare_subscriber("@ros2_lv/7/**", change, history=True)]

    def key(self, name, kind, order):
        return f"7/{name.strip('/')}/{kind.__idl_typename__.replace('.', '::')}/{order.get('hash', 'RIHS01_0')}"

    def writer(self, name, kind, order):
        self.count += 1
        key, sent = self.key(name, kind, order), 0
        typename, digest = key.rsplit("/", 2)[1:]
        entity = f"{self.session.zid()}/0/{self.count}/MP/%/%/talker/{name.replace('/', '%')}"
        token = f"@ros2_lv/7/{entity}/{typename}/{digest}/::,10:,:,:,,"
        self.kept.append(self.session.liveliness().declare_token(token))
        publisher = self.session.declare_publisher(key)

        class Writer:
            def write(_, message):
                nonlocal sent
                sent += 1
                attached = struct.pack("<qqB16s", sent, time.time_ns(), 16, b"peer".ljust(16))
                publisher.put(message.serialize(), attachment=attached)

        return Writer()

    def reader(self, name, kind, order):
        def hear(sample):
            number, sent_ns, length, gid = struct.unpack("<qqB16s", sample.attachment.to_bytes())
            age_s = (time.time_ns() - sent_ns) * 1e-9
            attached = {"number": number, "age_s": age_s, "length": length, "gid": gid.hex()}
            message = plain(kind.deserialize(sample.payload.to_bytes()))
            tell({"topic": name, "message": {**message, "attached": attached}})

        key = self.key(name, kind, order)
        if order.get("transient_local"):
            history = zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=order.get("depth", 10))
            self.kept.append(zenoh.ext.declare_advanced_subscriber(self.session, key, hear, history=history, subscriber_detection=True))
        else:
            self.kept.append(self.session.declare_subscriber(key, hear))

    def caller(self, name, request, response, order):
        key = f"7/{name.strip('/')}/{request.__idl_typename__.replace('.', '::').replace('_Request', '')}"
        asked = 0

        def call(message):
            nonlocal asked
            asked += 1
            number, gid = asked, b"caller".ljust(16)

            def hear(reply):
                heard, sent_ns, _, to = struct.unpack("<qqB16s", reply.ok.attachment.to_bytes())
                if (heard, to) == (number, gid) and abs(time.time_ns() - sent_ns) < 60e9:
                    payload = reply.ok.payload.to_bytes()
                    tell({"topic": name, "message": plain(response.deserialize(payload[:4] + bytes(16) + payload[4:]))})

            payload = message.serialize()
            self.session.get(
                f"{key}/{order['hash']}",
                hear,
                payload=payload[:4] + payload[20:],
                attachment=struct.pack("<qqB16s", number, time.time_ns(), 16, gid),
                target=zenoh.QueryTarget.ALL_COMPLETE,
                consolidation=zenoh.ConsolidationMode.NONE,
            )

        return call


def main():
    place = sys.argv[1]
    middleware = Zenoh(place) if "/" in place else Dds(place)
    lock, says, hears, calls = threading.Lock(), {}, [], {}
    clock = {"ns": 0, "step_ns": 0, "write": None}

    def now():
        return Time_(*divmod(clock["ns"], 1_000_000_000))

    def speak():
        turn = 0
        while True:
            with lock:
                if clock["step_ns"]:
                    clock["ns"] += clock["step_ns"]
                    clock["write"](Clock_(now()))
                for writer, message, every, stamped in says.values():
                    if turn % every == 0:
                        if stamped:
                            # A monitor that never changes would raise an alarm.
                            current = message.current * (1 + turn % 5 * 1e-3)
                            message = dataclasses.replace(message, header=Header_(now()), current=current)
                        writer(message)
            turn += 1
            time.sleep(0.01)

    def listen():
        while True:
            with lock:
                readers = list(hears)
            for topic, reader in readers:
                for heard in reader.take(100):
                    if dataclasses.is_dataclass(heard):
                        tell({"topic": topic, "message": plain(heard)})
            time.sleep(0.005)

    for work in (speak, listen):
        threading.Thread(target=work, daemon=True).start()
    tell({"ready": True})
    for line in sys.stdin:
        order = json.loads(line)
        if "hush" in order:
            with lock:
                says.pop(order["hush"], None)
            continue
        if "clock" in order:
            with lock:
                clock["write"] = clock["write"] or middleware.writer("/clock", Clock_, order).write
                clock["ns"] = round(order.get("from_s", clock["ns"] * 1e-9) * 1e9)
                clock["step_ns"] = round(order["clock"] * 1e7)
            tell({"topic": "/clock", "message": {"s": clock["ns"] * 1e-9}})
            continue
        name = order.get("say") or order.get("hear") or order["call"]
        if "call" in order:
            request, response = (TYPES[order["type"] + part] for part in ("_Request", "_Response"))
            message = made(request, order["fields"])
            calls[name] = calls.get(name) or middleware.caller(name, request, response, order)
            with lock:
                says[name] = (calls[name], message, 50, False)
            continue
        kind = TYPES[order["type"]]
        if "say" in order:
            message = made(kind, order.get("fields", {}))
            every = max(1, round(100 / order.get("hz", 30)))
            with lock:
                before = says.get(name)
                writer = before[0] if before else middleware.writer(name, kind, order).write
                says[name] = (writer, message, every, order.get("stamped"))
        else:
            reader = middleware.reader(name, kind, order)
            if reader:
                with lock:
                    hears.append((name, reader))


main()
