"""The command line, `wbc`: the nodes, what checks, shows, tests and measures them, and tables of their topics."""

from __future__ import annotations

import logging
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar, get_args

import click

from wbc_controller.apps.page.page_commands import play, view
from wbc_controller.apps.terminal.completion import complete_config
from wbc_controller.apps.terminal.terminal_commands import echo, send, status
from wbc_controller.controller.check.finding import Finding
from wbc_controller.errors import ConfigurationError, WbcError
from wbc_controller.middleware.topics import ESTIMATOR_NODE, parse_remapping
from wbc_controller.nodes.signals import set_by_signals
from wbc_controller.recording.replay.replay_commands import replay, report
from wbc_controller.settings import NODE_NAME, Settings
from wbc_controller.settings.files import find_configuration, load_settings
from wbc_controller.settings.service import SensorQuality
from wbc_controller.validation.accuracy.accuracy_commands import accuracy
from wbc_controller.validation.fuzz.fuzz_commands import fuzz
from wbc_controller.validation.latency.latency_commands import bench

F = TypeVar("F", bound=Callable[..., Any])


class _Commands(click.Group):
    """Shows errors of this package as one readable message, with exit status 2."""

    def invoke(self, ctx: click.Context) -> Any:
        try:
            return super().invoke(ctx)
        except WbcError as error:
            click.echo(f"error: {error}", err=True)
            sys.exit(2)


@click.group(cls=_Commands, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="wbc_controller", prog_name="wbc")
def main() -> None:
    """Whole-body control by one quadratic program per cycle.

    CONFIG is the name of a robot that is shipped (g1, talos, go2) or the path of a .yaml file.
    """


main.add_command(accuracy)
main.add_command(fuzz)
main.add_command(bench)
for _command in (send, echo, status, view, play, replay, report):
    main.add_command(_command)


def _node_options(function: F) -> F:
    """Options of every node: where its topics are."""
    options = [
        click.option("--namespace", default="/", show_default=True, help="Namespace of the node's topics."),
        click.option("--remap", "remaps", multiple=True, metavar="FROM:=TO", help="Rename a topic; may be repeated."),
        click.option("-v", "--verbose", is_flag=True, help="Log more."),
    ]
    for option in reversed(options):
        function = option(function)
    return function


@main.command()
@click.argument("config", shell_complete=complete_config)
@click.option("--activate", is_flag=True, help="Activate as soon as the inputs are fresh, without a command.")
@click.option("--use-sim-time", is_flag=True, help="Measure ages and durations by /clock: for simulators alone.")
@click.option(
    "--record",
    type=click.Path(path_type=Path),
    help="Record all of the run to this .mcap file: docs/recording.md.",
)
@_node_options
def run(
    config: str,
    activate: bool,
    use_sim_time: bool,
    record: Path | None,
    namespace: str,
    remaps: tuple[str, ...],
    verbose: bool,
) -> None:
    """Run the controller on DDS, where ROS 2's topics are, without ROS 2."""
    from wbc_controller.nodes.controller_service import run_controller

    _log_to_stderr(verbose)
    settings, remappings = _load(config), _remappings(remaps)
    with _stop_on_signals() as stop, _dds(NODE_NAME, namespace) as transport, _naming(config):
        run_controller(
            settings,
            transport,
            stop,
            namespace=namespace,
            remappings=remappings,
            activate=activate,
            use_sim_time=use_sim_time,
            record=record,
        )


@main.command()
@click.argument("config", shell_complete=complete_config)
@click.option("--real-time-factor", default=1.0, show_default=True, help="Simulated seconds per second.")
@click.option("--lockstep", is_flag=True, help="Wait for the controller's answer to each state.")
@click.option("--patient", is_flag=True, help="Simulated time waits for a controller that is late: a computer that is "
              "too slow makes slow motion. The controller needs --use-sim-time.")  # fmt: skip
@click.option(
    "--faults", type=click.Path(path_type=Path, exists=True, dir_okay=False),
    help="A YAML file with a list of faults and the times at which they happen: docs/faults.md.",
)  # fmt: skip
@_node_options
def mock(
    config: str,
    real_time_factor: float,
    lockstep: bool,
    patient: bool,
    faults: Path | None,
    namespace: str,
    remaps: tuple[str, ...],
    verbose: bool,
) -> None:
    """Run the mock robot: rigid-body physics behind the robot's topics."""
    try:
        from wbc_controller.simulation.mock_service import run_mock
    except ModuleNotFoundError as error:
        raise ConfigurationError(
            f"the mock robot needs MuJoCo ({error}); install it with: pip install 'wbc_controller[mock]'"
        ) from error

    _log_to_stderr(verbose)
    settings, remappings = _load(config), _remappings(remaps)
    with _stop_on_signals() as stop, _dds("mock_robot", namespace) as transport, _naming(config):
        run_mock(
            settings,
            transport,
            stop,
            namespace=namespace,
            remappings=remappings,
            real_time_factor=real_time_factor,
            lockstep=lockstep,
            patient=patient,
            faults=faults,
        )


