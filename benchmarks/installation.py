"""Installs a wheel in an empty virtual environment, without and with each extra: tries it, measures sizes and times.

::

    make install-test                                       # builds the wheel first
    python benchmarks/installation.py dist/*.whl robots     # without extras, then with the extra `robots` alone

The environment is outside of the repository. After an extra has been tried, its packages are removed again. The exit
status is 1 if a command failed. Times depend on the load of the machine; seconds of processor time hardly do.
"""

import argparse
import email
import json
import os
import resource
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import textwrap
import time
import zipfile
from pathlib import Path

HEADING = "| Command | Time | Processor time |\n|---|---|---|"
TEST = Path(__file__).resolve().parent.parent / "test/test_public_names.py"
#: A link with a box of a mass, and a joint of a leg.
LINK = """<link name="{0}"><inertial><origin xyz="{1}"/><mass value="{2}"/><inertia ixx="{3}" ixy="0" ixz="0" iyy="{3}"
  iyz="0" izz="{3}"/></inertial><collision><origin xyz="{1}"/><geometry>{4}</geometry></collision></link>"""
JOINT = """<joint name="{0}" type="{1}"><parent link="{2}"/><child link="{3}"/><origin xyz="{4}"/><axis xyz="{5}"/>
  <limit lower="-2.5" upper="2.5" effort="60" velocity="15"/></joint>"""
#: Processes that must start, print a text, and end by Ctrl-C; the other commands must end with status 0.
SERVING = {
    "wbc run robot.yaml --verbose": "waiting for 'activate'",
    "wbc view robot.yaml --port 0": "page: http://localhost",
    "wbc_controller --ros-args --params-file robot.yaml": "the node is active",
}
#: The extras that are installed for a trial, and its commands. `python` is that of the environment.
TRIALS = {
    "dds": ("dds", ["wbc run robot.yaml --verbose"]),
    "robots": ("robots", ["wbc check g1"]),
    "mock": ("mock", ["python simulate.py"]),
    "plots": ("plots", ["python plot.py"]),
    "campaign": ("campaign,mock,robots", ["wbc faults go2 --kinds kick --seeds 1 --jobs 1"]),
    "fuzz": ("fuzz,mock,robots", ["wbc fuzz configurations go2 --count 20"]),
    "view": ("view", ["wbc view robot.yaml --port 0"]),
    "ros2": ("ros2", ["wbc_controller --ros-args --params-file robot.yaml"]),
    "ros2-kilted": ("ros2-kilted", ["wbc_controller --ros-args --params-file robot.yaml"]),
    "test": ("test,mock", [f"python -m pytest -q -p no:cacheprovider {TEST}"]),
    "demo": ("demo", ["wbc demo g1 --lockstep", "wbc report report/g1.mcap"]),
}
FILES = {
    # From the start of Python to the torques of a cycle.
    "torque.py": """
import wbc_controller as wbc
controller = wbc.Controller(wbc.load("robot.yaml"))
q, v = controller.stance(), [0.0] * controller.model.nv
controller.reset(q, v, t=0.0)
assert controller.step(q, v, t=0.002).tau.shape == (12,)
""",
    "simulate.py": """
import wbc_controller as wbc
robot = wbc.Simulation("robot.yaml")
robot.run(0.5)
assert robot.controller.mode is wbc.Mode.ACTIVE
""",
    "plot.py": """
import wbc_controller as wbc
controller = wbc.Controller(wbc.load("robot.yaml"))
q, v = controller.stance(), [0.0] * controller.model.nv
controller.reset(q, v, t=0.0)
wbc.plot([controller.step(q, v, t=0.002)]).write_html("plot.html")
""",
    # Names of the installed distributions, with the bytes of their files.
    "sizes.py": """
import importlib.metadata, json
def size(distribution):
    paths = {file.locate().resolve() for file in distribution.files or ()}
    return sum(path.stat().st_size for path in paths if path.is_file())
print(json.dumps({each.metadata["Name"]: size(each) for each in importlib.metadata.distributions()}))
""",
}


