"""Viser's server behind a check of every request.

viser serves its page and connections on one port with `websockets`, which calls `Gate` before it answers a request;
`PageConnection` drops messages that are not on the allow-list.
"""

import asyncio
import contextlib
import hmac
import http
import io
import ipaddress
import logging
import re
import secrets
import socket
import threading
from collections.abc import Callable, Iterator
from functools import partial
from http.cookies import CookieError, SimpleCookie
from typing import Any
from urllib.parse import parse_qs, urlsplit

import viser
import websockets.asyncio.server
from websockets.asyncio.server import Server, ServerConnection
from websockets.http11 import Request, Response
from websockets.server import ServerProtocol
from websockets.typing import Data

from wbc_controller.apps.page.page_messages import MAX_MESSAGE_SIZE, AllowList
from wbc_controller.errors import ConfigurationError, TransportError

#: Ping period of a page, and time limit of the answer, wall time, s. A page without network is disconnected, so that
#: delayed input cannot move the robot later.
PING_PERIOD, PING_TIMEOUT = 0.5, 2.5
MAX_PAGES = 32
_COOKIE = "wbc_token_{port}"  # cookies of a host are shared by all its ports
_LOOPBACK = ("localhost", "127.0.0.1", "[::1]")
_UNAUTHORIZED = "This page requires the token in the address printed by wbc.\n"
_INVALID_HOST = "{subject} is {value!r}; valid: {host}.\n"
_DROPPED = "page at %s: message dropped: %s; further dropped messages of this page are not logged"
_TOO_MANY_PAGES = f"{MAX_PAGES} pages are open, the maximum; close one.\n"
#: A host with or without a port, as browsers send it.
_HOST = re.compile(r"([\w.-]+|\[[0-9A-Fa-f:.]+\])(:\d{1,5})?", re.ASCII)
#: Content security policy: no content of other servers, and no evaluation of text as code. The page's address can name
#: a server (``?websocket=``) or a file (``?playbackPath=``), and viser's Gaussian splats, unused here, evaluate text.
_POLICY = (
    "default-src 'none'; script-src 'unsafe-inline' 'wasm-unsafe-eval' blob: data:; worker-src blob: data:; "
    "style-src 'unsafe-inline'; img-src data: blob:; font-src data:; "
    "connect-src 'self' ws://{host} wss://{host} data: blob:; base-uri 'none'; form-action 'none'"
)

_HEADERS = {
    "X-Content-Type-Options": "nosniff", "Referrer-Policy": "no-referrer", "X-Frame-Options": "DENY",
    "Cache-Control": "no-store",
}  # fmt: skip
_Process = Callable[[ServerConnection, Request], Response | None]
_log = logging.getLogger(__name__)

RATE, BURST = 300.0, 300.0  # rate limit, messages per second, and burst; a page sends at most 90 per second


class RateLimit:
    """Passes a burst at once, further messages at the rate."""

    def __init__(self, rate: float = RATE, burst: float = BURST) -> None:
        """Start with a full burst; rate in messages per second."""
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
                _log.warning(_DROPPED, self.remote_address, fault)


