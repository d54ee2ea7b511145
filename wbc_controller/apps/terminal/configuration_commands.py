"""Commands `wbc check`, `new`, `identify` and `security-policy`."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import click

from wbc_controller.apps.terminal import command_options as common
from wbc_controller.controller.check import Finding
from wbc_controller.errors import ConfigurationError
from wbc_controller.settings.files import find_configuration


@click.command()
@common.config_argument
@click.option("--html", "page", type=click.Path(path_type=Path, dir_okay=False),
              help="Also write a page: the robot in its stance, its contacts and the shapes of the URDF.")  # fmt: skip
def check(config: str, page: Path | None) -> None:
    """Check a configuration before the robot moves, and print the findings.

    With --html, a failed check also writes its page, with the robot and the error.
    """
    from wbc_controller.controller.check.preflight import check as find

    try:
        findings = find(config)
    except ConfigurationError as error:
        if page is not None:
            _write_page(config, [], str(error), page)
        raise
    click.echo(f"{find_configuration(config)}")
    for finding in findings:
        click.echo(f"  {finding.subject:16} {finding.text}")
    if page is not None:
        _write_page(config, findings, "", page)
    click.echo("ok")


def _write_page(config: str, findings: Sequence[Finding], failure: str, page: Path) -> None:
    from wbc_controller.apps.terminal.check_page import write_check_page
    from wbc_controller.settings.config import load

    try:
        write_check_page(load(config), findings, failure, page)
    except ConfigurationError as error:
        if not failure:
            raise
        click.echo(f"{page}: not written, because the robot cannot be drawn: {error}", err=True)
    else:
        click.echo(f"page: {page}", err=bool(failure))


@click.command()
@click.argument("urdf", metavar="ROBOT.urdf")
@click.option("--srdf", metavar="FILE", help="SRDF with postures: half_sitting, standing, …")
@click.option(
    "--base", type=click.Choice(["floating", "fixed"]), help="Type of the base; by default floating if feet are found."
)
@click.option("--feet", multiple=True, metavar="LINK", help="Link of a foot, in place of the search; repeatable.")
def new(urdf: str, srdf: str | None, base: Any, feet: tuple[str, ...]) -> None:
    """Print a first configuration of a robot, and check it: `wbc new ROBOT.urdf > robot.yaml`.

    ROBOT.urdf and FILE are paths or package:// addresses. The configuration has comments on measured, guessed and
    missing values; guesses, missing values and the findings of the check go to stderr. The exit status is 2 if the
    robot cannot stand with the configuration yet.
    """
    from wbc_controller.apps.new.draft import TITLE, new_configuration
    from wbc_controller.controller.check.preflight import check as find

    draft = new_configuration(urdf, srdf=srdf, base=base, feet=feet)
    click.echo(draft.to_yaml(TITLE), nl=False)
    for point in draft.open_points:
        click.echo(point, err=True)
    for finding in find(draft.settings):
        click.echo(f"  {finding.subject:16} {finding.text}", err=True)
    click.echo("ok", err=True)


@click.command()
@common.config_argument
@click.argument("recording", type=click.Path(path_type=Path, exists=True, dir_okay=False))
def identify(config: str, recording: Path) -> None:
    """Fit masses, armature and joint frictions, with standard errors, to a RECORDING of `wbc run --record`."""
    from wbc_controller.recording.identification import identify as fit
    from wbc_controller.recording.identification import report

    with common.naming_file(config):
        click.echo(report(*fit(common.load_named(config), recording)), nl=False)


@click.command("security-policy")
@common.config_argument
@click.option("--urdf", type=click.Path(path_type=Path, exists=True, dir_okay=False),
              help="URDF, if the configuration does not name one.")  # fmt: skip
@common.namespace_option
@common.remap_option
def security_policy(config: str, urdf: Path | None, namespace: str, remappings: Mapping[str, str]) -> None:
    """Print an SROS 2 policy with least privilege for every node."""
    from wbc_controller.controller.build.robot import make_model
    from wbc_controller.controller.build.robot_description import read_urdf
    from wbc_controller.nodes.ros2.security_policy import security_policy as policy_of

    settings = common.load_named(config)
    with common.naming_file(config):
        model = make_model(settings, read_urdf(str(urdf)) if urdf is not None else None)
    click.echo(policy_of(settings, model, namespace, remappings), nl=False)