def quadruped() -> str:
    """Return the URDF of a quadruped with twelve joints and ball feet, from primitive shapes."""
    parts = [LINK.format("base", "0 0 0", 8.0, 0.1, '<box size="0.4 0.2 0.1"/>')]
    for leg, x, y in (("lf", 0.2, 0.1), ("rf", 0.2, -0.1), ("lh", -0.2, 0.1), ("rh", -0.2, -0.1)):
        parts += [
            LINK.format(f"{leg}_hip", "0 0 0", 0.5, 0.001, '<sphere radius="0.03"/>'),
            JOINT.format(f"{leg}_roll", "revolute", "base", f"{leg}_hip", f"{x} {y} 0", "1 0 0"),
            LINK.format(f"{leg}_thigh", "0 0 -0.1", 1.0, 0.005, '<box size="0.03 0.03 0.16"/>'),
            JOINT.format(f"{leg}_pitch", "revolute", f"{leg}_hip", f"{leg}_thigh", "0 0 0", "0 1 0"),
            LINK.format(f"{leg}_shank", "0 0 -0.1", 0.3, 0.002, '<box size="0.02 0.02 0.16"/>'),
            JOINT.format(f"{leg}_knee", "revolute", f"{leg}_thigh", f"{leg}_shank", "0 0 -0.2", "0 1 0"),
            LINK.format(f"{leg}_foot", "0 0 0", 0.05, 0.0001, '<sphere radius="0.02"/>'),
            JOINT.format(f"{leg}_ankle", "fixed", f"{leg}_shank", f"{leg}_foot", "0 0 -0.2", "0 0 1"),
        ]
    return '<robot name="quadruped">' + "\n".join(parts) + "</robot>\n"


class Environment:
    """An empty virtual environment with a working folder, and the result of each command."""

    def __init__(self, folder: Path, wheel: Path) -> None:
        """Make the environment."""
        self.wheel, self.folder, self.bin = wheel, folder, folder / "venv/bin"
        self.failed: list[str] = []
        subprocess.run([sys.executable, "-m", "venv", folder / "venv"], check=True)  # noqa: S603
        (self.site,) = (folder / "venv/lib").glob("python3*/site-packages")
        self.variables = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "AMENT"))}
        self.variables |= {
            "XDG_STATE_HOME": str(folder),
            "ROS_DOMAIN_ID": "77",
            "PATH": f"{self.bin}{os.pathsep}{os.environ['PATH']}",
        }
        for name, text in FILES.items():
            (folder / name).write_text(text, encoding="utf-8")
        (folder / "robot.urdf").write_text(quadruped(), encoding="utf-8")

    def start(self, command: str) -> subprocess.Popen[bytes]:
        """Start a program of the environment; its outputs go to the files `stdout` and `stderr` of the folder."""
        program, *words = shlex.split(command)
        with (self.folder / "stdout").open("w") as stdout, (self.folder / "stderr").open("w") as stderr:
            return subprocess.Popen(  # noqa: S603 - the commands of this file
                [str(self.bin / program), *words], cwd=self.folder, env=self.variables, stdout=stdout, stderr=stderr
            )

    def output(self) -> str:
        """Return both outputs of the last command."""
        return "".join((self.folder / name).read_text(encoding="utf-8") for name in ("stdout", "stderr"))

    def run(self, command: str, status: int = 0) -> None:
        """Run a command and print its time; another exit status counts as a failure."""
        before, started = processor_time(), time.monotonic()
        found = self.start(command).wait()
        short = textwrap.shorten(command.replace(str(self.wheel), self.wheel.name), 100, placeholder=" …")
        print(f"| `{short}` | {time.monotonic() - started:.1f} s | {processor_time() - before:.1f} s |", flush=True)
        if found != status:
            self.fail(f"{short}: status {found} in place of {status}: {self.output()[-4000:]}")

    def serve(self, command: str, text: str, patience: float = 60.0) -> None:
        """Run a command until it prints a text, and end it by Ctrl-C."""
        started = time.monotonic()
        process = self.start(command)
        while text not in self.output() and process.poll() is None and time.monotonic() - started < patience:
            time.sleep(0.1)
        seconds = time.monotonic() - started
        process.send_signal(signal.SIGINT)
        try:
            status: int | None = process.wait(30.0)
        except subprocess.TimeoutExpired:
            process.kill()
            status = None
        print(f"| `{command}` until it prints {text!r} | {seconds:.1f} s | |", flush=True)
        if text not in self.output() or status != 0:
            self.fail(f"{command}: status {status}, or no {text!r} in: {self.output()[-4000:]}")

    def fail(self, sentence: str) -> None:
        """Print a failure and keep it for the exit status."""
        print(f"\nFAILED: {sentence}\n", flush=True)
        self.failed.append(sentence)

    def install(self, extras: str = "") -> None:
        """Install the wheel with some extras."""
        self.run(f"pip install '{self.wheel}{extras and f'[{extras}]'}'")

    def sizes(self) -> dict[str, float]:
        """Return the size of each installed package, MB."""
        self.start("python sizes.py").wait()
        return {name: size / 1e6 for name, size in json.loads(self.output()).items()}


