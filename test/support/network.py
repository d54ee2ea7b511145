"""Two hosts and a cable between them: network namespaces, joined by a bridge in a third one.

A process in one host cannot reach the other but through the cable. Cutting it takes the carrier from both ends, as
pulling a plug does; addresses and routes stay. It needs `unshare`, `nsenter` and `ip`, and either root or unprivileged
user namespaces.
"""

import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from typing import Any

import pytest

SIDES = {"robot": "10.77.0.1/24", "controller": "10.77.0.2/24"}
#: Variables of the shell that affect the discovery.
DISCOVERY = ("ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_LOCALHOST_ONLY", "ROS_STATIC_PEERS", "CYCLONEDDS_URI")


class NotPermitted(Exception):
    """This machine does not let us make network namespaces; says why."""


class Network:
    """Two hosts, `robot` and `controller`, and the cable between them."""

    def __init__(self) -> None:
        missing = [tool for tool in ("unshare", "nsenter", "ip") if shutil.which(tool) is None]
        if missing:
            raise NotPermitted(f"{', '.join(missing)} is not installed (util-linux, iproute2)")
        self._holders: list[subprocess.Popen[bytes]] = []
        self._user = [] if os.geteuid() == 0 else ["--user", "--map-root-user"]
        try:
            self._cable = self._hold(["unshare", *self._user, "--net"])
            self._places = {side: self._hold([*self._inside(self._cable), "unshare", "--net"]) for side in SIDES}
            self._ip(self._cable, "link add plug type bridge")
            self._ip(self._cable, "link set plug up")
            for side, address in SIDES.items():
                pid = self._places[side].pid
                self._ip(self._cable, f"link add {side} type veth peer name eth0 netns {pid}")
                self._ip(self._cable, f"link set {side} master plug")
                self._ip(self._cable, f"link set {side} up")
                self._ip(self._places[side], "link set lo up")
                self._ip(self._places[side], f"address add {address} dev eth0")
                self._ip(self._places[side], "link set eth0 up")
        except (OSError, subprocess.SubprocessError, NotPermitted) as error:
            self.close()
            said = getattr(error, "stderr", None)
            raise NotPermitted(f"network namespaces cannot be made here: {said or error}") from error

    def words(self, side: str, *words: str) -> list[str]:
        """A command line that runs on one of the hosts."""
        return [*self._inside(self._places[side]), *words]

    def environment(self, **changes: str) -> dict[str, str]:
        """The environment of a Python process on one of the hosts."""
        kept = {name: value for name, value in os.environ.items() if name not in DISCOVERY}
        return kept | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))} | changes

    def cut(self) -> None:
        """Pull the plug."""
        for side in SIDES:
            self._ip(self._cable, f"link set {side} down")

    def heal(self) -> None:
        """Put it back."""
        for side in SIDES:
            self._ip(self._cable, f"link set {side} up")

    def close(self) -> None:
        """End the namespaces; everything in them goes with them."""
        for holder in reversed(self._holders):
            holder.kill()
            holder.wait()

    def _hold(self, words: list[str]) -> subprocess.Popen[bytes]:
        """A process that keeps a new namespace alive; says `ready` in it."""
        holder = subprocess.Popen(
            [*words, "sh", "-c", "echo ready; exec sleep 600"], stdout=subprocess.PIPE, stderr=subprocess.PIPE
        )
        self._holders.append(holder)
        if (holder.stdout.readline() if holder.stdout else b"") != b"ready\n":
            raise NotPermitted((holder.stderr.read() if holder.stderr else b"").decode().strip())
        time.sleep(0.01)
        return holder

    def _inside(self, holder: subprocess.Popen[bytes]) -> list[str]:
        user = ["--user", "--preserve-credentials"] if self._user else []
        return ["nsenter", "--target", str(holder.pid), *user, "--net"]

    def _ip(self, holder: Any, words: str) -> None:
        subprocess.run([*self._inside(holder), "ip", *words.split()], check=True, capture_output=True, text=True)


@pytest.fixture
def network() -> Iterator[Network]:
    """Two hosts and their cable; skips the test where they cannot be made."""
    try:
        made = Network()
    except NotPermitted as error:
        print(f"skipped: {error}")
        pytest.skip(str(error))
    yield made
    made.close()
