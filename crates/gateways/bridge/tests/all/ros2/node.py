"""A node of ROS 2 by rclpy, told by the same lines of JSON as peer.py. Prints what it hears.

    node.py DOMAIN < {"say": topic, "type": name, "fields": {...}} | {"hear": topic, "type": name}
        | {"call": service, "type": name, "fields": {...}} | {"hush": name} | {"graph": node name}
"""

import json
import math
import os
import sys
import threading

os.environ["ROS_DOMAIN_ID"] = sys.argv[1]
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Point, Twist
from joulebus_msgs.msg import Outlook
from joulebus_msgs.srv import Acknowledge, WhatIf
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
from sensor_msgs.msg import BatteryState

TYPES = {kind.__name__: kind for kind in (Acknowledge, BatteryState, DiagnosticArray, Outlook, Twist, WhatIf)}


def fill(message, fields):
    for name, found in fields.items():
        if isinstance(found, dict):
            fill(getattr(message, name), found)
        elif isinstance(found, list) and found and isinstance(found[0], dict):
            setattr(message, name, [fill(Point(), point) for point in found])
        else:
            setattr(message, name, float(found) if found in ("nan", "inf", "-inf") else found)
    return message


def plain(found):
    """As JSON: NaN is null."""
    if hasattr(found, "get_fields_and_field_types"):
        return {name: plain(getattr(found, name)) for name in found.get_fields_and_field_types()}
    if isinstance(found, (str, bool, int)):
        return found
    if hasattr(found, "__iter__"):
        return [plain(one) for one in found]
    return float(found) if math.isfinite(found) else None


def tell(topic, message):
    print(json.dumps({"topic": topic, "message": message}), flush=True)


def main():
    rclpy.init()
    node = rclpy.create_node("peer")
    lock, says, publishers, clients, kept = threading.Lock(), {}, {}, {}, []

    def follow(order):
        if "hush" in order:
            says.pop(order["hush"], None)
            return
        if "graph" in order:
            name = order["graph"]

            def look():
                if name in node.get_node_names():
                    served = dict(node.get_service_names_and_types_by_node(name, "/"))
                    written = dict(node.get_publisher_names_and_types_by_node(name, "/"))
                    tell("graph", {"services": served, "writes": written})

            says["graph"] = look
            return
        kind = TYPES[order["type"]]
        if "hear" in order:
            topic = order["hear"]
            latched = QoSProfile(depth=order.get("depth", 10), durability=DurabilityPolicy.TRANSIENT_LOCAL)
            qos = latched if order.get("transient_local") else qos_profile_sensor_data
            kept.append(node.create_subscription(kind, topic, lambda it: tell(topic, plain(it)), qos))
        elif "say" in order:
            topic, message = order["say"], fill(kind(), order["fields"])
            publisher = publishers.get(topic) or node.create_publisher(kind, topic, qos_profile_sensor_data)
            publishers[topic] = publisher
            says[topic] = lambda: publisher.publish(message)
        else:
            name, request = order["call"], fill(kind.Request(), order["fields"])
            client = clients.get(name) or node.create_client(kind, name)
            clients[name] = client

            def call():
                if client.service_is_ready():
                    client.call_async(request).add_done_callback(lambda done: tell(name, plain(done.result())))

            says[name] = call

    orders = []

    def listen():
        for line in sys.stdin:
            with lock:
                orders.append(json.loads(line))
        os._exit(0)

    threading.Thread(target=listen, daemon=True).start()
    print(json.dumps({"ready": True}), flush=True)
    turn = 0

    def speak():
        nonlocal turn
        with lock:
            taken, orders[:] = list(orders), []
        for order in taken:
            follow(order)
        for name, say in list(says.items()):
            if name in publishers or turn % 15 == 0:
                say()
        turn += 1

    node.create_timer(1 / 30, speak)
    rclpy.spin(node)


main()
