"""The connection of one browser: passes on the messages of the allow-list, at a bounded rate."""

from __future__ import annotations

import asyncio
import logging
from typing import Any

from websockets.asyncio.server import Server, ServerConnection
from websockets.server import ServerProtocol
from websockets.typing import Data

from wbc_controller.apps.page.page_messages import AllowList

_log = logging.getLogger(__name__)

#: Messages per second of one browser that are read at most, and how many may come at once. The page itself sends at
#: most 50 of the camera, 20 of a control and 20 of a handle or a link.
RATE, BURST = 300.0, 300.0


class Pace:
    """Spaces messages in time: a burst passes at once, more only at the rate."""

    def __init__(self, rate: float = RATE, burst: float = BURST) -> None:
        """Start with a full burst; `rate` is in messages per second, `burst` the messages that pass at once."""
        self._period, self._ahead = 1.0 / rate, (burst - 1.0) / rate
        self._next = -float("inf")  # time of the next message if all came at the rate, s

    def wait(self, now: float) -> float:
        """Count a message at the monotonic time `now`, s; return the time until it may be read, s."""
        wait = max(0.0, self._next - self._ahead - now)
        self._next = max(self._next, now) + self._period
        return wait


class PageConnection(ServerConnection):
    """Drops messages that are not on the allow-list, and logs the first one of each browser.

    A browser that sends faster than the pace is not read: its answers to the pings are late, and it is disconnected.
    """

    def __init__(self, allowed: AllowList, protocol: ServerProtocol, server: Server, **options: Any) -> None:
        """Replace websockets' own connection, whose arguments follow the allow-list."""
        super().__init__(protocol, server, **options)
        self._allowed = allowed
        self._pace = Pace()
        self._logged = False

    async def recv(self, decode: bool | None = None) -> Data:  # type: ignore[override]
        """Receive the next allowed message."""
        while True:
            payload = await super().recv(decode)
            wait = self._pace.wait(self.loop.time())
            if wait > 0.0:
                await asyncio.sleep(wait)
            fault = self._allowed.fault(payload)
            if not fault:
                return payload
            if not self._logged:
                self._logged = True
                _log.warning(
                    "page at %s: message dropped: %s; further ones of this page are dropped without a message",
                    self.remote_address,
                    fault,
                )
