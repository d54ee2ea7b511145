"""Pairs of links from URDF, SRDF and settings, and errors."""

from itertools import combinations

import numpy as np
import pytest
from refusals import refusal
from robot_cases import joint, robot
from urdf_models import build_model, link

from wbc_controller.controller.build import collision_model
from wbc_controller.controller.build.collision_model import build_collision_model
from wbc_controller.controller.build.limits import make_self_collision
from wbc_controller.controller.check.preflight import check
from wbc_controller.errors import ConfigurationError
from wbc_controller.settings import Settings

TALOS_SRDF = "package://example-robot-data/robots/talos_data/srdf/talos.srdf"


def star(**elements):
    """Single-joint arms on a base, with collision elements."""
    arms = [name for name in elements if name != "base"]
    links = link("base", *elements.get("base", ())), *(link(name, *elements[name]) for name in arms)
    joints = (joint(f"{name}_joint", "base", name, "1 0 0", f"0 {i} 0") for i, name in enumerate(arms))
    return build_model(robot(*links, *joints), [f"{name}_joint" for name in arms], [0.0] * len(arms))


BALL = ("0 0 0", "0 0 0", '<sphere radius="0.1"/>')


def names(collision):
    shapes = collision.geometry.geometryObjects
    return {(shapes[p.first].name, shapes[p.second].name) for p in collision.geometry.collisionPairs}


def test_several_elements_are_one_hull_and_missing_shapes_are_named():
    far = ("0 0 -0.5", "0 0 0", '<box size="0.2 0.2 0.2"/>')
    collision = build_collision_model(star(a=(BALL, far), b=(BALL,)), margin=0.01)
    first, second = collision.geometry.geometryObjects
    first.geometry.computeLocalAABB()
    assert first.placement.translation[2] == pytest.approx(-0.25)
    assert first.geometry.aabb_local.max_ - first.geometry.aabb_local.min_ == pytest.approx([0.2, 0.2, 0.7])
    assert type(second.geometry).__name__ == "Sphere"
    with pytest.raises(ConfigurationError, match="the URDF has no <collision> elements; add them"):
        build_collision_model(star(a=(), b=()), margin=0.01)
    mesh = ("0 0 0", "0 0 0", '<mesh filename="package://example-robot-data/robots/no_such.stl"/>')
    with pytest.raises(ConfigurationError, match=r"collision element cannot be read: .*no_such"):
        build_collision_model(star(a=(mesh,), b=(BALL,)), margin=0.01)
    mesh = ("0 0 0", "0 0 0", '<mesh filename="package://no-such-package/a.stl"/>')
    with pytest.raises(ConfigurationError, match="package 'no-such-package' is not installed"):
        build_collision_model(star(a=(mesh,), b=(BALL,)), margin=0.01)


def test_pairs_of_links():
    collision = build_collision_model(star(base=(BALL,), a=(BALL,), b=(BALL,), c=(BALL,)), margin=0.01)
    assert names(collision) == set(combinations("abc", 2))
    assert collision.summary == "3 pairs of 3 links kept apart"
    srdf = '<robot name="star"><disable_collisions link1="b" link2="a" reason="Never"/></robot>'
    collision = build_collision_model(star(a=(BALL,), b=(BALL,), c=(BALL,)), margin=0.01, srdf=srdf)
    assert names(collision) == {("a", "c"), ("b", "c")}
    big = ("0 0 0", "0 0 0", '<sphere radius="0.85"/>')
    collision = build_collision_model(star(a=(big,), b=(BALL,), c=(BALL,)), margin=0.1)
    assert collision.near == (("a", "b"),)
    assert names(collision) == {("a", "c"), ("b", "c")}
    assert collision.summary.endswith("excluded, nearer than the margin in robot.posture: a/b")
    collision = build_collision_model(star(base=(BALL,), a=(BALL,), b=(BALL,)), margin=0.01, pairs=["b/base", "b/a"])
    assert names(collision) == {("base", "b"), ("a", "b")}


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"pairs": ["a/d"]}, "pairs: 'a/d': 'd' is not a link with collision elements; Valid: a, b"),
        ({"pairs": ["a"]}, "pairs: 'a': '' is not a link with collision elements"),
        ({"pairs": ["a/a"]}, "pairs: 'a/a': the links must differ"),
        ({"pairs": ["a/b"], "margin": 0.9}, "pairs: a/b are nearer than margin = 0.9 m in robot.posture"),
        ({"margin": 0.9}, "all pairs of links are excluded"),
        ({"srdf": "<robot>"}, "srdf: not a usable SRDF"),
    ],
)
def test_invalid_pairs_are_refused(changes, said):
    assert said in refusal(build_collision_model, star(a=(BALL,), b=(BALL,)), **{"margin": 0.01} | changes)


