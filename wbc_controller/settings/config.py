"""Configuration of a robot for Python users."""

import reprlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import yaml

from wbc_controller.errors import ConfigurationError, require_known, valid_choices
from wbc_controller.settings import NODE_NAME, Settings
from wbc_controller.settings.files import find_configuration, load_settings, parse_settings
from wbc_controller.settings.nesting import merged, nested

_SECTIONS_BY_NAME = ("tasks", "contacts", "loops")  # sections of named entries, which can be removed


class UnknownKey(ConfigurationError, KeyError):
    """Unknown key of a configuration."""

    __str__ = Exception.__str__


@dataclass(frozen=True)
class Config:
    """Validated, immutable configuration of one robot."""

    settings: Settings  # the values (docs/configuration.md)
    source: str = "a dictionary"  # path of the file, or ``"a dictionary"``; prefix of error messages, if not empty
    urdf: str | None = None  # URDF text, if ``robot.urdf`` is not used

    def replace(self, changes: Mapping[str, Any], *, urdf: str | None = None) -> "Config":
        """Return a configuration with changed values, or raise `ConfigurationError` with one line per problem.

        Args:
            changes: values by dotted key, such as ``{"tasks.com.weight": 20.0}``, or nested as in a file. None removes
                a task, contact or loop: ``{"tasks.torso": None}``. A single joint of the posture, in rad:
                ``{"robot.posture.left_knee_joint": 0.6}``.
            urdf: URDF text.
        """
        _require_text(urdf)
        values = self.to_dict()
        tree = nested(changes)
        joints = self.settings.robot.joints
        _order_posture(tree, joints, dict(zip(joints, self.settings.robot.posture, strict=True)))
        result = merged(values, tree)
        for section in _SECTIONS_BY_NAME:
            entries = result.get(section)
            removed = [name for name in entries if entries[name] is None] if isinstance(entries, Mapping) else []
            known = values.get(section, {})
            for name in removed:
                if name not in known:
                    choices = valid_choices(str(name), known)
                    problem = f"{section}.{name} = None: unknown entry, cannot be removed; {choices}"
                    raise ConfigurationError(self.with_source(problem))
                del result[section][name]
        return replace(self, settings=parse_settings(result, self.source), urdf=self.urdf if urdf is None else urdf)

    def with_source(self, error: str) -> str:
        """Prefix an error message with the source."""
        return f"{self.source}: {error}" if self.source else error

    def to_dict(self) -> dict[str, Any]:
        """Return the values without defaults, as below ``ros__parameters``."""
        return self.settings.model_dump(exclude_unset=True)

    def to_yaml(self) -> str:
        """Return the text of a ROS 2 parameter file without defaults."""
        content = {NODE_NAME: {"ros__parameters": self.to_dict()}}
        return str(yaml.safe_dump(content, sort_keys=False, allow_unicode=True, default_flow_style=None, width=120))

    def __getitem__(self, key: str) -> Any:
        """Return a value or section by dotted key, or raise `UnknownKey`."""
        value: Any = self.settings.model_dump()
        if not isinstance(key, str):
            raise UnknownKey(f"{reprlib.repr(key)}: a key must be a string with dots, such as 'tasks.com.weight'")
        for depth, part in enumerate(key.split("."), 1):
            if not isinstance(value, Mapping) or part not in value:
                section = ".".join(key.split(".")[: depth - 1])
                choices = value if isinstance(value, Mapping) else ()
                raise UnknownKey(
                    f"{key!r}: {section or 'the configuration'} has no {part!r}; {valid_choices(part, choices)}"
                )
            value = value[part]
        return value

    def __repr__(self) -> str:
        return f"<Config of {self.source}>\n{self.to_yaml()}"


def load(source: str | Path | Mapping[str, Any] | Settings | Config, *, urdf: str | None = None) -> Config:
    """Load a robot's configuration; `ConfigurationError` if it does not exist or is invalid, with one line per problem.

    Args:
        source: name of a shipped robot (``"g1"``, ``"talos"``, ``"go2"``), path of a .yaml file, or a dictionary,
            nested or with dotted keys, in which ``robot.posture`` may be a dictionary by joint.
        urdf: URDF text, in place of ``robot.urdf``.
    """
    _require_text(urdf)
    if isinstance(source, Config):
        return source if urdf is None else replace(source, urdf=urdf)
    if isinstance(source, Settings):
        return Config(source, "", urdf)
    if isinstance(source, Mapping):
        tree = nested(source)
        robot = tree.get("robot")
        _order_posture(tree, robot.get("joints") if isinstance(robot, dict) else None, {})
        return Config(parse_settings(tree, "a dictionary"), urdf=urdf)
    if not isinstance(source, str | Path):
        raise ConfigurationError(
            f"{reprlib.repr(source)} is not a configuration; valid: name of a robot, path of a .yaml file, dictionary"
        )
    path = find_configuration(str(source))
    return Config(load_settings(path), str(path), urdf)


def _require_text(urdf: Any) -> None:
    if urdf is not None and not isinstance(urdf, str):
        raise ConfigurationError(f"urdf = {reprlib.repr(urdf)}: must be the text of a URDF")


def _order_posture(tree: Mapping[str, Any], joints: Any, present: Mapping[str, float]) -> None:
    """Replace a posture by joint, over the present values, by a list in the order of the joints."""
    robot: Any = tree.get("robot")
    posture = robot.get("posture") if isinstance(robot, dict) else None
    if isinstance(posture, Mapping):
        order = joints if isinstance(joints, list) else list(posture)
        values = {**present, **posture}
        require_known(values, order, "robot.posture:", " is not in robot.joints")
        missing = [name for name in order if name not in values]
        if missing:
            raise ConfigurationError(f"robot.posture: missing joint {missing[0]!r}; required: {', '.join(order)}")
        robot["posture"] = [values[name] for name in order]
