"""Draft of a configuration: values with notes on their origin."""

import re
import textwrap
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from wbc_controller.settings import NODE_NAME, Settings
from wbc_controller.settings.files import parse_settings, yaml_line

#: Origin of a value: files of the robot, a guess, or to be filled in by the user.
Origin = Literal["found", "guess", "missing"]
_PREFIX: dict[Origin, str] = {"found": "", "guess": "Guess: ", "missing": "Fill in: "}
_TASKS = ("com", "base", "torso", "posture")  # in every draft
_UNBROKEN: dict[str, Any] = {"break_long_words": False, "break_on_hyphens": False}  # lines are not broken within names
_TIED = ":\N{NO-BREAK SPACE}"
#: Line length in characters, and sections with one entry per line.
_WIDTH, _ONE_LINE = 120, ("tasks", "contacts", "robot.joint_limits", "robot.locked_joints")


@dataclass(frozen=True, slots=True)
class Note:
    """A sentence on a key."""

    key: str
    comment: str  # with a prefix for its origin
    origin: Origin


@dataclass
class Draft:
    """A draft."""

    values: dict[str, Any] = field(default_factory=dict)
    notes: list[Note] = field(default_factory=list)

    def put(self, key: str, value: Any, text: str = "", origin: Origin = "found") -> None:
        """Set the value of a dotted key, with a note if a text is given."""
        *sections, last = key.split(".")
        place = self.values
        for section in sections:
            place = place.setdefault(section, {})
        place[last] = value
        if text:
            self.note(key, text, origin)

    def free_name(self, section: str, link: str) -> str:
        """Return an unused name for a task or contact of a link."""
        name, used = identifier(link), {*self.values.get(section, {}), *_TASKS}
        while name in used:
            name += "_"
        return name

    def note(self, key: str, text: str, origin: Origin) -> None:
        """Add a note on a dotted key or its section."""
        self.notes.append(Note(key, _PREFIX[origin] + text, origin))

    @property
    def open_points(self) -> list[str]:
        """One line for each guess and each missing value."""
        return [f"{note.key}: {note.comment}" for note in self.notes if note.origin != "found"]

    @property
    def settings(self) -> Settings:
        """Settings of the draft; raises `ConfigurationError` with one line for each invalid value."""
        return parse_settings(self.values, "the draft")

    def to_yaml(self, title: str) -> str:
        """Return the draft as a ROS 2 parameter file, with the notes as comments."""
        lines = [*_comment(title, ""), f"{NODE_NAME}:", "  ros__parameters:"]
        self._write(self.values, "", "    ", lines)
        return "\n".join(lines) + "\n"

    def _write(self, values: Mapping[str, Any], above: str, indent: str, lines: list[str]) -> None:
        for name, value in values.items():
            key = f"{above}{name}"
            whole = not isinstance(value, Mapping) or above.rstrip(".") in _ONE_LINE or not value
            for note in self.notes:
                if note.key == key:
                    lines += _comment(note.comment, indent)
                elif whole and note.key.startswith(f"{key}."):
                    lines += _comment(f"{note.key.removeprefix(f'{key}.')}: {note.comment}", indent)
            if whole:
                lines += _entry(name, value, indent)
            else:
                lines.append(f"{indent}{yaml_line(name)}:")
                self._write(value, f"{key}.", indent + "  ", lines)


def identifier(name: str) -> str:
    """Return a link's name with letters, digits and underscores only."""
    plain = re.sub(r"\W", "_", name, flags=re.ASCII)
    return plain if re.match(r"[A-Za-z_]", plain) else f"_{plain}"


def _comment(text: str, indent: str) -> list[str]:
    return textwrap.wrap(text, _WIDTH, initial_indent=f"{indent}# ", subsequent_indent=f"{indent}# ", **_UNBROKEN)


def _entry(name: str, value: Any, indent: str) -> list[str]:
    start = f"{indent}{yaml_line(name)}: "
    text = yaml_line(value).replace(": ", _TIED)  # lines are not broken between a key and its value
    lines = textwrap.wrap(text, _WIDTH, initial_indent=start, subsequent_indent=" " * (len(start) + 1), **_UNBROKEN)
    return [line.replace(_TIED, ": ") for line in lines]
