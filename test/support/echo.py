"""Two ends of the embedded DDS, for processes: one answers, the other asks."""

import threading
import time

from wbc_controller.middleware import topics
from wbc_controller.middleware.codec import encode, message
from wbc_controller.middleware.topics import Direction, Endpoint
from wbc_controller.middleware.transports.dds import DdsTransport

STRING = "std_msgs/msg/String"


def endpoint(name: str, qos: topics.Qos = topics.REQUEST, type_name: str = STRING) -> Endpoint:
    return Endpoint("test", "", name, type_name, Direction.IN, qos)


def text(content: str) -> bytes:
    return encode(message(STRING, data=content))


def echo(domain: int, discovery_range: str | None = "LOCALHOST") -> None:
    """Send back what comes on two topics, until told to stop."""
    done = threading.Event()
    transport = DdsTransport("echo", domain_id=domain, discovery_range=discovery_range)
    for question, answer, qos in (("/ping", "/pong", topics.REQUEST), ("/urdf", "/urdf_back", topics.LATCHED)):
        transport.subscribe(endpoint(question, qos), transport.advertise(endpoint(answer, qos)))
    transport.subscribe(endpoint("/stop"), lambda payload: done.set())
    done.wait(15)
    transport.close()


def ask(domain: int, patience: float) -> None:
    """Print whether an answer came in time."""
    heard: list[bytes] = []
    transport = DdsTransport("ask", domain_id=domain)
    transport.subscribe(endpoint("/pong"), heard.append)
    ping, end = transport.advertise(endpoint("/ping")), time.monotonic() + patience
    while time.monotonic() < end and not heard:
        ping(text("hello"))
        time.sleep(0.05)
    print(len(heard) > 0)
    transport.close()
