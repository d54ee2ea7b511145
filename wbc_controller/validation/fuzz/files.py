"""The fuzzer of configurations and URDFs: whatever they hold, they work or are refused in a sentence.

Each case is a folder with ``robot.yaml`` and ``robot.urdf``, one of them changed, which follows from the seed and its
number alone. A child process reads it as `wbc check`, `run`, `guard` and `mock` do, so that a crash is seen and named.
"""

from __future__ import annotations

import contextlib
import itertools
import multiprocessing
import os
import re
import resource
import shutil
import signal
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from wbc_controller.controller.build.robot import make_model
from wbc_controller.controller.build.robot_description import describe, read_urdf
from wbc_controller.controller.check.preflight import check
from wbc_controller.controller.controller import Controller
from wbc_controller.errors import ConfigurationError, InputRefused, WbcError
from wbc_controller.settings.files import find_configuration, load_settings
from wbc_controller.simulation.plant import Plant
from wbc_controller.validation.fuzz.mutations import encoded, mutated_text, pick, scaled
from wbc_controller.validation.fuzz.values import ATTRIBUTES, SCALARS, STRINGS, TEXTS

#: Most processor time of one case, s: a robot of the size that is shipped takes a tenth of a second.
_LIMIT = 5.0
#: Wall time after which a case hangs, s, and within which the child process has to be ready.
_HANG, _START = 60.0, 300.0
#: Memory that a case may ask for, bytes.
_MEMORY = 8 << 30
#: Links of the chains, and depths of the nesting, that a hostile URDF has.
_SIZES = (2, 50, 300, 2000, 20_000)

#: What the child process says when it has imported all that it needs.
_READY = "ready"
#: The line of a configuration that names the URDF of its case.
_URDF_KEY = re.compile(r"(?m)^(\s*urdf:\s*).*$")


@dataclass(slots=True)
class FilesOutcome:
    """The result of a run.

    Attributes:
        results: number of cases by result: ``works``, ``refused``, or the name of what went wrong.
        failures: the folder of each case that went wrong, and a sentence.
        seconds: duration, s.
    """

    results: Counter[str] = field(default_factory=Counter)
    failures: dict[Path, str] = field(default_factory=dict)
    seconds: float = 0.0


def fuzz_files(
    kind: str,
    robots: tuple[str, ...],
    count: int,
    seed: int,
    folder: Path,
    *,
    first: int = 0,
    most_failures: int = 20,
    progress: Callable[[FilesOutcome, int], None] = lambda outcome, number: None,
) -> FilesOutcome:
    """Read hostile files in a child process.

    Args:
        kind: ``configurations`` or ``urdf``.
        robots: names of the shipped robots whose files are changed, in turn.
        count: number of cases.
        seed: of all choices.
        folder: for the cases; those that went wrong stay there.
        first: number of the first case.
        most_failures: number of failures after which it ends.
        progress: called after each case with its number.

    Returns:
        What came out.

    Raises:
        WbcError: if the child process does not start.
    """
    outcome, due, began = FilesOutcome(), first, time.monotonic()
    while due < first + count and len(outcome.failures) < most_failures:
        ours, theirs = multiprocessing.get_context("spawn").Pipe()
        child = multiprocessing.get_context("spawn").Process(
            target=_work, args=(theirs, _reader, kind, robots, seed, due, first + count, folder), daemon=True
        )
        child.start()
        theirs.close()
        try:
            for number, result in _results(child, ours, due):
                due = number + 1
                place = case_folder(folder, kind, number)
                outcome.results[result.partition(":")[0]] += 1
                if result in ("works", "refused"):
                    shutil.rmtree(place)
                else:
                    outcome.failures[place] = result
                outcome.seconds = time.monotonic() - began
                progress(outcome, number)
                if len(outcome.failures) >= most_failures:
                    break
        finally:
            child.kill()
            child.join()
            ours.close()
    return outcome


def case_folder(folder: Path, kind: str, number: int) -> Path:
    """The folder of a case."""
    return folder / f"{kind}-{number}"


