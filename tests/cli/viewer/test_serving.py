"""The server sends the page and the scene to those who know the printed address, else nothing."""

import contextlib
import http.client
import socket
import struct
from collections.abc import Iterator
from pathlib import Path

import pytest

from gsc_jax.cli.viewer.server import serving

PAGE, SCENE = "<title>the page ü</title>", b"ply\n\0\xff scene"


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("served") / "tamper.ply"
    path.write_bytes(SCENE)
    (path.parent / "result.json").write_text("private")
    return path


@pytest.fixture(scope="module")
def port(scene: Path) -> Iterator[int]:
    with serving(PAGE, scene, token="secret", host="127.0.0.1", port=0) as port:
        yield port


def answer(port: int, path: str, *, method: str = "GET") -> tuple[int, bytes, dict[str, str]]:
    """Status, content and headers of a request with exactly this path."""
    with contextlib.closing(http.client.HTTPConnection("127.0.0.1", port)) as connection:
        connection.putrequest(method, path)
        connection.endheaders()
        with connection.getresponse() as found:
            return found.status, found.read(), dict(found.getheaders())


@pytest.mark.parametrize("query", ["", "?frame", "?frame&fixedDpr=0.5", "?a=/b"])
def test_the_page_has_the_address_that_is_printed(port: int, query: str):
    status, content, headers = answer(port, f"/secret/{query}")
    assert (status, content.decode()) == (200, PAGE)
    assert headers["Content-Type"] == "text/html; charset=utf-8"
    assert headers["Cache-Control"] == "no-store"
    assert headers["Referrer-Policy"] == "no-referrer", "the token would be told to other pages"
    assert "Access-Control-Allow-Origin" not in headers


def test_the_scene_is_beside_the_page_as_long_as_it_exists(port: int, scene: Path):
    assert answer(port, "/secret/tamper.ply")[:2] == (200, SCENE)
    moved = scene.rename(scene.with_name("moved.ply"))
    assert answer(port, "/secret/tamper.ply")[0] == 404
    moved.rename(scene)


@pytest.mark.parametrize(
    "path",
    [
        *("/", "//secrets/", "/index.html", "/secre/", "/secrets/", "/?secret", "/%73ecret/"),
        *("/tamper.ply", "//tamper.ply", "/tamper.ply?/secret/", "/%C3%A9/", "*"),
    ],
)
def test_nothing_without_the_token(port: int, path: str):
    status, content, _ = answer(port, path)
    assert status == 403
    assert b"page" not in content


def test_an_address_without_its_last_slash_is_none(port: int):
    assert answer(port, "/secret")[0] == 404, "its export would ask for another address"


@pytest.mark.parametrize(
    "name", ["result.json", "../tamper.ply", "../../etc/passwd", "..%2fresult.json", "tamper.ply/"]
)
def test_nothing_but_the_page_and_the_scene(port: int, name: str):
    assert answer(port, f"/secret/{name}")[0] == 404


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "OPTIONS"])
def test_nothing_can_be_sent(port: int, method: str):
    assert answer(port, "/secret/", method=method)[0] == 501


def test_a_browser_that_goes_away_is_no_error(scene: Path, capfd: pytest.CaptureFixture[str]):
    with (
        serving("x" * 10**7, scene, token="secret", host="127.0.0.1", port=0) as port,
        socket.create_connection(("127.0.0.1", port)) as plain,
    ):
        plain.sendall(b"GET /secret/ HTTP/1.0\r\n\r\n")
        plain.recv(10)
        for request in (b"", b"nonsense\r\n\r\n"):
            with socket.create_connection(("127.0.0.1", port)) as other:
                other.sendall(request)
                other.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    assert capfd.readouterr() == ("", "")


def test_a_server_ends_with_its_block(scene: Path):
    with serving(PAGE, scene, token="secret", host="localhost", port=0) as port:
        pass
    with pytest.raises(ConnectionError):
        socket.create_connection(("127.0.0.1", port))
