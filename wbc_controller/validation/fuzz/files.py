"""Fuzzer of configurations, URDFs and recordings.

Each case is a folder with ``robot.yaml`` and ``robot.urdf``, one of them changed, or with ``robot.mcap``; a child
process reads it (docs/robustness.md).
"""

import contextlib
import itertools
import logging
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
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from hypothesis import strategies as st
from hypothesis.strategies import DrawFn, SearchStrategy

from wbc_controller.controller.build.robot import make_model
from wbc_controller.controller.build.robot_description import describe, read_urdf
from wbc_controller.controller.check.preflight import check
from wbc_controller.controller.controller import Controller
from wbc_controller.errors import ConfigurationError, InputRefused, WbcError
from wbc_controller.nodes.processes import end_with_parent
from wbc_controller.recording.mcap_file import write_messages
from wbc_controller.settings.files import find_configuration, load_settings
from wbc_controller.simulation.plant import Plant
from wbc_controller.validation.fuzz.hostile_recordings import hostile_messages, original, read_recording
from wbc_controller.validation.fuzz.strategies import draw_by_key, encoded, mutated_text, scaled_text, share
from wbc_controller.validation.fuzz.values import ATTRIBUTES, SCALARS, STRINGS, TEXTS

_PROCESSOR_TIME_LIMIT = 5.0  # largest processor time of one case, s; a supplied robot requires 0.1 s
_CASE_TIMEOUT, _START_TIMEOUT = 60.0, 300.0  # wall time limits of a case and of the start, s
_MEMORY = 8 << 30  # bytes
_MOST_FAILURES = 20
_READY = "ready"
_SIZES = st.sampled_from((2, 50, 300, 2000, 20_000))  # sizes of chains and nestings in a hostile URDF
#: Attributes that are changed in all links or joints together.
_EVERYWHERE = ("value", "ixx", "iyy", "ixy", "effort", "velocity", "lower", "upper", "type", "xyz", "rpy")
#: False declarations of the encoding.
_ENCODINGS = st.sampled_from(("utf-16", "ascii", "latin-1", "utf-7", "rot13", "idna", "x" * 300, "", "zlib"))
_URDF_KEY = re.compile(r"(?m)^(\s*urdf:\s*).*$")  # line of the configuration with the URDF


@dataclass(frozen=True, slots=True)
class FileTrial:
    """One case."""

    number: int
    folder: Path  # with its files, after a failure
    result: str  # `works`, `refused`, or the name and the description of the failure
    seconds: float  # since the start of the run

    @property
    def failed(self) -> bool:
        """True if the files neither worked nor were refused."""
        return self.result not in ("works", "refused")

    def __str__(self) -> str:
        return f"case {self.number}: {self.result}"


def summary(trials: Sequence[FileTrial]) -> Iterator[str]:
    """Yield a line with the number of each result, and a line for each failure."""
    counts = Counter(trial.result.partition(":")[0] for trial in trials)
    seconds = max((trial.seconds for trial in trials), default=0.0)
    yield f"{len(trials)} cases in {seconds:.0f} s: " + ", ".join(f"{n} {result}" for result, n in counts.items())
    yield from (f"{trial.folder}: {trial.result}" for trial in trials if trial.failed)


def fuzz_files(
    kind: str, robots: tuple[str, ...], count: int, seed: int, folder: Path, *, first: int = 0
) -> Iterator[FileTrial]:
    """Read hostile ``configurations``, ``urdf`` or ``recordings`` of the robots in turn, in a child process."""
    due, failures, began = first, 0, time.monotonic()
    while due < first + count and failures < _MOST_FAILURES:
        ours, theirs = multiprocessing.get_context("spawn").Pipe()
        child = multiprocessing.get_context("spawn").Process(
            target=_work, args=(theirs, read_case, kind, robots, seed, due, first + count, folder), daemon=True
        )
        child.start()
        theirs.close()
        try:
            for number, result in _results(child, ours, due):
                due = number + 1
                trial = FileTrial(number, case_folder(folder, kind, number), result, time.monotonic() - began)
                failures += trial.failed
                if not trial.failed:
                    shutil.rmtree(trial.folder)
                yield trial
                if failures >= _MOST_FAILURES:
                    break
        finally:
            child.kill()
            child.join()
            ours.close()


