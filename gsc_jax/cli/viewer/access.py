"""Access to the viewer's server: only for those who know the address that `view` prints.

Any web page in a browser can send requests to servers on the same machine, and open WebSockets to
them; viser answers all of them. Here, every request, that of a WebSocket included, must have a
random token as the first folder of its path, must come from a page of the server itself (Origin),
and must name the server by an address of its own (Host), not by a name that an attacker lets point
to it. Others are refused with status 403. The port is not compared, since ssh may forward another.
viser has no option for this, so the `serve` of `websockets` is replaced while viser starts.
"""

import contextlib
import dataclasses
import ipaddress
import secrets
import socket
from collections.abc import Callable, Iterator
from http import HTTPStatus
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

if TYPE_CHECKING:
    from websockets.http11 import Request


@dataclasses.dataclass(frozen=True, kw_only=True)
class Access:
    """What a request must have.

    Attributes:
        host: Name of the server in the options, which addresses may contain.
        token: First folder of the path in all addresses.
    """

    host: str
    token: str = dataclasses.field(default_factory=lambda: secrets.token_urlsafe(16))

    def path(self, request: "Request") -> str | None:
        """Path of a request behind the token; None if the request is refused."""
        hosts, origins = (request.headers.get_all(name) for name in ("Host", "Origin"))
        try:
            if len(hosts) != 1 or any(urlsplit(origin).netloc != hosts[0] for origin in origins):
                return None
            name = urlsplit(f"//{hosts[0]}").hostname
            if name not in {"localhost", self.host.lower(), socket.gethostname().lower()}:
                ipaddress.ip_address(name or "")  # which is no attacker's name
        except ValueError:  # neither a name of this machine nor an address
            return None
        path, mark, query = request.path.partition("?")
        token, _, rest = path.removeprefix("/").partition("/")
        if not secrets.compare_digest(token.encode(errors="replace"), self.token.encode()):
            return None
        return f"/{rest}{mark}{query}"


@contextlib.contextmanager
def guarded(access: Access) -> Iterator[None]:
    """Check every request to a server of viser that is created inside the block.

    RuntimeError if the server was not started as expected, and is open to everybody.
    """
    from unittest import mock

    from websockets.asyncio import server

    original, started = server.serve, []

    def serve(*arguments: Any, process_request: Callable | None, **options: Any) -> Any:
        def check(connection: server.ServerConnection, request: "Request") -> Any:
            if (path := access.path(request)) is None:
                return connection.respond(HTTPStatus.FORBIDDEN, "use the address that was printed")
            return (process_request or (lambda *_: None))(
                connection, dataclasses.replace(request, path=path)
            )

        started.append(True)
        return original(*arguments, process_request=check, **options)

    with mock.patch.object(server, "serve", serve):
        yield
    if not started:
        raise RuntimeError("this version of viser starts its server in another way")
