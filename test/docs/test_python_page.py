"""docs/python.md: its snippets run, in order, and what it says of examples and names is so."""

from __future__ import annotations

import re
from pathlib import Path

import wbc_controller as wbc

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "python.md").read_text(encoding="utf-8")
SNIPPETS = re.findall(r"^```python\n(.*?)^```$", PAGE, flags=re.MULTILINE | re.DOTALL)


def test_the_snippets_run_in_order(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    for number, snippet in enumerate(SNIPPETS, 1):
        exec(compile(snippet, f"docs/python.md, snippet {number}", "exec"), names)  # noqa: S102  # the page's own
    said = capsys.readouterr().out
    assert "active at 0.002 s" in said
    assert "tasks.com.wieght: unknown key; did you mean 'weight'?" in said
    assert (tmp_path / "run.html").stat().st_size > 100_000
    assert len(SNIPPETS) >= 8


def test_every_name_that_it_mentions_is_public():
    mentioned = set(re.findall(r"\bwbc\.(\w+)", PAGE)) - {"__all__"}
    assert mentioned <= set(wbc.__all__)
    assert {"Controller", "Simulation", "MujocoInterface", "load", "check", "plot"} <= mentioned


def test_the_loop_is_as_short_as_it_says():
    lines = (ROOT / "examples" / "mujoco_loop.py").read_text(encoding="utf-8").splitlines()
    (said,) = re.findall(r"a whole one in (\d+) lines", PAGE)
    assert len(lines) == int(said) <= 25


def test_every_attribute_in_the_table_of_results_exists():
    table = PAGE[PAGE.index("| `result.`") : PAGE.index("A result prints itself")]
    names = re.findall(
        r"`(\w+)(?:\(\))?`", "\n".join(row.split("|")[1] for row in table.splitlines()[2:] if "|" in row)
    )
    assert len(names) >= 15
    assert all(hasattr(wbc.CycleResult, name) for name in names)
