"""README.md and the pages of its lists: sizes, the Python code, all commands, examples and equations."""

import re
from pathlib import Path

import numpy as np
import pytest

from wbc_controller.cli import COMMANDS

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")


@pytest.mark.parametrize(("name", "most"), [("README.md", 90), ("CHANGELOG.md", 45)])
def test_the_file_is_short(name, most):
    assert len((ROOT / name).read_text(encoding="utf-8").splitlines()) <= most


def test_the_python_code_runs(capsys):
    code = README.split("```python\n")[1].split("```")[0]
    names = {}
    exec(compile(code, "README.md", "exec"), names)  # noqa: S102 - the README's own code
    assert np.isfinite(names["result"].tau).all()
    assert "com" in capsys.readouterr().out
    assert len(code.splitlines()) <= 10


def test_pages_list_all_commands_examples_and_equations():
    page = (ROOT / "docs" / "commands.md").read_text(encoding="utf-8")
    assert [name for name in COMMANDS if f"`wbc {name}`" not in page] == []
    page = (ROOT / "docs" / "examples.md").read_text(encoding="utf-8")
    scripts = [path.name for path in (ROOT / "examples").iterdir() if path.suffix in (".py", ".ipynb")]
    assert [name for name in scripts if f"(../examples/{name})" not in page] == []
    page = (ROOT / "docs" / "equations.md").read_text(encoding="utf-8")
    assert re.findall(r"^## (S\d+):", page, re.MULTILINE) == [f"S{number}" for number in range(1, 13)]
    named = re.findall(r"\]\(\.\./([^)]+)\) \(`(\w+)`\)", page)
    assert len(named) >= 2
    assert [name for path, name in named if f"def {name}(" not in (ROOT / path).read_text(encoding="utf-8")] == []
