"""Mutations of bytes and texts, drawn from a generator of random numbers."""

from __future__ import annotations

import re
import struct
from collections.abc import Sequence
from typing import TypeVar

import numpy as np

from wbc_controller.validation.fuzz.values import FLOATS, LENGTHS

T = TypeVar("T")

#: Number of mutations of one payload or text; one alone gets furthest into what reads it.
_MUTATIONS = (1, 1, 1, 2, 4)
#: Longest run of bytes or characters that is repeated or inserted.
_LONGEST_RUN = 64
#: A number, a word, or any other visible character.
_TOKEN = re.compile(r"[-+]?[0-9][-+.0-9eE]*|[A-Za-z_][\w./:-]*|\S")
#: A number in a text, and what it may be multiplied by: signs, mistaken units, degrees for radians.
_NUMBER = re.compile(r"(?<![\w.])-?[0-9]+\.?[0-9]*(?:[eE][-+]?[0-9]+)?(?![\w.])")
_FACTORS = (-1.0, 0.0, 0.5, 2.0, 57.29577951308232, 1e-9, 1e-3, 1e3, 1e6)
#: What a text cannot hold in one encoding or another.
_STRAY = ("\x00", "\r", "\t", "\ufeff", "\u2028", "é", "\U0001f916", "#", ":", "-", "[", "}", "&", "*", "!", "<", ">")


def pick(rng: np.random.Generator, choices: Sequence[T]) -> T:
    """One of some choices."""
    return choices[int(rng.integers(len(choices)))]


def mutated_bytes(rng: np.random.Generator, payload: bytes) -> bytes:
    """Change a serialized message: bits, lengths, values, truncation, repetition, insertion."""
    data = bytearray(payload)
    for _ in range(pick(rng, _MUTATIONS)):
        if not data:
            return bytes(rng.bytes(int(rng.integers(_LONGEST_RUN))))
        at, run = int(rng.integers(len(data))), int(rng.integers(1, _LONGEST_RUN))
        aligned = at - at % 4
        kind = int(rng.integers(8))
        if kind == 0:
            data[at] ^= 1 << int(rng.integers(8))
        elif kind == 1:
            data[at] = pick(rng, (0, 1, 0x7F, 0x80, 0xFF))
        elif kind == 2:
            data[aligned : aligned + 4] = struct.pack("<I", pick(rng, LENGTHS))
        elif kind == 3:
            data[at - at % 8 + 4 : at - at % 8 + 12] = struct.pack("<d", pick(rng, FLOATS))
        elif kind == 4:
            del data[at:]
        elif kind == 5:
            del data[at : at + run]
        elif kind == 6:
            data[at:at] = data[at : at + run] * int(rng.integers(1, 4))
        else:
            data[at:at] = rng.bytes(run)
    return bytes(data)


def mutated_text(rng: np.random.Generator, text: str, values: Sequence[str]) -> str:
    """Change a text: tokens replaced by hostile values or by each other, lines lost, repeated, swapped or indented.

    Args:
        rng: source of the choices.
        text: a valid text.
        values: what may take the place of a token.
    """
    for _ in range(pick(rng, _MUTATIONS)):
        tokens = list(_TOKEN.finditer(text))
        lines = text.split("\n")
        line = int(rng.integers(len(lines)))
        kind = int(rng.integers(12))
        if kind >= 9:
            text = scaled(rng, text)
        elif kind <= 3 and tokens:
            token = pick(rng, tokens)
            text = text[: token.start()] + pick(rng, values) + text[token.end() :]
        elif kind == 4 and tokens:
            token, other = pick(rng, tokens), pick(rng, tokens)
            text = text[: token.start()] + other.group() + text[token.end() :]
        elif kind == 5:
            at = int(rng.integers(len(text) + 1))
            text = text[:at] + pick(rng, _STRAY) + text[at:]
        elif kind == 6:
            del lines[line]
            text = "\n".join(lines)
        elif kind == 7:
            lines.insert(int(rng.integers(len(lines) + 1)), lines[line])
            text = "\n".join(lines)
        else:
            lines[line] = " " * int(rng.integers(9)) + lines[line].strip()
            text = "\n".join(lines)
    return text


def scaled(rng: np.random.Generator, text: str) -> str:
    """Multiply a number of a text."""
    numbers = list(_NUMBER.finditer(text))
    if not numbers:
        return text
    at = pick(rng, numbers)
    return f"{text[: at.start()]}{float(at.group()) * pick(rng, _FACTORS):.12g}{text[at.end() :]}"


def encoded(rng: np.random.Generator, text: str) -> bytes:
    """The bytes of a text: UTF-8 as a rule, at times another encoding, or bytes that are none."""
    kind = int(rng.integers(50))
    if kind == 0:
        return text.encode(pick(rng, ("utf-16", "utf-32", "utf-8-sig")))
    if kind == 1:
        return text.encode("latin-1", errors="replace")
    if kind == 2:
        return mutated_bytes(rng, text.encode())
    return text.encode()
