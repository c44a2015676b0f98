"""`gsc-jax view`: results of `locate` in 3D in a browser, drawn by viser, served or as a page.

The written page holds viser's standalone client in a frame, under a bar that selects the camera.
viser reads the first view from the address of its page (`?initialCameraPosition=...`). The page
therefore loads itself into the frame with such an address, and there replaces itself by the client.
The frame is sandboxed, since browsers refuse the client's workers in pages opened from a file.
"""

import contextlib
import socket
import threading
import webbrowser
from collections.abc import Callable, Iterator, Mapping
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import urlencode

import numpy as np

from gsc_jax.cli.options import View
from gsc_jax.cli.ownership import refuse_foreign_file
from gsc_jax.cli.results import read_results
from gsc_jax.cli.viewer.access import Access, guarded
from gsc_jax.cli.viewer.contents import Contents, Pose, legend, viewer_contents
from gsc_jax.cli.viewer.controls import add_layers, add_viewer, set_first_view
from gsc_jax.evidence.monitor import Monitor
from gsc_jax.io.files import atomic, memory_limit
from gsc_jax.scene import InputError

if TYPE_CHECKING:
    import viser

TITLE_END = "gsc-jax</title>"
"""In the title of every written page."""
WITHOUT_GPU = 10_000, 40_000
"""Gaussians of a written page in a browser without a graphics card: at first, and on request."""
ALL_ADDRESSES = ("0.0.0.0", "::")
"""Hosts that stand for every address of this machine."""


def run_view(
    options: View,
    *,
    monitor: Monitor | None = None,
    say: Callable[[str], None] = print,
    wait: Callable[[], object] | None = None,
) -> tuple[list[str], list[str]]:
    """Show results in 3D: serve a page until interrupted, or write one; lines, and warnings.

    `say` prints a line while the command runs: addresses and notes. `wait` blocks while the page is
    served and ends with KeyboardInterrupt; by default forever.

    Raises:
        InputError: if the results cannot be read, viser is missing, the page cannot be written, or
            it cannot be served at that address.
    """
    _check(options)
    monitor = monitor or Monitor()
    monitor.progress("load", 0, 1)
    limit = memory_limit(options.memory)
    # The results are not kept in a variable: they are large, and serving lasts.
    contents, notes = viewer_contents(
        read_results(options.folder, max_bytes=limit), most=options.most, max_bytes=limit
    )
    monitor.progress("load", 1, 1)
    if options.html is not None:
        return [write_page(options.html, contents)], notes
    access = Access(host=options.host)
    with serving(access, port=options.port) as server:
        add_viewer(server, contents)
        port = server.get_port()
        for line in (_address_line(options, port, access.token), *notes, "end with Ctrl-C"):
            say(line)
        if not options.no_browser:
            webbrowser.open(_url(options.host, port, access.token))
        with contextlib.suppress(KeyboardInterrupt):
            (wait or threading.Event().wait)()
    return ["the server has ended"], []


def write_page(path: Path, contents: Contents) -> str:
    """Write a page that needs neither server nor network, and describe it in a line."""
    refuse_foreign_file(path, TITLE_END)
    total = len(contents.score)
    counts = [*(count for count in WITHOUT_GPU if count < total), total]
    html = viewer_page({n: _client(contents.with_most(n)) for n in counts}, contents)
    with atomic(path) as temporary:
        temporary.write_text(html, encoding="utf-8")
    return f"page     {path} ({len(html) / 2**20:.1f} MiB)"


def _client(contents: Contents) -> str:
    """The page of viser, with the scene inside."""
    with serving(Access(host="127.0.0.1"), port=0) as server:
        add_layers(server, contents)
        set_first_view(server, contents)
        return server.scene.as_html(dark_mode=True)


@contextlib.contextmanager
def serving(access: Access, *, port: int) -> Iterator["viser.ViserServer"]:
    """Run an empty viser server inside a block; it uses the next free port if `port` is taken.

    Requests without what `access` demands are refused.
    """
    import rich
    import viser

    rich.reconfigure(quiet=True)  # viser prints its status with rich
    with contextlib.ExitStack() as stack:
        with guarded(access):
            server = viser.ViserServer(host=access.host, port=port, label="gsc-jax", verbose=False)
            stack.callback(server.stop)
        yield server


def _check(options: View) -> None:
    """Reject options before the results are read."""
    try:
        import viser  # noqa: F401
    except ImportError as error:
        raise InputError("view: needs viser: pip install 'gsc_jax[viewer]'") from error
    if options.most < 1:
        raise InputError(f"--most {options.most}: expected at least one Gaussian")
    if options.html is not None:
        return
    host, port = options.host, options.port
    try:  # at an address where nothing can be served, viser would try the next port forever
        family, kind, _, _, address = socket.getaddrinfo(host, 0, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind) as probe:
            probe.bind(address)
    except OSError as error:
        raise InputError(
            f"--host {host}: not an address of this machine ({error.strerror or error}); use "
            "localhost, or 0.0.0.0 to allow other machines"
        ) from error
    if not 0 <= port < 65536:
        raise InputError(f"--port {port}: expected a number from 0 to 65535")


def _address_line(options: View, port: int, token: str) -> str:
    note = f" (port {options.port} is taken)" if options.port not in (0, port) else ""
    if options.host in ALL_ADDRESSES:
        note += f", from other machines {_url(socket.gethostname(), port, token)}"
    return f"view     {_url(options.host, port, token)}{note}"


def _url(host: str, port: int, token: str) -> str:
    name = "localhost" if host in ALL_ADDRESSES else f"[{host}]" if ":" in host else host
    return f"http://{name}:{port}/{token}/"


def viewer_page(clients: Mapping[int, str], contents: Contents) -> str:
    """Render a page without server and network; the clients, by their Gaussians, are ascending."""
    from jinja2 import Environment

    template = files("gsc_jax.cli.viewer").joinpath("viewer.html").read_text(encoding="utf-8")
    views = [(pose.name, _address(pose, contents)) for pose in contents.poses]
    page = Environment(autoescape=True).from_string(template)
    return page.render(contents=contents, views=views, legend=legend(), clients=clients)


def _address(pose: Pose, contents: Contents) -> str:
    """Query string with which viser starts at a camera."""
    facts = {"Position": pose.position, "LookAt": pose.look_at, "Up": pose.up}
    facts |= {"Fov": pose.fov, "Near": contents.near, "Far": contents.far}
    numbers = {f"initialCamera{key}": np.ravel(fact).tolist() for key, fact in facts.items()}
    return urlencode({key: ",".join(map(str, row)) for key, row in numbers.items()}, safe=",")
