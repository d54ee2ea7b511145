"""Geometry of the markers against Pinocchio, the solution and the references."""

from functools import cache

import numpy as np
import pinocchio as pin
import pytest
from chains import MENAGERIE, menagerie
from composed import whole

from wbc_controller.controller.build.program import make_qp
from wbc_controller.controller.build.robot import make_model
from wbc_controller.controller.visualization.scene import CONE_HEIGHT, FORCE_LENGTH
from wbc_controller.middleware.codec import nanoseconds
from wbc_controller.nodes.diagnostics.markers import MarkerScene, read_shapes
from wbc_controller.records import RobotState

LINE_STRIP, LINE_LIST, SPHERE_LIST, ARROW = 4, 5, 7, 0
KINDS = {
    "contact_forces": ARROW, "friction_cones": LINE_LIST, "contacts": LINE_LIST, "support": LINE_STRIP,
    "capture_point": SPHERE_LIST, "references": SPHERE_LIST, "task_errors": LINE_LIST,
}  # fmt: skip


def points(marker):
    return np.array([[point.x, point.y, point.z] for point in marker.points])


def scene(controller):
    """Return the markers of the last message by namespace and id."""
    found = {}
    for marker in controller.received("markers")[-1].markers:
        assert (marker.ns, marker.id) not in found, "RViz would show only the last one"
        found[marker.ns, marker.id] = marker
    return found


def standing(bench, name, **changes):
    controller = bench(name, {"control": {"markers_rate": 100.0}} | changes)
    controller.activate()
    controller.cycle(90)  # until the contacts are ramped in
    controller.v[0] = 0.1
    controller.cycle(30)  # past the next message
    return controller


@cache
def at_rest(bench, name):
    """A standing robot, left unchanged by the tests."""
    return standing(bench, name)


@pytest.mark.parametrize("name", ["g1", "go2"])
def test_markers_are_those_that_rviz_takes_and_forces_those_of_the_solution(bench, name):
    controller = at_rest(bench, name)
    found = scene(controller)
    assert {namespace for namespace, _ in found} >= set(KINDS) - {"contacts"} | {"com"}
    for (namespace, _), marker in found.items():
        assert marker.header.frame_id == "world"
        assert 0 <= controller.time - nanoseconds(marker.header.stamp) < 10e6
        assert marker.type == KINDS.get(namespace, marker.type)
        assert marker.action == 0
        assert marker.pose.orientation.w == 1.0  # a zero quaternion is refused
        assert marker.color.a > 0.0
        assert nanoseconds(marker.lifetime) == 30_000_000  # three periods
        assert marker.scale.x > 0.0
        assert len(marker.points) > 0
        assert np.isfinite(points(marker)).all()
        if marker.type == LINE_LIST:
            assert len(marker.points) % 2 == 0
        if marker.type == ARROW:
            assert len(marker.points) == 2
            assert marker.scale.y > marker.scale.x > 0.0
    report, model = controller.reports[-1], controller.model
    weight = model.mass * model.gravity
    arrows = [points(found["contact_forces", i]) for i in range(len(controller.settings.contacts))]
    total = sum(tip - origin for origin, tip in arrows)
    assert total[2] == pytest.approx(FORCE_LENGTH, rel=0.1)  # together they carry the weight
    torque = np.zeros(3)
    for (origin, tip), (contact, force) in zip(arrows, report.solution.forces.items(), strict=True):
        length = np.linalg.norm(force[:3]) * FORCE_LENGTH / weight
        assert np.linalg.norm(tip - origin) == pytest.approx(length, rel=1e-2), contact
        torque += np.cross(origin, (tip - origin) * weight / FORCE_LENGTH)
    # The forces at their points of application change the horizontal angular momentum as the solution does.
    data = model.pinocchio.createData()
    com = pin.centerOfMass(model.pinocchio, data, controller.q)
    lever = np.cross(com, total * weight / FORCE_LENGTH)
    h_dot = pin.computeCentroidalMomentumTimeVariation(
        model.pinocchio, data, controller.q, controller.v, report.solution.v_dot
    ).vector
    np.testing.assert_allclose((torque - lever)[:2], h_dot[3:5], atol=0.02 * weight * 0.01)


