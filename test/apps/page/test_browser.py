"""`wbc play` in a real browser: effects of each button, a handle, a pull and a slider on topics and the robot."""

# ruff: noqa: E402 - the package and its helpers are imported after the check for playwright

import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import time

import numpy as np
import pytest

playwright = pytest.importorskip("playwright.sync_api", reason="a browser is driven by playwright, of requirements/dev")

from browser import projected
from domains import own_domain

from wbc_controller.apps.page.drawing import GROUPS, camera
from wbc_controller.apps.page.meshes import build_meshes
from wbc_controller.apps.page.snapshot import Robot
from wbc_controller.apps.terminal.session import Session
from wbc_controller.controller.build.robot import make_model
from wbc_controller.settings.config import load

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
pytestmark = [pytest.mark.browser, pytest.mark.skipif(CHROMIUM is None, reason="no chromium or google-chrome")]
# A browser without a GPU uses both processors of a small computer. Slow motion keeps the torques in time.
CONFIG = load("g1").replace({"safety.state_timeout": 1.0})
SLOW_MOTION = "0.3"
SIZE = {"width": 1100, "height": 700}
#: Reduced resolution of viser's drawing, because the browser has no GPU here.
COARSE = "?fixedDpr=0.4"


@pytest.fixture(scope="module")
def playing(tmp_path_factory):
    """Run `wbc play`, and yield its process, the address of its page and the file of its log."""
    folder, domain = tmp_path_factory.mktemp("play"), own_domain()
    robot = folder / "g1.yaml"
    robot.write_text(CONFIG.to_yaml(), encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_DOMAIN_ID", str(domain))
        patch.delenv("DISPLAY", raising=False)
        command = [sys.executable, "-m", "wbc_controller", "play", str(robot), "--port", "0", "--domain", str(domain)]
        command += ["--real-time-factor", SLOW_MOTION]
        log = folder / "log"
        with log.open("w", encoding="utf-8") as written:
            process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=written, text=True)
        address = ""
        for line in process.stdout:
            if found := re.match(r"page: (\S+)", line):
                address = found[1]
                break
        assert address, f"wbc play ended: {log.read_text(encoding='utf-8')}"
        yield process, address, log
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
            process.wait(timeout=60.0)


@pytest.fixture(scope="module")
def session(playing):
    with Session(CONFIG.settings, patience=30.0) as made:
        made.listen("controller", "state")
        made.until(lambda: made.mode() == "active", "the controller is not active", 60.0)
        yield made


@pytest.fixture(scope="module")
def requested():
    """Return the addresses requested by the page."""
    return []


@pytest.fixture(scope="module")
def page(playing, session, requested):
    flags = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox"]
    with playwright.sync_playwright() as started:
        browser = started.chromium.launch(executable_path=CHROMIUM, args=flags)
        page = browser.new_page(viewport=SIZE)
        page.set_default_timeout(60_000)
        page.on("request", lambda request: requested.append(request.url))
        page.on("websocket", lambda connection: requested.append(connection.url))
        page.goto(playing[1] + COARSE)
        page.get_by_text("active", exact=True).wait_for()
        page.get_by_role("button", name="Hold").wait_for()
        for close in page.locator(".mantine-Notification-closeButton").all():
            close.click()  # notification of drawing without a GPU
        page.wait_for_timeout(2000)  # the handles follow
        yield page
        browser.close()


class Pixels:
    """Screen position of points in the world, in the initial view."""

    def __init__(self, page):
        robot = Robot(CONFIG.settings)
        self.view = camera(robot, build_meshes(robot.model))
        self.box = page.locator("canvas").first.bounding_box()

    def __call__(self, point):
        ((right, up),) = projected(np.asarray(point)[None], *self.view)
        half = self.box["height"] / 2.0
        return self.box["x"] + self.box["width"] / 2.0 + half * right, self.box["y"] + half * (1.0 - up)


def drag(page, start, end, steps=12):
    page.mouse.move(*start)
    page.wait_for_timeout(300)
    page.mouse.down()
    for share in np.linspace(0.0, 1.0, steps):
        page.mouse.move(*(np.array(start) + share * (np.array(end) - np.array(start))))
        page.wait_for_timeout(30)
    page.wait_for_timeout(200)
    page.mouse.up()


def first(messages, patience=30.0):
    """Return the first messages that arrive."""
    deadline = time.monotonic() + patience
    while time.monotonic() < deadline:
        found = messages(0.1)
        if found:
            return found
    raise AssertionError("no message arrived")


def position(content):
    point = content.pose.position if hasattr(content, "pose") else content.point
    return np.array([point.x, point.y, point.z])


