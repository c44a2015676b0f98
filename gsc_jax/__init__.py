"""gsc_jax finds the tampered Gaussians of a 3D Gaussian Splatting model.

The names of `__init__.pyi` are imported when they are first used, so that `import gsc_jax` is fast.
"""

import sys
import types
from typing import Any

import lazy_loader

_lazy, _, _names = lazy_loader.attach_stub(__name__, __file__)
__all__ = [name.removesuffix("_maps") for name in _names]  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    """Import a public name (PEP 562)."""
    return _lazy("accumulate_maps" if name == "accumulate" else name)


def __dir__() -> list[str]:
    """List the public names for completion in interactive sessions."""
    return sorted({*globals(), *__all__})


class _Package(types.ModuleType):
    """Keep the functions `locate` and `render` when the modules of these names are imported."""

    def __setattr__(self, name: str, value: Any) -> None:
        if name not in __all__ or not isinstance(value, types.ModuleType):
            super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package