def test_cone_centre_of_mass_and_support_are_those_of_the_state(bench):
    controller = at_rest(bench, "g1")
    contact = controller.settings.contacts["left_foot"]
    cone = points(scene(controller)["friction_cones", 0])[:8].reshape(4, 2, 3)
    centre = cone[0, 0]
    edges = cone[:, 1] - centre
    np.testing.assert_allclose(edges[:, 2], CONE_HEIGHT, atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(edges[:, :2], axis=1), contact.friction * CONE_HEIGHT, rtol=1e-6)
    placement = controller.loop.controller.qp.contacts["left_foot"].placement(controller.loop.controller.qp.dynamics)
    np.testing.assert_allclose(centre, placement.translation, atol=1e-6)
    found, model = scene(controller), controller.model
    data = model.pinocchio.createData()
    com = pin.centerOfMass(model.pinocchio, data, controller.q, controller.v)
    velocity = data.vcom[0]
    drawn, below = points(found["com", 0])
    np.testing.assert_allclose(drawn, com)
    np.testing.assert_allclose(below[:2], com[:2])
    assert below[2] == pytest.approx(0.0, abs=0.01)  # on the ground
    (capture,) = points(found["capture_point", 0])
    omega = np.sqrt(model.gravity / (com[2] - below[2]))
    np.testing.assert_allclose(capture[:2], com[:2] + velocity[:2] / omega)
    assert np.linalg.norm(velocity) > 0.01
    assert capture[2] == below[2]
    outline, corners = points(found["support", 0]), points(found["contacts", 0])
    np.testing.assert_array_equal(outline[0], outline[-1])
    assert corners[:, 0].max() == pytest.approx(outline[:, 0].max())
    assert corners[:, 1].min() == pytest.approx(outline[:, 1].min())
    assert len(corners) == 2 * 4 * 2  # two rectangles, an edge by its two ends
    for foot in corners.reshape(2, 4, 2, 3):
        np.testing.assert_array_equal(foot[:, 1], np.roll(foot[:, 0], -1, axis=0))


def test_task_errors_are_lines_to_the_reference(bench, make):
    controller, drop = standing(bench, "go2", tasks={"com": {"setpoint_duration": 0.0}}), np.array([0.0, 0.0, 0.05])
    start = points(scene(controller)["task_errors", 0])[0]
    controller.send("setpoint", make.point(start - drop), "com")
    controller.cycle(10)
    found = scene(controller)
    line = points(found["task_errors", 0])
    assert len(line) == 2  # only com has a place in the world
    np.testing.assert_allclose(line[1] - line[0], -drop, atol=1e-6)
    np.testing.assert_allclose(points(found["references", 0]), line[1:])


def test_kinds_of_tasks_that_have_a_place(bench):
    tasks = {
        "hand": {"type": "frame_pose", "frame": "left_rubber_hand"},
        "foot": {"type": "frame_position", "frame": "left_ankle_roll_link"},
        "grip": {"type": "relative_pose", "frame": "left_rubber_hand", "reference_frame": "right_rubber_hand"},
        "look": {"type": "gaze", "frame": "torso_link", "axis": [1.0, 0.0, 0.0]},
        "steady": {"type": "capture_point"},
        "off": {"type": "frame_position", "frame": "torso_link", "enabled": False},
        "spin": {"type": "angular_momentum"},
    }
    controller = standing(bench, "g1", tasks=tasks)
    lines = points(scene(controller)["task_errors", 0]).reshape(-1, 2, 3)
    model, data = controller.model, controller.model.pinocchio.createData()
    pin.framesForwardKinematics(model.pinocchio, data, controller.q)
    at = {name: data.oMf[model.frame_id(name, "")].translation for name in ("left_rubber_hand", "torso_link")}
    starts = lines[:, 0]
    assert sum(np.allclose(start, at["left_rubber_hand"]) for start in starts) == 2  # hand, grip
    assert sum(np.allclose(start, at["torso_link"]) for start in starts) == 1  # gaze, not the disabled task
    (gaze,) = [line for line in lines if np.allclose(line[0], at["torso_link"])]
    np.testing.assert_allclose(gaze[1] - gaze[0], [1.0, 0.0, 0.0], atol=0.05)  # the point 1 m ahead
    for line in lines:  # the robot is held at its initial pose
        if not np.allclose(line[0], at["torso_link"]):
            assert np.linalg.norm(line[1] - line[0]) < 0.06


