"""Ctrl-C: what may be cut short, and what may not.

Python hears of it between two of its own steps. A 2D network on the CPU may take half a minute for
one, so it is asked in a thread that nobody has to wait for; putting results in place takes
milliseconds and is not interrupted at all, so that what lies in a folder belongs together.
"""

import contextlib
import signal
import threading
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future
from typing import Any

import numpy as np

from gsc_jax.evidence.detector import Detector
from gsc_jax.scene import Camera

STOPS = (signal.SIGINT, signal.SIGTERM)


class Interruptible:
    """A detector that need not be waited for when the run is interrupted.

    Attributes:
        judged: Number of views that it was asked about and has answered.
    """

    def __init__(self, detector: Detector):
        """Asks nothing yet.

        Args:
            detector: Who is asked, of one view at a time.
        """
        self._detector = detector
        self.judged = 0

    @property
    def needs_image(self) -> bool:
        """Whether the detector looks at the render."""
        return self._detector.needs_image

    @property
    def warnings(self) -> Sequence[str]:
        """Those of the detector."""
        return getattr(self._detector, "warnings", ())

    @property
    def notes(self) -> Mapping[str, Any]:
        """Those of the detector, on its views."""
        return getattr(self._detector, "notes", {})

    def select(self, cameras: Sequence[Camera]) -> list[Camera]:
        """The cameras that the detector has something to say on."""
        return self._detector.select(cameras)

    def __call__(self, image: np.ndarray | None, camera: Camera) -> np.ndarray:
        """What the detector says of a view."""
        answer: Future[np.ndarray] = Future()

        def ask() -> None:
            try:
                answer.set_result(self._detector(image, camera))
            except BaseException as error:  # for who waits, whatever it is
                answer.set_exception(error)

        # A daemon, as the end of the program would wait for any other.
        threading.Thread(target=ask, daemon=True).start()
        said = answer.result()
        self.judged += 1
        return said


@contextlib.contextmanager
def uninterrupted() -> Iterator[None]:
    """Lets an interruption wait until the block has ended.

    Only the main thread can be interrupted; in others this does nothing.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    waiting: list[int] = []
    before = {one: signal.getsignal(one) for one in STOPS}
    for one, handler in before.items():
        if callable(handler):  # else it is ignored already, or ends the process at once
            signal.signal(one, lambda number, _: waiting.append(number))
    try:
        yield
    finally:
        for one, handler in before.items():
            if callable(handler):
                signal.signal(one, handler)
        for number in waiting[:1]:
            signal.raise_signal(number)