class Gate:
    """Decides on every HTTP request.

    On the loopback, hosts must be names of the loopback, and connections from pages of other sites are refused. On
    other interfaces every request needs the token.
    """

    def __init__(self, host: str) -> None:
        """Set the rules; addresses beyond the loopback get a random token."""
        try:
            self.loopback = ipaddress.ip_address(host).is_loopback
        except ValueError:
            self.loopback = host == "localhost"
        self.token = "" if self.loopback else secrets.token_urlsafe(24)  # empty if none is required
        self.port = 0

    def refusal(self, request: Request) -> str:
        """Return the reason for a refusal, or an empty text."""
        hosts, origins = request.headers.get_all("Host"), request.headers.get_all("Origin")
        named = hosts[0] if len(hosts) == 1 else ""
        found = _HOST.fullmatch(named)
        if found is None or (self.loopback and found[1].lower() not in _LOOPBACK):
            this = "a name of the loopback" if self.loopback else "the address of this page"
            return _INVALID_HOST.format(host=this, subject="The requested host", value=", ".join(hosts))
        if any(origin not in (f"http://{named}", f"https://{named}") for origin in origins):
            return _INVALID_HOST.format(host=named, subject="The requesting site", value=", ".join(origins))
        if self.token and not any(hmac.compare_digest(_bytes(self.token), _bytes(t)) for t in self._tokens(request)):
            return _UNAUTHORIZED
        return ""

    def _tokens(self, request: Request) -> Iterator[str]:
        yield from parse_qs(urlsplit(request.path).query).get("token", [])
        try:
            cookie = SimpleCookie("; ".join(request.headers.get_all("Cookie")))
        except CookieError:
            return
        name = _COOKIE.format(port=self.port)
        if name in cookie:
            yield cookie[name].value

    def answer(self, process: _Process, connection: ServerConnection, request: Request) -> Response | None:
        """Return the answer of `process` to a request that passes the check."""
        why = self.refusal(request)
        if why:
            return connection.respond(http.HTTPStatus.FORBIDDEN, why)
        response = process(connection, request)
        if response is None:  # a request for a connection
            full = len(connection.server.connections) >= MAX_PAGES
            return connection.respond(http.HTTPStatus.SERVICE_UNAVAILABLE, _TOO_MANY_PAGES) if full else None
        response.headers.update(_HEADERS)
        response.headers["Content-Security-Policy"] = _POLICY.format(host=request.headers["Host"])
        if self.token:
            name = _COOKIE.format(port=self.port)
            response.headers["Set-Cookie"] = f"{name}={self.token}; Path=/; HttpOnly; SameSite=Strict"
        return response


def _bytes(token: str) -> bytes:
    return token.encode(errors="surrogateescape")  # as websockets decodes headers


def open_server(host: str, port: int, gate: Gate, *, commands: bool = False) -> viser.ViserServer:
    """Open the server behind the gate and the allow-list, on `port` or the next free one, 0 for any.

    Raises `ConfigurationError` if `host` is not an address of this computer, and `TransportError` if viser does not use
    the checks; the server is then stopped.
    """
    _require_own_address(host)
    allowed = AllowList(commands=commands)
    with (
        _install_checks(gate, allowed) as in_use,
        contextlib.redirect_stdout(io.StringIO()),  # viser draws a box around two addresses
    ):
        server = viser.ViserServer(host, port, verbose=False)
    if not in_use.is_set():
        server.stop()
        raise TransportError(
            f"viser {viser.__version__} bypasses the request checks, so the server was stopped; install the supported "
            "version: pip install 'wbc_controller[view]'"
        )
    allowed.gui = server.gui
    gate.port = server.get_port()
    return server


def address(gate: Gate, host: str) -> str:
    """Return the page's address, with its token if required."""
    shown = "localhost" if gate.loopback else f"[{host}]" if ":" in host else host
    if host in ("0.0.0.0", "::"):  # noqa: S104 - compared with, not bound to
        shown = socket.gethostname()
    return f"http://{shown}:{gate.port}/" + (f"?token={gate.token}" if gate.token else "")


@contextlib.contextmanager
def _install_checks(gate: Gate, allowed: AllowList) -> Iterator[threading.Event]:
    """Install the checks in the server opened in this context; the event is set once they are in use."""
    serve, in_use = websockets.asyncio.server.serve, threading.Event()

    def checked(*args: Any, process_request: _Process, **options: Any) -> Any:
        options |= {"ping_interval": PING_PERIOD, "ping_timeout": PING_TIMEOUT, "close_timeout": PING_TIMEOUT}
        options |= {"max_size": MAX_MESSAGE_SIZE, "create_connection": partial(PageConnection, allowed)}
        made = serve(*args, process_request=partial(gate.answer, process_request), **options)
        in_use.set()
        return made

    websockets.asyncio.server.serve = checked  # type: ignore[misc, assignment]
    try:
        yield in_use
    finally:
        websockets.asyncio.server.serve = serve  # type: ignore[misc]


def _require_own_address(host: str) -> None:
    """Refuse an address of another computer; viser would wait forever."""
    try:
        family, kind, _, _, place = socket.getaddrinfo(host, 0, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind) as probe:
            probe.bind(place)
    except OSError as error:
        raise ConfigurationError(f"--host {host}: not an address of this computer: {error}") from error
