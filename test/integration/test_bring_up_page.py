"""The commands of docs/bring-up.md in two real processes without ROS 2."""

import re
from pathlib import Path

import pytest
from busy import patience
from pages import files, page
from waiting import until

PAGE = page("bring-up")
FILES = files(PAGE)
#: Wall time in which a command ends on a computer without other work, s.
PATIENCE = 120.0

pytestmark = pytest.mark.live


def commands(name):
    """The lines of `wbc send` and `wbc status` in the page's blocks for a robot, in order."""
    blocks = "\n".join(re.findall(r"```bash\n(.*?)```", PAGE, re.DOTALL))
    return re.findall(rf"^wbc ((?:send|status) {name}.*)$", blocks, re.MULTILINE)


def test_the_page_has_commands_for_both_robots():
    assert [line.split()[2] for line in commands("anymal.yaml")[:2]] == ["activate", "release"]
    assert commands("stand.yaml") == ["send stand.yaml posture LF_KFE by 0.1"]


@pytest.mark.parametrize(("name", "first"), [("anymal.yaml", []), ("stand.yaml", ["send stand.yaml activate"])])
def test_a_robot_is_brought_up(tmp_path, processes, name, first):
    path = str(tmp_path / name)
    Path(path).write_text(FILES[name], encoding="utf-8")
    # In lockstep a slow computer has no effect.
    processes.start("mock", path, "--lockstep")
    processes.start("run", path, "--use-sim-time")
    lines = [*first, *commands(name)]

    def execute(line):
        verb, _, *words = line.split()
        run = processes.start(verb, path, "--wait", str(patience(60.0)), *words)
        assert run.wait(timeout=patience(PATIENCE)) == 0, processes.logs()

    def last_status():
        return processes.logs().rpartition("-status.log\n")[2]

    for line in lines:
        execute(line)
    logs = processes.logs()
    assert "the controller is active at full torque" in logs
    assert "refused" not in logs.split("-send.log", 1)[1]
    if name == "anymal.yaml":
        assert re.search(r"the last seconds are written to '\S+the-push\.mcap'", logs.split("-send.log", 1)[1])
        assert lines[-1].startswith("status ")
        # The audit reports the push for a while.
        until(lambda: last_status().startswith("anymal: active\n"), "a calm status", again=lambda: execute(lines[-1]))
        assert re.search(r"^ com +com +50 +\S+ \S+ \S+ ", last_status(), re.MULTILINE)
    else:
        assert "accepted: posture moves LF_KFE by 0.1" in logs
