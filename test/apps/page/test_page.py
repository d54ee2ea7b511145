"""The page on the real server, with browsers without a screen and a simulated source of snapshots."""

import itertools
import time
from contextlib import closing
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from page_rig import Rig, status
from waiting import repeated

from wbc_controller.apps.page.page import RATE

pytestmark = pytest.mark.live


@pytest.fixture(scope="module")
def rig():
    with Rig(commands=True) as made:
        yield made


@pytest.fixture
def browser(rig):
    rig.sent.clear()
    page = rig.open_page()
    yield page
    page.close()
    page.until(lambda: not rig.server.get_clients())


def settled(rig, pause=0.3):
    """Wait until nothing has been sent for `pause` seconds; return the requests."""
    while rig.sent and time.monotonic() - rig.sent[-1][0] < pause:
        time.sleep(0.02)
    return rig.said()


def test_drawing_rate_is_independent_of_the_topics(rig, browser):
    before, began = rig.page.shown, time.monotonic()
    browser.until(lambda: rig.page.shown - before >= 20)
    rate = (rig.page.shown - before) / (time.monotonic() - began)
    assert rate <= 1.2 * RATE  # not faster, although every snapshot is new
    assert browser.positions["/robot/1"] == pytest.approx((0.0, 0.0, 0.76), abs=1e-3)


def placement(browser, name):
    """Return the pose of a scene node in the world, from the chain of its parents."""
    found = pin.SE3.Identity()
    for place in itertools.accumulate(name.strip("/").split("/"), "{}/{}".format):
        w, x, y, z = browser.turns.get(f"/{place}", (1.0, 0.0, 0.0, 0.0))
        position = np.array(browser.positions.get(f"/{place}", (0.0, 0.0, 0.0)))
        found = found * pin.SE3(pin.Quaternion(w, x, y, z), position)
    return found


@pytest.fixture
def pose(rig):
    """Yield a function that sets the configuration of the robot, and restore it at the end."""

    def take(q):
        while rig.story.now.q is not q:
            rig.story.now = replace(rig.story.now, q=q)
            time.sleep(0.05)

    there = rig.story.now.q
    yield take
    take(there)


def test_placement_of_every_link(rig, browser, pose):
    model = rig.robot.model.pinocchio
    q = pin.integrate(model, rig.story.now.q, 0.3 * np.cos(np.arange(model.nv)))
    pose(q)
    before = rig.page.shown
    browser.until(lambda: rig.page.shown - before >= 5)
    data = model.createData()
    pin.forwardKinematics(model, data, q)
    for handle, joint in rig.page.drawing.links:
        browser.until(
            lambda joint=joint, name=handle.name: np.allclose(placement(browser, name), data.oMi[joint], atol=2e-3)
        )
    moved = browser.moved.copy()
    pose(pin.integrate(model, q, np.r_[np.zeros(6), 0.2, np.zeros(model.nv - 7)]))
    browser.until(lambda: browser.moved != moved)
    before = rig.page.shown
    browser.until(lambda: rig.page.shown - before >= 5)
    links = [name for name in browser.moved - moved if name.startswith("/robot")]
    assert links == ["/robot/1/2"]  # one joint has moved; the links behind it follow in the browser


@pytest.mark.parametrize(
    ("label", "said"),
    [
        ("STOP", "estop"),
        *((word.capitalize(), word) for word in ("activate", "deactivate", "damp", "reset")),
        ("Record", "the last seconds are written to a file"),
        ("Hold", "the hoist lifts the robot to its start pose"),
        ("Release", "the hoist releases the robot"),
    ],
)
def test_request_of_each_button(rig, browser, label, said):
    browser.set(label, True)
    browser.until(lambda: rig.said() == [said])


def test_switches_and_sliders(rig, browser):
    browser.set("left_foot", False)
    browser.until(lambda: rig.said() == ["contact left_foot goes off in 0.2 s"])
    browser.set("weight", 20.0)
    browser.until(lambda: "the weight of com becomes 20 in 0.5 s" in rig.said())
    browser.set("stiffness", 150.0)
    browser.until(lambda: "update {tasks: {com: {stiffness: 150}}}" in rig.said())
    browser.set("Sensor noise [rad]", 0.002)
    noise = "kind: joint_noise, sigma: 0.002, velocity_sigma: 0.02, duration: 3600"
    browser.until(lambda: f"fault [{{{noise}}}]" in rig.said())
    browser.set("Slippery floor", True)
    floor = "kind: slippery_floor, friction: 0.2, duration: 3600"
    browser.until(lambda: f"fault [{{{noise}}}, {{{floor}}}]" in rig.said())  # all faults in one message
    browser.set("Slippery floor", False)
    browser.set("Sensor noise [rad]", 0.0)
    browser.until(lambda: rig.said()[-1] == "fault clear")


