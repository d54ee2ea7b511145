"""Checks the recording of a trial's fault: it names the fault, and its replay gives the same cycles bit for bit."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from wbc_controller.errors import ConfigurationError
from wbc_controller.recording.recording_file import Recording
from wbc_controller.recording.replay.cycle_replay import Replay
from wbc_controller.recording.replay.recording_summary import summarize


@dataclass(frozen=True, slots=True)
class Place:
    """Where the recordings of one trial are."""

    folder: Path
    name: str  # of the trial, with which the files begin

    @property
    def settings(self) -> Mapping[str, object]:
        """Those of the recorder, by dotted key."""
        return {"recorder.folder": str(self.folder.absolute())}

    def clear(self) -> None:
        """Remove what an earlier run of the same trial has left."""
        for file in self._files():
            file.unlink()

    def mistake(self, code: str, sentence: str) -> str:
        """What is wrong with the recording of a fault, or nothing: it names the fault, and all its cycles come out."""
        files = self._files()
        if not files:
            return f"there is none of {code}"
        try:
            found = [Recording(file) for file in files]
            named = [each for each in found if f"fault {code} " in summarize(each) and sentence in summarize(each)]
            if not named:
                return f"{files[-1]} does not name {code}"
            run = Replay(named[0])
            with np.errstate(all="ignore"):  # as in the trial
                cycles = list(run.run())
        except ConfigurationError as error:
            return str(error)
        different = sum(not each.is_identical for each in cycles)
        if different or not cycles:
            return f"{named[0].path}: of {len(cycles)} cycles {different} do not come out as they were recorded"
        return ""

    def _files(self) -> list[Path]:
        return sorted(self.folder.glob(f"{self.name}-[0-9]*-[0-9]*-*.mcap"))
