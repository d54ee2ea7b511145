"""The area for the centre of pressure: rectangles around all points of the line between two feet."""

import math

import pytest

from wbc_controller.walking.references_kernels import nearest_in_support

HALF = (0.08, 0.02)


@pytest.mark.parametrize(
    ("left", "point", "nearest"),
    [
        (0j, 0.05 + 0.01j, 0.05 + 0.01j),  # inside
        (0j, 0.2 - 0.1j, 0.08 - 0.02j),  # beyond a corner
        (0j, -0.01 + 0.05j, -0.01 + 0.02j),
        (0.2j, 0.1j, 0.1j),  # between the feet
        (0.2j, 0.3j, 0.22j),  # beside the left one
        (0.2j, 0.2 + 0.1j, 0.08 + 0.1j),  # in front of both
        (0.2j, -0.1 - 0.1j, -0.08 - 0.02j),  # beyond a corner
    ],
)
def test_one_foot_and_two_feet(left, point, nearest):
    for feet in ((0j, left), (left, 0j)):
        assert nearest_in_support(point, *feet, 0.0, *HALF) == pytest.approx(nearest)
        turned, *turned_feet = (1.0 + 1j * place for place in (point, *feet))  # a quarter turn
        assert nearest_in_support(turned, *turned_feet, math.pi / 2.0, *HALF) == pytest.approx(1.0 + 1j * nearest)
