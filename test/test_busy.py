"""Live tests on a busy computer: deadline failures are repeated, faults are reported."""

import subprocess
import sys

import pytest
from pages import ROOT

TESTS = """
import pytest

COUNTS = {{}}

@pytest.fixture
def attempt(request):
    COUNTS[request.node.name] = COUNTS.get(request.node.name, 0) + 1
    return COUNTS[request.node.name]

@pytest.mark.live
@pytest.mark.parametrize("succeeds", [1, 2, 9])
def test_live(attempt, succeeds):
    assert attempt >= succeeds, f"attempt {{attempt}}"

@pytest.mark.browser
def test_browser(attempt):
    assert attempt >= 2

def test_attempts():
    assert list(COUNTS.values()) == {attempts}
"""


@pytest.mark.parametrize(
    ("slowness", "attempts", "outcome"),
    [(9.0, [1, 2, 3, 1], "2 failed, 3 passed, 3 warnings"), (1.0, [1, 1, 1, 1], "3 failed, 2 passed")],
)
def test_only_live_tests_are_repeated_and_only_on_a_busy_computer(tmp_path, slowness, attempts, outcome):
    """A fault fails every time."""
    hook = f"import busy\nbusy.slowness = lambda: {slowness}\nfrom busy import pytest_runtest_protocol\n"
    (tmp_path / "conftest.py").write_text(hook)
    (tmp_path / "test_once.py").write_text(TESTS.format(attempts=attempts))
    words = [sys.executable, "-m", "pytest", "-q", "-c", str(ROOT / "pyproject.toml"), "--rootdir", str(tmp_path), "."]
    done = subprocess.run([*words, "-p", "no:cacheprovider"], cwd=tmp_path, capture_output=True, text=True)
    assert f"\n{outcome} in " in done.stdout, done.stdout
    repeated = "test_live[2] failed at a load average of" in done.stdout
    assert repeated is (slowness > 2.0)
    assert ("and is repeated: AssertionError: attempt 1" in done.stdout) is repeated
