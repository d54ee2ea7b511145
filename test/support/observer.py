"""A user in a process of its own: prints what it hears as lines of JSON, and sends the commands that it reads.

Run as ``python observer.py <robot>``; each line read is a word for the command topic. Printed are the states
of controller and guard as they change, and fifty times a second the robot's torques: the largest, the largest
difference from the damping of the guard, and their power.
"""

import contextlib
import json
import sys
import time

import numpy as np

from wbc_controller.middleware.codec import decode, encode, message
from wbc_controller.middleware.topics import counterpart
from wbc_controller.middleware.transports.dds import DdsTransport
from wbc_controller.nodes.wiring import topics_of
from wbc_controller.settings.files import find_configuration, load_settings

PAUSE = 0.02


def say(kind, **values):
    print(json.dumps({"at": time.monotonic(), "kind": kind, **values}), flush=True)


def main(robot):
    settings = load_settings(find_configuration(robot))
    transport = DdsTransport("observer")
    due = 0.0

    def state(kind):
        return lambda payload: say(kind, text=decode(payload, "std_msgs/msg/String").data)

    def joint_states(payload):
        nonlocal due
        if time.monotonic() < due:
            return
        due = time.monotonic() + PAUSE
        content = decode(payload, "sensor_msgs/msg/JointState")
        expected = -settings.guard.damping * content.velocity
        say(
            "robot",
            largest=float(np.max(np.abs(content.effort))),
            from_damping=float(np.max(np.abs(content.effort - expected))),
            power=float(content.effort @ content.velocity),
        )

    topics = {place: counterpart(topic) for place, topic in topics_of(settings).items()}
    transport.subscribe(topics["controller", "state", ""], state("controller"))
    transport.subscribe(topics["guard", "state", ""], state("guard"))
    transport.subscribe(topics["mock", "joint_states", ""], joint_states)
    publish = transport.advertise(topics["controller", "command", ""])
    with contextlib.suppress(KeyboardInterrupt):
        for line in sys.stdin:
            publish(encode(message("std_msgs/msg/String", data=line.strip())))
    transport.close()


if __name__ == "__main__":
    main(sys.argv[1])
