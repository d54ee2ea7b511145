"""Connection of a browser, with allow-list and rate limit."""

from __future__ import annotations

import asyncio
import logging
from typing import Any

from websockets.asyncio.server import Server, ServerConnection
from websockets.server import ServerProtocol
from websockets.typing import Data

from wbc_controller.apps.page.page_messages import AllowList

_log = logging.getLogger(__name__)

#: Rate limit, messages per second, and burst; a page sends at most 90 per second.
RATE, BURST = 300.0, 300.0


class RateLimit:
    """Passes a burst at once, further messages at the rate."""

    def __init__(self, rate: float = RATE, burst: float = BURST) -> None:
        """Start with a full burst of messages; rate in messages per second."""
        self._period, self._ahead = 1.0 / rate, (burst - 1.0) / rate
        self._next = -float("inf")  # time of the next message at the constant rate, s

    def wait(self, now: float) -> float:
        """Count a message at the time `now`; return the delay before its reading; s."""
        wait = max(0.0, self._next - self._ahead - now)
        self._next = max(self._next, now) + self._period
        return wait


class PageConnection(ServerConnection):
    """Drops messages not on the allow-list, and logs the first one.

    The rate limit delays reading; a browser above it answers pings late and is disconnected.
    """

    def __init__(self, allowed: AllowList, protocol: ServerProtocol, server: Server, **options: Any) -> None:
        super().__init__(protocol, server, **options)
        self._allowed = allowed
        self._rate_limit = RateLimit()
        self._logged = False

    async def recv(self, decode: bool | None = None) -> Data:  # type: ignore[override]
        """Receive the next allowed message."""
        while True:
            payload = await super().recv(decode)
            wait = self._rate_limit.wait(self.loop.time())
            if wait > 0.0:
                await asyncio.sleep(wait)
            fault = self._allowed.fault(payload)
            if not fault:
                return payload
            if not self._logged:
                self._logged = True
                _log.warning(
                    "page at %s: message dropped: %s; further dropped messages of this page are not logged",
                    self.remote_address,
                    fault,
                )
