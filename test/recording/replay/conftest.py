"""A memory every 100 cycles, for short recordings."""

from collections.abc import Iterator

import pytest


@pytest.fixture(scope="module", autouse=True)
def _frequent_memories() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("wbc_controller.recording.recorder._SNAPSHOT", 0.2)
        yield
