"""The command line."""

import subprocess
import sys

import pytest
import yaml
from command_line import wbc

from wbc_controller.cli import COMMANDS, main


def test_invalid_options_and_unknown_commands_are_refused(monkeypatch):
    assert "'ideal', 'good', 'cheap'" in wbc("demo", "go2", "--sensors", "perfect", status=2).output
    monkeypatch.setenv("ROS_DOMAIN_ID", "many")
    result = wbc("run", "go2", status=2)
    assert "ROS_DOMAIN_ID" in result.stderr
    assert "many" in result.stderr
    assert "rnu" in wbc("rnu", status=2).output


@pytest.mark.parametrize(
    "words",
    [
        *(f"fuzz {name} --count 0" for name in ("messages", "urdf", "classes", "clocks", "problems")),
        *("fuzz floods --trials 0", "fuzz kills --trials 0", "fuzz soak --minutes 0", "fuzz setpoints --minutes -1"),
        *("accuracy standing --jobs 0", "faults --jobs 0", "faults --jobs -2"),
    ],
)
def test_runs_without_trials_or_processes_are_refused(words):
    *_, option, number = words.split()
    said = wbc(*words.split(), status=2).stderr
    assert f"Invalid value for '{option}': {number}" in said
    assert "is not in the range" in said


def test_help_lists_all_commands_in_order_and_the_table_of_topics_is_printed():
    result = wbc("--help")
    for command in ("new", "run", "mock", "guard", "check", "demo", "fuzz", "bench", "topics"):
        assert f"  {command} " in result.output
    assert "g1, talos, go2" in result.output
    assert list(COMMANDS) == sorted(COMMANDS)
    for name in COMMANDS:
        assert main.get_command(None, name).name == name
    assert "`~/command`" in wbc("topics").output


@pytest.mark.parametrize("option", ["-h", "--help"])
def test_help_of_each_command(option):
    """`test_interface.py` finds the removal of an option."""
    for command in COMMANDS:
        assert f"Usage: main {command} [OPTIONS]" in wbc(command, option).output


def test_check_prints_findings_of_a_shipped_robot():
    lines = wbc("check", "g1").output.splitlines()
    assert lines[0].endswith("config/g1.yaml")
    assert lines[-1] == "ok"
    for part in ("29 actuated, base floating", "left_foot (surface)", "com (com)", "daqp, 500 cycles per second"):
        assert any(part in line for line in lines)


def test_a_new_configuration_is_all_of_stdout_and_doubts_and_findings_are_on_stderr():
    result = wbc("new", "package://example-robot-data/robots/go1_description/urdf/go1.urdf")
    values = yaml.safe_load(result.stdout)["wbc_controller"]["ros__parameters"]
    assert len(values["robot"]["joints"]) == 12
    for part in ("robot.armature: Fill in: ", "robot.joints: Guess: ", "  standing         possible on "):
        assert part in result.stderr
        assert part not in result.stdout
    assert result.stderr.endswith("\nok\n")


def test_draft_with_which_the_robot_cannot_stand_has_a_status_and_a_missing_urdf_is_refused():
    result = wbc("new", "package://example-robot-data/robots/bolt_description/robots/bolt.urdf", status=2)
    assert yaml.safe_load(result.stdout)["wbc_controller"]["ros__parameters"]["contacts"]
    assert "contacts: Fill in: " in result.stderr
    assert "outside the support" in result.stderr.splitlines()[-1]
    result = wbc("new", "no.urdf", status=2)
    assert (result.stdout, result.stderr) == ("", "error: ROBOT.urdf = 'no.urdf': file no.urdf does not exist\n")


@pytest.mark.parametrize("command", ["run", "mock", "guard", "check", "demo"])
def test_a_robot_that_is_not_shipped_suggests_one(command, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = wbc(command, "g2", status=2)
    assert list(tmp_path.iterdir()) == []
    assert result.stderr == (
        "error: unknown configuration 'g2'; did you mean 'go2'? Valid: g1, go2, talos, or the path of a .yaml file\n"
    )


@pytest.mark.parametrize("command", ["run", "mock", "guard"])
@pytest.mark.parametrize("remapping", ["odom", "odom=/x", ":=x"])
def test_a_remapping_of_another_form_is_refused_before_anything_starts(command, remapping):
    result = wbc(command, "go2", "--remap", remapping, status=2)
    assert result.stderr.startswith(f"error: invalid remapping {remapping!r}; valid: from:=to")


#: Modules imported by their own commands only.
WORKSHOP = ("validation", "simulation", "apps.demo")
IMPORTED = f"""
import sys
from click.testing import CliRunner
from wbc_controller.cli import main

def show(user):
    print(user, [name for name in sys.modules if name.removeprefix("wbc_controller.").startswith({WORKSHOP!r})])

for command in ("send", "status", "echo", "run", "guard", "view", "check"):
    assert CliRunner().invoke(main, [command, "--help"]).exit_code == 0
    show(command)
from wbc_controller.apps.terminal import session, status_view
from wbc_controller.nodes import controller_service, guard_service, estimator_service
from wbc_controller.nodes.ros2 import security_policy
from wbc_controller.recording.replay import replay_commands
show("modules")
"""


def test_only_their_own_commands_import_simulation_validation_and_demo():
    said = subprocess.run([sys.executable, "-c", IMPORTED], capture_output=True, text=True, check=True).stdout
    assert len(said.splitlines()) == 8
    assert [line for line in said.splitlines() if not line.endswith(" []")] == []
