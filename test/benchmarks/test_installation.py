"""A wheel of the checkout, installed beside the libraries of the tests: `make install-test` installs them anew."""

import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from installation import FILES, TRIALS, quadruped
from pages import PROJECT, ROOT

import wbc_controller

#: Kernels as Python functions: compiling them takes longer.
VARIABLES = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"} | {"NUMBA_DISABLE_JIT": "1"}
#: Files and folders of the checkout of which the wheel is made.
PARTS = ("wbc_controller", "config", "launch", "layouts", "resource", "LICENSE", "README.md", "package.xml",
         "pyproject.toml", "setup.cfg", "setup.py")  # fmt: skip


def run(*words, folder=None):
    words = [str(word) for word in words]
    done = subprocess.run(words, cwd=folder, env=VARIABLES, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """A wheel built from a copy: setuptools leaves files in its folder."""
    folder = tmp_path_factory.mktemp("source")
    for part in PARTS:
        if (ROOT / part).is_dir():
            shutil.copytree(ROOT / part, folder / part, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy(ROOT / part, folder)
    run(sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "--no-build-isolation", "-w", folder / "dist", folder)
    (path,) = (folder / "dist").glob("*.whl")
    return path


def test_the_wheel_contains_the_package_and_the_files_of_ament(wheel):
    name = f"wbc_controller-{wbc_controller.__version__}"
    share = f"{name}.data/data/share"
    with zipfile.ZipFile(wheel) as file:
        found = set(file.namelist())
        entry_points = file.read(f"{name}.dist-info/entry_points.txt").decode()
    sources = [path for path in (ROOT / "wbc_controller").rglob("*") if path.is_file()]
    data = [path for folder in ("config", "launch", "layouts") for path in (ROOT / folder).rglob("*.*")]
    expected = {path.relative_to(ROOT).as_posix() for path in sources if "__pycache__" not in path.parts}
    expected |= {f"{share}/wbc_controller/{path.relative_to(ROOT)}" for path in data if "__pycache__" not in path.parts}
    expected |= {f"{share}/wbc_controller/package.xml", f"{share}/ament_index/resource_index/packages/wbc_controller"}
    assert {each for each in found if ".dist-info/" not in each} == expected
    for script in ("wbc", "wbc_controller", "mock_robot", "guard", "base_estimator"):
        assert f"\n{script} = wbc_controller." in entry_points


def test_the_installed_wheel_drafts_a_configuration_and_computes_torques(wheel, tmp_path):
    python, wbc = tmp_path / "venv/bin/python", tmp_path / "venv/bin/wbc"
    run(sys.executable, "-m", "venv", "--without-pip", tmp_path / "venv")
    run(sys.executable, "-m", "pip", "--python", python, "install", "-q", "--no-deps", "--no-index", wheel)
    # The libraries, without the .pth files beside them: one of these may lead to the checkout.
    libraries = [path for path in sys.path if path.endswith(("site-packages", "dist-packages"))]
    (site,) = tmp_path.glob("venv/lib/python3*/site-packages")
    (site / "libraries.pth").write_text("\n".join(libraries), encoding="utf-8")
    (tmp_path / "robot.urdf").write_text(quadruped(), encoding="utf-8")
    (tmp_path / "torque.py").write_text(FILES["torque.py"], encoding="utf-8")
    assert run(wbc, "--version", folder=tmp_path) == f"wbc, version {wbc_controller.__version__}\n"
    (tmp_path / "robot.yaml").write_text(run(wbc, "new", "robot.urdf", folder=tmp_path), encoding="utf-8")
    # The configurations are in the wheel.
    script = "import runpy, wbc_controller as wbc; wbc.load('go2'); runpy.run_path('torque.py'); print(wbc.__file__)"
    assert Path(run(python, "-c", script, folder=tmp_path).splitlines()[-1]).is_relative_to(tmp_path)


def test_every_extra_has_a_trial_and_is_named_by_the_error_messages():
    assert TRIALS.keys() == PROJECT["optional-dependencies"].keys()
    from wbc_controller.extras import EXTRAS

    for library, extra in EXTRAS.items():
        requirements = PROJECT["optional-dependencies"][extra]
        names = [requirement.replace("-", "_").partition(">")[0] for requirement in requirements]
        assert any(name.startswith(library) for name in names), f"{library} is not in [{extra}]"
