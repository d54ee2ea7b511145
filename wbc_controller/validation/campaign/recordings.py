"""Check of fault recordings: named fault, identical replay."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from wbc_controller.errors import ConfigurationError
from wbc_controller.recording.recording_file import Recording
from wbc_controller.recording.replay.cycle_replay import Replay
from wbc_controller.recording.replay.recording_summary import summarize


@dataclass(frozen=True, slots=True)
class TrialRecordings:
    """Recordings of one trial."""

    folder: Path
    name: str  # beginning of the file names

    def clear(self) -> None:
        """Remove the recordings of an earlier run of the trial."""
        for file in self._files():
            file.unlink()

    def error_of_fault(self, code: str, sentence: str) -> str:
        """Return the error of a fault's recording, or an empty text."""
        files = self._files()
        if not files:
            return f"no recording of {code}"
        try:
            found = [Recording(file) for file in files]
            named = [each for each in found if f"fault {code} " in (said := summarize(each)) and sentence in said]
            if not named:
                return f"{files[-1]} does not name {code}"
            run = Replay(named[0])
            with np.errstate(all="ignore"):
                cycles = list(run.run())
        except ConfigurationError as error:
            return str(error)
        different = sum(not each.is_identical for each in cycles)
        if different or not cycles:
            return f"{named[0].path}: the replay of {different} of {len(cycles)} cycles differs from the recording"
        return ""

    def _files(self) -> list[Path]:
        return sorted(self.folder.glob(f"{self.name}-[0-9]*-[0-9]*-*.mcap"))
