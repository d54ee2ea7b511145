"""Data of a report: arrays over samples, from a recording."""

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from wbc_controller.controller.cycle import ControlCycle
from wbc_controller.errors import ConfigurationError
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.inverse_dynamics.robot.orientation import rotation_of
from wbc_controller.inverse_dynamics.tasks import AccelerationTask, Task
from wbc_controller.middleware.codec import decode
from wbc_controller.middleware.stamps import header_time
from wbc_controller.middleware.states import OdometryReader
from wbc_controller.middleware.topics import MOCK_NODE, MOCK_TOPICS, Endpoint, endpoints
from wbc_controller.recording.cycle_layout import cycle_slots, reference_slots
from wbc_controller.recording.mcap_file import Topic
from wbc_controller.recording.recording_file import Recording
from wbc_controller.records import Array
from wbc_controller.settings import Settings
from wbc_controller.settings.contacts import ContactSettings, FixedContact, PointContact, RollingContact
from wbc_controller.settings.tasks import ComTask

MAX_SAMPLES = 30_000  # of a report; longer recordings have one sample per two, three, … cycles
PHASES = "/wbc_demo/phase"  # topic of a demo's phases, std_msgs/msg/String


@dataclass(frozen=True, slots=True)
class Result:
    """One line of the verdict."""

    name: str
    target: str
    measured: str
    passed: bool


@dataclass(frozen=True, slots=True, eq=False)
class RunData:
    """Arrays of a run: n samples, m cycles, na actuators."""

    robot: str
    actuators: tuple[str, ...]  # in the order of the command
    time: Array  # since the first sample, (n,) in s, non-decreasing
    q: Array  # Pinocchio configuration, (n, nq)
    tau: Array  # commanded torques, (n, na) in N·m
    effort_limits: Array  # (na,) in N·m
    com: Array  # centre of mass in the world, (n, 3) in m
    com_reference: Array  # (n, 3) in m; NaN without a reference
    disturbance: Array  # vertical force of the disturbance on the base, (n,) in N; NaN without a solution
    task_errors: Mapping[str, Array] = field(default_factory=dict)  # norms, (n,) in m or rad; NaN while disabled
    #: By contact, a wrench in its frame, (n, 6), or a force along the world's axes, (n, 3), in N and N·m; NaN or zero
    #: while inactive. Solution, and truth of a simulation.
    contact_wrenches: Mapping[str, Array] = field(default_factory=dict)
    true_wrenches: Mapping[str, Array] = field(default_factory=dict)
    friction: Mapping[str, float] = field(default_factory=dict)  # Coulomb coefficient by contact
    cycle_seconds: Array = field(default_factory=lambda: np.zeros(0))  # duration of each cycle, (m,) in s
    stage_seconds: Mapping[str, Array] = field(default_factory=dict)  # part of each stage, (m,) in s
    phases: tuple[tuple[float, str], ...] = ()  # starts of the phases since the start of the run, s, and names
    results: tuple[Result, ...] = ()
    modes: tuple[tuple[float, str], ...] = ()  # changes of the supervisor's mode, (time in s, mode)
    contacts: Mapping[str, ContactSettings] = field(default_factory=dict)  # drawn contacts
    #: Model audit, (n,): ``energy`` in W, ``force`` in N, NaN without an audit, and number of ``warnings``.
    audit: Mapping[str, Array] = field(default_factory=dict)
    start: float = 0.0  # stamp of the first sample, s
    stride: int = 1  # cycles per sample

    @property
    def duration(self) -> float:
        """Length of the run, s."""
        return float(self.time[-1] - self.time[0])

    @property
    def spans(self) -> list[tuple[float, float, str]]:
        """Start, end and name of each phase."""
        starts = [start for start, _ in self.phases]
        ends = [*starts[1:], float(self.time[-1])]
        return [(start, end, name) for (start, name), end in zip(self.phases, ends, strict=False)]


