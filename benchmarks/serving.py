"""Workers' side of the comparison: answers states over a pipe. The only external import is NumPy.

The first line of standard input is a JSON object, the scene of `scenes.py`. The worker answers with its `hello` in one
line. Each question is two int64, a count and the bytes to touch before each cycle, and rows of float64: q, v, and the
reference of the centre of mass (position, velocity, acceleration). The answer has as many rows of float64: v̇, τ,
contact forces, seconds of each part, and seconds of the whole cycle.
"""

import ast
import gc
import json
import os
import struct
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np

#: Text for the parser of `CacheEviction`, which uses other branches and memory than a control cycle.
_TEXT = Path(__file__).read_text(encoding="utf-8")


class Contestant(Protocol):
    """Timed object of a worker.

    Attributes:
        hello: its description by `describe`.
    """

    hello: dict[str, Any]

    def cycle(self, q: np.ndarray, v: np.ndarray, reference: np.ndarray) -> np.ndarray:
        """Answer one state: v̇, τ, forces, seconds of the parts, seconds of the whole; NaN without a solution."""


def describe(version: str, problem: Sequence[int], sizes: Sequence[int], parts: Sequence[str]) -> dict[str, Any]:
    """Return the first answer of a worker.

    `version`, if any; unknowns, equalities and inequalities of the problem; sizes of v̇, τ and the contact forces;
    names of the timed parts.
    """
    counts = dict(zip(("unknowns", "equalities", "inequalities"), problem, strict=True))
    return {"version": version, **counts, "sizes": list(sizes), "parts": list(parts)}


class CacheEviction:
    """Other work between two cycles that evicts the cycle from the caches: memory writes and a parsed text."""

    def __init__(self) -> None:
        self._memory = np.zeros(0)

    def work(self, size: int) -> None:
        """Touch a number of bytes; 0 for no work."""
        if not size:
            return
        if 8 * len(self._memory) != size:
            self._memory = np.zeros(size // 8)
        self._memory += 1.0
        ast.parse(_TEXT)


def take_code_from(folder: str) -> None:
    """Make `wbc_controller` the package in a folder.

    Raises:
        ImportError: if another package was imported.
    """
    sys.path.insert(0, folder)
    import wbc_controller

    found = Path(wbc_controller.__file__ or "").resolve()
    if Path(folder).resolve() not in found.parents:
        raise ImportError(f"wbc_controller is {found}, not in {folder}")


def serve(make: Any) -> None:
    """Answer on standard output until standard input is closed; `make` returns a `Contestant` for the scene."""
    # Output of libraries must not mix with the answers.
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    questions = sys.stdin.buffer
    scene = json.loads(questions.readline())
    contestant: Contestant = make(scene)
    nq, nv = scene["nq"], scene["nv"]
    eviction = CacheEviction()
    gc.collect()
    gc.freeze()  # as in a running service; the collector remains active
    # Last work before waiting: then the other contestants are timed on the same processor.
    answers.write((json.dumps(contestant.hello) + "\n").encode())
    answers.flush()
    while head := questions.read(16):
        count, size = struct.unpack("<qq", head)
        width = nq + nv + 9
        rows = np.frombuffer(questions.read(8 * count * width)).reshape(count, width)
        # Answers are written together, because a woken reader would disturb the cycles on the same processor.
        found = []
        for row in rows:
            q, v, reference = np.split(row, [nq, nq + nv])
            eviction.work(size)
            found.append(contestant.cycle(q, v, reference))
        answers.write(np.concatenate(found).tobytes())
        answers.flush()
