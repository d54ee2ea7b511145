"""Fixtures that draft configurations, and shorten demos."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from robot_cases import EDGED_SOLE, STANDING

from wbc_controller.apps.demo import director, run
from wbc_controller.apps.demo.derived_scenario import derived_scenario
from wbc_controller.apps.demo.scenario import Scenario
from wbc_controller.apps.new.draft import new_configuration
from wbc_controller.apps.new.notes import Draft
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.settings import Settings


def _draft(folder: Path, text: str, **options: Any) -> Draft:
    (folder / "robot.urdf").write_text(text, encoding="utf-8")
    (folder / "sole.obj").write_text(EDGED_SOLE, encoding="utf-8")
    return new_configuration(str(folder / "robot.urdf"), **options)


@pytest.fixture
def drafted(tmp_path: Path) -> Callable[..., Draft]:
    """Return a function that drafts the configuration of a URDF's text."""
    return lambda text, **options: _draft(tmp_path, text, **options)


@pytest.fixture(scope="session")
def draft_of(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Draft]:
    """Return a function that drafts a robot of `STANDING` once, by name."""
    drafts: dict[str, Draft] = {}

    def draft(case: str) -> Draft:
        if case not in drafts:
            drafts[case] = _draft(tmp_path_factory.mktemp("case"), STANDING[case])
        return drafts[case]

    return draft


@pytest.fixture
def shorten_demos(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Return a function that shortens demos to 0.5 s of standing, and some moves, reaches and pushes."""

    def shorten(*kept: str) -> None:
        def scenario(settings: Settings, model: RobotModel) -> Scenario:
            whole = derived_scenario(settings, model)
            moves, shoves = (tuple(one for one in parts if one.name in kept) for parts in (whole.moves, whole.shoves))
            reaches = tuple(replace(reach, duration=2.0) for reach in whole.reaches if "reach" in kept)
            return replace(whole, stand=0.5, moves=moves, reaches=reaches, shoves=shoves, recovery=1.0)

        monkeypatch.setattr(run, "derived_scenario", scenario)
        monkeypatch.setattr(director, "_SETTLING_TIME", 0.1)

    return shorten
