"""Progress bars: one per stage on a terminal, nothing elsewhere."""

import sys
from typing import TextIO

from tqdm import tqdm


class Bars:
    """A `Progress` that draws a bar per stage on a terminal, by default stderr, until closed."""

    def __init__(self, stream: TextIO | None = None) -> None:
        self._stream = stream or sys.stderr
        self._stage = ""
        self._bar: tqdm | None = None

    def __call__(self, stage: str, done: int, total: int) -> None:
        """Show that `done` of `total` items of a stage are finished."""
        if self._bar is None or stage != self._stage:
            self.close()
            # `disable=None`: only on a terminal. `initial` is left out of the rate.
            self._bar = tqdm(
                desc=f"{stage:8}",
                total=total,
                initial=done,
                unit="view" if stage in ("views", "masks", "render") else "it",
                file=self._stream,
                disable=None,
            )
            self._stage = stage
        self._bar.update(done - self._bar.n)
        if done >= total:  # the time until the next stage does not belong to this one
            self.close()

    def close(self) -> None:
        """End the current bar, so that the cursor is on a new line."""
        if self._bar is not None:
            self._bar.close()
        self._bar = None
