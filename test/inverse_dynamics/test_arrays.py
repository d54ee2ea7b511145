"""Fast array functions against NumPy."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from wbc_controller.inverse_dynamics.arrays import cross

vectors = st.lists(st.floats(-1e6, 1e6), min_size=3, max_size=3).map(np.array)


@given(a=vectors, b=vectors)
def test_cross_product_equals_numpy(a, b):
    np.testing.assert_array_equal(cross(a, b), np.cross(a, b))