def processor_time() -> float:
    """Return the processor time of all processes that have ended, s."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def size_of(folder: Path) -> float:
    """Return the size of all files below a folder, MB."""
    return sum(path.lstat().st_size for path in folder.rglob("*") if path.is_file()) / 1e6


def try_without_extras(environment: Environment) -> None:
    """Install the wheel alone; make a configuration from a URDF, check it, and compute torques."""
    print("\n## Without extras\n\n" + HEADING)
    environment.install()
    total = size_of(environment.folder / "venv")
    # `wbc new` compiles the kernels: it and the first torques are the time from the installation to the first torque.
    started = time.monotonic()
    environment.run("wbc new robot.urdf")
    shutil.copy(environment.folder / "stdout", environment.folder / "robot.yaml")
    environment.run("python torque.py")
    first = time.monotonic() - started
    for _ in range(3):
        environment.run("python torque.py")
    environment.run("wbc check robot.yaml")
    environment.run("wbc demo g1 --lockstep", status=2)
    sizes = environment.sizes()
    headers = environment.site / "cmeel.prefix/include"
    print(f"\nFrom the end of the installation to the first torque: {first:.1f} s.")
    print(f"Size: {total:.0f} MB, of which {size_of(headers):.0f} MB are C++ headers.\n")
    print("| Package | MB |\n|---|---|")
    for name, size in sorted(sizes.items(), key=lambda item: -item[1])[:12]:
        print(f"| {name} | {size:.0f} |")


def try_extra(environment: Environment, name: str) -> None:
    """Install an extra, run its commands, and remove its packages again."""
    extras, commands = TRIALS[name]
    before = environment.sizes()
    print(f"\n## Extra `{name}`" + f", installed as [{extras}]" * (extras != name) + f"\n\n{HEADING}")
    environment.install(extras)
    added = {package: size for package, size in environment.sizes().items() if package not in before}
    for command in commands:
        if command in SERVING:
            environment.serve(command, SERVING[command])
        else:
            environment.run(command)
    if added:
        environment.run(f"pip uninstall -y {' '.join(added)}")
    print(f"\nSize of {len(added)} packages: {sum(added.values()):.0f} MB.")


def try_without_headers(environment: Environment) -> None:
    """Remove the files of C++ compilers, and compute torques again."""
    print("\n## Without extras, C++ headers and static libraries\n\n" + HEADING)
    prefix = environment.site / "cmeel.prefix"
    shutil.rmtree(prefix / "include")
    for path in prefix.rglob("*.a"):
        path.unlink()
    environment.run("python torque.py")
    print(f"\nSize: {size_of(environment.folder / 'venv'):.0f} MB.")


def main() -> int:
    """Try the wheel without extras, then with each extra."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("wheel", type=Path)
    parser.add_argument("extras", nargs="*", metavar="extra", help="all by default; none: no extra")
    options = parser.parse_args()
    with zipfile.ZipFile(options.wheel) as file:
        (path,) = (name for name in file.namelist() if name.endswith(".dist-info/METADATA"))
        extras = email.message_from_bytes(file.read(path)).get_all("Provides-Extra", [])
    if untried := set(extras) ^ TRIALS.keys():
        sys.exit(f"extras of the wheel and of TRIALS differ: {', '.join(sorted(untried))}")
    if unknown := set(options.extras) - TRIALS.keys() - {"none"}:
        sys.exit(f"unknown extras {sorted(unknown)}; valid: none, {', '.join(TRIALS)}")
    version = ".".join(map(str, sys.version_info[:3]))
    print(f"{options.wheel.name}, Python {version}, {os.cpu_count()} processors, load {os.getloadavg()[0]:.1f}")
    with tempfile.TemporaryDirectory(prefix="wbc_installation_") as folder:
        environment = Environment(Path(folder), options.wheel.resolve())
        try_without_extras(environment)
        for name in [name for name in options.extras if name in TRIALS] if options.extras else TRIALS:
            try_extra(environment, name)
        try_without_headers(environment)
    print(f"\nload {os.getloadavg()[0]:.1f}; {len(environment.failed)} commands failed")
    return int(bool(environment.failed))


if __name__ == "__main__":
    sys.exit(main())
