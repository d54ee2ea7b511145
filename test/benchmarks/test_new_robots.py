"""Table of drafted configurations for some robots."""

import new_robots
import pytest


@pytest.mark.parametrize(("robot", "base", "feet"), [
    ("Go1", "floating", "4 point"),
    ("UR5", "fixed", "none"),
])  # fmt: skip
def test_drafted_robot_passes(monkeypatch, robot, base, feet):
    for name, seconds in (("STAND", 0.5), ("REST", 0.8), ("WALK", 2.5), ("REACHED", 1.8)):
        monkeypatch.setattr(new_robots, name, seconds)
    row = new_robots.run(robot)
    assert (row.kind, row.feet, row.check) == (base, feet, "ok")
    assert (row.stands, row.sway, row.squat, row.push) == ("yes",) * 4
    assert row.walk.endswith("–" if base == "fixed" else " m/s")


def test_robot_on_two_points_cannot_stand():
    row = new_robots.run("Bolt")
    assert (row.check, row.stands) == ("no", "")
    assert "outside the support" in row.to_do
