"""`gsc-jax view`: the results of `locate` in 3D, in a browser, by viser.

Served to the browsers of this machine until interrupted, or written as a page that needs no server.
"""

import contextlib
import io
import socket
import threading
import webbrowser
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from gsc_jax.cli.options import View
from gsc_jax.cli.results import read_results
from gsc_jax.cli.viewer.exhibit import Exhibit, exhibit
from gsc_jax.cli.viewer.panel import add_controls, add_scene
from gsc_jax.evidence.monitor import Progress, silent
from gsc_jax.io.files import atomic
from gsc_jax.scene import InputError

if TYPE_CHECKING:
    import viser

ANYONE = ("0.0.0.0", "::")
"""Hosts that stand for every address of this machine."""
SECONDS_TO_STOP = 2.0


def run_view(
    options: View,
    *,
    progress: Progress = silent,
    say: Callable[[str], None] = print,
    wait: Callable[[], object] | None = None,
) -> tuple[list[str], list[str]]:
    """Shows results in 3D: serves a page until interrupted, or writes one.

    Args:
        options: The arguments of the command line.
        progress: Called with (stage, done, total).
        say: Told at once where the page is served, and what a person should know of it.
        wait: Returns, or raises KeyboardInterrupt, when serving shall end; by default for ever.

    Returns:
        What a person should be told, and warnings.

    Raises:
        InputError: if there are no such results, viser is missing, the page cannot be written, or
            not be served at that address.
    """
    _check(options)
    progress("load", 0, 1)
    # Unnamed, as serving lasts and the results are large.
    shown, warnings = exhibit(read_results(options.folder), most=options.most)
    progress("load", 1, 1)
    if options.html is not None:
        return [write_page(options.html, shown)], warnings
    with serving(shown, host=options.host, port=options.port) as server:
        for line in [*_addresses(options, server.get_port()), *warnings, "end with Ctrl-C"]:
            say(line)
        if not options.no_browser:
            webbrowser.open(_url(options.host, server.get_port()))
        with contextlib.suppress(KeyboardInterrupt):
            (wait or threading.Event().wait)()
    return ["served no longer"], []


def write_page(path: Path, exhibit: Exhibit) -> str:
    """Writes a page that needs neither server nor network.

    Args:
        path: The .html to write or to replace.
        exhibit: What it shows.

    Returns:
        What was written, in a line.

    Raises:
        InputError: if the file cannot be written.
    """
    from gsc_jax.cli.viewer.page import page

    with serving(exhibit, host="127.0.0.1", port=0) as server:
        html = page(server.get_scene_serializer().as_html(dark_mode=True), exhibit)
    with atomic(path) as temporary:
        temporary.write_text(html, encoding="utf-8")
    return f"page     {path} ({len(html) / 2**20:.1f} MiB)"


@contextlib.contextmanager
def serving(exhibit: Exhibit, *, host: str, port: int) -> Iterator["viser.ViserServer"]:
    """A viewer, for as long as the block takes.

    Args:
        exhibit: What it shows.
        host: Address to listen at.
        port: Port to listen at; the next free one is taken where it is not free, any for 0.

    Yields:
        The server.
    """
    import viser

    others = set(threading.enumerate())
    # viser tells of itself on stdout, which belongs to the results, also from its thread.
    with contextlib.redirect_stdout(io.StringIO()):
        server = viser.ViserServer(host=host, port=port, label="gsc-jax", verbose=False)
    try:
        add_controls(server, exhibit, add_scene(server, exhibit))
        yield server
    finally:
        with contextlib.redirect_stdout(io.StringIO()):
            started = set(threading.enumerate()) - others
            server.stop()
            for thread in started:
                thread.join(SECONDS_TO_STOP)


def _check(options: View) -> None:
    """What can be wrong before anything is read."""
    try:
        import viser  # noqa: F401
    except ImportError as error:
        raise InputError("view: needs viser: pip install 'gsc_jax[viewer]'") from error
    if options.most < 1:
        raise InputError(f"--most {options.most}: expected at least one Gaussian")
    if options.html is None:
        _check_address(options.host, options.port)


def _check_address(host: str, port: int) -> None:
    """Refuses addresses at which nothing can be served; viser would try the next port forever."""
    try:
        family, kind, _, _, address = socket.getaddrinfo(host, 0, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind) as probe:
            probe.bind(address)
    except OSError as error:
        raise InputError(
            f"--host {host}: no address of this machine ({error.strerror or error}); localhost, or "
            "0.0.0.0 for whoever can reach it"
        ) from error
    if not 0 <= port < 65536:
        raise InputError(f"--port {port}: expected a number from 0 to 65535")


def _addresses(options: View, port: int) -> list[str]:
    taken = options.port not in (0, port)
    note = f" (port {options.port} is taken)" if taken else ""
    lines = [f"view     {_url(options.host, port)}{note}"]
    if options.host in ANYONE:
        lines.append(f"also     http://{socket.gethostname()}:{port} from other machines")
    return lines


def _url(host: str, port: int) -> str:
    place = "localhost" if host in ANYONE else f"[{host}]" if ":" in host else host
    return f"http://{place}:{port}"
