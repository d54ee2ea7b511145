"""`wbc identify` with a file of the flight recorder."""

import pytest

from wbc_controller.errors import ConfigurationError
from wbc_controller.recording.identification.identify import identify
from wbc_controller.settings.config import load


def test_a_file_of_the_flight_recorder_is_read(record, tmp_path):
    run = record(tmp_path / "run.mcap")
    run.stand(200)
    run.recorder.close()
    with pytest.raises(
        ConfigurationError, match=r"run\.mcap: the recording contains no motion that its contacts permit"
    ):
        identify(load("go2").settings, tmp_path / "run.mcap")
