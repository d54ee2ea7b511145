"""Each command and name that needs an optional library reports the line that installs it."""

import json
import re
import subprocess
import sys
from pathlib import Path

import click
import pytest
from robot_cases import joint, link, robot

from wbc_controller.cli import main
from wbc_controller.extras import EXTRAS

FUZZERS = ("clocks", "configurations", "floods", "kills", "messages", "recordings", "setpoints", "soak", "urdf")
#: The extras that each command needs. `run.mcap` is an empty file.
NEEDED = {
    **{
        f"accuracy {name}": "mock campaign"
        for name in ("standing", "flaws", "mishaps", "walking", "walking-grounds", "walking-starts", "walking-pushes")
    },
    "bench latency": "dds mock robots",
    **{f"{name} robot.yaml": "dds" for name in ("estimate", "guard", "run", "status")},
    "drive robot.yaml": "dds",
    "echo robot.yaml state": "dds",
    "mock robot.yaml": "mock dds",
    "send robot.yaml activate": "dds",
    "demo g1 --lockstep": "mock plots robots",
    "faults g1": "mock campaign",
    **{f"fuzz {name}": "mock" for name in FUZZERS},
    **{f"fuzz {name} --count 1": "fuzz" for name in ("classes", "configurations", "messages", "recordings", "urdf")},
    "mock g1": "dds mock robots",
    "play g1": "dds mock view",
    "replay run.mcap --config g1 --plot page.html": "plots",
    "report run.mcap": "plots",
    "view g1": "dds view robots",
    **{f"{name} g1": "dds robots" for name in ("estimate", "guard", "run")},
    **{f"{name} g1": "robots" for name in ("check", "security-policy")},
}
#: Commands that need no extra.
PLAIN = {"fuzz problems", "identify", "new", "topics"}
ARM = robot(link("base"), link("upper", 2.0, "0 0 0.2"), joint("shoulder", "base", "upper"))
CONFIGURATION = """
wbc_controller:
  ros__parameters:
    robot: {urdf: robot.urdf, base: fixed, joints: [shoulder], posture: [0.0]}
    tasks: {posture: {type: posture}}
"""
#: Runs the commands with the libraries of some extras missing, and prints status and output of each.
RUN = """
import importlib.metadata, json, sys
from click.testing import CliRunner
commands, libraries, packages = json.loads(sys.argv[1])
sys.modules.update(dict.fromkeys(libraries))
found = importlib.metadata.distribution
def distribution(name):
    if name in packages:
        raise importlib.metadata.PackageNotFoundError(name)
    return found(name)
importlib.metadata.distribution = distribution
from wbc_controller.cli import main
results = {}
for command in commands:
    result = CliRunner().invoke(main, command.split())
    results[command] = result.exit_code, result.output
print(json.dumps(results))
"""


def results_without(extras, commands, folder: Path) -> dict[str, tuple[int, str]]:
    libraries = [name for name, extra in EXTRAS.items() if extra in extras]
    packages = ["example-robot-data"] if "robots" in extras else []
    words = [sys.executable, "-c", RUN, json.dumps([list(commands), libraries, packages])]
    (folder / "run.mcap").touch()
    (folder / "robot.urdf").write_text(ARM, encoding="utf-8")
    (folder / "robot.yaml").write_text(CONFIGURATION, encoding="utf-8")
    done = subprocess.run(words, cwd=folder, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def names_of(command: click.Command, path: str = "") -> set[str]:
    if not isinstance(command, click.Group):
        return {path}
    below = {name: command.get_command(click.Context(command), name) for name in command.list_commands(None)}
    return {name for key, each in below.items() for name in names_of(each, f"{path} {key}".strip())}


def test_every_command_is_listed():
    names = names_of(main)
    assert PLAIN | {name for name in names if any(f"{command} ".startswith(f"{name} ") for command in NEEDED)} == names


@pytest.mark.parametrize("missing", [("mock", "plots", "view"), ("campaign", "dds", "fuzz", "robots")])
def test_commands_without_an_extra_report_the_line_that_installs_it(missing, tmp_path):
    commands = [command for command, extras in NEEDED.items() if not set(missing).isdisjoint(extras.split())]
    for command, (status, output) in results_without(missing, commands, tmp_path).items():
        line = re.search(r"pip install 'wbc_controller\[(.*)\]'\n", output)
        assert status == 2, f"{command}: {output}"
        assert line is not None, f"{command}: {output}"
        assert set(line.group(1).split(",")) <= {*missing} & {*NEEDED[command].split()}
        if command.startswith(("demo", "play")) and "mock" in missing:
            assert "," in line.group(1)  # all missing ones, in one line
    assert {path.name for path in tmp_path.iterdir() if path.is_file()} == {"run.mcap", "robot.urdf", "robot.yaml"}


ALONE = """
import sys
sys.modules.update(dict.fromkeys(sys.argv[1:]))
from click.testing import CliRunner
from wbc_controller.cli import main
drafted = CliRunner().invoke(main, ["new", "arm.urdf"])
assert drafted.exit_code == 0, drafted.output
open("arm.yaml", "w").write(drafted.stdout)
checked = CliRunner().invoke(main, ["check", "arm.yaml", "--html", "page.html"])
assert checked.exit_code == 0, checked.output
import wbc_controller as wbc
controller = wbc.Controller(wbc.load("arm.yaml"))
controller.reset(controller.stance(), [0.0], t=0.0)
print(controller.step(controller.stance(), [0.0], t=0.002).tau.shape)
for name in ("Simulation", "MujocoInterface"):
    try:
        getattr(wbc, name)
    except wbc.ConfigurationError as error:
        print(name, error)
"""


def test_a_given_urdf_needs_no_optional_library_and_a_simulation_reports_its_extra(tmp_path):
    (tmp_path / "arm.urdf").write_text(ARM, encoding="utf-8")
    words = [sys.executable, "-c", ALONE, *EXTRAS]
    done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == [
        "(1,)",
        "Simulation mujoco is not installed; install with: pip install 'wbc_controller[mock]'",
    ]


def test_an_import_of_another_library_is_not_replaced(monkeypatch):
    from wbc_controller.extras import optional_libraries

    with pytest.raises(ModuleNotFoundError, match="no_such_library"), optional_libraries():
        import no_such_library  # noqa: F401
