"""The process in which a worker judges scenes: it stays warm, and can be killed at any time.

A hang in a native library, or memory that the kernel takes back, ends this process and nothing
else. It uses the cores of its worker only, since the pools of XLA, NumPy and onnxruntime are as
large as the set of cores that a process may use when they start.
"""

import contextlib
import ctypes
import os
import select
import subprocess
import sys
import threading
from collections.abc import Mapping, Sequence
from multiprocessing.connection import Connection, Pipe
from pathlib import Path
from typing import Any

from gsc_jax.collection.record import Row

START = "from gsc_jax.collection.process import serve; serve({})"
"""Program of the process; the number is its end of the pipe."""


class SceneProcess:
    """A process that is started when it is needed, and killed if a scene takes too long.

    Args:
        cores: Cores that it may use.
        cache: Folder of the persistent compilation cache; None for none.
    """

    def __init__(self, cores: Sequence[int], cache: Path | None) -> None:
        self._cores, self._cache = list(cores), cache
        self._running: tuple[subprocess.Popen, Connection] | None = None

    def judge(self, command: Mapping[str, Any], above: float | None, *, timeout: float) -> Row:
        """Judge a scene, as `judge` does, by the options of `locate` under their names.

        Raises:
            TimeoutError: if it takes more than `timeout` seconds after the start of the process.
            EOFError: if the process died.
        """
        try:
            self._running = self._running or self._started()
            pipe = self._running[1]
            pipe.send((dict(command), above))
            if not pipe.poll(timeout):
                raise TimeoutError
            return pipe.recv()
        except OSError as error:
            self.kill()
            if isinstance(error, TimeoutError):
                raise
            raise EOFError from error
        except EOFError:
            self.kill()
            raise

    def kill(self) -> None:
        """Kill the process; the next scene starts another."""
        if self._running is not None:
            process, pipe = self._running
            process.kill()
            process.wait()
            pipe.close()
        self._running = None

    def _started(self) -> tuple[subprocess.Popen, Connection]:
        own, other = Pipe()
        with other:
            program = [sys.executable, "-c", START.format(other.fileno())]
            process = subprocess.Popen(program, pass_fds=[other.fileno()])
        own.send((self._cores, self._cache))
        own.recv()  # everything is imported
        return process, own


def serve(number: int) -> None:
    """Judge the scenes that arrive through a pipe, until its other end is closed."""
    with Connection(number) as pipe:
        cores, cache = pipe.recv()
        if hasattr(os, "sched_setaffinity"):  # Linux; before NumPy and JAX make their threads
            os.sched_setaffinity(0, cores)
        with contextlib.suppress(OSError):  # Linux: the kernel kills it rather than the worker
            Path("/proc/self/oom_score_adj").write_text("1000", "ascii")
        threading.Thread(target=_end_with_worker, args=[number], daemon=True).start()
        from gsc_jax.cli.cache import enable_compilation_cache
        from gsc_jax.cli.options import Locate
        from gsc_jax.collection.judge import judge

        if cache is not None:
            enable_compilation_cache(cache)
        # glibc keeps what scenes of many sizes leave in its arenas, 20 to 50 MiB for each.
        trim = getattr(ctypes.CDLL(None), "malloc_trim", lambda _: None)
        pipe.send(None)
        with contextlib.suppress(EOFError):
            while True:
                command, above = pipe.recv()
                pipe.send(judge(Locate(**command), above))
                trim(0)


def _end_with_worker(number: int) -> None:
    """End at once when the worker is gone, also in the middle of a scene."""
    watched = select.poll()
    watched.register(number, 0)  # a closed pipe is reported in any case
    watched.poll()
    os._exit(1)
