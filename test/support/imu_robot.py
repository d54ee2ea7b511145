"""A standing robot whose base is estimated from an IMU, and from absolute poses."""

import numpy as np

from wbc_controller.middleware.codec import pose_with_covariance
from wbc_controller.simulation.sensors import imu_message

IMU = {"estimation": {"base_state": "imu", "settling": 0.1, "imu_frame": ""}}
GRAVITY = (0.0, 0.0, 9.81)
THERE = np.array([3.0, -2.0, 0.5, 0.0, 0.0, np.sin(1.0), np.cos(1.0)])


class Standing:
    """A bench of Go2 on its feet; `refused` has the sentences of all cycles."""

    def __init__(self, bench):
        self.bench, self.count, self.refused = bench, 0, []
        self.inputs = bench.loop._inputs

    def imu(self, turning=(0.0, 0.0, 0.0), force=GRAVITY, frame="base", time=None):
        stamp, vectors = self.bench.time if time is None else time, (np.array(turning), np.array(force))
        self.bench.send("imu", imu_message(stamp, frame, np.zeros(4), *vectors))

    def send_pose(self, pose=THERE, *, frame="map", time=None, variance=None, covariance=None):
        content = pose_with_covariance(self.bench.time if time is None else time, frame, np.array(pose), 0.0, 0.0)
        if variance is not None:
            content.pose.covariance[0] = variance
        if covariance is not None:
            content.pose.covariance[:] = covariance
        self.bench.send("pose", content)

    def cycle(self, count=1, *, imu=True, pose=None, **changes):
        """Run cycles with changes of the IMU's data, and an absolute pose every 50 ms."""
        for _ in range(count):
            self.bench.clock.time += self.bench.period
            if imu:
                self.imu(**changes)
            if pose is not None and self.count % 25 == 0:
                self.send_pose(pose)
            self.count += 1
            self.bench.joints()
            report = self.bench.loop.cycle()
            self.refused += report.refused
        return report

    def request(self, word, **changes):
        self.bench.command(word)
        return self.cycle(**changes)

    def activate(self):
        self.cycle(80)
        return self.request("activate")
