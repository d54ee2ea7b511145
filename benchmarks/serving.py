"""The workers' side of the comparison: answers states over a pipe. Of the outside it imports NumPy alone.

A worker is started with a JSON object on the first line of its standard input, the scene of `scenes.py` as a
dictionary, and answers with a line: its `hello`. Then every question is two int64, a count and the bytes to touch
before each cycle, and as many rows of float64: q, v, and the centre of mass's reference (position, velocity,
acceleration). The answer has as many rows of float64: v̇, τ, the contact forces, the seconds of each part of the cycle,
and the seconds of the whole.
"""

from __future__ import annotations

import ast
import gc
import json
import os
import struct
import sys
from pathlib import Path
from typing import Any, Protocol

import numpy as np

#: Code that `Elsewhere` runs: a parser meets other branches and other memory than a control cycle does.
_TEXT = Path(__file__).read_text(encoding="utf-8")


class Contestant(Protocol):
    """What a worker times.

    Attributes:
        hello: its `version`, where it has one; `unknowns`, `equalities` and `inequalities` of its problem; `sizes` of
            v̇, τ and the contact forces; and the names of its `parts`.
    """

    hello: dict[str, Any]

    def cycle(self, q: np.ndarray, v: np.ndarray, reference: np.ndarray) -> np.ndarray:
        """Answer one state: v̇, τ, forces, seconds of the parts, seconds of the whole; NaN without a solution."""


class Elsewhere:
    """Other work between two cycles: writes to memory, then parses a text, so that caches hold nothing of the cycle."""

    def __init__(self) -> None:
        self._memory = np.zeros(0)

    def work(self, size: int) -> None:
        """Touch so many bytes; 0 does nothing."""
        if not size:
            return
        if 8 * len(self._memory) != size:
            self._memory = np.zeros(size // 8)
        self._memory += 1.0
        ast.parse(_TEXT)


def take_code_from(folder: str) -> None:
    """Make `wbc_controller` the package in a folder.

    Raises:
        ImportError: where it would be another one.
    """
    sys.path.insert(0, folder)
    import wbc_controller

    found = Path(wbc_controller.__file__ or "").resolve()
    if Path(folder).resolve() not in found.parents:
        raise ImportError(f"wbc_controller is {found}, not in {folder}")


def serve(make: Any) -> None:
    """Answer on standard output until standard input is closed.

    Args:
        make: gives a `Contestant` for the scene.
    """
    # What libraries print must not get between the answers.
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    questions = sys.stdin.buffer
    scene = json.loads(questions.readline())
    contestant: Contestant = make(scene)
    nq, nv = scene["nq"], scene["nv"]
    elsewhere = Elsewhere()
    gc.collect()
    gc.freeze()  # as a running service has it: the collector works, on what the cycles make
    # The last thing before it waits: the others are timed from then on, on the same processor.
    answers.write((json.dumps(contestant.hello) + "\n").encode())
    answers.flush()
    while head := questions.read(16):
        count, size = struct.unpack("<qq", head)
        width = nq + nv + 9
        rows = np.frombuffer(questions.read(8 * count * width)).reshape(count, width)
        # Written when all are there: whoever reads them would be woken, on the same processor, between two cycles.
        found = []
        for row in rows:
            q, v, reference = np.split(row, [nq, nq + nv])
            elsewhere.work(size)
            found.append(contestant.cycle(q, v, reference))
        answers.write(np.concatenate(found).tobytes())
        answers.flush()
