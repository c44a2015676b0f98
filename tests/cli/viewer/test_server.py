"""Start and end of the viewer, its output and its errors."""

import gc
import re
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
    def test_serves_until_interrupted(self, folder, capsys):
        lines = []

        def interrupted():
            with urllib.request.urlopen(lines[0].split()[1]) as answer:
                assert b"<title>found" in answer.read()
            raise KeyboardInterrupt

        ending = run_view(view(folder), say=lines.append, wait=interrupted)
        assert ending == (["the server has ended"], [])
        assert capsys.readouterr().out == ""

    def test_results_are_released_while_serving(self, folder, monkeypatch):
        references: list[weakref.ref] = []

        def read(path: Path, **limits):
            results = read_results(path, **limits)
            references.extend([weakref.ref(results), weakref.ref(results.scene.gaussians)])
            return results

        monkeypatch.setattr(viewer, "read_results", read)
        alive: list[object] = []
        run_view(
            view(folder),
            say=lambda _: None,
            wait=lambda: (gc.collect(), alive.extend(ref() for ref in references)),
        )
        assert alive == [None, None]

    def test_opens_a_browser_unless_disabled(self, folder, monkeypatch):
        opened = []
        monkeypatch.setattr(viewer.webbrowser, "open", opened.append)
        options = view(folder, no_browser=False)
        run_view(options, say=opened.append, wait=lambda: None)
        assert re.fullmatch(rf"http://localhost:{options.port}/[\w-]{{22}}/", opened[-1])
        assert opened[0].split()[1] == opened[-1], "another address was printed"
        opened.clear()
        run_view(view(folder), say=lambda _: None, wait=lambda: None)
        assert opened == []

    def test_taken_port_and_omitted_gaussians_are_reported(self, folder):
        lines = []
        with socket.create_server(("127.0.0.1", 0)) as taken:
            port = taken.getsockname()[1]
            run_view(view(folder, port=port, most=10), say=lines.append, wait=lambda: None)
        assert f"port {port} is taken" in lines[0]
        assert f"localhost:{port} " not in lines[0]
        assert any("10 of 1,998" in line for line in lines)

    def test_page_is_written(self, folder, tmp_path):
        path = tmp_path / "page.html"
        summary, warnings = run_view(view(folder, html=path, most=50))
        assert str(path) in summary[0]
        assert "50 of 1,998" in warnings[0]
        assert "<title>found" in path.read_text(encoding="utf-8")

    @pytest.mark.parametrize(
        ("changes", "message"),
        [
            ({"most": 0}, "--most 0"),
            ({"port": 70000}, "--port 70000"),
            ({"port": -1}, "--port -1"),
            ({"host": "no.such.host.invalid"}, "--host no.such.host.invalid"),
            ({"host": "192.0.2.1"}, "--host 192.0.2.1"),
            ({"folder": Path("nothing")}, "nothing"),
            ({"html": Path("page.txt")}, r"page\.txt: .* ends with \.html"),
        ],
    )
    def test_invalid_options_are_rejected(self, folder, changes, message):
        with pytest.raises(InputError, match=message) as raised:
            run_view(view(folder, **changes), wait=lambda: None)
        assert "\n" not in str(raised.value)

    def test_only_a_written_page_is_replaced(self, folder, tmp_path):
        page, other = tmp_path / "page.html", tmp_path / "report.html"
        other.write_text("<!doctype html><title>mine</title>")
        for _ in range(2):
            run_view(view(folder, html=page, most=50))
        with pytest.raises(InputError, match=r"report\.html: exists and is not from"):
            run_view(view(folder, html=other))
        assert "mine" in other.read_text()

    def test_page_that_cannot_be_written(self, folder, tmp_path):
        with pytest.raises(InputError, match="cannot be written"):
            run_view(view(folder, html=tmp_path))

    def test_missing_viser_names_the_extra(self, folder, monkeypatch):
        monkeypatch.setitem(sys.modules, "viser", None)
        with pytest.raises(InputError, match=r"python\S* -m pip install viser"):
            run_view(view(folder))
