"""`wbc identify` reads what the flight recorder writes."""

from __future__ import annotations

from wbc_controller.identification.command import identify
from wbc_controller.settings.config import load


def test_a_file_of_the_flight_recorder_is_read(record, tmp_path):
    run = record(tmp_path / "run.mcap")
    run.stand(200)
    run.recorder.close()
    found, model = identify(load("go2").settings, tmp_path / "run.mcap")
    assert found.count > 0
    assert {f"dry {joint}" for joint in model.joints} <= set(found.names)