def mean_velocity(way: Array, begin: float, end: float) -> Array:
    """Return the mean velocity in the heading between two times in s, (3,) in m/s and rad/s.

    `way`: times in s, x and y in m and heading in rad, (n, 4).
    """
    part = way[(way[:, 0] >= begin) & (way[:, 0] <= end)]
    headings = np.unwrap(part[:, 3])
    steps = np.diff(part[:, 1] + 1j * part[:, 2]) * np.exp(-0.5j * (headings[1:] + headings[:-1]))
    moved = steps.sum()
    change = np.array([moved.real, moved.imag, headings[-1] - headings[0]])
    return change / float(part[-1, 0] - part[0, 0])


def heading(q: Array) -> float:
    """Return the heading of a floating base, rad."""
    x, y, z, w = q[3:7].tolist()
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def truth_topics(settings: Settings) -> list[Endpoint]:
    """Return the topics of a simulation's truth: contact wrenches, and odometry for an estimated base."""
    keys = ("contact_wrench", "odom") if settings.estimation.base_state == "imu" else ("contact_wrench",)
    topics = endpoints(MOCK_TOPICS, MOCK_NODE, settings)
    return [topic for topic in topics if topic.key in keys]


class _OtherTopics:
    """Contents of the topics of a demo."""

    def __init__(self, model: RobotModel, settings: Settings) -> None:
        self._truth = {endpoint.name: endpoint for endpoint in truth_topics(settings)}
        self._base_reader = OdometryReader(model.base_link)
        self.wrenches: dict[str, list[list[float]]] = {}  # stamp, s, and true wrench, N and N·m, by contact
        self.bases: dict[int, Array] = {}  # true poses of the base, (7,), by stamp, ns
        self.phases: list[tuple[int, str]] = []  # times of the record, ns, and names

    def read(self, messages: Iterable[tuple[Topic, int, bytes]]) -> Iterator[tuple[Topic, int, bytes]]:
        """Read the messages of these topics, and yield all messages."""
        for topic, time, payload in messages:
            truth = self._truth.get(topic.name)
            if topic.name == PHASES:
                self.phases.append((time, str(decode(payload, topic.type).data)))
            elif truth is not None and truth.key == "odom":
                base = self._base_reader.read(payload)
                self.bases[base.stamp] = base.pose
            elif truth is not None:
                wrench = decode(payload, topic.type).wrench
                force, torque = wrench.force, wrench.torque
                row = [header_time(payload), force.x, force.y, force.z, torque.x, torque.y, torque.z]
                self.wrenches.setdefault(truth.subject, []).append(row)
            yield topic, time, payload