def test_drag_of_a_handle_moves_the_hand(page, session):
    updates = session.follow(session.topics["controller", "update", ""])
    setpoints = session.follow(session.topics["controller", "setpoint", "left_hand"])
    start = position(session.wait_for_message("controller", "task_value", "left_hand"))
    pixels = Pixels(page)
    along = np.array([0.0, 0.0, 0.12])  # the tip of the vertical arrow
    drag(page, pixels(start + along), pixels(start + along + [0.0, 0.0, 0.15]))
    (begun, *_) = first(updates)
    assert begun.data.startswith("{tasks: {left_hand: {enabled: true, setpoint: [")
    asked = position(first(setpoints)[-1])
    assert np.abs(asked - start)[:2].max() < 0.01
    assert asked[2] > start[2] + 0.05
    session.until(
        lambda: position(session.newest("controller", "task_value", "left_hand"))[2] > start[2] + 0.04,
        "the hand did not move",
    )


def test_pull_on_the_torso_pushes_the_robot(page, session):
    pushes = session.follow(session.topics["mock", "push", ""])
    session.listen("mock", "odom")
    model = make_model(CONFIG.settings)
    chest = np.array([0.06, 0.0, 1.0])
    pixels = Pixels(page)
    page.keyboard.down("Shift")
    drag(page, pixels(chest), pixels(chest + [0.0, 0.25, 0.0]))
    page.keyboard.up("Shift")
    (push,) = first(pushes)
    assert push.header.frame_id in {frame.name for frame in model.pinocchio.frames}
    assert push.wrench.force.y > 10.0
    session.until(lambda: abs(session.newest("mock", "odom").twist.twist.linear.y) > 0.01, "the robot did not sway")


def test_slider_of_the_sensor_noise(page, session):
    faults = session.follow(session.topics["mock", "fault", ""])
    page.get_by_role("slider").nth(4).focus()  # after those of walking and of the floor's friction
    page.keyboard.press("ArrowRight")
    assert "kind: joint_noise, sigma: 0.0005" in first(faults)[-1].data
    page.keyboard.press("ArrowLeft")
    assert first(faults)[-1].data == "clear"


def test_switches_and_camera_pass_the_allow_list(page, playing):
    page.get_by_text("Show", exact=True).click()
    for label in [*GROUPS.values(), "Follow the robot", "Translucent robot", "Shadows", "Rotation rings"]:
        switch = page.get_by_label(label, exact=True)
        was = switch.is_checked()
        switch.click()
        page.wait_for_timeout(200)
        assert switch.is_checked() is not was
        switch.click()
    left, top = Pixels(page).box["x"], Pixels(page).box["y"]
    page.mouse.move(left + 60.0, top + 600.0)
    page.mouse.wheel(0.0, 300.0)
    drag(page, (left + 60.0, top + 600.0), (left + 120.0, top + 630.0))  # turns the view
    page.wait_for_timeout(500)


def test_page_contacts_only_its_own_server(page, playing, requested):
    own = playing[1].removeprefix("http://")
    assert any(url.startswith(f"http://{own}") for url in requested)
    foreign = [url for url in requested if not url.startswith((f"http://{own}", f"ws://{own}", "data:", "blob:"))]
    assert foreign == []


@pytest.mark.parametrize("query", ["?websocket=ws://127.0.0.1:{port}", "?playbackPath=http://127.0.0.1:{port}/x.viser"])
def test_address_cannot_load_from_another_server(page, playing, query):
    """Messages of another server would run code in this page, which may command the robot."""
    with socket.create_server(("127.0.0.1", 0)) as other:
        other.settimeout(10.0)
        opened = page.context.browser.new_page()
        opened.goto(playing[1] + query.format(port=other.getsockname()[1]))
        with pytest.raises(TimeoutError):
            other.accept()
        opened.close()


@pytest.fixture
def press(page, session):
    """Yield a function that presses a button, and waits for a mode of the controller."""

    def pressed(name, mode="", patience=30.0):
        page.get_by_role("button", name=name, exact=True).click()
        if mode:
            session.until(lambda: session.mode().startswith(mode), f"{name}: not {mode} but {session.mode()}", patience)

    return pressed


def test_effect_of_each_button(page, session, press):
    holds = session.follow(session.topics["mock", "hold", ""])
    press("Record")
    page.get_by_text("the last seconds are written to '").wait_for()  # as the controller names the file
    press("Hold")
    assert first(holds)[-1].data is True
    time.sleep(1.0)  # the hoist lifts it
    press("Deactivate", "inactive")
    press("Activate", "active")
    press("Release")
    assert first(holds)[-1].data is False
    press("STOP", "fault ESTOP")
    page.get_by_text("Next: if safe").wait_for()
    press("Hold")
    press("Reset", "inactive")
    press("Activate", "active")
    press("Damp", "damping")


def test_no_message_of_the_page_is_dropped(page, playing):
    assert "message dropped" not in playing[2].read_text(encoding="utf-8")


def test_end_of_the_page_ends_the_robot(playing, session):
    process = playing[0]
    nodes = subprocess.run(["ps", "-o", "pid=", "--ppid", str(process.pid)], capture_output=True, text=True).stdout
    assert len(nodes.split()) >= 2
    process.send_signal(signal.SIGINT)
    assert process.wait(timeout=60.0) == 0
    assert not [pid for pid in nodes.split() if os.path.exists(f"/proc/{pid}")]
