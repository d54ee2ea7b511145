"""A recorded controller of Go2 as a process of its own, to be killed: it writes the number of its cycles into a file.

python killed_recording.py RECORDING COUNTER [CYCLES PER SECOND]
"""

import itertools
import mmap
import struct
import sys
import time
from pathlib import Path

from wbc_controller.nodes.lockstep import Lockstep
from wbc_controller.recording.recorder import Recorder
from wbc_controller.settings.config import load


def main(path: str, counter: str, rate: float) -> None:
    """Run until killed."""
    settings = load("go2").replace({"recorder.folder": str(Path(path).parent / "faults")}).settings
    lockstep = Lockstep(settings, recorder=Recorder(settings, Path(path), name="go2"))
    with Path(counter).open("r+b") as file, mmap.mmap(file.fileno(), 8) as shown:
        due = time.monotonic()
        for number in itertools.count():
            if number == 3:
                lockstep.user.send_text("command", "activate")
            lockstep.cycle()
            shown[:] = struct.pack("<q", number + 1)
            due = max(due + 1.0 / rate, time.monotonic() - 0.1)
            time.sleep(max(0.0, due - time.monotonic()))


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], float(sys.argv[3]) if len(sys.argv) > 3 else 500.0)
