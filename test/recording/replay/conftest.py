"""Tests of replays use a controller whose cycles are recorded, with a memory every 100 cycles: they stay short."""

import pytest
from recorded_run import record

__all__ = ["record"]


@pytest.fixture(autouse=True)
def _frequent_memories(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("wbc_controller.recording.recorder._SNAPSHOT", 0.2)
