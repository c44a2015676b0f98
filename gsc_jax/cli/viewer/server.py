"""`gsc-jax view`: writes the 3D page of the results of `locate`, or serves it to a browser.

The served page is the written one, beside the scene file that it exports parts of. It is sent only
to who knows the random token in the address that `view` prints: other programs and web pages that
are open in a browser may send requests to servers of the same machine, too.
"""

import contextlib
import io
import os
import secrets
import shutil
import socket
import sys
import threading
import webbrowser
from collections.abc import Callable, Iterator
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import BinaryIO

from gsc_jax.cli.options import View
from gsc_jax.cli.ownership import refuse_foreign_file
from gsc_jax.cli.results import read_results, result_file
from gsc_jax.cli.viewer.contents import viewer_contents
from gsc_jax.cli.viewer.page import viewer_page
from gsc_jax.evidence.monitor import Monitor
from gsc_jax.io.files import atomic, memory_limit
from gsc_jax.scene import InputError

TITLE_END = "gsc-jax</title>"  # of every written page
HEADERS = ("Cache-Control", "no-store"), ("Referrer-Policy", "no-referrer")
ALL_ADDRESSES = ("0.0.0.0", "::")  # hosts that stand for every address of this machine


def run_view(
    options: View,
    *,
    monitor: Monitor | None = None,
    say: Callable[[str], None] = print,
    wait: Callable[[], object] | None = None,
) -> tuple[list[str], list[str]]:
    """Show results in 3D: serve a page until interrupted, or write one; lines, and warnings.

    `say` prints a line while the command runs: addresses and notes. `wait` blocks while the page is
    served and ends with KeyboardInterrupt; by default forever. InputError if viser is missing, the
    results cannot be read, or the page cannot be written, or served at that address.
    """
    _check(options)
    monitor = monitor or Monitor()
    monitor.progress("load", 0, 1)
    # The results are not kept in a variable: they are large, and serving lasts.
    contents, notes = viewer_contents(
        read_results(options.folder, max_bytes=memory_limit(options.memory)), most=options.most
    )
    page = viewer_page(contents)
    monitor.progress("load", 1, 1)
    if options.html is not None:
        return [write_page(options.html, page)], notes
    del contents
    token, scene = secrets.token_urlsafe(16), result_file(options.folder, "tamper.ply")
    with serving(page, scene, token=token, host=options.host, port=options.port) as port:
        address = _url(options.host, port, token)
        note = f" (port {options.port} is taken)" if options.port not in (0, port) else ""
        if options.host in ALL_ADDRESSES:
            note += f", from other machines {_url(socket.gethostname(), port, token)}"
        for line in (f"view     {address}{note}", *notes, "end with Ctrl-C"):
            say(line)
        if not options.no_browser:
            webbrowser.open(address)
        with contextlib.suppress(KeyboardInterrupt):
            (wait or threading.Event().wait)()
    return ["the server has ended"], []


def write_page(path: Path, page: str) -> str:
    """Write the page, and describe it in a line."""
    refuse_foreign_file(path, TITLE_END)
    with atomic(path) as temporary:
        temporary.write_text(page, encoding="utf-8")
    return f"page     {path} ({len(page) / 2**20:.1f} MiB)"


@contextlib.contextmanager
def serving(page: str, scene: Path, *, token: str, host: str, port: int) -> Iterator[int]:
    """Serve both at addresses that begin with the token; at a free port if `port` is taken."""
    facts = {"page": page.encode(), "scene": scene, "token": token.encode()}
    handler = type("Handler", (_Handler,), {**facts, "log_message": lambda *_: None})
    try:
        family, *_, (address, *_) = socket.getaddrinfo(host, 0, type=socket.SOCK_STREAM)[0]
        ended = {"address_family": family, "handle_error": lambda *_: None}  # a browser goes away
        kind = type("Server", (ThreadingHTTPServer,), ended)
        try:
            server = kind((str(address), port), handler)
        except OSError:
            server = kind((str(address), 0), handler)
    except OSError as error:
        raise InputError(
            f"--host {host}: not an address of this machine ({error.strerror or error}); use "
            "localhost, or 0.0.0.0 to allow other machines"
        ) from error
    with server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        try:
            yield server.server_address[1]
        finally:
            server.shutdown()


class _Handler(BaseHTTPRequestHandler):
    page: bytes
    scene: Path
    token: bytes
    timeout = 60

    def do_GET(self) -> None:
        token, slash, name = self.path.removeprefix("/").partition("?")[0].partition("/")
        if not secrets.compare_digest(token.encode(errors="replace"), self.token):
            self.send_error(HTTPStatus.FORBIDDEN, "use the address that was printed")
        elif slash and not name:
            self._send("text/html; charset=utf-8", io.BytesIO(self.page), len(self.page))
        elif name == "tamper.ply" and self.scene.is_file():
            with self.scene.open("rb") as content:
                self._send("application/octet-stream", content, os.fstat(content.fileno()).st_size)
        else:
            self.send_error(HTTPStatus.NOT_FOUND)

    def _send(self, kind: str, content: BinaryIO, length: int) -> None:
        self.send_response(HTTPStatus.OK)
        for header in (("Content-Type", kind), ("Content-Length", str(length)), *HEADERS):
            self.send_header(*header)
        self.end_headers()
        shutil.copyfileobj(content, self.wfile)


def _check(options: View) -> None:
    """Reject options before the results are read."""
    try:
        import viser  # noqa: F401
    except ImportError as error:
        raise InputError(f"view: needs viser: {sys.executable} -m pip install viser") from error
    page = options.html
    if page is not None and not page.is_dir() and page.suffix.lower() not in (".html", ".htm"):
        raise InputError(f"--html {page}: a browser opens it only if its name ends with .html")
    if options.most < 1:
        raise InputError(f"--most {options.most}: expected at least one Gaussian")
    if not 0 <= options.port < 65536:
        raise InputError(f"--port {options.port}: expected a number from 0 to 65535")


def _url(host: str, port: int, token: str) -> str:
    name = "localhost" if host in ALL_ADDRESSES else f"[{host}]" if ":" in host else host
    return f"http://{name}:{port}/{token}/"
