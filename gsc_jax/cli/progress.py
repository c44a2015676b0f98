"""Progress bars: one per stage, on a terminal; silence where nobody watches.

A bar shows what is done, how long that took, how long the rest will take at this rate, and the
rate: of "look", the views that a 2D network has judged.
"""

import sys
from types import TracebackType
from typing import TextIO

from tqdm import tqdm

UNITS: dict[str, str] = dict.fromkeys(("look", "masks", "render"), "view")
"""What is counted, where it is not steps."""


class Bars:
    """Draws the `Progress` of a run: a bar for each stage, which stays when the next begins."""

    def __init__(self, stream: TextIO | None = None):
        """Draws nothing yet.

        Args:
            stream: Where to draw, by default stderr; if that is no terminal, nothing is drawn.
        """
        self._stream = stream or sys.stderr
        self._stage = ""
        self._bar: tqdm | None = None

    def __call__(self, stage: str, done: int, total: int) -> None:
        """Show how far a stage is.

        Args:
            stage: Name of the stage; another one than before begins a bar.
            done: How much of it is done.
            total: How much there is to do.
        """
        if self._bar is None or stage != self._stage:
            self.close()
            # Of None tqdm makes: disabled unless the stream is a terminal. What is done when a
            # bar begins took no time that it could know of, and says nothing of the rate.
            self._bar = tqdm(
                desc=f"{stage:8}",
                total=total,
                initial=done,
                unit=UNITS.get(stage, "it"),
                file=self._stream,
                disable=None,
            )
            self._stage = stage
        self._bar.update(done - self._bar.n)
        if done >= total:  # what comes before the next stage is not of this one
            self.close()

    def close(self) -> None:
        """End the bar that is being drawn."""
        if self._bar is not None:
            self._bar.close()
        self._bar = None

    def __enter__(self) -> "Bars":
        """Nothing to prepare."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Leave the cursor on a line of its own, whatever happened."""
        self.close()
