"""Fuzzer of configurations, URDFs and recordings.

Each case is a folder with ``robot.yaml`` and ``robot.urdf``, one of them changed, or with ``robot.mcap``; a child
process reads it (docs/robustness.md).
"""

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

from wbc_controller.apps.terminal.command_options import naming_file
from wbc_controller.controller.build.robot import make_model
from wbc_controller.controller.build.robot_description import describe, read_urdf
from wbc_controller.controller.check.preflight import check
from wbc_controller.controller.controller import Controller
from wbc_controller.errors import ConfigurationError, WbcError
from wbc_controller.nodes.processes import end_with_parent
from wbc_controller.recording.mcap_file import write_messages
from wbc_controller.settings.files import find_configuration, load_settings
from wbc_controller.simulation.plant import Plant
from wbc_controller.validation.fuzz.hostile_recordings import hostile_messages, original, read_recording
from wbc_controller.validation.fuzz.strategies import draw_by_key, hostile_configuration, hostile_urdf

_PROCESSOR_TIME_LIMIT = 5.0  # largest processor time of one case, s; a supplied robot requires 0.1 s
_CASE_TIMEOUT, _START_TIMEOUT = 60.0, 300.0  # wall time limits of a case and of the start, s
_MEMORY = 8 << 30  # bytes
_MOST_FAILURES = 20
_READY = "ready"
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
        context = multiprocessing.get_context("spawn")
        ours, theirs = context.Pipe()
        work = theirs, read_case, kind, robots, seed, range(due, first + count), folder
        child = context.Process(target=_work, args=work, daemon=True)
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
    pipe: Connection, read: Callable[[Path], str], kind: str, robots: Sequence[str], seed: int, due: range, folder: Path
) -> None:
    end_with_parent()
    resource.setrlimit(resource.RLIMIT_AS, (_MEMORY, _MEMORY))
    warnings.simplefilter("ignore")
    logging.disable(logging.CRITICAL)  # replays log the faults of a controller
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)  # C++ parsers print their refusals
    pipe.send(_READY)
    for number in due:
        place = case_folder(folder, kind, number)
        make_case(kind, robots[number % len(robots)], seed, number, place)
        pipe.send((number, read(place)))
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
    with naming_file(str(path)):
        Controller(settings, preflight=False)
        describe(read_urdf(settings.robot.urdf), settings.robot)
        Plant(make_model(settings), settings)


@cache
def _originals(robot: str) -> tuple[str, str]:
    path = find_configuration(robot)
    urdf = read_urdf(load_settings(path).robot.urdf)
    return path.read_text(encoding="utf-8"), re.sub(r"(?s)<visual.*?</visual>|<!--.*?-->|\n\s*(?=\n)", "", urdf)
