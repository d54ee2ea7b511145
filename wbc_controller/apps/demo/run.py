"""Execution of a demo, with verdict and report."""

import os
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, nullcontext, suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from wbc_controller.apps.demo.derived_scenario import derived_scenario
from wbc_controller.apps.demo.director import DemoFailed, Director, Record
from wbc_controller.apps.demo.scenario import SCENARIOS, WALK, WALK_ROBOT, WALK_SCENARIO, Scenario
from wbc_controller.apps.demo.verdict import distances_to_targets, judge, reference_of
from wbc_controller.controller.build.robot import make_model
from wbc_controller.controller.check.preflight import check
from wbc_controller.controller.cycle import ControlCycle
from wbc_controller.controller.visualization.tables import Table, as_text
from wbc_controller.errors import ConfigurationError
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.middleware.transports.memory import MemoryTransport
from wbc_controller.middleware.transports.transport import Transport
from wbc_controller.nodes.lockstep import Lockstep
from wbc_controller.nodes.processes import Processes
from wbc_controller.recording.recorder import Recorder
from wbc_controller.recording.recording_file import Recording, add_topics
from wbc_controller.recording.report.run_data import PHASES, Result, make_run_data, truth_topics
from wbc_controller.recording.report.run_report import write_run_report
from wbc_controller.settings.config import Config, load

_FIRST_DOMAIN = 100  # 100 to 199 by process ID, for concurrent demos
_UserSession = tuple[Transport, Callable[[threading.Event], None], Record]


def run_demo(
    robot: str, folder: Path, *, lockstep: bool = False, real_time_factor: float = 1.0, sensors: str | None = None
) -> bool:
    """Run the demo of a robot, and write the recording and the report; return True if all targets were met.

    `robot` is a configuration, or "walk" for the walk of G1; robots without a scenario get a derived one. `sensors` is
    the quality of the sensors for base estimation; None for exact sensors and odometry.

    Raises `ConfigurationError` if the robot is unknown, refused by the pre-flight check, or has no possible scenario.
    """
    config = load(WALK_ROBOT if robot == WALK else robot)
    check(config)
    if sensors is not None:
        config = config.replace({"estimation.base_state": "imu", "mock.sensors": sensors})
    folder.mkdir(parents=True, exist_ok=True)
    record = folder / f"{Path(robot).stem}.mcap"
    record.unlink(missing_ok=True)
    model = make_model(config.settings)
    known = {**SCENARIOS, WALK: WALK_SCENARIO}
    scenario = known[robot] if robot in known else derived_scenario(config.settings, model)
    console = Console()
    how = "in lockstep, in one process" if lockstep else "two processes, DDS on the loopback interface"
    base = "base from odometry" if sensors is None else f"base estimated from {sensors} sensors"
    base = base if model.floating_base else "fixed base"
    console.print(f"[bold]{record.stem}[/bold]: {model.nj} joints, {model.mass:.1f} kg; {base}; {how}")
    play = _in_lockstep(config, model, record) if lockstep else _in_real_time(config, record, real_time_factor)
    failure = None
    with _progress(console, scenario) as report_phase, play as (transport, advance, record_message):
        director = Director(config.settings, model, scenario, transport, advance, record_message, report_phase)
        try:
            director.play()
        except DemoFailed as error:
            failure = str(error)
    return _conclude(console, record, model, scenario, director, failure)


@contextmanager
def _progress(console: Console, scenario: Scenario) -> Iterator[Callable[[str], None]]:
    phases = 4 + len([*scenario.moves, *scenario.reaches, *scenario.shoves, *scenario.walks])
    bar = Progress(
        SpinnerColumn(), TextColumn("{task.description:16}"), BarColumn(),
        TextColumn("{task.completed:.0f}/{task.total:.0f}"), TimeElapsedColumn(), console=console, transient=True,
    )  # fmt: skip
    task = bar.add_task("start", total=phases)

    def report_phase(phase: str) -> None:
        bar.update(task, description=phase, advance=1)
        if not console.is_terminal:
            console.print(f"  {phase}")

    with bar if console.is_terminal else nullcontext():
        yield report_phase


@contextmanager
def _in_real_time(config: Config, path: Path, real_time_factor: float) -> Iterator[_UserSession]:
    from wbc_controller.middleware.transports.dds import DdsTransport

    domain = _FIRST_DOMAIN + os.getpid() % 100
    recorded: dict[tuple[str, str], list[tuple[int, bytes]]] = {}

    def record(topic: str, kind: str, stamp: int, payload: bytes) -> None:
        recorded.setdefault((topic, kind), []).append((stamp, payload))

    with (
        tempfile.TemporaryDirectory() as folder,
        closing(DdsTransport("wbc_demo", domain_id=domain, discovery_range="LOCALHOST")) as transport,
        closing(Processes(config, Path(folder), domain)) as processes,
    ):
        processes.start("mock", "--real-time-factor", str(real_time_factor))
        processes.start("controller", "--record", str(path))

        def advance(arrived: threading.Event) -> None:
            if not arrived.wait(0.05):
                error = processes.early_end()
                if error:
                    raise DemoFailed(error)
            arrived.clear()

        yield transport, advance, record
    with suppress(ConfigurationError):  # `_conclude` reports an unreadable recording
        add_topics(path, recorded)


@contextmanager
def _in_lockstep(config: Config, model: RobotModel, path: Path) -> Iterator[_UserSession]:
    settings = config.settings
    recorder = Recorder(settings, path, patient=True, name=path.stem)
    recorded = [(topic.name, topic.type) for topic in truth_topics(settings)] + [(PHASES, "std_msgs/msg/String")]
    channels = {topic: recorder.channel(topic, kind) for topic, kind in recorded}
    robot = Lockstep(settings, model=model, recorder=recorder)

    def record(topic: str, _kind: str, _stamp: int, payload: bytes) -> None:
        recorder.record_incoming(channels[topic], payload)  # at the clock's time, as the stamp

    def advance(arrived: threading.Event) -> None:
        robot.cycle()

    try:
        yield MemoryTransport(robot.bus), advance, record
    finally:
        recorder.close()


def _conclude(
    console: Console, path: Path, model: RobotModel, scenario: Scenario, director: Director, failure: str | None
) -> bool:
    try:
        recording = Recording(path)
        run = make_run_data(recording, ControlCycle(recording.config, preflight=False), largest=recording.count)
    except ConfigurationError as error:
        console.print(f"[red]the demo ended before the first command of the controller: {failure or error}[/red]")
        return False
    run = replace(run, robot=path.stem, com_reference=reference_of(run, director))
    distances = distances_to_targets(run, director, model)
    results = judge(run, scenario, director.windows, distances, model.mass * model.gravity)
    if failure is not None:
        results = (Result("run", "complete", failure, False), *results)
    rows = tuple((each.name, each.target, each.measured, "met" if each.passed else "missed") for each in results)
    times = 1e3 * run.cycle_seconds
    cycle_time = (
        f"cycle time of the controller: median {np.median(times):.2f} ms, 99 % below {np.quantile(times, 0.99):.2f} ms "
        f"({len(times)} cycles)"
    )
    table = Table(("check", "target", "measured", ""), rows)
    console.print(as_text(cycle_time, [table]), markup=False, highlight=False)
    page = path.with_suffix(".html")
    write_run_report(replace(run, results=results), model, page, kind="wbc_controller demo")
    console.print(f"recording: {path}")
    console.print(f"report: {page}")
    good = all(result.passed for result in results)
    console.print("[green]all targets met[/green]" if good else "[red]targets missed[/red]")
    return good
