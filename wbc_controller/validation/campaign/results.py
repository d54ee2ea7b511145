"""Outcomes of trials, and their resumable file: one line of JSON per trial."""

import dataclasses
import functools
import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from wbc_controller.errors import ConfigurationError
from wbc_controller.settings.files import find_configuration
from wbc_controller.validation.campaign.monitor import MAX_FALLEN_TIME, STALL

FILE = "trials.jsonl"
#: Violations by decreasing severity.
VIOLATIONS: Mapping[str, str] = {
    "not_finite": "a torque of NaN or infinity",
    "unreadable": "an unreadable torque message, or one of another size",
    "over_limit": "a torque above its effort limit",
    "over_rate": "a torque rate above limits.torque_rate",
    "stale": "torques or damping from a state with a true age above safety.state_timeout",
    "internal_error": "the fault INTERNAL_ERROR",
    "logged": "an exception in the log",
    "stall": f"processor time of the loop above {1e3 * STALL:.0f} ms in one cycle",
    "fell": f"the robot lay on the ground for {MAX_FALLEN_TIME:g} s with an active controller",
    "undetected": "a fault with a deadline was not detected in time",
    "wrong_reason": "damping for an invalid reason, or despite a harmless fault",
    "recording": "the recording of the fault does not name it, or its replay differs",
    "early": "the controller left its active mode before the fault",
    "start": "the robot did not stand at the beginning of the fault",
    "diverged": "the physics of the mock robot diverged; the trial is invalid",
}


class TrialKey(NamedTuple):
    """Arguments that determine a trial."""

    robot: str
    kind: str
    seed: int
    walking: bool = False


@dataclasses.dataclass(frozen=True, slots=True)
class Outcome:
    """Outcome of a trial."""

    robot: str
    kind: str
    seed: int
    parameters: Mapping[str, Any]
    deadline: float | None  # time limit of the detection, s; or None
    result: str  # `survived`, `damped` or `violation`
    code: str  # fault code, or mode without a fault; empty if active
    sentence: str
    after: float | None  # from the beginning of the fault to the end of the active mode, s; or None
    moved: float  # largest displacement of the centre of mass, m
    longest: float  # longest processor time of a cycle, s
    violations: Mapping[str, str]  # texts by name, as in `VIOLATIONS`
    walking: bool = False  # True if the robot walked

    @property
    def key(self) -> TrialKey:
        """Key of the trial."""
        return TrialKey(self.robot, self.kind, self.seed, self.walking)

    @property
    def violations_text(self) -> str:
        """All violations in one text."""
        return "; ".join(f"{name}: {sentence}" for name, sentence in self.violations.items())


class Results:
    """Outcomes of a campaign, in memory and on disk."""

    def __init__(self, folder: Path) -> None:
        """Open and read the file of a folder; raise `ConfigurationError` if this fails."""
        self.path = folder / FILE
        self.outcomes: dict[TrialKey, Outcome] = {}  # newest, of this version of code and configuration
        self.repeated: dict[TrialKey, Outcome] = {}  # earlier outcomes
        self.other_versions = 0  # number of unused lines of other versions
        self._version = functools.cache(version_of)
        try:
            folder.mkdir(parents=True, exist_ok=True)
            if self.path.exists():
                self._read()
            self._file = self.path.open("a", encoding="utf-8")
        except OSError as error:
            raise ConfigurationError(
                f"{self.path}: opening of the results failed: {error.strerror or error}"
            ) from error

    def add(self, outcome: Outcome) -> None:
        """Append an outcome immediately."""
        content = {"version": self._version(outcome.robot), **dataclasses.asdict(outcome)}
        self._file.write(json.dumps(content, ensure_ascii=False) + "\n")
        self._file.flush()
        self._store(outcome)

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _read(self) -> None:
        text = self.path.read_text(encoding="utf-8")
        complete = text[: text.rfind("\n") + 1]
        if complete != text:  # the process ended while writing the last line
            self.path.write_text(complete, encoding="utf-8")
        for number, line in enumerate(complete.splitlines(), 1):
            try:
                content = json.loads(line)
                if content.pop("version") == self._version(content["robot"]):
                    self._store(Outcome(**content))
                else:
                    self.other_versions += 1
            except (ValueError, TypeError, KeyError, AttributeError) as error:
                raise ConfigurationError(
                    f"{self.path}:{number}: invalid line of a fault campaign ({type(error).__name__}: {error}); choose "
                    "another folder"
                ) from error

    def _store(self, outcome: Outcome) -> None:
        if outcome.key in self.outcomes:
            self.repeated[outcome.key] = self.outcomes[outcome.key]
        self.outcomes[outcome.key] = outcome


def version_of(robot: str) -> str:
    """Return a hash of this package's code and of a robot's configuration, if its file exists."""
    digest = hashlib.sha256()
    package = Path(__file__).resolve().parents[2]
    shown = {Path(__file__).with_name(f"{name}.py") for name in ("results", "campaign_report", "run")}
    for path in sorted(package.rglob("*.py")):
        if path not in shown and path.parent.name != "demo":
            digest.update(path.relative_to(package).as_posix().encode() + b"\0" + path.read_bytes())
    try:
        digest.update(find_configuration(robot).read_bytes())
    except ConfigurationError:
        digest.update(b"no such configuration")
    return digest.hexdigest()[:16]
