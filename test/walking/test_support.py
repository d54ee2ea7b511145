"""The area for the centre of pressure: rectangles around all points of the line between two feet, and strips."""

import math

import pytest

from wbc_controller.walking.support_kernels import nearest_in_support, supported_strip

HALF = (0.08, -0.02, 0.02)


@pytest.mark.parametrize(
    ("point", "nearest"),
    [
        (0.05 + 0.01j, 0.05 + 0.01j),  # inside
        (0.2 - 0.1j, 0.08 - 0.02j),  # beyond a corner
        (-0.01 + 0.05j, -0.01 + 0.02j),
    ],
)
def test_one_foot(point, nearest):
    assert nearest_in_support(point, 0j, 0j, 0.0, *HALF) == pytest.approx(nearest)
    turned = 1.0 + 1j * point  # a quarter turn
    assert nearest_in_support(turned, 1.0, 1.0, math.pi / 2.0, *HALF) == pytest.approx(1.0 + 1j * nearest)


@pytest.mark.parametrize(
    ("point", "nearest"),
    [
        (0.1j, 0.1j),  # between the feet
        (0.3j, 0.22j),  # beside the left one
        (0.2 + 0.1j, 0.08 + 0.1j),  # in front of both
        (-0.1 - 0.1j, -0.08 - 0.02j),
    ],
)
def test_two_feet(point, nearest):
    assert nearest_in_support(point, 0j, 0.2j, 0.0, *HALF) == pytest.approx(nearest)
    assert nearest_in_support(point, 0.2j, 0j, 0.0, *HALF) == pytest.approx(nearest)


def test_one_foot_on_a_strip():
    assert nearest_in_support(0.05 - 0.01j, 0j, 0j, 0.0, 0.08, 0.005, 0.02) == pytest.approx(0.05 + 0.005j)


WHOLE, DT = (-0.02, 0.02), 0.002


@pytest.mark.parametrize(
    ("line", "rolling", "strip"),
    [
        (0.005, 2.0, (0.01, 0.02)),  # the right side sinks
        (0.005, -2.0, (-0.02, 0.0)),  # the left side sinks
        (0.019, 2.0, (0.016, 0.02)),  # the narrowest strip
        (-0.025, -2.0, (-0.02, -0.016)),
        (-0.028, 2.0, WHOLE),  # it tips over its edge
        (0.005, 0.5, WHOLE),  # too slowly
        (0.04, 2.0, WHOLE),  # the whole sole moves
    ],
)
def test_the_rising_side_of_a_tipping_sole_is_supported(line, rolling, strip):
    assert supported_strip(*WHOLE, 0.02, -rolling * line, complex(rolling, 0.3), DT) == pytest.approx(strip)


def test_a_sole_that_tips_forwards_keeps_its_strip():
    assert supported_strip(*WHOLE, 0.02, 0.0, 2.0 - 3.0j, DT) == WHOLE


def test_a_strip_at_rest_returns_to_its_width():
    strip = (0.01, 0.02)
    for _ in range(150):
        strip = supported_strip(*strip, 0.02, 0.0, 0j, DT)
    assert strip == pytest.approx(WHOLE)
