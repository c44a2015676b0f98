"""Settings of all tests: strict JAX, a shared cache folder, a counter of compilations."""

import contextlib
import importlib.metadata
import os
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

import hypothesis
import jax
import pytest

from gsc_jax.cli import cache
from gsc_jax.io.files import memory_limit
from gsc_jax.scene.parallel import usable_cores

if TYPE_CHECKING:
    from browser import Browser

COMPILED: list[str] = []


def _count(event: str, duration_secs: float, **kwargs: str | int) -> None:
    if "backend_compile" in event:
        COMPILED.append(event)


def pytest_configure(config):
    # Global settings, because context managers are thread-local and the library uses threads.
    jax.config.update("jax_numpy_dtype_promotion", "strict")
    jax.config.update("jax_numpy_rank_promotion", "raise")
    # About half of the time of the tests is compilation by JAX. The workers of pytest, processes
    # that they start, and later runs share the compiled functions in a folder.
    os.environ["XDG_CACHE_HOME"] = str(config.rootpath / ".pytest_cache" / "user")
    os.environ["JAX_COMPILATION_CACHE_DIR"] = str(cache.cache_folder())
    os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0"
    # By default, the workers of Ray have a low priority, and would wait for the other tests.
    os.environ["RAY_worker_niceness"] = "0"  # noqa: SIM112 - the name that Ray reads
    cache.enable_compilation_cache(cache.cache_folder())
    jax.monitoring.register_event_duration_secs_listener(_count)
    hypothesis.settings.register_profile(
        "gsc_jax", deadline=None, max_examples=20, derandomize=True, print_blob=True
    )
    hypothesis.settings.load_profile("gsc_jax")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Run files with slow tests first: at the end, one worker would run them while others wait."""
    slow = {item.path for item in items if item.get_closest_marker("slow")}
    items.sort(key=lambda item: item.path not in slow)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers() -> int:
    """One worker per core: at most four, or at most two on a machine with less than 32 GiB."""
    most = 4 if memory_limit() >= 16 << 30 else 2  # half of the memory of the machine
    return min(len(usable_cores()), most)


def pytest_report_header() -> str:
    """Versions that results may depend on; pytest itself prints that of Python."""
    names = ("jax", "numpy", "scipy", "optax", "onnxruntime")
    return ", ".join(f"{name} {importlib.metadata.version(name)}" for name in names)


@pytest.fixture
def nan_is_an_error() -> Iterator[None]:
    """Raise an error for any NaN that a JAX function returns."""
    with jax.debug_nans(True):
        yield


@pytest.fixture
def count_compilations() -> Callable[[], contextlib.AbstractContextManager[list[str]]]:
    """A context manager that yields a list; at its end the list holds the compilations inside."""

    @contextlib.contextmanager
    def counting():
        compiled: list[str] = []
        before = len(COMPILED)
        yield compiled
        compiled += COMPILED[before:]

    return counting


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator["Browser"]:
    """A headless browser for the tests of one file."""
    from browser import CHROMIUM, DRIVER, opened  # which needs Selenium

    if not (CHROMIUM and DRIVER):
        pytest.skip("no browser: Debian's packages chromium and chromium-driver are not installed")
    yield from opened(tmp_path_factory.mktemp("browser"))