def case_folder(folder: Path, kind: str, number: int) -> Path:
    """Return the folder of a case."""
    return folder / f"{kind}-{number}"


def _results(child: Any, ours: Connection, number: int) -> Iterator[tuple[int, str]]:
    if not ours.poll(_START_TIMEOUT) or ours.recv() != _READY:
        raise WbcError(f"the child process is not ready after {_START_TIMEOUT:g} s")
    while True:
        if not ours.poll(_CASE_TIMEOUT):
            yield number, f"hang: no result after {_CASE_TIMEOUT:g} s"
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
    end_with_parent()
    resource.setrlimit(resource.RLIMIT_AS, (_MEMORY, _MEMORY))
    warnings.simplefilter("ignore")
    logging.disable(logging.CRITICAL)  # replays log the faults of a controller
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)  # C++ parsers print their refusals
    pipe.send(_READY)
    for i in range(number, end):
        place = case_folder(folder, kind, i)
        make_case(kind, robots[i % len(robots)], seed, i, place)
        pipe.send((i, reader(place)))
    pipe.close()


def make_case(kind: str, robot: str, seed: int, number: int, place: Path) -> None:
    """Write the files of one case of ``configurations``, ``urdf`` or ``recordings``."""
    place.mkdir(parents=True, exist_ok=True)
    if kind == "recordings":
        topics, messages = original(robot)
        drawn = draw_by_key(hostile_messages(messages), kind, seed, number)
        changed = ((topic.number, time, payload) for topic, time, payload in drawn)
        write_messages(place / "robot.mcap", topics.values(), changed)
        return
    configuration, urdf = _originals(robot)
    configuration = _URDF_KEY.sub(lambda found: f"{found.group(1)}{place / 'robot.urdf'}", configuration)
    files = {"robot.yaml": configuration.encode(), "robot.urdf": urdf.encode()}
    if kind == "configurations":
        files["robot.yaml"] = draw_by_key(hostile_configuration(configuration), kind, seed, number)
    else:
        files["robot.urdf"] = draw_by_key(hostile_urdf(urdf), kind, seed, number)
    for name, content in files.items():
        (place / name).write_bytes(content)


def read_case(place: Path) -> str:
    """Read a case as the commands do; return ``works``, ``refused``, or a description of the failure."""
    path = place / "robot.mcap"
    recorded = path.exists()
    path = path if recorded else place / "robot.yaml"
    began = time.process_time()
    try:
        (read_recording if recorded else _read_configuration)(path)
        result = "works"
    except ConfigurationError as error:
        result = "refused" if str(path) in str(error) else f"unnamed: no path in {str(error)[:300]!r}"
    except (Exception, SystemExit) as error:
        where = traceback.extract_tb(error.__traceback__)[-1]
        result = f"traceback: {type(error).__name__}: {str(error)[:300]} ({Path(where.filename).name}:{where.lineno})"
    spent = time.process_time() - began
    return result if spent <= _PROCESSOR_TIME_LIMIT else f"slow: {spent:.1f} s of processor time, then: {result}"


def _read_configuration(path: Path) -> None:
    check(str(path))
    settings = load_settings(path)
    with _named(path):
        Controller(settings, preflight=False)
        describe(read_urdf(settings.robot.urdf), settings.robot)
        Plant(make_model(settings), settings)


@contextlib.contextmanager
def _named(path: Path) -> Iterator[None]:
    try:
        yield
    except ConfigurationError as error:
        raise ConfigurationError(f"{path}: {error}") from error
    except InputRefused as error:
        raise RuntimeError(f"message refusal without a message: {error}") from error


