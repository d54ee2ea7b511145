"""Commands of `wbc` in this process."""

from click.testing import CliRunner, Result

from wbc_controller.cli import main


def wbc(*words: object, status: int = 0) -> Result:
    """Run a command, and check its exit status."""
    result = CliRunner().invoke(main, [str(word) for word in words])
    assert result.exit_code == status, (result.exception, result.output)
    return result
