"""Reading of faults from YAML, messages on mistakes, random parameters, and documentation."""

import numpy as np
import pytest
from faults_table import by_place, faults_table
from pages import page
from refusals import refusal
from stepping import has_faults

from wbc_controller.errors import InputRefused
from wbc_controller.simulation.faults.catalogue import KINDS, draw, read_faults
from wbc_controller.validation.campaign.trial import ALL_KINDS


def test_there_are_at_least_45_kinds_and_the_page_describes_each():
    assert len(KINDS) >= 45
    for name, kind in KINDS.items():
        assert kind.place, name
        assert kind.__doc__.strip().endswith("."), name
    for place, kinds in by_place(ALL_KINDS.values()).items():
        assert faults_table(kinds) in page("faults"), place


def test_one_fault_or_a_list_is_read_and_an_entry_of_a_script_needs_its_time():
    (one,) = read_faults("{kind: joint_noise, sigma: 0.01, start: 0.5, duration: 2.0, seed: 7}", "x")
    assert (one.kind(), one.sigma, one.start, one.duration, one.seed) == ("joint_noise", 0.01, 0.5, 2.0, 7)
    both = read_faults("[{kind: kick}, {kind: odom_frozen}]", "x")
    assert [fault.kind() for fault in both] == ["kick", "odom_frozen"]
    (fault,) = read_faults("- {at: 12.5, kind: kick}", "x", script=True)
    assert fault.start == 12.5
    for text in ("[{kind: kick}]", "[{kind: kick, at: 1.0, start: 2.0}]", "[{kind: kick, start: 1.0}]"):
        assert "'at'" in refusal(read_faults, text, "here", script=True)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("{kind: joint_noize}", ["unknown kind 'joint_noize'", "did you mean 'joint_noise'?", "Valid: "]),
        ("{sigma: 1}", ["unknown kind None"]),
        ("{kind: [1]}", ["unknown kind"]),
        ("{kind: joint_noise, sigma: 3.0}", ["joint_noise.sigma = 3.0", "1e-05 to 0.05 rad", "standard deviation"]),
        ("{kind: joint_noise, sigma: .nan}", ["joint_noise.sigma = nan"]),
        ("{kind: joint_noise, sigmma: 0.01}", ["unknown key 'sigmma'", "did you mean 'sigma'?"]),
        ("{kind: message_loss, stream: odometry}", ["stream = 'odometry'", "joint_states, odom, imu, both"]),
        ("{kind: kick, duration: -1}", ["kick.duration = -1"]),
        ("{kind: kick, seed: -1}", ["kick.seed = -1"]),
        ("{kind: kick, at: 1.0}", ["unknown key 'at'"]),
        ("[{kind: kick}, 5]", ["fault 2: expected a mapping, got 5", "{kind: joint_noise"]),
        ("[{kind: kick}, {kind: kick, link: 3}]", ["fault 2", "kick.link = 3"]),
        ("", ["expected a mapping, got None"]),
        ("{kind: kick", ["not valid YAML"]),
        (f"[{', '.join(['{kind: kick}'] * 101)}]", ["101 faults", "at most 100"]),
    ],
)
def test_a_mistake_is_named_with_the_value_and_the_valid_ones(text, said):
    found = refusal(read_faults, text, "here")
    assert found.startswith("here")
    assert [part for part in said if part not in found] == []


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("{kind: joint_bias, joint: FL_knee}", "unknown joint 'FL_knee'.*Valid: FL_calf_joint"),
        ("{kind: actuator_dead, actuator: x}", "unknown actuator 'x'; Valid"),
        ("{kind: payload, link: trunk}", "unknown link 'trunk'"),
        ("{kind: floor_hole, contact: left}", "unknown contact 'left'.*front_left_foot"),
    ],
)
def test_unknown_names_are_refused_with_the_whole_list(bench, text, said):
    faults = [*read_faults("{kind: kick}", "x"), *read_faults(text, "x")]
    with pytest.raises(InputRefused, match=said):
        bench.faults.plan(faults, 0.0)
    assert not has_faults(bench.faults)


def test_too_many_are_refused(bench):
    faults = read_faults("{kind: kick, start: 1.0}", "x") * 600
    bench.faults.plan(faults, 0.0)
    with pytest.raises(InputRefused, match="too many; at most 1000"):
        bench.faults.plan(faults, 0.0)


@pytest.mark.parametrize("kind", ALL_KINDS)
def test_every_kind_is_drawn_within_its_ranges_and_begins_on_a_robot(bench, kind):
    for seed in range(5):
        fault, again = (draw(ALL_KINDS[kind], np.random.default_rng(seed), start=0.0, duration=0.004) for _ in range(2))
        assert fault == again
        if kind in KINDS:
            bench.faults.plan([fault], bench.plant.time)
    bench.measures(3)
    for stream in ("joint_states", "odom"):
        bench.faults.deliver(stream, 0, b"0")


def test_wide_ranges_are_drawn_by_their_logarithm():
    rng = np.random.default_rng(0)
    sigmas = [draw(KINDS["joint_noise"], rng).sigma for _ in range(400)]
    assert 1e-5 <= min(sigmas) < 1.2e-5
    assert 4e-2 < max(sigmas) <= 5e-2
    assert 3e-4 < np.median(sigmas) < 2e-3  # of a uniform draw it would be 2.5e-2