def make_run_data(recording: Recording, controller: ControlCycle, *, largest: int = MAX_SAMPLES) -> RunData:
    """Return the data of a report with at most `largest` samples.

    A recording without commands, or with another layout, raises `ConfigurationError`.
    """
    slots = cycle_slots(controller.model, controller.contacts)
    recording.require_slots(slots + reference_slots(controller.tasks, controller.contacts))
    model, settings = controller.model, controller.config.settings
    other = _OtherTopics(model, settings)
    table = recording.arrays(other.read(recording.messages()))
    if not table or not np.isfinite(table["q"]).all(axis=1).any():
        raise ConfigurationError(f"recording {recording.path}: nothing to report: no command was sent")
    stride = -(-len(table["number"]) // largest)
    shown = {name: values[::stride][table["has_state"][::stride] > 0.0] for name, values in table.items()}
    stamps = 1.0e-9 * shown["stamp"]
    start = float(stamps[0])
    time = np.maximum.accumulate(stamps - start)
    errors = _task_errors(shown, controller.tasks, Dynamics(model))
    q = np.array(shown["q"])
    vertical = np.zeros(len(q))
    if model.floating_base:
        forces = shown["disturbance"][:, :3]
        vertical = np.array([rotation_of(row[3:7])[2] @ force for row, force in zip(q, forces, strict=True)])
    for i, stamp in enumerate(shown["stamp"].tolist()):
        q[i, :7] = other.bases.get(stamp, q[i, :7])
    data = model.pinocchio.createData()
    reference = np.full((len(q), 3), np.nan)
    for name in [name for name, task in settings.tasks.items() if isinstance(task, ComTask)][:1]:
        reference = np.where(shown[f"weight/{name}"][:, None] > 0.0, shown[f"position/{name}"], np.nan)
    specs = settings.contacts
    sizes = {name: 3 if isinstance(each, PointContact | RollingContact) else 6 for name, each in specs.items()}
    return RunData(
        robot=str(recording.about["robot"]),
        actuators=model.actuators,
        time=time,
        q=q,
        tau=shown["tau"],
        effort_limits=model.effort_limits,
        com=np.array([pin.centerOfMass(model.pinocchio, data, row) for row in q]),
        com_reference=reference,
        disturbance=vertical,
        task_errors={name: error for name, error in errors.items() if np.isfinite(error).any()},
        contact_wrenches={
            name: (shown[f"force/{name}"] @ controller.contacts[name].basis.T)[:, :size] for name, size in sizes.items()
        },
        true_wrenches={
            name: _latest(np.array(rows), stamps)[:, : sizes[name]] for name, rows in other.wrenches.items()
        },
        contacts=specs,
        friction={name: each.friction for name, each in specs.items() if not isinstance(each, FixedContact)},
        cycle_seconds=table["seconds/total"],
        stage_seconds={
            stage: table[f"seconds/{stage}"]
            for stage in ("read", "compute", "supervise", "write")
            if np.isfinite(table[f"seconds/{stage}"]).all()
        },
        phases=tuple(
            (float(np.interp(float(at), shown["time"], time)), name)
            for at, name in other.phases or _requests_and_faults(recording)
        ),
        modes=_modes(table["mode"], 1.0e-9 * table["stamp"] - start),
        audit={
            "energy": shown["audit/energy"],
            "force": np.linalg.norm(shown["audit/force"], axis=1),
            "warnings": shown["audit/warnings"],
        },
        start=start,
        stride=stride,
    )


def _latest(rows: Array, time: Array) -> Array:
    """Return the newest values, (n, k), at times, (n,) in s, of rows with stamps, (m, 1 + k); NaN before the first."""
    rows = rows[np.argsort(rows[:, 0], kind="stable")]
    index = np.searchsorted(rows[:, 0], time + 1.0e-9, side="right") - 1
    latest: Array = rows[np.maximum(index, 0), 1:]
    latest[index < 0] = np.nan
    return latest


def _task_errors(cycles: Mapping[str, Array], tasks: Mapping[str, Task], dynamics: Dynamics) -> dict[str, Array]:
    absent = np.full(len(cycles["q"]), np.nan)
    errors = {name: absent.copy() for name, task in tasks.items() if isinstance(task, AccelerationTask)}
    for i, (q, v) in enumerate(zip(cycles["q"], cycles["v"], strict=True)):
        dynamics.update(np.array(q), np.array(v))
        for name, error in errors.items():
            task = tasks[name]
            if cycles[f"weight/{name}"][i] > 0.0 and isinstance(task, AccelerationTask):
                error[i] = np.linalg.norm(task.error(dynamics, cycles[f"position/{name}"][i]))
    return errors


def _requests_and_faults(recording: Recording) -> Iterator[tuple[int, str]]:
    for _, event in sorted(recording.events.items()):
        words = [str(word) for word in event.get("requests", ())]
        if event.get("fault") is not None:
            words.append(event["fault"].code)
        if words:
            yield event["time"], ", ".join(words)


def _modes(modes: Array, time: Array) -> tuple[tuple[float, str], ...]:
    changes = np.flatnonzero(np.append(True, modes[1:] != modes[:-1])).tolist()
    return tuple((max(0.0, float(time[i])), str(modes[i])) for i in changes)
