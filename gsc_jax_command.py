"""What `gsc-jax` starts with: Ctrl-C ends it at any time with 130 and no traceback.

It lies beside the package because importing anything of that takes a second or two, of JAX mostly,
in which the package could not say yet how an interruption ends. It owns the process, so it may do
what no library should: answer signals, and end without waiting for threads that still compute.
"""

import os
import signal
import sys
import threading
import time
from types import FrameType
from typing import Any, NoReturn

INTERRUPTED = 130
DEAF_SECONDS = 3.0
"""For how long nothing else interrupts: tidying up must not be cut short by impatience."""


def main() -> int:
    """Runs the command line of this process.

    Returns:
        The exit code; an interruption does not return.
    """
    stop = _Stop()
    stop.listen()
    from gsc_jax.cli.main import main as command

    stop.imported = True
    try:
        code = command()
    except BaseException:  # an interruption may become any error on its way
        if not stop.frames:
            raise
        _leave("gsc-jax: interrupted; no file is left half written\n")
    if code == INTERRUPTED:
        _leave()
    return code


def _leave(message: str = "") -> NoReturn:
    """Ends the process; the interpreter would wait for threads, or trip over what they do."""
    sys.stdout.flush()
    sys.stderr.write(message)
    sys.stderr.flush()
    os._exit(INTERRUPTED)


class _Stop:
    """What SIGINT and SIGTERM do.

    Attributes:
        imported: Whether the program is there. Before, it ends at once, as there is nothing to tidy
            up, and libraries in the middle of their first steps crash when they are interrupted.
        frames: What was interrupted. It is kept, as threads of others may be at work on its arrays:
            SciPy's read a tree that would be gone with the frame that made it.
    """

    def __init__(self) -> None:
        self.imported = False
        self.frames: list[FrameType | None] = []
        self._last = -DEAF_SECONDS

    def listen(self) -> None:
        """Answers from now on; what is ignored already stays so, as in the background."""
        if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
            signal.signal(signal.SIGINT, self)
        if signal.getsignal(signal.SIGTERM) is signal.SIG_DFL:
            signal.signal(signal.SIGTERM, self)
        sys.unraisablehook = self._unraisable

    def __call__(self, number: int, frame: FrameType | None) -> None:
        """Interrupts what runs."""
        del number
        if not self.imported:
            _leave("gsc-jax: interrupted before anything was done\n")
        if time.monotonic() - self._last < DEAF_SECONDS:
            return
        self._last = time.monotonic()
        self.frames.append(frame)
        raise KeyboardInterrupt

    def _unraisable(self, lost: Any) -> None:
        """Interrupts again a little later where nothing could be raised, as in a finalizer."""
        if not issubclass(lost.exc_type, KeyboardInterrupt):
            sys.__unraisablehook__(lost)
            return
        self._last = -DEAF_SECONDS
        threading.Timer(0.05, _interrupt_main).start()


def _interrupt_main() -> None:
    if hasattr(signal, "pthread_kill"):
        signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)
    else:
        signal.raise_signal(signal.SIGINT)


if __name__ == "__main__":
    sys.exit(main())
