"""The page on a real server, with a standing robot as a test double, and recorded requests."""

import threading
import time
from dataclasses import replace

import numpy as np
from browser import Browser

from wbc_controller.apps.page.page import Page
from wbc_controller.apps.page.request_sender import RequestSender
from wbc_controller.apps.page.server import Gate, open_server
from wbc_controller.apps.page.snapshot import Robot, Snapshot
from wbc_controller.apps.terminal.status_view import RobotStatus
from wbc_controller.controller.visualization.geometry import Part
from wbc_controller.middleware.codec import diagnostics
from wbc_controller.records import Reference, References
from wbc_controller.settings.files import find_configuration, load_settings

SETTINGS = load_settings(find_configuration("g1"))
TRIANGLE = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0]], dtype=np.float32)


class SnapshotDouble:
    """Source of snapshots of a standing robot; its clock advances with every snapshot."""

    def __init__(self, robot):
        self.robot = robot
        com = np.array([0.02, 0.0, 0.6])
        still = np.zeros(0)
        references = References(
            {"com": Reference(com, still, still)}, {"com": 50.0, "left_hand": 0.0}, {"left_foot": 1.0}
        )
        q = robot.model.configuration(robot.model.posture)
        q[2] = 0.76
        forces = {name: np.array([10.0, 0.0, 170.0, 0.0, 0.0, 0.0]) for name in robot.contacts}
        self.now = Snapshot(
            stamp=1, age=0.0, q=q, v=np.zeros(robot.model.nv), mode="active", torques=np.full(robot.model.nj, 5.0),
            forces=forces, references=references, status=status(), silence=0.0,
        )  # fmt: skip
        self.refusals = []

    def snapshot(self):
        self.now = replace(self.now, stamp=self.now.stamp + 2_000_000)
        return self.now

    def read_status(self):
        refusals, self.refusals = self.refusals, []
        return refusals


def status(**values):
    said = diagnostics(0, 0, "wbc: control loop", "active", "g1", {"task_weight/com": "50", **values}).status[0]
    return RobotStatus(said, 500.0, {}, "")


class Rig:
    def __init__(self, *, commands):
        self.robot = Robot(SETTINGS)
        self.story = SnapshotDouble(self.robot)
        self.sent, self.gate = [], Gate("127.0.0.1")
        self.server = open_server("127.0.0.1", 0, self.gate, commands=commands)
        joints = range(1, self.robot.model.pinocchio.njoints)
        meshes = [Part(f"m{i}", i, TRIANGLE, np.array([[0, 1, 2]]), (0.5,) * 3) for i in joints]
        self.page = Page(self.server, self.robot, meshes, self.story)
        self.sender = None
        if commands:
            self.sender = RequestSender(SETTINGS, self.take, self.page.report)
            self.page.enable_commands(self.sender, lambda: True)
            self.sender.start()
        self.page.add_view_options()
        self.stop = threading.Event()
        self.thread = threading.Thread(target=self.page.run, args=(self.stop,), daemon=True)
        self.thread.start()

    def __enter__(self):
        return self

    def __exit__(self, *error):
        self.stop.set()
        self.thread.join()
        if self.sender is not None:
            self.sender.close()
        self.server.stop()

    def open_page(self):
        """Open another page, and wait for its handles."""
        count, page = len(self.server.get_clients()), Browser(self.gate.port)
        page.until(lambda: len(self.server.get_clients()) > count and "/handles/com" in page.positions)
        return page

    def take(self, request):
        self.sent.append((time.monotonic(), request))

    def said(self):
        return [request.summary for _, request in self.sent]