def _results(child: Any, ours: Connection, number: int) -> Iterator[tuple[int, str]]:
    """The number and result of each case; of the one in which the child ended, what became of it."""
    if not ours.poll(_START) or ours.recv() != _READY:
        raise WbcError(f"the child process that reads the files is not ready after {_START:g} s")
    while True:
        if not ours.poll(_HANG):
            yield number, f"hang: no result after {_HANG:g} s"
            return
        try:
            number, result = ours.recv()
        except EOFError:
            child.join()
            if child.exitcode:
                code = child.exitcode
                yield number, f"crash: {signal.Signals(-code).name if code < 0 else f'exit status {code}'}"
            return
        yield number, result
        number += 1


def _work(
    pipe: Connection,
    reader: Callable[[Path], str],
    kind: str,
    robots: tuple[str, ...],
    seed: int,
    number: int,
    end: int,
    folder: Path,
) -> None:
    """Read the cases from a number on; in the child process."""
    resource.setrlimit(resource.RLIMIT_AS, (_MEMORY, _MEMORY))
    warnings.simplefilter("ignore")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)  # the parsers of C++ write what they refuse there too
    pipe.send(_READY)
    for i in range(number, end):
        place = case_folder(folder, kind, i)
        make_case(kind, robots[i % len(robots)], seed, i, place)
        pipe.send((i, reader(place)))
    pipe.close()


def make_case(kind: str, robot: str, seed: int, number: int, place: Path) -> None:
    """Write the files of one case.

    Args:
        kind: ``configurations`` or ``urdf``.
        robot: name of a shipped robot.
        seed: of all choices.
        number: of the case.
        place: folder of the case; it is made.
    """
    rng = np.random.default_rng([seed, number])
    configuration, urdf = _originals(robot)
    place.mkdir(parents=True, exist_ok=True)
    configuration = _URDF_KEY.sub(lambda found: f"{found.group(1)}{place / 'robot.urdf'}", configuration)
    if kind == "configurations":
        configuration = pick(rng, TEXTS) if rng.random() < 0.05 else _hostile_configuration(rng, configuration)
    else:
        urdf = _hostile_urdf(rng, urdf)
    (place / "robot.yaml").write_bytes(
        encoded(rng, configuration) if kind == "configurations" else configuration.encode()
    )
    (place / "robot.urdf").write_bytes(encoded(rng, urdf) if kind == "urdf" else urdf.encode())


def read_case(place: Path) -> str:
    """Read the files of a case as the commands do: ``works``, ``refused``, or what went wrong."""
    path = place / "robot.yaml"
    began = time.process_time()
    try:
        check(str(path))
        settings = load_settings(path)
        with _named(path):
            Controller(settings, preflight=False)
            describe(read_urdf(settings.robot.urdf), settings.robot)
            Plant(make_model(settings), settings)
        result = "works"
    except ConfigurationError as error:
        result = "refused" if str(path) in str(error) else f"unnamed: no path in {str(error)[:300]!r}"
    except (Exception, SystemExit) as error:
        where = traceback.extract_tb(error.__traceback__)[-1]
        result = f"traceback: {type(error).__name__}: {str(error)[:300]} ({Path(where.filename).name}:{where.lineno})"
    spent = time.process_time() - began
    return result if spent <= _LIMIT else f"slow: {spent:.1f} s of processor time, then: {result}"


#: Reads a case in the child process.
_reader = read_case


@contextlib.contextmanager
def _named(path: Path) -> Iterator[None]:
    """Put the file's path in front of what is wrong with its values, as the command line does."""
    try:
        yield
    except ConfigurationError as error:
        raise ConfigurationError(f"{path}: {error}") from error
    except InputRefused as error:
        raise RuntimeError(f"a message was refused where none came: {error}") from error


@cache
def _originals(robot: str) -> tuple[str, str]:
    """A shipped robot's configuration and URDF, the latter without what is only seen."""
    path = find_configuration(robot)
    urdf = read_urdf(load_settings(path).robot.urdf)
    return path.read_text(encoding="utf-8"), re.sub(r"(?s)<visual.*?</visual>|<!--.*?-->|\n\s*(?=\n)", "", urdf)


def _hostile_configuration(rng: np.random.Generator, text: str) -> str:
    values = STRINGS if rng.random() < 0.2 else SCALARS
    return mutated_text(rng, text, values)