@main.command()
@click.argument("robots", nargs=-1, metavar="[ROBOT]...")
@click.option("--kinds", default="", help="Kinds of fault, separated by commas: docs/faults.md; all by default.")
@click.option("--seeds", default=25, show_default=True, type=click.IntRange(1), help="Trials per kind and robot.")
@click.option("--seed", type=click.IntRange(0), help="One trial per kind and robot, with this seed, to repeat it.")
@click.option("--jobs", default=-1, show_default=True, help="Trials at once; -1 for one per processor.")
@click.option("--out", "folder", type=click.Path(path_type=Path), default=Path("faults"), show_default=True,
              help="Folder of the results; what is missing there is run.")  # fmt: skip
@click.option("--backend", default="loky", show_default=True, help="loky (this machine), dask or ray.")
@click.option("--address", help="Address of the dask scheduler or the ray cluster.")
@click.option("--recordings", type=click.Path(path_type=Path, file_okay=False),
              help="Folder for the recordings that faults leave: each has to name its fault, and to come out bit for "
              "bit. Trials that are in the results already are not recorded.")  # fmt: skip
def faults(
    robots: tuple[str, ...],
    kinds: str,
    seeds: int,
    seed: int | None,
    jobs: int,
    folder: Path,
    backend: str,
    address: str | None,
    recordings: Path | None,
) -> None:
    """Run a campaign of faults on mock robots, and report what came of each: g1, talos and go2 by default.

    The status is 1 where a trial violates what has to hold.
    """
    from wbc_controller.validation.campaign.run import run_campaign

    good = run_campaign(
        robots or ("g1", "talos", "go2"),
        [kind.strip() for kind in kinds.split(",") if kind.strip()],
        range(seeds) if seed is None else (seed,),
        folder,
        jobs=jobs,
        backend=backend,
        address=address,
        recordings=recordings,
    )
    sys.exit(0 if good else 1)


@main.command()
@click.argument("config", shell_complete=complete_config)
@_node_options
def guard(config: str, namespace: str, remaps: tuple[str, ...], verbose: bool) -> None:
    """Damp the robot when the controller's commands stop: start it beside `wbc run`."""
    from wbc_controller.nodes.guard_service import NODE_NAME, run_guard

    _log_to_stderr(verbose)
    settings, remappings = _load(config), _remappings(remaps)
    with _stop_on_signals() as stop, _dds(NODE_NAME, namespace) as transport, _naming(config):
        run_guard(settings, transport, stop, namespace=namespace, remappings=remappings)


@main.command()
@click.argument("config", shell_complete=complete_config)
@_node_options
def estimate(config: str, namespace: str, remaps: tuple[str, ...], verbose: bool) -> None:
    """Estimate where the base is, from an IMU and the legs, and publish it as odometry: docs/estimation.md.

    `wbc run` needs it only where `estimation.base_state` is odom: with imu, it estimates its base itself.
    """
    from wbc_controller.nodes.estimator_service import run_estimator

    _log_to_stderr(verbose)
    settings, remappings = _load(config), _remappings(remaps)
    with _stop_on_signals() as stop, _dds(ESTIMATOR_NODE, namespace) as transport, _naming(config):
        run_estimator(settings, transport, stop, namespace=namespace, remappings=remappings)


@main.command()
@click.argument("config", shell_complete=complete_config)
@click.option("--html", "page", type=click.Path(path_type=Path, dir_okay=False),
              help="Write a page, too: the robot as it stands, its contacts beside the URDF's shapes.")  # fmt: skip
def check(config: str, page: Path | None) -> None:
    """Check a configuration before the robot moves, and say what was found.

    A page that --html asks for is written where the check fails, too, with the robot and the sentence.
    """
    from wbc_controller.controller.check.preflight import check as find

    try:
        findings = find(config)
    except ConfigurationError as error:
        if page is not None:
            _draw(config, [], str(error), page)
        raise
    click.echo(f"{find_configuration(config)}")
    for finding in findings:
        click.echo(f"  {finding.subject:16} {finding.text}")
    if page is not None:
        _draw(config, findings, "", page)
    click.echo("ok")


def _draw(config: str, findings: Sequence[Finding], failure: str, page: Path) -> None:
    from wbc_controller.apps.terminal.check_page import write_check_page
    from wbc_controller.settings.config import load

    try:
        write_check_page(load(config), findings, failure, page)
    except ConfigurationError as error:
        if not failure:
            raise
        click.echo(f"{page}: not written, as there is nothing to draw: {error}", err=True)
    else:
        click.echo(f"page: {page}", err=bool(failure))


@main.command()
@click.argument("config", shell_complete=complete_config)
@click.argument("recording", type=click.Path(path_type=Path, exists=True, dir_okay=False))
def identify(config: str, recording: Path) -> None:
    """Fit masses, armature and joint frictions to a RECORDING of `wbc run --record`, with their standard errors."""
    from wbc_controller.recording.identification.identify_command import identify as fit
    from wbc_controller.recording.identification.identify_command import report

    with _naming(config):
        click.echo(report(*fit(_load(config), recording)), nl=False)


