"""Short trials, and the commands of `wbc accuracy`."""

import pytest
from click.testing import CliRunner

from wbc_controller.validation.accuracy.accuracy_commands import accuracy


@pytest.fixture(autouse=True)
def _short_rest(monkeypatch):
    monkeypatch.setattr("wbc_controller.validation.accuracy.estimation_trial._REST_TIME", 0.4)


@pytest.fixture
def run():
    """Run a command without its group, which takes over the process's signals."""
    return lambda command, *words: CliRunner().invoke(accuracy.commands[command], [*words, "--jobs", "1"])
