"""The page's server: viser's, behind a check of who may look at all.

viser serves its page and speaks with it on one port, by `websockets`, and has no check of its own. `websockets` asks a
function before it answers a request, of the page or of the connection; this is where the check stands.
"""

from __future__ import annotations

import contextlib
import hmac
import http
import io
import ipaddress
import secrets
import threading
from collections.abc import Callable, Iterator
from http.cookies import CookieError, SimpleCookie
from typing import Any
from urllib.parse import parse_qs, urlsplit

import viser
import websockets.asyncio.server
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from wbc_controller.errors import ConfigurationError, TransportError

#: Wall time between two signs of life that are asked of a page, and until its answer is missed, s. A page whose network
#: is cut is dropped after both: what its user did meanwhile must not arrive and move the robot once it is back.
PING_EVERY, PING_PATIENCE = 0.5, 2.5
#: Name of the cookie by which a page that was opened with the token shows it again; a cookie is of all ports of a host.
_COOKIE = "wbc_token_{port}"
#: What a browser calls the loopback.
_LOOPBACK = ("localhost", "127.0.0.1", "::1")
_LOCKED = "This page needs the token that stands in the address which wbc has printed.\n"
_FOREIGN = "This page is only for {host}: {what} is {said!r}.\n"

_Process = Callable[[Any, Request], Response | None]


class Gate:
    """Decides on every request, of the page and of its connection, before anything is answered.

    Where the server listens on the loopback alone, it answers who calls it by a name of the loopback: another name is
    that of a web site which has its own name point here. A connection that a page of another site opens is refused.
    On any other interface every request has to show the token.

    Attributes:
        token: empty where none is asked for.
    """

    def __init__(self, host: str, token: str = "") -> None:
        """Take the rules for an address to listen on.

        Args:
            host: the address.
            token: asked for where it is not empty; by default one is made for any address beyond the loopback.
        """
        self.loopback = _is_loopback(host)
        self.token = token or ("" if self.loopback else secrets.token_urlsafe(24))
        self.port = 0

    def refusal(self, request: Request) -> str:
        """Why a request is not answered; empty where it is."""
        named = request.headers.get("Host", "")
        host = _name(f"//{named}")
        if self.loopback and host not in _LOOPBACK:
            return _FOREIGN.format(host="this computer", what="the host that is asked for", said=named)
        origin = request.headers.get("Origin")
        if origin is not None and urlsplit(origin).netloc != named:
            return _FOREIGN.format(host=named, what="the site that asks", said=origin)
        if self.token and not any(hmac.compare_digest(self.token.encode(), t.encode()) for t in self._shown(request)):
            return _LOCKED
        return ""

    def _shown(self, request: Request) -> Iterator[str]:
        yield from parse_qs(urlsplit(request.path).query).get("token", [])
        try:
            cookie = SimpleCookie(request.headers.get("Cookie", ""))
        except CookieError:
            return
        name = _COOKIE.format(port=self.port)
        if name in cookie:
            yield cookie[name].value

    def before(self, process: _Process) -> _Process:
        """Ask here before a function that answers requests."""

        def checked(connection: Any, request: Request) -> Response | None:
            why = self.refusal(request)
            if why:
                text = why.encode()
                headers = Headers({"Content-Type": "text/plain; charset=utf-8", "Content-Length": str(len(text))})
                return Response(http.HTTPStatus.FORBIDDEN, "Forbidden", headers, text)
            response = process(connection, request)
            if response is not None:
                response.headers["Referrer-Policy"] = "no-referrer"
                response.headers["X-Frame-Options"] = "DENY"
                response.headers["Cache-Control"] = "no-store"
                if self.token:
                    name = _COOKIE.format(port=self.port)
                    response.headers["Set-Cookie"] = f"{name}={self.token}; Path=/; HttpOnly; SameSite=Strict"
            return response

        return checked


def open_server(host: str, port: int, gate: Gate) -> viser.ViserServer:
    """Open the server; nothing is answered that the gate refuses.

    Args:
        host: address to listen on.
        port: port; where it is taken, the next one that is free. 0 for any.
        gate: who may look.

    Raises:
        ConfigurationError: if there is no such address on this computer.
        TransportError: if viser does not ask the gate: it then serves nothing.
    """
    _can_listen(host)
    with _asked(gate) as passed, contextlib.redirect_stdout(io.StringIO()):  # viser draws a box around two addresses
        server = viser.ViserServer(host, port, verbose=False)
    if not passed.is_set():
        server.stop()
        raise TransportError(f"viser {viser.__version__} does not ask who may see its page; nothing is served")
    gate.port = server.get_port()
    return server


def address(gate: Gate, host: str) -> str:
    """The address of the page, with the token where one is asked for."""
    shown = "localhost" if gate.loopback else f"[{host}]" if ":" in host else host
    if host in ("0.0.0.0", "::"):  # noqa: S104 - compared with, not bound to
        import socket

        shown = socket.gethostname()
    return f"http://{shown}:{gate.port}/" + (f"?token={gate.token}" if gate.token else "")


@contextlib.contextmanager
def _asked(gate: Gate) -> Iterator[threading.Event]:
    """Have the server that is opened meanwhile ask the gate; the event says that it does."""
    serve, passed = websockets.asyncio.server.serve, threading.Event()

    def checked(*args: Any, process_request: _Process, **options: Any) -> Any:
        options |= {"ping_interval": PING_EVERY, "ping_timeout": PING_PATIENCE, "close_timeout": PING_PATIENCE}
        made = serve(*args, process_request=gate.before(process_request), **options)
        passed.set()
        return made

    websockets.asyncio.server.serve = checked  # type: ignore[misc, assignment]
    try:
        yield passed
    finally:
        websockets.asyncio.server.serve = serve  # type: ignore[misc]


def _can_listen(host: str) -> None:
    """Refuse an address that this computer has not: viser would try a thousand ports and wait for ever."""
    import socket

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
