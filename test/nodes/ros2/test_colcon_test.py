"""`colcon test` in a sourced workspace: the documented dependencies, and the pytest plugins of ROS 2."""

import os
import re
import subprocess
import sys

from pages import PROJECT, ROOT, page

#: Entry points of launch_testing and launch_testing_ros.
PLUGINS = "launch_testing", "launch_ros"


def name(requirement):
    return re.match(r"[\w-]+", requirement).group()


def test_the_documented_installation_contains_all_libraries_of_package_and_tests():
    """Besides those of requirements/ros.txt, which test_package_xml.py compares with the dependencies."""
    extras = PROJECT["optional-dependencies"]
    needed = [*extras["robots"], extras["mock"][0], *extras["test"]]
    section = page("ros2").split("## Install on an installation of ROS")[1]
    commands = re.search(r"```bash\n(.*?)```", section, re.DOTALL).group(1)
    assert "-r src/wbc_controller/requirements/ros.txt" in commands
    assert {name(each) for each in needed} == {name(each) for each in re.findall(r"'(.*?)'", commands)}


def test_the_plugins_of_a_sourced_ros_2_are_not_loaded(tmp_path):
    """They import each test file under its bare name, so that equal file names end the collection."""
    (tmp_path / "plugin_of_a_test.py").write_text("raise RuntimeError('the plugin is loaded')\n", encoding="utf-8")
    distribution = tmp_path / "plugin_of_a_test-1.dist-info"
    distribution.mkdir()
    (distribution / "METADATA").write_text("Metadata-Version: 2.1\nName: plugin-of-a-test\nVersion: 1\n")
    plugins = "".join(f"{plugin} = plugin_of_a_test\n" for plugin in PLUGINS)
    (distribution / "entry_points.txt").write_text(f"[pytest11]\n{plugins}")
    paths = f"{tmp_path}{os.pathsep}{os.environ.get('PYTHONPATH', '')}"
    words = [sys.executable, "-m", "pytest", "--collect-only", "-q", "--noconftest", "-p", "no:cacheprovider"]
    words += ["test/test_layering.py"]
    done = subprocess.run(words, cwd=ROOT, env=os.environ | {"PYTHONPATH": paths}, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
