"""Progress bars."""

import contextlib
import io

from gsc_jax.cli.progress import Bars


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_bars_show_every_stage_on_a_terminal_only():
    for stream, drawn in ((Terminal(), True), (io.StringIO(), False)):
        with contextlib.closing(Bars(stream)) as bars:
            for done in range(3):
                bars("views", done, 2)
            bars("masks", 1, 1)
        assert ("views" in stream.getvalue()) == drawn
        assert ("masks" in stream.getvalue()) == drawn
        assert ("2/2" in stream.getvalue()) == drawn


def test_the_rate_excludes_views_that_were_done_before_the_bar_began(monkeypatch):
    now = [1000.0]
    monkeypatch.setattr("tqdm.std.time", lambda: now[0])
    stream = Terminal()
    monkeypatch.setenv("COLUMNS", "100")
    with contextlib.closing(Bars(stream)) as bars:
        for done in range(1, 5):
            bars("views", done, 10)
            now[0] += 8.0
        bars("views", 10, 10)
        now[0] += 100.0
    assert "10/10 [00:32<00:00" in stream.getvalue().split("\r")[-1]
    last = next(line for line in stream.getvalue().split("\r") if "4/10" in line)
    assert "[00:24<00:48,  8.00s/view]" in last
