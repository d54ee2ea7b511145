"""Fixture of replay tests: a controller with recorded cycles, and a memory every 100 cycles for short recordings."""

from collections.abc import Iterator

import pytest
from recorded_run import record

__all__ = ["record"]


@pytest.fixture(scope="module", autouse=True)
def _frequent_memories() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("wbc_controller.recording.recorder._SNAPSHOT", 0.2)
        yield
