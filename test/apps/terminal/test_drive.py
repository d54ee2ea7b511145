"""Driving by keyboard: keys become velocities, and a terminal is restored."""

import contextlib
import os
import pty
import signal
import termios

import pytest
from command_line import wbc
from domains import own_domain
from forked import fork_wbc
from waiting import until

from wbc_controller.apps.terminal.keyboard import Drive
from wbc_controller.middleware.codec import decode, diagnostics, encode, message
from wbc_controller.middleware.transports.dds import DdsTransport
from wbc_controller.nodes.wiring import topics_of
from wbc_controller.settings.config import load

DOMAIN = own_domain()


@pytest.mark.parametrize(
    ("keys", "velocity"),
    [
        ("i", (0.2, 0.0, 0.0)),
        ("u", (0.2, 0.0, 0.3)),
        ("m", (-0.2, 0.0, -0.3)),
        ("L", (0.0, -0.2, 0.0)),
        ("a", (0.0, 0.2, 0.0)),
        ("\x1b[A", (0.2, 0.0, 0.0)),
        ("\x1bOD", (0.0, 0.0, 0.3)),
        ("iqq", (0.242, 0.0, 0.0)),
        ("jzq", (0.0, 0.0, 0.3)),
        ("ik", (0.0, 0.0, 0.0)),
        ("i ", (0.0, 0.0, 0.0)),
        ("i\x1b", (0.0, 0.0, 0.0)),
    ],
)
def test_keys(keys, velocity):
    assert Drive(0.2, 0.3).after(keys).velocity == pytest.approx(velocity)


@pytest.mark.parametrize(
    ("robot", "text"),
    [("g1", "standard input is not a terminal"), ("examples/a1.yaml", "a1.yaml cannot walk: its configuration")],
)
def test_refusals(robot, text):
    result = wbc("drive", robot, status=2)
    assert result.stderr.startswith("error: ")
    assert text in result.stderr


@contextlib.contextmanager
def controller_double():
    """Publish the state of a controller; yield its received velocities."""
    topics, received = topics_of(load("g1").settings), []
    velocity = topics["controller", "cmd_vel", ""]
    values = {"walking/phase": "double support", "walking/steps": "7"}
    with contextlib.closing(DdsTransport("wbc_controller", "/", DOMAIN, "LOCALHOST")) as transport:
        say, diagnose = (transport.advertise(topics["controller", key, ""]) for key in ("state", "diagnostics"))
        status = encode(diagnostics(1, 0, "wbc_controller: control loop", "active", "g1", values))

        def receive(payload):
            twist = decode(payload, velocity.type)
            received.append((twist.linear.x, twist.linear.y, twist.angular.z))

        transport.subscribe(velocity, receive)
        say(encode(message("std_msgs/msg/String", data="active")))
        yield received, lambda: diagnose(status)


@pytest.mark.live
@pytest.mark.parametrize("ending", ["Ctrl-C", signal.SIGTERM, "closed terminal"])
def test_driving_in_a_terminal(ending):
    outside, inside = pty.openpty()
    before = termios.tcgetattr(inside)
    surroundings = {**os.environ, "ROS_DOMAIN_ID": str(DOMAIN), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    shown = b""
    os.set_blocking(outside, False)

    def output():
        nonlocal shown
        with contextlib.suppress(BlockingIOError):
            shown += os.read(outside, 10_000)
        return shown.decode()

    with controller_double() as (received, diagnose):
        process = fork_wbc(surroundings, os.ttyname(inside), "drive", "g1", "--wait", "30")

        def shows(condition):
            def met():
                return (output() and condition()) or process.poll() is not None

            until(met, again=diagnose)
            assert condition(), output()

        try:
            shows(lambda: received)
            os.write(outside, b"i")
            shows(lambda: received[-1] == (0.2, 0.0, 0.0))
            shows(lambda: "forward 0.20, left 0.00 m/s, turn 0.00 rad/s | active | double support, 7 steps" in output())
            count = len(received)
            shows(lambda: len(received) >= count + 5)  # without further keys
            if ending == "Ctrl-C":
                os.write(outside, b"\x03")
            elif ending == "closed terminal":
                os.close(inside)
                os.close(outside)
            else:
                process.send_signal(ending)
            status = process.wait(60.0)
            until(lambda: received[-1] == (0.0, 0.0, 0.0))
            if ending != "closed terminal":
                assert termios.tcgetattr(inside) == before
                assert status == {"Ctrl-C": 0}.get(ending, 128 + signal.SIGTERM)
        finally:
            process.kill()
            process.wait()