def test_of_named_links_the_visual_elements_count(robot_of):
    settings, model = robot_of("g1")
    hands = ["left_rubber_hand", "right_rubber_hand"]
    without, seen = (build_collision_model(model, margin=0.02, visual=visual).geometry for visual in ((), hands))
    links = [{shape.name for shape in geometry.geometryObjects} for geometry in (without, seen)]
    assert links[1] - links[0] == set(hands)
    summary = make_self_collision(changed(settings, visual=hands), model).summary
    assert summary.startswith(f"{len(seen.collisionPairs)} ")
    said = refusal(build_collision_model, model, margin=0.02, visual=["left_ruber_hand"])
    assert "visual: 'left_ruber_hand' is not a link with visual elements; did you mean 'left_rub" in said


def changed(settings, **own):
    values = settings.model_dump()
    values["limits"]["self_collision"] = {"enabled": True} | own
    return Settings.model_validate(values)


def test_self_collision_is_disabled_by_default_and_takes_an_srdf(robot_of):
    settings, _ = robot_of("g1")
    assert not settings.limits.self_collision.enabled
    settings, model = robot_of("talos")
    without, with_srdf = (make_self_collision(changed(settings, srdf=srdf), model).summary for srdf in ("", TALOS_SRDF))
    assert int(with_srdf.split()[0]) < int(without.split()[0])
    (line,) = [found.text for found in check(changed(settings, srdf=TALOS_SRDF)) if found.subject == "self-collision"]
    assert line == with_srdf
    assert "leg_left_3_link/leg_right_3_link" in line
    said = refusal(make_self_collision, changed(settings, srdf="/no/such.srdf"), model)
    assert said == "limits.self_collision.srdf = '/no/such.srdf': file /no/such.srdf does not exist"


AROUND = np.linspace(0.0, 2.0 * np.pi, 400, endpoint=False)
RIM = np.column_stack([np.cos(AROUND), np.sin(AROUND), np.zeros(400)])


def mesh(folder, name, points):
    """Write points as an OBJ mesh with arbitrary faces."""
    faces = [f"f {i} {i + 1} {i + 2}" for i in range(1, len(points) - 1)]
    lines = [f"v {x} {y} {z}" for x, y, z in points] + faces
    (folder / name).write_text("\n".join(lines) + "\n", encoding="utf-8")
    return ("0 0 0", "0 0 0", f'<mesh filename="{folder / name}"/>')


@pytest.mark.parametrize(
    ("points", "boxed"),
    [
        (np.vstack([[[0.0, 0.0, 1.0]], RIM]), False),  # the tip has 400 neighbours
        (RIM, True),  # flat
    ],
)
def test_a_mesh_without_a_usable_hull_does_not_end_all(tmp_path, points, boxed):
    model = star(a=(mesh(tmp_path, "odd.obj", 0.1 * points),), b=(BALL,), c=(BALL,))
    collision = build_collision_model(model, margin=0.01)
    assert collision.replaced == (("a",) if boxed else ())
    assert ("bounding box in place of an unusable convex hull: a" in collision.summary) is boxed
    shape = next(shape for shape in collision.geometry.geometryObjects if shape.name == "a")
    shape.geometry.computeLocalAABB()
    assert shape.geometry.aabb_local.max_[:2] == pytest.approx([0.1, 0.1], abs=1e-3)


def test_links_without_pairs_have_no_shape(tmp_path, monkeypatch):
    made = []
    monkeypatch.setattr(collision_model, "_hull", lambda points: made.append(len(points)))
    model = star(a=(mesh(tmp_path, "odd.obj", 0.1 * RIM),), b=(BALL,), c=(BALL,))
    collision = build_collision_model(model, margin=0.01, pairs=["b/c"])
    assert [shape.name for shape in collision.geometry.geometryObjects] == ["b", "c"]
    assert made == []
    build_collision_model(model, margin=0.01, pairs=["a/c"])
    assert made == [400]
