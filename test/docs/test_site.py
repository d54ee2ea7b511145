"""The documentation site: the strict build succeeds, fails on each kind of error, and is self-contained."""

import re
import shutil
import subprocess
import sys

import pytest
from pages import ROOT

for package in ("material", "math_core"):
    pytest.importorskip(package, reason=f"make site needs '{package}' of requirements/dev.txt")


def build(config, folder):
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--config-file", config, "--site-dir", folder]
    output = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
    return subprocess.run(command, check=False, timeout=120, **output)


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    folder = tmp_path_factory.mktemp("site")
    done = build(ROOT / "mkdocs.yml", folder)
    assert done.returncode == 0, done.stdout
    return folder


def test_pages_are_self_contained_and_found(site):
    pages = list(site.glob("*.html"))
    assert len(pages) > 25
    for page in pages:
        text = page.read_text(encoding="utf-8")
        loaded = re.findall(r"<(?:script|link|img|iframe)\b[^>]*?(?:src|href)=\"?([^\s\">]+)", text)
        assert [address for address in loaded if re.match(r"(?:https?:)?//", address)] == [], page.name
    styles = "".join(style.read_text(encoding="utf-8") for style in site.rglob("*.css"))
    assert re.findall(r"url\([\"']?(?:https?:)?//", styles) == []
    page = (site / "equations.html").read_text(encoding="utf-8")
    assert page.count("<math") >= 12
    assert "arithmatex" not in page
    links = set(re.findall(r'href="(source/[^"]+)"', page))
    assert len(links) > 20
    assert all((site / link).is_file() for link in links)
    index = (site / "search" / "search_index.js").read_text(encoding="utf-8")
    assert '"location":"equations.html#s8-gausss-principle"' in index
    assert "readme.html" not in index


@pytest.fixture(scope="module")
def broken_build(tmp_path_factory):
    folder = tmp_path_factory.mktemp("broken")
    shutil.copytree(ROOT / "docs", folder / "docs", ignore=shutil.ignore_patterns("__pycache__"))
    hooks = ROOT / "docs" / "site_hooks.py"
    config = f"INHERIT: {ROOT / 'mkdocs.yml'}\ndocs_dir: {folder / 'docs'}\nhooks: [{hooks}]\n"
    (folder / "mkdocs.yml").write_text(config, encoding="utf-8")
    with (folder / "docs" / "limits.md").open("a", encoding="utf-8") as page:
        page.write("\n[page](nothing.md) [anchor](tasks.md#nothing) [file](../nothing.py)\n\n$$\\nothing$$\n")
    (folder / "docs" / "outside.md").write_text("# A page outside the navigation\n", encoding="utf-8")
    return build(folder / "mkdocs.yml", folder / "site")


@pytest.mark.parametrize(
    "warning",
    [
        "contains a link 'nothing.md', but the target is not found",
        "does not contain an anchor '#nothing'",
        "contains a link '../nothing.py', but the target is not found",
        "contains an invalid equation",
        'not included in the "nav" configuration:\n  - outside.md',
    ],
)
def test_an_error_fails_the_build(broken_build, warning):
    assert broken_build.returncode == 1
    assert warning in broken_build.stdout
    assert "Aborted with 5 warnings in strict mode" in broken_build.stdout