@main.command()
@click.argument("urdf", metavar="ROBOT.urdf")
@click.option("--srdf", metavar="FILE", help="Its SRDF, for a posture: half_sitting, standing, …")
@click.option("--base", type=click.Choice(["floating", "fixed"]), help="Of the robot; floating if it has feet.")
@click.option("--feet", multiple=True, metavar="LINK", help="A link to stand on, not those found; once for each.")
def new(urdf: str, srdf: str | None, base: Any, feet: tuple[str, ...]) -> None:
    """Print a first configuration of a robot, and check it: `wbc new ROBOT.urdf > robot.yaml`.

    ROBOT.urdf and FILE are paths or package:// addresses. The configuration has a comment on each value that was
    measured, guessed, or is missing. What was guessed or is missing, and the findings of the check, go to stderr. The
    status is 2 where the robot cannot stand with it yet.
    """
    from wbc_controller.apps.new.draft import TITLE, new_configuration
    from wbc_controller.controller.check.preflight import check as find

    draft = new_configuration(urdf, srdf=srdf, base=base, feet=feet)
    click.echo(draft.to_yaml(TITLE), nl=False)
    for doubt in draft.doubts:
        click.echo(doubt, err=True)
    for finding in find(draft.settings):
        click.echo(f"  {finding.subject:16} {finding.text}", err=True)
    click.echo("ok", err=True)


@main.command()
@click.argument("robot", default="g1", shell_complete=complete_config)
@click.option("--report", "folder", type=click.Path(path_type=Path), default=Path("report"), show_default=True,
              help="Folder for the report.")  # fmt: skip
@click.option("--lockstep", is_flag=True, help="One process, no real time: the run is the same every time.")
@click.option("--real-time-factor", default=1.0, show_default=True, help="Simulated seconds per second.")
@click.option("--sensors", type=click.Choice(get_args(SensorQuality)),
              help="Run without odometry: the base is estimated, from sensors of this quality.")  # fmt: skip
def demo(robot: str, folder: Path, lockstep: bool, real_time_factor: float, sensors: str | None) -> None:
    """Show the controller at work on a mock robot, commanded by topics; ROBOT is as CONFIG elsewhere."""
    from wbc_controller.apps.demo.run import run_demo

    done = run_demo(robot, folder, lockstep=lockstep, real_time_factor=real_time_factor, sensors=sensors)
    sys.exit(0 if done else 1)


@main.command()
def topics() -> None:
    """Print the table of all topics, as Markdown."""
    from wbc_controller.middleware.topics_table import topics_page

    click.echo(topics_page(), nl=False)


@main.command("security-policy")
@click.argument("config", shell_complete=complete_config)
@click.option("--urdf", type=click.Path(path_type=Path, exists=True, dir_okay=False),
              help="The URDF, where the configuration names none.")  # fmt: skip
@click.option("--namespace", default="/", show_default=True, help="Namespace of the nodes.")
@click.option("--remap", "remaps", multiple=True, metavar="FROM:=TO", help="A topic that is renamed; may be repeated.")
def security_policy(config: str, urdf: Path | None, namespace: str, remaps: tuple[str, ...]) -> None:
    """Print an SROS 2 policy of every node, with least privilege."""
    from wbc_controller.controller.build.robot import make_model
    from wbc_controller.controller.build.robot_description import read_urdf
    from wbc_controller.nodes.ros2 import security_policy as policy

    settings, remappings = _load(config), _remappings(remaps)
    with _naming(config):
        model = make_model(settings, read_urdf(str(urdf)) if urdf is not None else None)
    click.echo(policy.security_policy(settings, model, namespace, remappings), nl=False)


def _load(config: str) -> Settings:
    path = find_configuration(config)
    return load_settings(path)


@contextmanager
def _naming(config: str) -> Iterator[None]:
    """Put the file's path in front of what is wrong with its values."""
    try:
        yield
    except ConfigurationError as error:
        raise ConfigurationError(f"{find_configuration(config)}: {error}") from error


def _remappings(texts: tuple[str, ...]) -> dict[str, str]:
    return dict(parse_remapping(text) for text in texts)


@contextmanager
def _dds(node: str, namespace: str) -> Iterator[Any]:
    from wbc_controller.middleware.transports.dds import DdsTransport

    transport = DdsTransport(node, namespace)
    try:
        yield transport
    finally:
        transport.close()


@contextmanager
def _stop_on_signals() -> Iterator[threading.Event]:
    """An event that Ctrl-C, SIGTERM and the end of the terminal set."""
    stop = threading.Event()
    with set_by_signals(stop):
        yield stop


def _log_to_stderr(verbose: bool) -> None:
    logging.basicConfig(
        level=logging.INFO if verbose else logging.WARNING,
        format="%(asctime)s %(levelname)-7s %(name)s: %(message)s",
        datefmt="%H:%M:%S",
    )
