"""A recorded controller of Go2 as a process of its own, to be killed: it writes the number of its cycles into a file.

python killed_recording.py RECORDING COUNTER [CYCLES PER SECOND]
"""

import mmap
import struct
import sys
import time
from pathlib import Path

from wbc_controller.controller.controller import Controller
from wbc_controller.middleware.codec import encode, message
from wbc_controller.middleware.topics import counterpart
from wbc_controller.middleware.transports.memory import MemoryBus, MemoryTransport
from wbc_controller.nodes.clock import MonotonicClock
from wbc_controller.nodes.controller_service import make_loop
from wbc_controller.nodes.wiring import controller_endpoints
from wbc_controller.recording.recorder import Recorder
from wbc_controller.settings.config import load
from wbc_controller.simulation.mock_robot import MockRobot


def main(path: str, counter: str, rate: float) -> None:
    """Run until killed."""
    settings = load("go2").replace({"recorder.folder": str(Path(path).parent / "faults")}).settings
    recorder = Recorder(settings, Path(path), name="go2")
    controller = Controller(settings, preflight=False)
    topics = controller_endpoints(settings, controller.model)
    bus = MemoryBus()
    robot = MockRobot(controller.model, settings, MemoryTransport(bus))
    loop = make_loop(controller, MemoryTransport(bus), MonotonicClock(), topics, recorder=recorder)
    (command,) = [topic for topic in topics if topic.key == "command"]
    say = MemoryTransport(bus).advertise(counterpart(command))
    with Path(counter).open("r+b") as file, mmap.mmap(file.fileno(), 8) as shown:
        due = time.monotonic()
        number = 0
        while True:
            robot.publish()
            if number == 3:
                say(encode(message("std_msgs/msg/String", data="activate")))
            loop.cycle()
            robot.advance()
            number += 1
            shown[:] = struct.pack("<q", number)
            due = max(due + 1.0 / rate, time.monotonic() - 0.1)
            time.sleep(max(0.0, due - time.monotonic()))


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], float(sys.argv[3]) if len(sys.argv) > 3 else 500.0)
