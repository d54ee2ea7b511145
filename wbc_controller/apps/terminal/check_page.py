"""Page of `wbc check --html`."""

import html
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from wbc_controller.controller.build.program import make_qp
from wbc_controller.controller.build.references import make_board
from wbc_controller.controller.build.robot import make_model
from wbc_controller.controller.check import Finding
from wbc_controller.controller.check.contact_shapes import undersides
from wbc_controller.controller.check.preflight import stance
from wbc_controller.controller.visualization.page_report import Drawing, PageReport, ResultTable, write_page
from wbc_controller.errors import NoSolution
from wbc_controller.inverse_dynamics.contacts import UnilateralContact
from wbc_controller.inverse_dynamics.contacts.support import support_polygon
from wbc_controller.inverse_dynamics.whole_body_qp import WholeBodyQP
from wbc_controller.recording.report.motion import make_motion
from wbc_controller.recording.report.run_data import RunData
from wbc_controller.records import Array, RobotState, frozen
from wbc_controller.settings.config import Config

_MARGIN, _WIDTH = 0.05, 560  # m, and width of the drawing, pixels
_DOT = 0.012  # radius of dots, as a share of the drawing's width


def write_check_page(config: Config, findings: Sequence[Finding], failure: str, path: Path) -> None:
    """Write the findings of a check, or its error `failure`; raise `ConfigurationError` if this fails."""
    settings = config.settings
    model = make_model(settings, config.urdf)
    qp = make_qp(settings, model)
    active = [name for name, contact in settings.contacts.items() if contact.enabled]
    q = stance(model, qp, active, settings.mock.floor_normal)
    name = config.source or "robot"
    picture = RunData(
        robot=name,
        actuators=model.actuators,
        time=np.zeros(1),
        q=q[None],
        tau=np.zeros((1, model.na)),
        effort_limits=model.effort_limits,
        com=np.array(qp.dynamics.com)[None],
        com_reference=np.full((1, 3), np.nan),
        disturbance=np.zeros(1),
        contact_wrenches={key: force[None] for key, force in _forces(config, qp, q).items()},
        contacts=settings.contacts,
    )
    rows: list[tuple[tuple[str, str], bool | None]] = [((each.subject, each.text), None) for each in findings]
    caption = (
        'x is up, y to the left.<i style="--c: var(--planned)"></i>contact in the configuration'
        '<i style="--c: var(--true)"></i>underside in the URDF<i style="--c: var(--com)"></i>centre of mass'
    )
    report = PageReport(
        title=Path(name).stem,
        kind="wbc check",
        verdict=failure or "ok",
        passed=not failure,
        facts={"Mass": f"{model.mass:.1f} kg", "Joints": str(model.nj), "Contacts": str(len(active))},
        motion=make_motion(picture, model),
        drawing=Drawing("From above", caption, _floor_plan(qp, active, undersides(settings, qp))),
        table=ResultTable("Findings", (), rows or [(("The check ended with the error above.",), None)]),
    )
    write_page(report, path)


def _forces(config: Config, qp: WholeBodyQP, q: Array) -> Mapping[str, Array]:
    state = RobotState(0, frozen(q), frozen(np.zeros(qp.model.nv)))
    board = make_board(config.settings, qp)
    board.reset(qp.dynamics, 0.0)
    try:
        found = qp.solve(state, board.sample(0.0), None).forces
    except NoSolution:  # the check reports the reason
        found = {}
    sizes = {name: contact.size for name, contact in qp.contacts.items() if isinstance(contact, UnilateralContact)}
    return {name: found.get(name, np.zeros(size)) for name, size in sizes.items()}


def _floor_plan(qp: WholeBodyQP, active: Sequence[str], true: Mapping[str, Array]) -> str:
    feet = {
        name: contact.points(qp.dynamics)[:, :2]
        for name in active
        if isinstance(contact := qp.contacts[name], UnilateralContact) and not contact.internal
    }
    if not feet:
        return "<p>No active contact with the floor.</p>"
    com = qp.dynamics.com[:2]
    everything = np.vstack([*feet.values(), *(corners[:, :2] for corners in true.values()), com[None]])
    low, high = everything.min(axis=0) - _MARGIN, everything.max(axis=0) + _MARGIN
    height, width = high - low
    scale = _WIDTH / width

    def at(point: Array) -> tuple[float, float]:
        return round(float(scale * (high[1] - point[1])), 1), round(float(scale * (high[0] - point[0])), 1)

    def shape(points: Array, kind: str, title: str) -> str:
        tooltip = f"<title>{html.escape(title)}</title>"
        corners = support_polygon(points)
        if len(corners) < 3:
            dots = [f'cx="{x}" cy="{y}" r="{_DOT * _WIDTH}"' for x, y in map(at, points)]
            return "".join(f'<circle class="{kind}" {dot}>{tooltip}</circle>' for dot in dots)
        vertices = " ".join(f"{x},{y}" for x, y in map(at, corners))
        return f'<polygon class="{kind}" points="{vertices}">{tooltip}</polygon>'

    parts = [shape(np.vstack(list(feet.values())), "support", "support polygon")]
    parts += [shape(corners[:, :2], "true", f"{name}: underside in the URDF") for name, corners in true.items()]
    parts += [shape(points, "assumed", f"{name}: in the configuration") for name, points in feet.items()]
    for name, points in feet.items():
        x, y = at(points.mean(axis=0))
        parts.append(f'<text x="{x}" y="{y}">{html.escape(name)}</text>')
    x, y = at(com)
    parts.append(f'<circle class="com" cx="{x}" cy="{y}" r="{_DOT * _WIDTH}"><title>centre of mass</title></circle>')
    length = 0.1 * scale
    parts.append(
        f'<path class="scale" d="M 12 {scale * height - 12:.1f} h {length:.1f}"/>'
        f'<text class="scale" x="{12 + length / 2:.1f}" y="{scale * height - 18:.1f}">100 mm</text>'
    )
    return f'<svg viewBox="0 0 {_WIDTH} {scale * height:.1f}" role="img">{"".join(parts)}</svg>'
