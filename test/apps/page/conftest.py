"""Recordings for the tests of the page, which are skipped without viser."""

from pathlib import Path

import pytest
from recorded_run import record

__all__ = ["record"]


class PageModule(pytest.Module):
    """Module whose imports require viser."""

    def collect(self):
        pytest.importorskip("viser", reason="the page requires viser: pip install 'wbc_controller[view]'")
        return super().collect()


def pytest_pycollect_makemodule(module_path: Path, parent: pytest.Collector) -> PageModule:
    return PageModule.from_parent(parent, path=module_path)