def test_markers_before_activation_at_the_configured_rate_and_without_a_plan(bench):
    controller = bench("g1")
    controller.cycle(3)
    assert {namespace for namespace, _ in scene(controller)} == {"contacts", "com", "capture_point"}
    for rate, expected in ((10.0, (2, 3)), (50.0, (9, 11))):
        controller = bench("go2", {"control": {"markers_rate": rate}})
        controller.cycle(100)
        assert expected[0] <= len(controller.received("markers")) <= expected[1], rate
    silent = bench("go2", {"control": {"markers_rate": 0.0}})
    silent.cycle(100)
    assert "markers" not in {topic.key for topic in silent.topics}
    controller = at_rest(bench, "g1")
    assert not {"steps", "swing_paths"} & {namespace for namespace, _ in scene(controller)}
    values = {key: value for key, value in controller.values.items() if key.startswith("walking/")}
    assert values == {"walking/phase": "stand", "walking/steps": "0", "walking/command": "none"}


def test_a_broken_contact_is_no_longer_drawn(bench, make):
    controller = standing(bench, "go2")
    controller.v[0] = 0.0
    controller.send("contact_enable", make.bool(False), "rear_left_foot")
    controller.cycle(130)
    found = scene(controller)
    assert ("contact_forces", 2) not in found
    assert ("contact_forces", 3) in found
    assert len(points(found["support", 0])) == 4  # a triangle, closed


def test_a_robot_on_a_fixed_base_has_no_capture_point():
    settings = menagerie()
    model = make_model(settings, MENAGERIE)
    qp = make_qp(settings, model)
    state = RobotState(1, model.configuration(model.posture), np.zeros(model.nv))
    drawn = whole(MarkerScene(model, qp.tasks, qp.contacts, 1.0).compose(state, None, None))
    assert {marker.ns for marker in drawn.markers} == {"com"}


def test_the_plan_of_a_step_is_drawn_and_in_the_diagnostics(bench, make):
    controller = standing(bench, "g1")
    controller.v[0] = 0.0
    for _ in range(3):
        controller.send("cmd_vel", make.velocity("cmd_vel", [0.2, 0.1, 0.0, 0.0, 0.0, 0.0]))
        controller.cycle(160)
    found, plan = scene(controller), controller.loop.controller.walker.plan()
    (foot,) = plan.landings
    outline = points(found["steps", 0])
    corners = np.array(controller.settings.contacts[foot].corners)
    assert found["steps", 0].type == LINE_LIST
    np.testing.assert_allclose(outline.mean(axis=0), plan.landings[foot], atol=5e-3)
    np.testing.assert_allclose(np.ptp(outline, axis=0)[:2], np.ptp(corners, axis=0), atol=5e-3)
    path = points(found["swing_paths", 0])
    np.testing.assert_allclose(path[-1], plan.landings[foot], atol=5e-3)
    assert path[:, 2].max() > plan.landings[foot][2] + 0.01  # the foot lands early, as this robot does not move
    wanted = points(found["capture_point", 1])[0]
    np.testing.assert_allclose(wanted[:2], [plan.wanted_dcm.real, plan.wanted_dcm.imag], atol=0.02)
    values = controller.values
    assert values["walking/phase"] == "single support"
    assert values["walking/command"] == "0.200 0.100 m/s, 0.000 rad/s"
    assert values["walking/steps"] == "0"
    assert float(values["walking/margin"].partition(" ")[0]) == pytest.approx(plan.margin, abs=0.03)
    assert 0.0 < float(values["walking/touchdown"].partition(" ")[0]) <= controller.loop.controller.walker.gait.single
    assert "walking/velocity" in values
    walking = {(name, number) for name, number in found if name in ("steps", "swing_paths")}
    read = read_shapes(controller.received("markers")[-1], ("steps", "swing_paths"))
    assert {(shape.group, shape.number) for shape in read} == walking
    np.testing.assert_array_equal(next(s for s in read if s.group == "steps").points, outline)
