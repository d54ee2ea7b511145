"""Robot and controller on two hosts; the network is cut for 5 s."""

import json
import os
import re
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from network import network
from waiting import until

from wbc_controller.settings.config import load

__all__ = ["network"]

pytestmark = pytest.mark.live

#: Tolerant limits: only the network is tested.
CHANGES = {
    "control": {"rate": 200.0},
    "safety": {"state_timeout": 0.3, "damping_time": 1.0, "activation_ramp": 0.3},
    "guard": {"patience": 0.2, "damping": 0.3},  # a late guard must not shake the legs
    "mock": {"command_timeout": 10.0},  # only the guard damps
}
SUPPORT = Path(__file__).resolve().parent.parent / "support"
CUT = 5.0


class Host:
    """Processes on one host, and messages of an observer there."""

    def __init__(self, network, side, folder, robot):
        self._network, self._side, self._folder, self._robot = network, side, folder, robot
        self._started = []
        self._heard = []  # messages of the observer

    def start(self, *words):
        environment = os.environ | {"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET", "ROS_DOMAIN_ID": "7"}
        with (self._folder / f"{self._side}-{len(self._started)}.log").open("wb") as log:
            process = subprocess.Popen(
                self._network.words(self._side, sys.executable, *words), env=environment,
                stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=log, text=True,
            )  # fmt: skip
        self._started.append(process)
        return process

    def observe(self):
        self._observer = self.start(str(SUPPORT / "observer.py"), self._robot)
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self):
        for line in self._observer.stdout:
            self._heard.append(json.loads(line))

    def command(self, word):
        self._observer.stdin.write(word + "\n")
        self._observer.stdin.flush()

    def since(self, at, kind):
        return [said for said in list(self._heard) if said["kind"] == kind and said["at"] >= at]

    def says(self, kind, start):
        found = self.since(0.0, kind)
        return bool(found) and found[-1]["text"].startswith(start)

    def running(self):
        return all(process.poll() is None for process in self._started)

    def stop(self):
        for process in self._started:
            process.terminate()  # a background job would ignore SIGINT
        for process in self._started:
            try:
                process.wait(10)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


@pytest.fixture
def hosts(network, tmp_path):
    """Mock robot and guard on one host, the controller on the other; an observer on each."""
    path = str(tmp_path / "robot.yaml")
    Path(path).write_text(load("go2").replace(CHANGES).to_yaml(), encoding="utf-8")
    robot, controller = Host(network, "robot", tmp_path, path), Host(network, "controller", tmp_path, path)
    robot.start("-m", "wbc_controller", "mock", path)
    robot.start("-m", "wbc_controller", "guard", path)
    controller.start("-m", "wbc_controller", "run", path)
    robot.observe()
    controller.observe()
    yield robot, controller
    robot.stop()
    controller.stop()
    for path in sorted(tmp_path.glob("*.log")):
        print(f"--- {path.name}\n{path.read_text()}")  # shown after a failure


def test_a_cut_of_five_seconds_is_survived_on_both_sides(network, hosts):
    robot, controller = hosts
    until(lambda: controller.since(0.0, "robot"), "the robot's states to cross")
    until(lambda: controller.says("controller", "active"), "activation", again=lambda: controller.command("activate"))
    until(lambda: robot.says("guard", "watching"), "the guard to watch")
    time.sleep(0.5)  # until the torques have ramped in
    assert robot.since(0.0, "robot")[-1]["largest"] > 0.5

    network.cut()
    cut = time.monotonic()
    until(lambda: controller.since(cut, "controller"), "the controller to notice")
    until(lambda: robot.since(cut, "guard"), "the guard to notice")
    noticed = controller.since(cut, "controller")[0]
    assert re.match(r"damping STALE_INPUT: (joint_states|odom) is \d+ ms old", noticed["text"])
    guarded = robot.since(cut, "guard")[0]
    assert guarded["text"].startswith("damping COMMANDS_STOPPED: the last command came ")
    figures = {"fault": noticed["at"] - cut, "guard": guarded["at"] - cut}
    print({name: f"{1e3 * value:.0f} ms after the cut" for name, value in figures.items()})
    assert figures["fault"] < 1.0
    assert figures["guard"] < 1.0

    # On the robot's side the guard damps the joints.
    time.sleep(CUT - 0.5 - (time.monotonic() - cut))
    damped = robot.since(cut + 0.5, "robot")
    assert len(damped) > 50
    assert np.median([said["from_damping"] for said in damped]) < 0.25  # lag of the swinging legs
    assert sum(said["power"] for said in damped) < 0.0
    assert not controller.since(cut + 0.5, "robot")  # no messages through the cut
    assert controller.says("controller", "fault STALE_INPUT: ")
    time.sleep(max(0.0, cut + CUT - time.monotonic()))
    network.heal()
    healed = time.monotonic()

    # Only the documented commands resume the control, and the guard is silent.
    until(lambda: controller.since(healed, "robot"), "the robot's states to come back")
    assert not controller.says("controller", "active")

    def resume():
        controller.command("reset")
        controller.command("activate")

    until(lambda: controller.says("controller", "active"), "activation after the cut", again=resume)
    until(lambda: robot.says("guard", "watching"), "the guard to watch again")
    until(lambda: robot.says("controller", "active"), "the robot's side to be told")
    resumed = time.monotonic()
    time.sleep(0.6)
    assert robot.says("guard", "watching")
    assert robot.since(0.0, "robot")[-1]["largest"] > 0.5
    assert [said["text"] for said in controller.since(resumed, "controller")] == []
    assert robot.running()
    assert controller.running()
