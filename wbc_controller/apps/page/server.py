"""The page's server: viser's, behind a check of every request and every message.

viser serves its page and its connections on one port with `websockets`, without checks of its own. `websockets` calls
`Gate` before it answers a request, and `PageConnection` drops the messages that are not on the allow-list.
"""

from __future__ import annotations

import contextlib
import hmac
import http
import io
import ipaddress
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
from websockets.asyncio.server import ServerConnection
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from wbc_controller.apps.page.connection import PageConnection
from wbc_controller.apps.page.page_messages import LARGEST, AllowList
from wbc_controller.errors import ConfigurationError, TransportError

#: Wall time between two pings of a page, and until its answer is overdue, s. A page without network is disconnected
#: after both: the actions of its user meanwhile must not arrive later and move the robot.
PING_EVERY, PING_PATIENCE = 0.5, 2.5
#: Pages that may be open at once.
MOST_PAGES = 32
#: Name of the cookie with the token of a page that was opened with it; all ports of a host share their cookies.
_COOKIE = "wbc_token_{port}"
#: Names of the loopback in browsers.
_LOOPBACK = ("localhost", "127.0.0.1", "::1")
_LOCKED = "This page needs the token in the address that wbc has printed.\n"
_FOREIGN = "This page is only for {host}: {what} is {said!r}.\n"
_FULL = f"At most {MOST_PAGES} pages may be open at once.\n"
#: A host with or without a port, as browsers send it.
_HOST = re.compile(r"([\w.-]+|\[[0-9A-Fa-f:.]+\])(:\d{1,5})?", re.ASCII)
#: Content security policy: the page loads nothing from other servers, and evaluates no text as code. It has all its own
#: code. Its address can name another server (``?websocket=``) or a file (``?playbackPath=``) whose messages would run
#: code here, in a page that may command a robot. viser's sorter of Gaussian splats, unused here, evaluates text too.
_POLICY = (
    "default-src 'none'; script-src 'unsafe-inline' 'wasm-unsafe-eval' blob: data:; worker-src blob: data:; "
    "style-src 'unsafe-inline'; img-src data: blob:; font-src data:; "
    "connect-src 'self' ws://{host} wss://{host} data: blob:; base-uri 'none'; form-action 'none'"
)

_Process = Callable[[ServerConnection, Request], Response | None]


class Gate:
    """Decides on every request, of the page and of its connection, before anything is answered.

    On the loopback, only requests by a name of the loopback are answered: another name belongs to a web site that
    resolves its own name to this computer. Connections from pages of other sites are refused. On any other interface
    every request needs the token.
    """

    def __init__(self, host: str, token: str = "") -> None:
        """Set the rules for an address; without a token, addresses beyond the loopback get a random one."""
        self.loopback = _is_loopback(host)
        self.token = token or ("" if self.loopback else secrets.token_urlsafe(24))  # empty if none is needed
        self.port = 0

    def refusal(self, request: Request) -> str:
        """Return the reason why a request is refused; empty if it is answered."""
        hosts, origins = request.headers.get_all("Host"), request.headers.get_all("Origin")
        named = hosts[0] if len(hosts) == 1 else ""
        if not _HOST.fullmatch(named) or (self.loopback and _name(f"//{named}") not in _LOOPBACK):
            this = "this computer" if self.loopback else "its own address"
            return _FOREIGN.format(host=this, what="the requested host", said=", ".join(hosts))
        if any(origin not in (f"http://{named}", f"https://{named}") for origin in origins):
            return _FOREIGN.format(host=named, what="the requesting site", said=", ".join(origins))
        if self.token and not any(hmac.compare_digest(_bytes(self.token), _bytes(t)) for t in self._tokens(request)):
            return _LOCKED
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

    def before(self, process: _Process) -> _Process:
        """Check each request before a function that answers requests."""

        def checked(connection: ServerConnection, request: Request) -> Response | None:
            why = self.refusal(request)
            if why:
                return _plain(http.HTTPStatus.FORBIDDEN, why)
            response = process(connection, request)
            if response is None:  # it asks for a connection
                full = len(connection.server.connections) >= MOST_PAGES
                return _plain(http.HTTPStatus.SERVICE_UNAVAILABLE, _FULL) if full else None
            response.headers["Content-Security-Policy"] = _POLICY.format(host=request.headers["Host"])
            response.headers["X-Content-Type-Options"] = "nosniff"
            response.headers["Referrer-Policy"] = "no-referrer"
            response.headers["X-Frame-Options"] = "DENY"
            response.headers["Cache-Control"] = "no-store"
            if self.token:
                name = _COOKIE.format(port=self.port)
                response.headers["Set-Cookie"] = f"{name}={self.token}; Path=/; HttpOnly; SameSite=Strict"
            return response

        return checked


