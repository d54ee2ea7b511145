"""Fixture of replay tests: a controller with recorded cycles, and a memory every 100 cycles for short recordings."""

import pytest
from recorded_run import record

__all__ = ["record"]


@pytest.fixture(autouse=True)
def _frequent_memories(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("wbc_controller.recording.recorder._SNAPSHOT", 0.2)
