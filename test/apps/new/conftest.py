"""Fixture that drafts configurations."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from robot_cases import EDGED_SOLE

from wbc_controller.apps.new.draft import new_configuration
from wbc_controller.apps.new.notes import Draft


@pytest.fixture
def drafted(tmp_path: Path) -> Callable[..., Draft]:
    """Return a function that drafts the configuration of a URDF's text."""

    def make(text: str, **options: Any) -> Draft:
        (tmp_path / "robot.urdf").write_text(text, encoding="utf-8")
        (tmp_path / "sole.obj").write_text(EDGED_SOLE, encoding="utf-8")
        return new_configuration(str(tmp_path / "robot.urdf"), **options)

    return make