def _hostile_urdf(rng: np.random.Generator, text: str) -> str:
    kind = int(rng.integers(10))
    if kind == 0:
        return pick(rng, tuple(_STRUCTURES.values()))(rng, text)
    if kind == 1:
        return mutated_text(rng, text, STRINGS)
    if kind == 2:  # an attribute of all links or joints at once
        name = pick(
            rng, ("mass value", "ixx", "iyy", "ixy", "effort", "velocity", "lower", "upper", "type", "xyz", "rpy")
        )
        name = name.rpartition(" ")[2]
        value = pick(rng, ATTRIBUTES)
        return re.sub(rf'\b{name}="[^"]*"', lambda found: f'{name}="{value}"', text)
    if kind <= 5:  # an attribute by name
        found = list(re.finditer(r'="([^"]*)"', text))
        for at in sorted((pick(rng, found) for _ in range(int(rng.integers(1, 4)))), key=lambda m: -m.start()):
            text = text[: at.start(1)] + pick(rng, ATTRIBUTES) + text[at.end(1) :]
        return text
    if kind <= 7:
        return scaled(rng, text)
    return mutated_text(rng, text, ATTRIBUTES)


def _entities(rng: np.random.Generator, text: str) -> str:
    levels = "".join(f'<!ENTITY l{i} "{f"&l{i - 1};" * 10}">' for i in range(1, 12))
    return f'<!DOCTYPE robot [<!ENTITY l0 "x">{levels}]>' + text.replace('name="', 'name="&l11;', 1)


def _chain(rng: np.random.Generator, text: str) -> str:
    """Links one below the other, hung at the robot's first link."""
    size = pick(rng, _SIZES)
    root = (re.findall(r'<link\s+name="([^"]*)"', text) or ["base"])[0]
    names = [root, *(f"more_{i}" for i in range(size))]
    links = "".join(f'<link name="{name}"/>' for name in names[1:])
    joints = "".join(
        f'<joint name="at_{child}" type="fixed"><parent link="{parent}"/><child link="{child}"/></joint>'
        for parent, child in itertools.pairwise(names)
    )
    return text.replace("</robot>", links + joints + "</robot>")


def _loop(rng: np.random.Generator, text: str) -> str:
    """A joint whose parent and child change places, or are the same."""
    joints = list(re.finditer(r'<parent\s+link="([^"]*)"\s*/>\s*<child\s+link="([^"]*)"\s*/>', text))
    if not joints:
        return text
    at = pick(rng, joints)
    parent, child = at.group(2), pick(rng, (at.group(1), at.group(2)))
    return text[: at.start()] + f'<parent link="{parent}"/><child link="{child}"/>' + text[at.end() :]


def _twice(rng: np.random.Generator, text: str) -> str:
    """An element that stands twice."""
    elements = list(re.finditer(r"(?s)<(joint|link|inertial|limit|robot)\b.*?</\1>|<limit[^>]*/>", text))
    if not elements:
        return text
    at = pick(rng, elements)
    return text[: at.end()] + at.group() + text[at.end() :]


def _nested(rng: np.random.Generator, text: str) -> str:
    size = pick(rng, _SIZES)
    return text.replace("</robot>", "<a>" * size + "</a>" * size + "</robot>")


def _declared(rng: np.random.Generator, text: str) -> str:
    """An encoding that is declared and is another one."""
    name = pick(rng, ("utf-16", "ascii", "latin-1", "utf-7", "rot13", "idna", "x" * 300, "", "zlib"))
    return f'<?xml version="1.0" encoding="{name}"?>' + re.sub(r"<\?xml.*?\?>", "", text)


def _cut(rng: np.random.Generator, text: str) -> str:
    return text[: int(rng.integers(len(text)))]


def _external(rng: np.random.Generator, text: str) -> str:
    return '<!DOCTYPE robot [<!ENTITY f SYSTEM "file:///etc/hostname">]>' + text.replace('name="', 'name="&f;', 1)


#: Changes of a URDF's structure.
_STRUCTURES: Mapping[str, Callable[[np.random.Generator, str], str]] = {
    "entities": _entities, "chain": _chain, "loop": _loop, "twice": _twice, "nested": _nested, "declared": _declared,
    "cut": _cut, "external": _external,
}  # fmt: skip
