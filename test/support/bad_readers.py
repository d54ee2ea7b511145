"""A reader of files that breaks the process which it runs in."""

import os
import signal
import time
from pathlib import Path


def dies_and_hangs(place: Path) -> str:
    """Dies of case 1, and gets no further than case 2."""
    if place.name.endswith("-1"):
        os.kill(os.getpid(), signal.SIGSEGV)
    if place.name.endswith("-2"):
        time.sleep(1000)
    return "works"