@cache
def _originals(robot: str) -> tuple[str, str]:
    path = find_configuration(robot)
    urdf = read_urdf(load_settings(path).robot.urdf)
    return path.read_text(encoding="utf-8"), re.sub(r"(?s)<visual.*?</visual>|<!--.*?-->|\n\s*(?=\n)", "", urdf)


@st.composite
def hostile_configuration(draw: DrawFn, text: str) -> bytes:
    """Draw a configuration with hostile values, or a hostile YAML text."""
    if draw(share(0.05)):
        return draw(encoded(draw(st.sampled_from(TEXTS))))
    return draw(encoded(draw(mutated_text(text, STRINGS if draw(share(0.2)) else SCALARS))))


@st.composite
def hostile_urdf(draw: DrawFn, text: str) -> bytes:
    """Draw a URDF with hostile attributes, numbers, tokens or elements."""
    kind = draw(st.integers(0, 9))
    if kind <= 2:
        text = draw(mutated_text(text, ATTRIBUTES if kind else STRINGS))
    elif kind <= 4:
        text = draw(scaled_text(text))
    elif kind <= 7:
        for _ in range(draw(st.integers(1, 3))):
            at = draw(st.sampled_from(list(re.finditer(r'="([^"]*)"', text))))
            text = text[: at.start(1)] + draw(st.sampled_from(ATTRIBUTES)) + text[at.end(1) :]
    elif kind == 8:
        name, value = draw(st.sampled_from(_EVERYWHERE)), draw(st.sampled_from(ATTRIBUTES))
        text = re.sub(rf'\b{name}="[^"]*"', lambda found: f'{name}="{value}"', text)
    else:
        text = draw(st.one_of(*structures(text).values()))
    return draw(encoded(text))


def structures(text: str) -> dict[str, SearchStrategy[str]]:
    """Return strategies of URDFs with another structure, by name of the change."""
    elements = list(re.finditer(r"(?s)<(joint|link|inertial|limit|robot)\b.*?</\1>|<limit[^>]*/>", text))
    joints = list(re.finditer(r'<parent\s+link="([^"]*)"\s*/>\s*<child\s+link="([^"]*)"\s*/>', text))
    body = re.sub(r"<\?xml.*?\?>", "", text)
    levels = "".join(f'<!ENTITY l{i} "{f"&l{i - 1};" * 10}">' for i in range(1, 12))
    changed = {
        "entities": st.just(f'<!DOCTYPE robot [<!ENTITY l0 "x">{levels}]>' + text.replace('name="', 'name="&l11;', 1)),
        "external": st.just(
            '<!DOCTYPE robot [<!ENTITY f SYSTEM "file:///etc/hostname">]>' + text.replace('name="', 'name="&f;', 1)
        ),
        "chain": _SIZES.map(lambda size: text.replace("</robot>", _chain(text, size) + "</robot>")),
        "nested": _SIZES.map(lambda size: text.replace("</robot>", "<a>" * size + "</a>" * size + "</robot>")),
        "declared": _ENCODINGS.map(lambda name: f'<?xml version="1.0" encoding="{name}"?>' + body),
        "cut": st.integers(0, len(text) - 1).map(lambda length: text[:length]),
    }
    if elements:
        changed["twice"] = st.sampled_from(elements).map(lambda at: text[: at.end()] + at.group() + text[at.end() :])
    if joints:
        changed["loop"] = st.builds(_loop, st.just(text), st.sampled_from(joints), st.booleans())
    return changed


def _chain(text: str, size: int) -> str:
    root = (re.findall(r'<link\s+name="([^"]*)"', text) or ["base"])[0]
    names = [root, *(f"more_{i}" for i in range(size))]
    joint = '<joint name="at_{1}" type="fixed"><parent link="{0}"/><child link="{1}"/></joint>'
    return "".join(f'<link name="{pair[1]}"/>' + joint.format(*pair) for pair in itertools.pairwise(names))


def _loop(text: str, at: re.Match[str], same: bool) -> str:
    parent, child = at.group(2), at.group(2 if same else 1)
    return text[: at.start()] + f'<parent link="{parent}"/><child link="{child}"/>' + text[at.end() :]
