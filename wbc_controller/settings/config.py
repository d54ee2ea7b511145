"""A robot's configuration for Python users: loaded by name, from a file or a dictionary, and changed by dotted keys."""

from __future__ import annotations

import reprlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import yaml

from wbc_controller.errors import ConfigurationError, valid_choices
from wbc_controller.settings import NODE_NAME, Settings
from wbc_controller.settings.files import find_configuration, load_settings, parse_settings
from wbc_controller.settings.nesting import merged, nested

#: Sections whose entries have names, and can be removed one by one.
_NAMED = ("tasks", "contacts", "loops")


class UnknownKey(ConfigurationError, KeyError):
    """A configuration has no such key."""

    __str__ = Exception.__str__


@dataclass(frozen=True)
class Config:
    """One robot's configuration: validated, and never changed in place.

    Attributes:
        settings: the values, as docs/configuration.md lists them.
        source: the file that they came from, or ``"a dictionary"``; stands before every error where it is not empty.
        urdf: the URDF's text, where ``robot.urdf`` names no file.
    """

    settings: Settings
    source: str = "a dictionary"
    urdf: str | None = None

    def replace(self, changes: Mapping[str, Any], *, urdf: str | None = None) -> Config:
        """Return a configuration with some values changed.

        Args:
            changes: new values by dotted key, such as ``{"tasks.com.weight": 20.0}``, or nested as in a file. What is
                not named stays. None removes a task, contact or loop: ``{"tasks.torso": None}``. Single joints of the
                posture are named as ``{"robot.posture.left_knee_joint": 0.6}``, in rad.
            urdf: another URDF, as text.

        Raises:
            ConfigurationError: with one line per problem: the key, its value and the valid ones.
        """
        _require_text(urdf)
        values = self.settings.model_dump(exclude_unset=True)
        tree = nested(changes)
        robot = tree.get("robot")
        posture = robot.get("posture") if isinstance(robot, Mapping) else None
        if isinstance(posture, Mapping):
            tree["robot"]["posture"] = _posed(self.settings, posture)
        for section in _NAMED:
            for name, entry in tree.get(section, {}).items() if isinstance(tree.get(section), Mapping) else ():
                if entry is None and name not in values.get(section, {}):
                    raise ConfigurationError(
                        self.named(
                            f"{section}.{name} = None: there is none to remove; "
                            f"{valid_choices(str(name), values.get(section, {}))}"
                        )
                    )
        result = merged(values, tree)
        for section in _NAMED:
            if isinstance(result.get(section), Mapping):
                result[section] = {name: entry for name, entry in result[section].items() if entry is not None}
        settings = parse_settings(result, self.source)
        return replace(self, settings=settings, urdf=self.urdf if urdf is None else urdf)

    def named(self, error: str) -> str:
        """An error about these values, with their source before it."""
        return f"{self.source}: {error}" if self.source else error

    def to_dict(self) -> dict[str, Any]:
        """The values that were given, without defaults: what stands below ``ros__parameters`` in a file."""
        return self.settings.model_dump(exclude_unset=True)

    def to_yaml(self) -> str:
        """The same as the text of a ROS 2 parameter file."""
        content = {NODE_NAME: {"ros__parameters": self.to_dict()}}
        return str(yaml.safe_dump(content, sort_keys=False, allow_unicode=True, default_flow_style=None, width=120))

    def __getitem__(self, key: str) -> Any:
        """The value of a dotted key, such as ``config["tasks.com.weight"]``; a section is given as a dictionary.

        Raises:
            UnknownKey: if there is no such key; it is a `KeyError`, too.
        """
        value: Any = self.settings.model_dump()
        if not isinstance(key, str):
            raise UnknownKey(f"{reprlib.repr(key)}: a key is a text with dots, such as 'tasks.com.weight'")
        for depth, part in enumerate(key.split("."), 1):
            if not isinstance(value, Mapping) or part not in value:
                where = ".".join(key.split(".")[: depth - 1])
                choices = value if isinstance(value, Mapping) else ()
                raise UnknownKey(
                    f"{key!r}: {where or 'the configuration'} has no {part!r}; {valid_choices(part, choices)}"
                )
            value = value[part]
        return value

    def __repr__(self) -> str:
        return f"<Config of {self.source}>\n{self.to_yaml()}"


def load(source: str | Path | Mapping[str, Any] | Settings | Config, *, urdf: str | None = None) -> Config:
    """Load a robot's configuration.

    Args:
        source: the name of a robot that is shipped (``"g1"``, ``"talos"``, ``"go2"``), the path of a .yaml file, or
            the values as a dictionary, nested or with dotted keys, in place of a file. In a dictionary the posture may
            be given by joint.
        urdf: the URDF's text, where ``robot.urdf`` names no file.

    Raises:
        ConfigurationError: where there is no such file, or a value is not valid: one line per problem with the file,
            the key, the value and the valid ones.
    """
    _require_text(urdf)
    if isinstance(source, Config):
        return source if urdf is None else replace(source, urdf=urdf)
    if isinstance(source, Settings):
        return Config(source, "", urdf)
    if isinstance(source, Mapping):
        tree = nested(source)
        robot = tree.get("robot")
        if isinstance(robot, dict) and isinstance(robot.get("posture"), Mapping):
            robot["posture"] = _whole_posture(robot.get("joints"), robot["posture"])
        return Config(parse_settings(tree, "a dictionary"), urdf=urdf)
    if not isinstance(source, str | Path):
        raise ConfigurationError(
            f"{reprlib.repr(source)} is not a configuration; valid: a robot's name, the path of a .yaml file, or a "
            "dictionary"
        )
    path = find_configuration(str(source))
    return Config(load_settings(path), str(path), urdf)


def _require_text(urdf: Any) -> None:
    if urdf is not None and not isinstance(urdf, str):
        raise ConfigurationError(f"urdf = {reprlib.repr(urdf)}: it must be the text of a URDF")


def _whole_posture(joints: Any, posture: Mapping[str, Any]) -> list[Any]:
    """A posture by joint, in the order of the joints."""
    names = list(joints) if isinstance(joints, list) else list(posture)
    for name in (*names, *posture):
        if name not in posture or name not in names:
            what = "has no value for" if name in names else "has a value for"
            raise ConfigurationError(
                f"a dictionary: robot.posture {what} {name!r}; it takes one for each of: {', '.join(names)}"
            )
    return [posture[name] for name in names]


def _posed(settings: Settings, changes: Mapping[str, Any]) -> list[Any]:
    """The posture with some joints elsewhere."""
    joints: Sequence[str] = settings.robot.joints
    for name in changes:
        if name not in joints:
            raise ConfigurationError(
                f"robot.posture.{name}: {name!r} is not one of robot.joints; {valid_choices(name, joints)}"
            )
    return [changes.get(name, value) for name, value in zip(joints, settings.robot.posture, strict=True)]
