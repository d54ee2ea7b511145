"""Comparison of contacts with collision shapes."""

from collections.abc import Sequence
from functools import partial
from math import degrees, tan

import numpy as np
import pinocchio as pin

from wbc_controller.controller.build.collision_elements import read_shapes
from wbc_controller.controller.build.footprint import LAYER, Footprint, footprint
from wbc_controller.controller.check import Finding
from wbc_controller.errors import ConfigurationError
from wbc_controller.inverse_dynamics.contacts import PointContact, SurfaceContact, UnilateralContact
from wbc_controller.inverse_dynamics.whole_body_qp import WholeBodyQP
from wbc_controller.records import Array
from wbc_controller.settings import Settings
from wbc_controller.settings.contacts import ContactSettings
from wbc_controller.settings.contacts import SurfaceContact as SurfaceSettings

_HEIGHT = 0.02  # largest distance of a contact from the lowest point of its shapes, m
_REPORTED_HEIGHT = 0.005  # reported distance, m
_TILT = 0.0873  # largest angle between a sole and the flat underside of its shapes, rad: 5°
_OVERHANG, _OVERHANG_SHARE = 0.01, 0.1  # largest overhang of a support, m, and as a share of its smaller side
_REPORTED_OVERHANG = 0.001  # reported overhang, m: feet tip on the edge of the true sole
_TREAD = 0.002  # thickness of the touching layer of soles, m, as in the mock robot
_LONGEST = 0.3  # longest sole, m
_SIDE_OFFSET = 0.03  # largest horizontal distance of a point contact from the footprint of its body, m
_UPSIDE_DOWN = -0.5  # cosine of the smallest angle of an upside-down contact, 120°


def upside_down(qp: WholeBodyQP, name: str, normal: Array) -> str:
    """Return the error message for a surface contact against the floor's normal, (3,) in the world; else ""."""
    contact = qp.contacts[name]
    if not isinstance(contact, SurfaceContact) or contact.internal:
        return ""
    if not contact.placement(qp.dynamics).rotation[:, 2] @ normal < _UPSIDE_DOWN:
        return ""
    return (
        f"contacts.{name}.rpy: the sole is upside down: its z axis points down in robot.posture, but must point away "
        "from the floor; turn it by 3.14159 about x or y"
    )


def compare_with_shapes(settings: Settings, qp: WholeBodyQP, normal: Array) -> list[Finding]:
    """Compare soles, enabled balls and wheels with shapes in robot.posture; `ConfigurationError` if they differ."""
    contacts = {
        name: contact
        for name, spec in settings.contacts.items()
        if isinstance(contact := qp.contacts[name], UnilateralContact)
        and not contact.internal
        and (isinstance(contact, SurfaceContact) or spec.enabled)
    }
    if not contacts:
        return []
    try:
        elements = read_shapes(settings, qp.model)
    except ConfigurationError as error:  # the controller needs no meshes
        return [Finding("not compared", f"contacts with the URDF: {error}")]
    specs = settings.contacts
    texts = {name: _compare_contact(qp, elements, each, specs[name], normal) for name, each in contacts.items()}
    found = [f"{name} {text}" for name, text in texts.items() if text is not None]
    without = [name for name, text in texts.items() if text is None]
    findings = [Finding("contact shapes", "; ".join(found))] if found else []
    if without:
        reason = "no readable <collision> on their links"
        findings.append(Finding("not compared", f"{', '.join(without)} with the URDF: {reason}"))
    return findings


def undersides(settings: Settings, qp: WholeBodyQP) -> dict[str, Array]:
    """Return the corners of the URDF's shapes, if readable, on the plane of each contact, (n, 3) in m, in the world."""
    found: dict[str, Array] = {}
    try:
        elements = read_shapes(settings, qp.model)
    except ConfigurationError:  # reported by `compare_with_shapes`
        return {}
    for name, contact in qp.contacts.items():
        if not isinstance(contact, UnilateralContact) or contact.internal:
            continue
        plane = pin.SE3(np.eye(3), contact.points(qp.dynamics)[0])
        if isinstance(contact, SurfaceContact):
            plane = contact.placement(qp.dynamics)
        index = qp.model.frame_id(settings.contacts[name].frame, f"contacts.{name}.frame")
        region = _footprint_of_link(qp, elements, index, plane, _TREAD)
        if region is not None:
            corners = np.column_stack([region.polygon, np.full(len(region.polygon), region.height)])
            found[name] = np.asarray(corners @ plane.rotation.T + plane.translation)
    return found


def _footprint_of_link(
    qp: WholeBodyQP, elements: Sequence[pin.GeometryObject], index: int, plane: pin.SE3, layer: float = LAYER
) -> Footprint | None:
    frame = qp.model.pinocchio.frames[index]
    link = qp.dynamics.placement(index) * frame.placement.inverse()
    own = [element for element in elements if element.parentJoint == frame.parentJoint]
    return footprint(own, link.actInv(plane), layer)


