"""Only requests with the token, from the server's own page and to its own name are answered."""

import contextlib
import http.client
import socket
from collections.abc import Iterator
from typing import Any

import pytest

pytest.importorskip("viser")

import viser
import websockets.asyncio.server
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect
from websockets.typing import Origin, Subprotocol

from gsc_jax.cli.viewer.access import Access
from gsc_jax.cli.viewer.server import serving

ACCESS = Access(host="127.0.0.1", token="secret")
PAGE, WEBSOCKET = "/secret/", "/secret"


@pytest.fixture(scope="module")
def port() -> Iterator[int]:
    with serving(ACCESS, port=0) as server:
        server.scene.add_label("scene", "shown")
        yield server.get_port()


def status(port: int, path: str, *headers: tuple[str, str]) -> int:
    """Status of a request with exactly these headers."""
    with contextlib.closing(http.client.HTTPConnection("127.0.0.1", port)) as connection:
        connection.putrequest("GET", path, skip_host=True)
        for name, value in headers:
            connection.putheader(name, value)
        connection.endheaders()
        with connection.getresponse() as answer:
            return answer.status


def message(port: int, path: str, *, origin: str | None = None, host: str | None = None) -> object:
    """What the server sends first over a WebSocket."""
    protocol = Subprotocol(f"viser-v{viser.__version__}")
    with socket.create_connection(("127.0.0.1", port)) as plain:
        address = f"ws://{host or f'127.0.0.1:{port}'}{path}"
        given: dict[str, Any] = {
            "sock": plain,
            "origin": origin and Origin(origin),
            "subprotocols": [protocol],
        }
        with connect(address, proxy=None, **given) as connection:
            return connection.recv(timeout=30)


@pytest.mark.parametrize(
    ("host", "origin", "expected"),
    [
        ("127.0.0.1:{port}", None, 200),
        ("localhost:9000", None, 200),  # a port that ssh forwards
        ("[::1]:{port}", None, 200),
        (f"{socket.gethostname()}:{{port}}", None, 200),
        ("127.0.0.1:{port}", "http://127.0.0.1:{port}", 200),
        ("evil.example:{port}", None, 403),
        ("127.0.0.1.evil.example", None, 403),
        ("localhost.evil.example", None, 403),
        ("[", None, 403),
        ("", None, 403),
        ("127.0.0.1:{port}", "http://evil.example", 403),
        ("127.0.0.1:{port}", "http://127.0.0.1:1", 403),
        ("127.0.0.1:{port}", "http://127.0.0.1:{port}.evil.example", 403),
        ("127.0.0.1:{port}", "null", 403),
        ("127.0.0.1:{port}", "http://[", 403),
    ],
)
def test_host_and_origin_of_pages(port, host, origin, expected):
    headers = [("Host", host.format(port=port))]
    headers += [("Origin", origin.format(port=port))] if origin else []
    assert status(port, PAGE, *headers) == expected
    assert status(port, "/", *headers) == 403


def test_one_host_is_required(port):
    assert status(port, PAGE) == 403
    assert status(port, PAGE, ("Host", "localhost"), ("Host", "evil.example")) == 403


@pytest.mark.parametrize(
    "path", ["/", "//secret/", "/index.html", "/secre/", "/secrets/", "/?secret", "/%73ecret/"]
)
def test_pages_without_the_token(port, path):
    assert status(port, path, ("Host", "localhost")) == 403


def test_nothing_outside_of_the_page_is_served(port):
    assert status(port, "/secret/?a=/b", ("Host", "localhost")) == 200
    assert status(port, "/secret/../../../_viser.py", ("Host", "localhost")) == 404
    assert status(port, "/secret/nothing", ("Host", "localhost")) == 404


def test_the_scene_is_sent_to_the_page_only(port):
    own = f"http://127.0.0.1:{port}"
    assert message(port, WEBSOCKET, origin=own)
    for given in (
        {"path": "/"},
        {"path": "/", "origin": own},
        {"path": WEBSOCKET, "origin": "http://evil.example"},
        {"path": WEBSOCKET, "origin": "null"},
        {"path": WEBSOCKET, "origin": own, "host": "evil.example"},
        {"path": WEBSOCKET, "origin": "http://evil.example", "host": "evil.example"},
    ):
        with pytest.raises(InvalidStatus) as raised:
            message(port, **given)
        assert raised.value.response.status_code == 403, given


def test_tokens_are_random_and_long():
    tokens = {Access(host="localhost").token for _ in range(100)}
    assert len(tokens) == 100
    assert min(map(len, tokens)) >= 22  # 128 bits


def test_a_server_that_cannot_be_guarded_ends(monkeypatch):
    """As if another version of viser had got hold of `serve` before."""
    ports = []

    class Unguarded(viser.ViserServer):
        def __init__(self, *arguments, **options):
            with monkeypatch.context() as patch:
                patch.setattr(websockets.asyncio.server, "serve", original)
                super().__init__(*arguments, **options)
            ports.append(self.get_port())

    original = websockets.asyncio.server.serve
    monkeypatch.setattr(viser, "ViserServer", Unguarded)
    with pytest.raises(RuntimeError, match="another way"), serving(ACCESS, port=0):
        pass
    with pytest.raises(ConnectionError):
        status(ports[0], PAGE, ("Host", "localhost"))
    assert websockets.asyncio.server.serve is original
