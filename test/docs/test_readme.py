"""README.md and the pages of its lists: sizes, the Python code, all commands, examples, equations and named files."""

import re

import numpy as np
import pytest
from pages import ROOT, page

from wbc_controller.cli import COMMANDS

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
    commands, examples, equations = page("commands"), page("examples"), page("equations")
    assert [name for name in COMMANDS if f"`wbc {name}`" not in commands] == []
    scripts = [path.name for path in (ROOT / "examples").iterdir() if path.suffix in (".py", ".ipynb")]
    assert [name for name in scripts if f"(../examples/{name})" not in examples] == []
    assert re.findall(r"^## (S\d+):", equations, re.MULTILINE) == [f"S{number}" for number in range(1, 13)]
    named = re.findall(r"\]\(\.\./([^)]+)\) \(`(\w+)`\)", equations)
    assert len(named) >= 2
    assert [name for path, name in named if f"def {name}(" not in (ROOT / path).read_text(encoding="utf-8")] == []


def test_modules_named_by_the_architecture_page_exist():
    """`nodes/loop` is a file or folder of the package."""
    rooms = "nodes|controller|middleware|inverse_dynamics|simulation|recording|safety"
    named = re.findall(rf"`((?:{rooms})/[\w/.]+)`", page("architecture"))
    assert len(named) > 12
    package = ROOT / "wbc_controller"
    assert [name for name in named if not any((package / f"{name}{end}").exists() for end in ("", ".py"))] == []
