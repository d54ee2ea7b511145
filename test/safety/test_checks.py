import re

import numpy as np
import pytest
from pages import ROOT, page
from safety_table import CHECKS, safety_table

from wbc_controller.safety.checks import stale_inputs, unusable_torques
from wbc_controller.settings import Settings

LIMITS = np.array([10.0, 20.0])
EFFORT = -LIMITS, LIMITS
JOINTS = ("hip", "knee")


@pytest.mark.parametrize(
    ("age", "said"),
    [
        *((fresh, None) for fresh in (0.0, 0.049, 0.05)),
        (np.nextafter(0.05, 1.0), "joint_states is 50 ms old (limit 50 ms)"),
        (0.0521, "joint_states is 52 ms old (limit 50 ms)"),
        (float("inf"), "joint_states has not arrived (limit 50 ms)"),
        (float("nan"), "joint_states has not arrived (limit 50 ms)"),
    ],
)
def test_an_input_over_the_limit_is_named_with_its_age(age, said):
    fault = stale_inputs({"joint_states": age, "odom": 0.0}, 0.05)
    assert (fault and (fault.code, fault.sentence)) == (said and ("STALE_INPUT", said))


def test_stale_inputs_are_named_with_what_is_known():
    fault = stale_inputs({"joint_states": 0.1, "odom": 0.2}, 0.05, lambda: {"odom": "last refusal: the twist is bad"})
    assert fault.sentence == (
        "joint_states is 100 ms old (limit 50 ms); odom is 200 ms old (limit 50 ms); last refusal: the twist is bad"
    )
    assert stale_inputs({"odom": 0.0}, float("nan")) is not None


@pytest.mark.parametrize("tau", [np.nan, np.inf, -np.inf, 10.1001, -10.1001, 1e300])
def test_torques_that_are_not_finite_or_over_a_limit_are_named(tau):
    fault = unusable_torques(np.array([tau, 1.0]), EFFORT, LIMITS, JOINTS)
    assert fault.code == "BAD_TORQUE"
    assert f"hip: {tau:.3g} N·m (limit 10)" in fault.sentence
    assert "knee" not in fault.sentence


def test_every_joint_with_a_bad_torque_is_named():
    sentence = unusable_torques(np.array([np.nan, 30.0]), EFFORT, LIMITS, JOINTS).sentence
    assert "hip: nan" in sentence
    assert "knee: 30" in sentence
    assert "hip: 0" in unusable_torques(np.zeros(2), EFFORT, np.array([np.nan, 20.0]), JOINTS).sentence
    available = np.array([-10.0, -5.0]), np.array([2.0, 20.0])
    fault = unusable_torques(np.array([2.2, -5.3]), available, LIMITS, JOINTS)
    assert fault.sentence.endswith("hip: 2.2 N·m (limit 2), knee: -5.3 N·m (limit 5)")
    fault = unusable_torques(np.array([2.1, -5.3]), available, LIMITS, JOINTS)
    assert fault.sentence.endswith("not usable: knee: -5.3 N·m (limit 5)")


PAGE = page("safety")


def test_the_table_of_checks_in_the_docs_is_that_of_the_code():
    assert safety_table() in PAGE, "replace the table in docs/safety.md by the output of: python docs/safety_table.py"


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.name)
def test_every_check_has_its_threshold_in_the_configuration_a_code_in_the_docs_and_a_test(check):
    for key in check.keys:
        section, name = key.split(".")
        assert name in Settings.model_fields[section].annotation.model_fields
    file, _, test = check.test.partition("::")
    assert re.search(rf"^def {test}\(", (ROOT / "test" / file).read_text(encoding="utf-8"), re.MULTILINE)
    assert not check.code or f"- `{check.code}`: " in PAGE


def test_limits_of_safety_are_not_live_and_have_a_check():
    assert Settings.model_fields["safety"].annotation.live == ()
    assert "torque_rate" not in Settings.model_fields["limits"].annotation.live
    keys = {key.split(".")[1] for check in CHECKS for key in check.keys if key.startswith("safety.")}
    assert keys | {"activation_ramp", "damping_time"} == set(Settings.model_fields["safety"].annotation.model_fields)
