"""Tests of the transfer of the weight after a touchdown."""

import cmath
from types import SimpleNamespace

import pytest

from wbc_controller.walking.pendulum_kernels import later, leading
from wbc_controller.walking.weight_transfer import WeightTransfer

OMEGA, OLD, NEW, GOAL, DOUBLE = 3.7, 0j, 0.1 + 0.2j, 0.12 + 0.15j, 0.05
GAIT = SimpleNamespace(double=DOUBLE)
EXPECTED = leading(GOAL, OLD, NEW, DOUBLE, OMEGA)  # DCM after a touchdown on time


def transfer(late, error=0j, heading=0.0, roughness=0.0, wait=0.0):
    """Return the transfer of a DCM that passes `EXPECTED` a time `wait` after the touchdown, apart from an error."""
    dcm = later(EXPECTED, OLD, OMEGA, -wait) + error
    return WeightTransfer.after_touchdown(late, dcm, GOAL, OLD, NEW, heading, OMEGA, GAIT, roughness)


@pytest.mark.parametrize(
    ("late", "roughness", "wait", "duration"),
    [
        (-0.08, 0.0, 0.05, 0.05),
        (-0.08, 0.5, 0.065, 0.05),  # the foot on rough ground is early, as its plan ends below the ground
        (-0.08, 1.0, 0.08, 0.05),
        (-0.02, 0.0, 0.0, 0.05),
        (0.0, 1.0, 0.0, 0.05),
        (0.04, 0.0, 0.0, 0.04),
        (0.15, 1.0, 0.0, 0.02),
    ],
)
def test_the_transfer_begins_later_after_an_early_touchdown_and_ends_sooner_after_a_late_one(
    late, roughness, wait, duration
):
    made = transfer(late, roughness=roughness, wait=wait)
    assert (made.wait, made.duration) == pytest.approx((wait, duration))
    dcm, pressure, ended = made.at(wait + duration + 1e-9, OMEGA)
    assert ended
    assert dcm == pytest.approx(GOAL)
    assert pressure == pytest.approx(NEW)
    dcm, pressure, ended = made.at(wait + 0.5 * duration, OMEGA)
    assert not ended
    assert pressure == pytest.approx(0.5 * (OLD + NEW))
    assert made.at(wait, OMEGA)[0] == pytest.approx(later(made.at(0.0, OMEGA)[0], OLD, OMEGA, wait))


@pytest.mark.parametrize(
    ("error", "heading", "duration"),
    [(0.09, 0.0, 0.05), (0.11, 0.0, 0.02), (0.02j, 0.0, 0.05), (-0.04j, 0.0, 0.02), (cmath.rect(0.05, 0.6), 0.6, 0.05)],
)
@pytest.mark.parametrize("wait", [0.0, 0.08])
def test_the_transfer_is_shortest_if_the_dcm_is_astray(error, heading, duration, wait):
    """After an early touchdown, the DCM is compared with its path before the transfer begins."""
    made = transfer(-wait, error, heading, 1.0, wait)
    assert made.duration == pytest.approx(duration)
    assert made.at(wait + duration, OMEGA)[0] == pytest.approx(GOAL)
