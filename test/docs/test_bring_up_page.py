"""What docs/bring-up.md shows of `wbc check` is what it prints, for its configurations and for each of its mistakes."""

import re

import pytest
from command_line import wbc
from pages import files, page

PAGE = page("bring-up")
FILES = files(PAGE)
SHOWN = re.findall(r"```console\n\$ wbc check (\w+\.yaml)\n(.*?)```", PAGE, re.DOTALL)
MISTAKES = re.findall(r"^\| `([^`]+)` \| `([^`]+)` \| `([^`]+)` \|$", PAGE, re.MULTILINE)


def check(tmp_path, monkeypatch, name, text, status=0):
    monkeypatch.chdir(tmp_path)
    (tmp_path / name).write_text(text, encoding="utf-8")
    return wbc("check", name, status=status)


def test_the_page_was_read():
    assert set(FILES) == {"anymal.yaml", "stand.yaml"}
    assert [name for name, _ in SHOWN] == ["anymal.yaml", "stand.yaml"]
    assert len(MISTAKES) == 11


@pytest.mark.parametrize(("name", "printed"), SHOWN, ids=[name for name, _ in SHOWN])
def test_what_is_printed(tmp_path, monkeypatch, name, printed):
    assert check(tmp_path, monkeypatch, name, FILES[name]).stdout == printed


@pytest.mark.parametrize(("instead", "written", "said"), MISTAKES, ids=[written for _, written, _ in MISTAKES])
def test_what_a_mistake_looks_like(tmp_path, monkeypatch, instead, written, said):
    text = FILES["anymal.yaml"]
    assert instead in text
    result = check(tmp_path, monkeypatch, "anymal.yaml", text.replace(instead, written), status=2)
    start, *rest = said.split("…")
    assert result.stderr.startswith(f"error: anymal.yaml: {start}")
    for part in rest:
        assert part in result.stderr
