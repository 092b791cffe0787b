"""A participant of ROS 2's DDS by Eclipse Cyclone DDS, told by lines of JSON what to say; prints what it hears.

    peer.py DOMAIN < {"say": topic, "type": name, "fields": {...}, "hz": 30} | {"hush": topic} | {"hear": topic, "type": name}
"""

import dataclasses
import json
import math
import sys
import threading
import time

from cyclonedds.core import Qos, Policy
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import array, float32, float64, int32, sequence, uint8, uint32
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
    """A message of these fields; others have their defaults. A text that says nan is NaN."""
    inner = {field.name: field.type for field in dataclasses.fields(kind)}

    def value(name, found):
        if isinstance(found, dict):
            return made(inner[name], found)
        return float(found) if found in ("nan", "inf", "-inf") else found

    return kind(**{name: value(name, found) for name, found in fields.items()})


def plain(found):
    """As JSON: NaN is null."""
    if dataclasses.is_dataclass(found):
        return {field.name: plain(getattr(found, field.name)) for field in dataclasses.fields(found)}
    if isinstance(found, (list, tuple)):
        return [plain(one) for one in found]
    return None if isinstance(found, float) and not math.isfinite(found) else found


def qos(order):
    reliable = Policy.Reliability.Reliable(1_000_000_000)
    return Qos(
        Policy.Reliability.BestEffort if order.get("best_effort") else reliable,
        Policy.Durability.TransientLocal if order.get("transient_local") else Policy.Durability.Volatile,
        Policy.History.KeepLast(10),
    )


def main():
    participant = DomainParticipant(int(sys.argv[1]))
    lock, says, hears = threading.Lock(), {}, []

    def speak():
        turn = 0
        while True:
            with lock:
                for writer, message, every in says.values():
                    if turn % every == 0:
                        writer.write(message)
            turn += 1
            time.sleep(0.01)

    def listen():
        while True:
            with lock:
                readers = list(hears)
            for topic, reader in readers:
                for heard in reader.take(100):
                    if dataclasses.is_dataclass(heard):
                        print(json.dumps({"topic": topic, "message": plain(heard)}), flush=True)
            time.sleep(0.005)

    for work in (speak, listen):
        threading.Thread(target=work, daemon=True).start()
    print(json.dumps({"ready": True}), flush=True)
    for line in sys.stdin:
        order = json.loads(line)
        if "hush" in order:
            with lock:
                says.pop(order["hush"], None)
            continue
        name = order.get("say") or order["hear"]
        kind = TYPES[order["type"]]
        topic = Topic(participant, "rt" + name, kind, qos=qos(order))
        if "say" in order:
            message = made(kind, order.get("fields", {}))
            every = max(1, round(100 / order.get("hz", 30)))
            with lock:
                before = says.get(name)
                writer = before[0] if before else DataWriter(participant, topic, qos=qos(order))
                says[name] = (writer, message, every)
        else:
            reader = DataReader(participant, topic, qos=qos(order))
            with lock:
                hears.append((name, reader))


main()
