"""docs/python.md: snippets, names and numbers."""

import re

from pages import ROOT, page

import wbc_controller as wbc

PAGE = page("python")
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


def test_names_length_and_attributes():
    mentioned = set(re.findall(r"\bwbc\.(\w+)", PAGE)) - {"__all__"}
    assert mentioned <= set(wbc.__all__)
    assert {"Controller", "Simulation", "MujocoInterface", "load", "check", "plot"} <= mentioned
    (said,) = re.findall(r"a complete loop in (\d+) lines", PAGE)
    assert len((ROOT / "examples" / "mujoco_loop.py").read_text(encoding="utf-8").splitlines()) == int(said) <= 25
    table = PAGE[PAGE.index("| `result.`") : PAGE.index("A result prints itself")]
    cells = "\n".join(row.split("|")[1] for row in table.splitlines()[2:] if "|" in row)
    names = re.findall(r"`(\w+)(?:\(\))?`", cells)
    assert len(names) >= 15
    assert all(hasattr(wbc.CycleResult, name) for name in names)
