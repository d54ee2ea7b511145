"""Fuzzer of user classes: hostile members are refused, or the robot is damped with the name of the method."""

import logging

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings

from wbc_controller.validation.fuzz.hostile_classes import HostileClass, hostile_class, run_class


@settings(max_examples=30, derandomize=True, suppress_health_check=list(HealthCheck))
@given(hostile=hostile_class())
def test_hostile_classes_are_refused_or_damped(caplog, hostile):
    with np.errstate(all="ignore"), caplog.at_level(logging.CRITICAL, "wbc_controller"):
        result = run_class(hostile)
    assert result in ("refused", "active", "damping METHOD_FAILED", "holding NO_SOLUTION", "damping NO_SOLUTION")


@pytest.mark.parametrize(
    ("kind", "member", "after", "value", "result"),
    [
        ("tasks", "enabled", 0, True, "active"),
        ("contacts", "enabled", 0, np.bool_(False), "active"),
        ("tasks", "drift", 13, np.full(1, np.nan), "damping METHOD_FAILED"),
        ("tasks", "drift", 13, np.ma.masked_array([0.0], mask=[1]), "damping METHOD_FAILED"),
        ("tasks", "drift", 13, RecursionError(), "damping METHOD_FAILED"),
        ("contacts", "jacobian", 6, np.zeros((3, 17)), "damping METHOD_FAILED"),
        ("limits", "fill", 6, np.nan, "damping METHOD_FAILED"),
        ("tasks", "name", 0, 5, "refused"),
        ("tasks", "rows", 0, -np.inf, "refused"),
        ("tasks", "enabled", 0, np.zeros(2), "refused"),
        ("tasks", "stiffness", 0, [[1, 2], [3]], "refused"),
        ("contacts", "bound_groups", 0, 1.0, "refused"),
        ("contacts", "size", 0, np.ones(3), "refused"),
    ],
)
def test_hostile_member(kind, member, after, value, result):
    with np.errstate(all="ignore"):
        assert run_class(HostileClass(kind, member, after, value)) == result
