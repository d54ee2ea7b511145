"""Examples run, meet their targets, and import public names only."""

import ast
import re
import runpy
import sys

import nbformat
import pytest
from nbclient import NotebookClient
from pages import ROOT

EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
NOTEBOOKS = sorted((ROOT / "examples").glob("*.ipynb"))


def test_there_are_examples():
    assert len(EXAMPLES) >= 13
    assert NOTEBOOKS


@pytest.mark.parametrize("script", EXAMPLES, ids=lambda script: script.stem)
def test_the_example_meets_its_targets(script, capsys, monkeypatch):
    monkeypatch.setattr(sys, "argv", [str(script)])
    status = None
    try:
        runpy.run_path(str(script), run_name="__main__")
    except SystemExit as ended:
        status = ended.code
    assert not status, capsys.readouterr()
    if script.stem == "mujoco_loop":
        heights = re.findall(r"asked (\S+) mm, centre of mass at (\S+) mm", capsys.readouterr().out)
        assert [float(asked) for asked, _ in heights] == [0.0, -100.0, 0.0]
        assert all(abs(float(asked) - float(reached)) < 1.0 for asked, reached in heights)


def sources():
    for script in EXAMPLES:
        yield pytest.param(script.read_text(encoding="utf-8"), id=script.stem)
    for path in NOTEBOOKS:
        cells = nbformat.read(path, as_version=4).cells
        yield pytest.param("\n".join(cell.source for cell in cells if cell.cell_type == "code"), id=path.stem)


@pytest.mark.parametrize("source", list(sources()))
def test_examples_import_public_names_only(source):
    found = [
        (alias.name, alias.asname) if isinstance(node, ast.Import) else (node.module, alias.name)
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.Import | ast.ImportFrom)
        for alias in node.names
    ]
    assert [each for each in found if str(each[0]).split(".")[0] == "wbc_controller"] == [("wbc_controller", "wbc")]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_the_notebook_runs_and_shows_tables_and_plots(path):
    notebook = nbformat.read(path, as_version=4)
    assert not any(cell.get("outputs") for cell in notebook.cells), "committed without outputs"
    NotebookClient(notebook, timeout=120, resources={"metadata": {"path": str(path.parent)}}).execute()
    shown = [output for cell in notebook.cells for output in cell.get("outputs", ())]
    kinds = [kind for output in shown for kind in output.get("data", {})]
    assert kinds.count("application/vnd.plotly.v1+json") == 3
    assert "<table>" in "".join(output.get("data", {}).get("text/html", "") for output in shown)
    assert "fallen: False, False" in "".join(output.get("text", "") for output in shown)