def _plain(status: http.HTTPStatus, text: str) -> Response:
    body = text.encode()
    headers = Headers({"Content-Type": "text/plain; charset=utf-8", "Content-Length": str(len(body))})
    return Response(status, status.phrase, headers, body)


def _bytes(token: str) -> bytes:
    return token.encode(errors="surrogateescape")  # as websockets decodes headers


def open_server(host: str, port: int, gate: Gate, *, commands: bool = False) -> viser.ViserServer:
    """Open the server, which answers only requests that the gate accepts, and reads only messages on the allow-list.

    Args:
        port: port; if it is taken, the next free one. 0 for any.
        commands: True if the page may command.

    Raises:
        ConfigurationError: if this computer does not have the address.
        TransportError: if viser does not use the checks; nothing is served then.
    """
    _can_listen(host)
    allowed = AllowList(commands=commands)
    with (
        _checked(gate, allowed) as in_use,
        contextlib.redirect_stdout(io.StringIO()),  # viser draws a box around two addresses
    ):
        server = viser.ViserServer(host, port, verbose=False)
    if not in_use.is_set():
        server.stop()
        raise TransportError(f"viser {viser.__version__} does not use the checks of its requests; nothing is served")
    allowed.gui = server.gui
    gate.port = server.get_port()
    return server


def address(gate: Gate, host: str) -> str:
    """Return the address of the page, with its token if it needs one."""
    shown = "localhost" if gate.loopback else f"[{host}]" if ":" in host else host
    if host in ("0.0.0.0", "::"):  # noqa: S104 - compared with, not bound to
        shown = socket.gethostname()
    return f"http://{shown}:{gate.port}/" + (f"?token={gate.token}" if gate.token else "")


@contextlib.contextmanager
def _checked(gate: Gate, allowed: AllowList) -> Iterator[threading.Event]:
    """Install the checks in the server that is opened meanwhile; the event is set when it uses them."""
    serve, in_use = websockets.asyncio.server.serve, threading.Event()

    def checked(*args: Any, process_request: _Process, **options: Any) -> Any:
        options |= {"ping_interval": PING_EVERY, "ping_timeout": PING_PATIENCE, "close_timeout": PING_PATIENCE}
        options |= {"max_size": LARGEST, "create_connection": partial(PageConnection, allowed)}
        made = serve(*args, process_request=gate.before(process_request), **options)
        in_use.set()
        return made

    websockets.asyncio.server.serve = checked  # type: ignore[misc, assignment]
    try:
        yield in_use
    finally:
        websockets.asyncio.server.serve = serve  # type: ignore[misc]


def _can_listen(host: str) -> None:
    """Refuse an address of another computer: viser would try a thousand ports and wait for ever."""
    try:
        family, kind, _, _, place = socket.getaddrinfo(host, 0, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind) as probe:
            probe.bind(place)
    except OSError as error:
        raise ConfigurationError(f"--host {host}: this computer cannot listen there: {error}") from error


def _is_loopback(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def _name(address: str) -> str:
    try:
        return urlsplit(address).hostname or ""
    except ValueError:
        return ""
