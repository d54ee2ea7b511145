"""The closed forms of the DCM agree with numerical integration, and the periodic gait repeats itself."""

import cmath
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from wbc_controller.walking import pendulum_kernels as kernels

OMEGA = 3.7
POINTS = st.complex_numbers(max_magnitude=1.0, allow_nan=False)
SINGLE, DOUBLE = st.floats(0.2, 1.0), st.just(0.0) | st.floats(0.01, 0.3)  # durations, s


def integrated(dcm, pressure, duration):
    """Integrate ξ̇ = ω (ξ - p(t)) by Runge-Kutta."""
    found = solve_ivp(lambda t, dcm: OMEGA * (dcm - pressure(t)), (0.0, duration), [dcm], rtol=1e-11, atol=1e-12)
    return found.y[0, -1]


def test_dcm_with_constant_and_moving_centre_of_pressure():
    assert kernels.natural_frequency(9.81, 9.81) == 1.0
    assert kernels.natural_frequency(0.5, 9.81) == pytest.approx(4.4294469)
    dcm, pressure = 0.1 + 0.05j, 0.02 - 0.03j
    assert kernels.later(dcm, pressure, OMEGA, 0.4) == pytest.approx(integrated(dcm, lambda t: pressure, 0.4), abs=1e-9)
    ended = kernels.later(dcm, pressure, OMEGA, 0.4) + 0.01j
    assert kernels.before(ended, pressure, OMEGA, 0.4, 0.01j) == pytest.approx(dcm, abs=1e-12)
    dcm, start, end = 0.1 + 0.05j, -0.02j, 0.3 + 0.2j
    found = kernels.transferred(dcm, start, end, 0.2, OMEGA, 0.15)
    assert found == pytest.approx(integrated(dcm, lambda t: start + (end - start) * t / 0.2, 0.15), abs=1e-9)
    ended = kernels.transferred(dcm, start, end, 0.2, OMEGA, 0.2)
    assert kernels.leading(ended, start, end, 0.2, OMEGA) == pytest.approx(dcm, abs=1e-12)


@given(POINTS, st.floats(-0.4, 0.4), SINGLE, DOUBLE, st.sampled_from([1.0, -1.0]), st.floats(0.0, 0.5))
def test_a_periodic_gait_repeats_its_offset(progress, width, single, double, side, push):
    step, following = progress + side * width * 1j, progress - side * width * 1j
    offset = kernels.periodic_offset(progress, side * width * 1j, OMEGA, single, double, push)
    dcm = step + offset  # the stance foot is the origin
    if double > 0.0:
        dcm = kernels.transferred(dcm, 0j, step, double, OMEGA, double)
    dcm = kernels.later(dcm, step, OMEGA, single) + push * (step + following)
    expected = kernels.periodic_offset(progress, -side * width * 1j, OMEGA, single, double, push)
    scale = math.exp(OMEGA * (single + double))
    assert dcm - step - following == pytest.approx(expected, abs=1e-11 * scale)
    assert cmath.isfinite(offset)
