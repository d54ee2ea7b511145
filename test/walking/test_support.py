"""The area for the centre of pressure: rectangles around all points of the line between two feet."""

import math

import pytest

from wbc_controller.walking.support_kernels import nearest_in_support

HALF = (0.08, 0.02)


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


def test_two_feet():
    places = ((0.1j, 0.1j), (0.3j, 0.22j), (0.2 + 0.1j, 0.08 + 0.1j), (-0.1 - 0.1j, -0.08 - 0.02j))
    for point, nearest in places:  # between the feet, beside the left one, in front of both, beyond a corner
        assert nearest_in_support(point, 0j, 0.2j, 0.0, *HALF) == pytest.approx(nearest)
        assert nearest_in_support(point, 0.2j, 0j, 0.0, *HALF) == pytest.approx(nearest)