def _compare_contact(
    qp: WholeBodyQP, shapes: list[pin.GeometryObject], contact: UnilateralContact, spec: ContactSettings, normal: Array
) -> str | None:
    name, index = contact.name, qp.model.frame_id(spec.frame, f"contacts.{contact.name}.frame")
    on = partial(_footprint_of_link, qp, shapes, index)
    if isinstance(contact, SurfaceContact) and isinstance(spec, SurfaceSettings):
        plane = contact.placement(qp.dynamics)
        region = on(plane)
        if region is None:
            return None
        if problem := upside_down(qp, name, normal):
            turned = on(plane * pin.SE3(np.diag([1.0, -1.0, -1.0]), np.zeros(3)))
            if turned is not None and abs(turned.height) <= _HEIGHT:
                raise ConfigurationError(problem)
        up = pin.rpy.rpyToMatrix(np.array(spec.rpy))[:, 2]
        _require_height(name, "sole", region.height, np.array(spec.translation) + region.height * up)
        tilt = region.tilt or 0.0
        if not (tilt <= _TILT):
            raise ConfigurationError(
                f"contacts.{name}.rpy: the sole is tilted by {degrees(tilt):.1f}° against the flat underside of "
                f"{spec.frame!r} in the URDF (allowed {degrees(_TILT):.0f}°); its z axis must be normal to it"
            )
        region = on(plane, LAYER + _LONGEST * tan(tilt)) or region
        _require_size(name, spec, region)
        flat = on(plane, _TREAD + _LONGEST * tan(tilt)) or region
        overhang = float(flat.outside(np.array(spec.corners)).max())
        length, width = 1e3 * np.ptp(np.array(spec.corners), axis=0)
        beyond = f", {1e3 * overhang:.1f} mm beyond its edge: the foot may tip" if overhang > _REPORTED_OVERHANG else ""
        return (
            f"{length:.0f} × {width:.0f} mm on a sole of {_size(region)}"
            + _describe_offset(region.height, tilt)
            + beyond
        )
    if not isinstance(contact, PointContact) or contact.wrench_in_world(qp.dynamics, np.eye(3)[2])[:3] @ normal < 0.5:
        return "not on the floor, not compared"
    region = on(pin.SE3(contact.axes(qp.dynamics), contact.points(qp.dynamics)[0]))
    if region is None:
        return None
    radius = f"radius = {contact.radius:g}"
    kind = f"lowest point ({radius})"
    shift = qp.dynamics.placement(index).rotation.T @ (region.height * contact.axes(qp.dynamics)[:, 2])
    _require_height(name, kind, region.height, np.array(spec.translation) + shift)
    side_offset = float(region.outside(np.zeros((1, 2)))[0])
    if not (side_offset <= _SIDE_OFFSET):
        allowed = f"(allowed {1e3 * _SIDE_OFFSET:.0f} mm); correct frame or translation"
        offset = f"{1e3 * side_offset:.0f} mm beside the footprint of {spec.frame!r} in the URDF"
        raise ConfigurationError(f"contacts.{name}: its {kind} is {offset} {allowed}")
    return f"{radius} m" + (_describe_offset(region.height) or " agrees")


def point_text(point: Array) -> str:
    """Format a point, (3,) in m."""
    return "[" + ", ".join(f"{value:.3f}" for value in point + 0.0) + "]"


def _size(region: Footprint) -> str:
    length, width = 1e3 * region.size
    return f"{length:.0f} × {width:.0f} mm"


def _describe_offset(height: float, tilt: float = 0.0) -> str:
    parts = [f"{abs(1e3 * height):.0f} mm {_side(height)} it"] if abs(height) > _REPORTED_HEIGHT else []
    parts += [f"tilted against it by {degrees(tilt):.1f}°"] if degrees(tilt) > 1.0 else []
    return ", " + " and ".join(parts) if parts else ""


def _side(height: float) -> str:
    return "below" if height > 0.0 else "above"


def _require_height(name: str, kind: str, height: float, translation: Array) -> None:
    if not (abs(height) <= _HEIGHT):
        raise ConfigurationError(
            f"contacts.{name}: its {kind} is {1e3 * abs(height):.0f} mm {_side(height)} the lowest point of the link's "
            f"collision shapes in the URDF (allowed {1e3 * _HEIGHT:.0f} mm); correct frame or translation, such as "
            f"translation: {point_text(translation)}"
        )


def _require_size(name: str, spec: SurfaceSettings, region: Footprint) -> None:
    corners = np.array(spec.corners)
    allowed = min(_OVERHANG, _OVERHANG_SHARE * float(region.size.min()))
    overhang = float(region.outside(corners).max())
    if overhang <= allowed:
        return
    key = "vertices" if spec.vertices is not None else "half_length and half_width"
    if region.outside(corners[:, ::-1]).max() <= allowed:
        sides = f"the sole of {spec.frame!r} in the URDF is {_size(region)} along x and y"
        raise ConfigurationError(f"contacts.{name}: {key} are swapped: {sides}")
    middle = 0.5 * (region.polygon.min(axis=0) + region.polygon.max(axis=0))
    raise ConfigurationError(
        f"contacts.{name}: {key} reach {1e3 * overhang:.0f} mm beyond the sole of {spec.frame!r} in the URDF (allowed "
        f"{1e3 * allowed:.0f} mm), which is {_size(region)} about [{middle[0]:.3f}, {middle[1]:.3f}] m of the contact; "
        "the centre of pressure would lie outside the real sole"
    )
