"""Access to the page on the real server, with real requests."""

import contextlib
import socket
import threading
import urllib.error
import urllib.request

import pytest
import websockets.asyncio.server
from browser import Browser
from websockets.exceptions import InvalidStatus

from wbc_controller.apps.page.server import Gate, address, open_server
from wbc_controller.errors import ConfigurationError, TransportError


@pytest.fixture(scope="module")
def locked():
    """Yield a server with a token, as on addresses beyond the loopback."""
    gate = Gate("0.0.0.0")  # noqa: S104 - requested, not listened on
    gate.server = open_server("127.0.0.1", 0, gate)
    yield gate
    gate.server.stop()


@pytest.fixture(scope="module")
def local():
    gate = Gate("127.0.0.1")
    server = open_server("127.0.0.1", 0, gate)
    yield gate
    server.stop()


def get(gate, path="/", **headers):
    """Return status, headers and content of the answer."""
    request = urllib.request.Request(f"http://127.0.0.1:{gate.port}{path}", headers=headers)
    try:
        with urllib.request.urlopen(request) as answer:  # noqa: S310 - our own address
            return answer.status, answer.headers, answer.read()
    except urllib.error.HTTPError as refusal:
        return refusal.code, refusal.headers, refusal.read()


def raw(gate, request):
    """Return the first bytes of the answer to a request that urllib cannot send."""
    with socket.create_connection(("127.0.0.1", gate.port), timeout=10.0) as connection:
        connection.sendall(request + b"\r\n")
        return connection.recv(4096)


@pytest.mark.parametrize("path", ["/", "/?token=", "/?token=wrong", "/index.html", "/?websocket"])
def test_page_requires_the_token(locked, path):
    status, headers, text = get(locked, path)
    assert (status, b"requires the token" in text, headers["Set-Cookie"]) == (403, True, None)


@pytest.mark.parametrize("headers", [{}, {"Cookie": "wbc_token=x"}, {"Cookie": ";;=, wbc"}, {"Upgrade": "websocket"}])
def test_connection_requires_the_token(locked, headers):
    with pytest.raises(InvalidStatus) as refusal:
        Browser(locked.port, additional_headers=headers)
    assert refusal.value.response.status_code == 403
    assert not locked.server.get_clients()


def test_printed_address_opens_page_and_connection(locked):
    assert address(locked, "0.0.0.0").endswith(f":{locked.port}/?token={locked.token}")  # noqa: S104 - as above
    assert len(locked.token) >= 32
    status, headers, text = get(locked, f"/?token={locked.token}")
    assert (status, b"<html" in text.lower()) == (200, True)
    cookie = headers["Set-Cookie"]
    assert {"HttpOnly", "SameSite=Strict"} <= set(cookie.split("; "))
    page = Browser(locked.port, additional_headers={"Cookie": cookie.partition(";")[0]})
    page.until(lambda: len(locked.server.get_clients()) == 1)
    page.close()
    assert Gate("192.0.2.1").token != Gate("192.0.2.1").token


@pytest.mark.parametrize(
    "headers",
    [
        {"Host": "robot.example"},  # a name of a web site that resolves to this computer
        {"Origin": "http://robot.example"},
        {"Origin": "null"},
        *(
            {"Host": host}
            for host in ("", "localhost; *", "localhost/", "localhost:8080@robot.example", "127.0.0.1.robot.example")
        ),
    ],
)
def test_other_sites_cannot_connect(local, headers):
    assert local.token == ""
    assert get(local)[0] == 200
    assert get(local, **headers)[0] == 403


@pytest.mark.parametrize(
    "lines",
    [
        b"Host: localhost\r\nHost: robot.example\r\n",
        b"",
        b"Host: localhost\r\nOrigin: http://localhost\r\nOrigin: http://robot.example\r\n",
        b"Host: localhost\r\nOrigin: http://[\r\n",
        b"Host: local\xffhost\r\n",
    ],
)
def test_invalid_headers_are_refused(local, lines):
    assert raw(local, b"GET / HTTP/1.1\r\n" + lines).startswith(b"HTTP/1.1 403 ")


def test_token_in_another_encoding_is_refused(locked):
    lines = b"Host: localhost\r\nCookie: wbc_token_%d=\xff\r\n" % locked.port
    assert raw(locked, b"GET / HTTP/1.1\r\n" + lines).startswith(b"HTTP/1.1 403 ")


@pytest.mark.parametrize(
    "path", ["/../index.html", "/..%2f..%2f__init__.py", "/%2e%2e/%2e%2e/__init__.py", "/..\\..\\__init__.py",
             "//etc/passwd", "/%2fetc%2fpasswd", "/index.html%00", "/build/../../src/App.tsx"]
)  # fmt: skip
def test_only_files_of_the_page_are_served(local, path):
    assert raw(local, b"GET " + path.encode() + b" HTTP/1.1\r\nHost: localhost\r\n").startswith(b"HTTP/1.1 404 ")


def test_page_loads_only_from_its_own_server(local):
    policy = get(local, Host="localhost:9000")[1]["Content-Security-Policy"]
    allowed = {part.split()[0]: part.split()[1:] for part in policy.split("; ")}
    assert allowed["default-src"] == ["'none'"]
    assert allowed["connect-src"] == ["'self'", "ws://localhost:9000", "wss://localhost:9000", "data:", "blob:"]
    assert not [where for places in allowed.values() for where in places if where in ("*", "http:", "https:")]
    assert "'unsafe-eval'" not in allowed["script-src"]


@pytest.mark.parametrize("host", ["localhost", "127.0.0.1", "127.0.0.1:9000", "[::1]:8080"])
def test_tunnel_to_another_port(local, host):
    assert get(local, Host=host, Origin=f"http://{host}")[0] == 200


def test_unchecked_server_is_stopped(monkeypatch):
    serve = websockets.asyncio.server.serve
    unchecked = contextlib.nullcontext(threading.Event())
    monkeypatch.setattr("wbc_controller.apps.page.server._install_checks", lambda gate, allowed: unchecked)
    with pytest.raises(TransportError, match="bypasses the request checks, so the server was stopped"):
        open_server("127.0.0.1", 0, Gate("127.0.0.1"))
    assert websockets.asyncio.server.serve is serve


def test_address_of_another_computer():
    with pytest.raises(ConfigurationError, match=r"--host 192\.0\.2\.1: not an address of this computer"):
        open_server("192.0.2.1", 0, Gate("192.0.2.1"))