def test_velocity_while_a_button_is_held(rig, browser):
    browser.set("Turn left [rad/s]", 0.3)
    for _ in range(4):
        browser.hold("Walk", 10.0)
        time.sleep(0.1)
    browser.until(lambda: len(rig.sent) >= 3)
    said = settled(rig, 0.3)
    assert set(said) == {"walk"}
    assert len(said) <= 4  # nothing more after the release
    _, request = rig.sent[-1]
    twist = request.make(None)
    assert request.key == "cmd_vel"
    assert (twist.linear.x, twist.linear.y, twist.angular.z) == (0.2, 0.0, 0.3)
    browser.set("Stand", True)
    browser.until(lambda: rig.said()[-1] == "the robot stops walking")
    assert rig.sent[-1][1].make(None).linear.x == 0.0


def test_user_input_is_sent_during_updates():
    """Updates from the controller arrive at 1 kHz instead of 5 Hz."""
    with (
        Rig(commands=True) as rig,
        repeated(lambda: rig.page._controls.show(rig.story.now, mock=True)),
        closing(rig.open_page()) as page,
    ):
        wanted = {"weight of com becomes 20": ("weight", 20.0)}
        wanted |= {f"contact {name} goes off": (name, False) for name in rig.robot.contacts}
        rig.story.now = replace(rig.story.now, forces={name: np.ones(6) for name in rig.robot.contacts})
        for words, (label, value) in wanted.items():
            page.set(label, value)
            page.until(lambda words=words: rig.sent and words in rig.said()[-1], patience=5.0)
        assert len(rig.sent) == len(wanted)


def test_drag_of_a_handle_sends_setpoints_until_its_end(rig, browser):
    browser.drag("com", "start")
    for i in range(60):
        browser.drag("com", "update", (0.02, 0.0, 0.6 - 0.001 * i))
        time.sleep(0.005)
    browser.drag("com", "end")
    said = settled(rig)
    assert said[-1] == "com goes to 0.02000 0.00000 0.54100 in world, in 1 s"
    assert np.diff([at for at, _ in rig.sent]).min() >= 0.04
    assert settled(rig, 0.5) == said


def test_drag_enables_a_disabled_task(rig, browser):
    browser.drag("left_hand", "start")
    browser.drag("left_hand", "update", (0.3, 0.2, 0.9))
    browser.drag("left_hand", "end")
    browser.until(lambda: rig.sent)
    (said,) = settled(rig)
    assert said.startswith("update {tasks: {left_hand: {enabled: true, setpoint: [0.30000, 0.20000, 0.90000, 0.0")


def test_closed_page_ends_its_drag(rig, browser):
    other = rig.open_page()
    other.drag("com", "start")
    other.drag("com", "update", (0.1, 0.0, 0.5))
    browser.until(lambda: rig.sent)
    browser.until(lambda: browser.positions["/handles/com"] == pytest.approx((0.1, 0.0, 0.5)))  # the other page follows
    other.cut()
    browser.until(lambda: len(rig.server.get_clients()) == 1)
    before = len(settled(rig))
    browser.until(lambda: browser.positions["/handles/com"] == pytest.approx((0.02, 0.0, 0.6)))  # back to its task
    assert len(rig.sent) == before


def test_pull_on_a_link_pushes_at_its_end(rig, browser):
    start, end = np.array([0.0, 0.0, 0.86]), np.array([0.2, 0.0, 0.86])
    for phase in ("start", "update"):
        browser.pull("/robot/1/m1", phase, start, end)
    time.sleep(0.2)
    assert not rig.sent
    browser.pull("/robot/1/m1", "end", start, end)
    browser.until(lambda: rig.sent)
    ((_, request),) = rig.sent
    wrench = request.make(None).wrench
    weight = rig.robot.model.mass * rig.robot.model.gravity
    assert request.make(None).header.frame_id == "pelvis"
    assert (wrench.force.x, wrench.force.y, wrench.force.z) == pytest.approx((0.16 * weight, 0.0, 0.0))
    assert wrench.torque.y == pytest.approx(0.1 * 0.16 * weight, rel=0.02)  # a pull above the origin of the pelvis


def test_closed_page_ends_its_pull(rig, browser):
    other = rig.open_page()
    for phase in ("start", "update"):
        other.pull("/robot/1/m1", phase, (0.0, 0.0, 0.8), (0.5, 0.0, 0.8))
    time.sleep(0.2)
    other.cut()
    browser.until(lambda: len(rig.server.get_clients()) == 1)
    assert settled(rig) == []
    time.sleep(0.3)
    assert not rig.sent


def test_refusals_are_shown(rig, browser):
    rig.story.refusals.append("<b>left_hand</b> is off")
    browser.until(lambda: any("&lt;b&gt;left_hand" in str(props.get("content")) for props in browser.controls.values()))


def test_texts_of_the_controller_are_escaped(rig, browser):
    fault = "fault STALE_INPUT: <script>joint_states</script> is 80 ms old"
    before = rig.story.now
    rig.story.now = replace(before, mode=fault, status=status(**{"cost/torque:left_knee_joint:upper": "2.5 1/(N·m)"}))

    def panel():
        return next(p["content"] for p in browser.controls.values() if 'class="mode"' in str(p.get("content")))

    browser.until(lambda: "STALE_INPUT" in panel())
    rig.story.now = before
    assert "&lt;script&gt;joint_states" in panel()
    assert "Next: check that the robot&#x27;s driver runs" in panel()
    assert "left knee&#x27;s upper torque limit" in panel()
