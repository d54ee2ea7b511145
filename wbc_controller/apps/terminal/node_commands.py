"""Commands `wbc run`, `mock`, `guard` and `estimate`."""

import contextlib
import logging
import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import click

from wbc_controller.apps.terminal import command_options as common
from wbc_controller.middleware.topics import ESTIMATOR_NODE, GUARD_NODE, MOCK_NODE
from wbc_controller.nodes.signals import set_by_signals
from wbc_controller.settings import NODE_NAME

_verbose = click.option("-v", "--verbose", is_flag=True, help="Log informational messages.")
_node_options = common.with_options(common.namespace_option, common.remap_option, _verbose)


@click.command()
@common.config_argument
@click.option("--activate", is_flag=True, help="Activate without a command as soon as the inputs are fresh.")
@click.option("--use-sim-time", is_flag=True, help="Measure ages and durations by /clock; only for simulators.")
@click.option("--record", type=click.Path(path_type=Path),
              help="Record the complete run to this .mcap file: docs/recording.md.")  # fmt: skip
@_node_options
def run(**options: Any) -> None:
    """Run the controller on DDS, with the topics of ROS 2 but without ROS 2."""
    from wbc_controller.nodes.controller_service import run_controller

    _serve(run_controller, NODE_NAME, **options)


@click.command()
@common.config_argument
@click.option("--real-time-factor", default=1.0, show_default=True, help="Simulated seconds per second.")
@click.option("--lockstep", is_flag=True, help="Wait for the controller's command after each state.")
@click.option("--patient", is_flag=True, help="Let simulated time wait for a late controller, as on a slow computer: "
              "slow motion. The controller requires --use-sim-time.")  # fmt: skip
@click.option("--faults", type=click.Path(path_type=Path, exists=True, dir_okay=False),
              help="YAML file with a list of faults and their times: docs/faults.md.")  # fmt: skip
@_node_options
def mock(**options: Any) -> None:
    """Run the mock robot: rigid-body physics behind the robot's topics."""
    from wbc_controller.simulation.mock_service import run_mock

    _serve(run_mock, MOCK_NODE, **options)


@click.command()
@common.config_argument
@_node_options
def guard(**options: Any) -> None:
    """Run the guard beside `wbc run`: it damps the robot if the controller's commands stop."""
    from wbc_controller.nodes.guard_service import run_guard

    _serve(run_guard, GUARD_NODE, **options)


@click.command()
@common.config_argument
@_node_options
def estimate(**options: Any) -> None:
    """Estimate the pose and twist of the base from an IMU and the legs, and publish odometry: docs/estimation.md.

    Required only if `estimation.base_state` is odom; with imu, the controller estimates the base itself.
    """
    from wbc_controller.nodes.estimator_service import run_estimator

    _serve(run_estimator, ESTIMATOR_NODE, **options)


def _serve(
    service: Callable[..., None],
    node: str,
    *,
    config: str,
    namespace: str,
    remappings: Mapping[str, str],
    verbose: bool,
    **options: Any,
) -> None:
    from wbc_controller.middleware.transports.dds import DdsTransport

    level, line = logging.INFO if verbose else logging.WARNING, "%(asctime)s %(levelname)-7s %(name)s: %(message)s"
    logging.basicConfig(level=level, format=line, datefmt="%H:%M:%S")
    settings, stop = common.load_named(config), threading.Event()
    with (
        set_by_signals(stop),
        contextlib.closing(DdsTransport(node, namespace)) as transport,
        common.naming_file(config),
    ):
        service(settings, transport, stop, namespace=namespace, remappings=remappings, **options)
