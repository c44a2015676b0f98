"""How the viewer is started and ended, what it says, and what it refuses."""

import contextlib
import gc
import io
import socket
import sys
import urllib.request
import weakref
from pathlib import Path
from typing import Any

import pytest
from results_folder import write_results

from gsc_jax.cli.options import View
from gsc_jax.cli.results import read_results
from gsc_jax.cli.viewer import server as viewer
from gsc_jax.cli.viewer.server import run_view
from gsc_jax.scene import InputError

pytest.importorskip("viser")


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    found = tmp_path_factory.mktemp("viewer") / "found"
    write_results(found)
    return found


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("localhost", 0))
        return probe.getsockname()[1]


def view(found: Path, **changes: Any) -> View:
    given: dict[str, Any] = {"folder": found, "no_browser": True, "port": free_port()}
    return View(**(given | changes))


class TestRunView:
    def test_it_serves_until_interrupted(self, folder):
        said, out = [], io.StringIO()

        def interrupted():
            address = said[0].split()[1]
            with urllib.request.urlopen(address) as answer:
                assert b"Viser client" in answer.read()
            raise KeyboardInterrupt

        with contextlib.redirect_stdout(out):
            ending = run_view(view(folder), say=said.append, wait=interrupted)
        assert ending == (["served no longer"], [])
        assert said[0].startswith("view     http://localhost:")
        assert out.getvalue() == ""

    def test_nobody_holds_the_results_while_it_serves(self, folder, monkeypatch):
        held: list[weakref.ref] = []

        def read(path: Path):
            results = read_results(path)
            held.extend([weakref.ref(results), weakref.ref(results.gaussians)])
            return results

        monkeypatch.setattr(viewer, "read_results", read)
        still: list[object] = []
        run_view(
            view(folder),
            say=lambda _: None,
            wait=lambda: (gc.collect(), still.extend(one() for one in held)),
        )
        assert still == [None, None]

    def test_it_opens_a_browser_unless_told_not_to(self, folder, monkeypatch):
        opened = []
        monkeypatch.setattr(viewer.webbrowser, "open", opened.append)
        options = view(folder, no_browser=False)
        run_view(options, say=opened.append, wait=lambda: None)
        assert opened[-1] == f"http://localhost:{options.port}"
        opened.clear()
        run_view(view(folder), say=lambda _: None, wait=lambda: None)
        assert opened == []

    def test_a_port_that_is_taken_is_told(self, folder):
        said = []
        with socket.create_server(("127.0.0.1", 0)) as taken:
            port = taken.getsockname()[1]
            run_view(view(folder, port=port), say=said.append, wait=lambda: None)
        assert f"port {port} is taken" in said[0]
        assert f"localhost:{port} " not in said[0]

    def test_what_is_missing_is_told_before_serving(self, folder):
        said = []
        run_view(view(folder, most=10), say=said.append, wait=lambda: None)
        assert any("10 of 1,998" in line for line in said)

    def test_a_page_is_written(self, folder, tmp_path):
        path = tmp_path / "page.html"
        lines, warnings = run_view(view(folder, html=path, most=50))
        assert str(path) in lines[0]
        assert "50 of 1,998" in warnings[0]
        text = path.read_text(encoding="utf-8")
        assert "<title>found" in text
        assert "<title>Viser</title>" not in text

    @pytest.mark.parametrize(
        ("changes", "said"),
        [
            ({"most": 0}, "--most 0"),
            ({"port": 70000}, "--port 70000"),
            ({"port": -1}, "--port -1"),
            ({"host": "no.such.host.invalid"}, "--host no.such.host.invalid"),
            ({"host": "192.0.2.1"}, "--host 192.0.2.1"),
            ({"folder": Path("nothing")}, "nothing"),
        ],
    )
    def test_what_cannot_be_is_refused(self, folder, changes, said):
        with pytest.raises(InputError, match=said) as refused:
            run_view(view(folder, **changes), wait=lambda: None)
        assert "\n" not in str(refused.value)

    def test_a_page_that_cannot_be_written(self, folder, tmp_path):
        with pytest.raises(InputError, match="cannot be written"):
            run_view(view(folder, html=tmp_path))

    def test_viser_is_an_extra(self, folder, monkeypatch):
        monkeypatch.setitem(sys.modules, "viser", None)
        with pytest.raises(InputError, match=r"pip install 'gsc_jax\[viewer\]'"):
            run_view(view(folder))
