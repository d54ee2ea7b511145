"""Tables of `wbc identify`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import yaml

from wbc_controller.controller.build.program import make_qp
from wbc_controller.controller.build.robot import make_model
from wbc_controller.controller.visualization.tables import Table, as_text
from wbc_controller.errors import ConfigurationError
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.recording.identification.equations import WIDTH, equations, select_samples
from wbc_controller.recording.identification.fit import UNSURE, Fit, fit
from wbc_controller.recording.recording_file import Recording
from wbc_controller.records import Array
from wbc_controller.settings import Settings


def identify(settings: Settings, path: Path) -> tuple[Fit, RobotModel]:
    """Fit masses, armature and frictions to a recording of this robot; raises `ConfigurationError` otherwise."""
    recorded = Recording(path).arrays()
    try:
        return fit_cycles(settings, recorded)
    except ConfigurationError as error:
        raise ConfigurationError(f"recording {path}: {error}") from error


def fit_cycles(settings: Settings, recorded: Mapping[str, Array]) -> tuple[Fit, RobotModel]:
    """Fit to the arrays of a recording; errors as for `select_samples`."""
    model = make_model(settings)
    contacts = make_qp(settings, model).contacts
    wide, narrow = (
        equations(select_samples(recorded, model, contacts, width), model, contacts) for width in (WIDTH, 0.5 * WIDTH)
    )
    return fit(wide, narrow), model


def report(found: Fit, model: RobotModel) -> str:
    """Return tables of the values with standard errors, and the friction settings."""
    masses, others = [], []
    known: dict[str, dict[str, float]] = {}
    shares = dict(zip(found.names, found.values, strict=True))
    for i, name in enumerate(found.names):
        kind, _, which = name.partition(" ")
        value, error = float(found.values[i]), float(found.errors[i])
        sure = "" if found.determined(i) else "not determined"
        if kind == "mass":
            masses.append((which, f"{100.0 * value:.1f} %", f"{100.0 * error:.1f} %", sure))
        elif kind == "armature":
            others.append(("armature", f"{value:.4f} kg·m²", f"{error:.4f}", sure))
        else:
            unit = "N·m" if kind == "dry" else "N·m·s/rad"
            others.append((f"{which} {kind}", f"{value:.3f} {unit}", f"{error:.3f}", sure))
            if not sure and value > 2.0 * error:
                known.setdefault(which, {})[kind] = round(value, 3)
    nominal = [inertia.mass for inertia in model.pinocchio.inertias]
    total = sum(
        mass * shares[f"mass {name}"]
        for name, mass in zip((each[0] for each in masses), (m for m in nominal[1:] if m > 0.0), strict=True)
    )
    heading = (
        f"{found.count} equations with residuals of {found.residual:.3g} N·m (RMS); total mass {total:.2f} kg, "
        f"{model.mass:.2f} kg in the URDF. 'not determined': standard error above {100.0 * UNSURE:g} % of the value"
    )
    tables = (
        Table(("link mass (with fixed links), relative to the URDF", "estimate", "± (1 σ)", ""), tuple(masses)),
        Table(("joint", "estimate", "± (1 σ)", ""), tuple(others)),
    )
    text = as_text(heading, tables)
    if known:
        text += "\n" + yaml.safe_dump({"robot": {"friction": known}}, sort_keys=False)
    return text
