"""Entry point of `gsc-jax` and of `python -m gsc_jax`.

Ctrl-C (SIGINT) ends the process with exit code 130 and SIGTERM with 143, each with one line on
stderr, also while JAX is imported, which takes seconds. Cleaning up may take `GRACE_SECONDS`; then
the process ends without it and leaves temporary files; a later run removes those in `.unfinished`.
"""

import atexit
import gc
import os
import signal
import socket
import sys
import threading
import time
from types import FrameType
from typing import Any, NoReturn

GRACE_SECONDS = 5.0
"""Time to clean up: removing the temporary files of a run takes well below a second."""


def main() -> int:
    """Run the command line of this process and return its exit code, except after a signal."""
    stop = _Stop()
    atexit.register(gc.freeze)  # else the interpreter searches all of JAX for garbage as it ends
    from gsc_jax.cli.main import main as run

    stop.imported = True
    try:
        code = run()
        if stop.number == signal.SIGTERM:  # `view` ends normally when it is interrupted
            _leave(stop.number)
        return code
    except BaseException:  # libraries may turn the KeyboardInterrupt into any other error
        if stop.number:
            _leave(stop.number)
        raise


class _Stop:
    """Handler of SIGINT and SIGTERM: raises KeyboardInterrupt at the first signal."""

    def __init__(self) -> None:
        self.imported = False  # until then, a signal ends the process at once
        self.number = 0  # the signal that was received
        self.frame = None  # the interrupted frame: native threads may still read its arrays
        # A signal that is ignored already, as in a background job, stays ignored.
        if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
            signal.signal(signal.SIGINT, self)
        if signal.getsignal(signal.SIGTERM) is signal.SIG_DFL:
            signal.signal(signal.SIGTERM, self)
        sys.unraisablehook = self._raise_again
        self._reader, self._writer = socket.socketpair()
        self._writer.setblocking(False)
        # Written to even while the main thread is inside a native library.
        signal.set_wakeup_fd(self._writer.fileno(), warn_on_full_buffer=False)
        threading.Thread(target=self._enforce, daemon=True).start()

    def __call__(self, number: int, frame: FrameType | None) -> None:
        if not self.imported:
            _leave(number)
        if not self.number:
            self.number, self.frame = number, frame
            raise KeyboardInterrupt

    def _raise_again(self, ignored: Any) -> None:
        """Interrupt once more where the first one fell into a callback, which ignores errors."""
        if ignored.exc_type is not KeyboardInterrupt or not self.number:
            return sys.__unraisablehook__(ignored)
        number, self.number = self.number, 0
        threading.Timer(0.01, signal.pthread_kill, [threading.main_thread().ident, number]).start()

    def _enforce(self) -> None:
        number = self._reader.recv(1)[0]
        time.sleep(GRACE_SECONDS)
        _leave(number)


def _leave(number: int) -> NoReturn:
    """End the process without waiting for threads that still compute."""
    try:  # not by sys.stderr, whose lock another thread may hold; its reader may be gone
        os.write(2, b"gsc-jax: interrupted; no file is left half written\n")
    finally:
        os._exit(128 + number)


if __name__ == "__main__":
    sys.exit(main())
