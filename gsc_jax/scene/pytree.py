"""How the package declares its types: frozen, keyword-only pytrees with a short `repr`."""

import dataclasses
import reprlib
from typing import Any, TypeVar, dataclass_transform

import chex

T = TypeVar("T")

STATIC = {"static": True}
"""Metadata of the fields that `jax.tree_util.register_dataclass` makes static; chex has none."""
SHORT = 16
"""`short_repr` prints the values of arrays with at most so many entries (a 4 x 4 matrix)."""


def short_repr(self: Any) -> str:
    """The `repr` of a dataclass on one line; a large array is shown as `float32[1000, 3]`."""

    def shown(value: Any) -> str:
        if getattr(value, "size", 0) > SHORT:
            return f"{value.dtype}{list(value.shape)}"
        return " ".join(repr(value).split()) if hasattr(value, "shape") else reprlib.repr(value)

    fields = ", ".join(f"{f.name}={shown(getattr(self, f.name))}" for f in dataclasses.fields(self))
    return f"{type(self).__name__}({fields})"


@dataclass_transform(frozen_default=True, kw_only_default=True)
def pytree(cls: type[T]) -> type[T]:
    """Turn a class into an immutable dataclass that JAX treats as a pytree of its fields."""
    cls.__repr__ = short_repr
    declare: Any = chex.dataclass  # type checkers do not understand its own annotations
    return declare(cls, frozen=True, eq=False, kw_only=True, mappable_dataclass=False)
