"""How the package declares its types: frozen, keyword-only pytrees with a short `repr`."""

import dataclasses
import reprlib
from typing import Any, TypeVar, dataclass_transform

import chex

T = TypeVar("T")

STATIC = {"static": True}
"""Metadata of the fields that `jax.tree_util.register_dataclass` makes static; chex has none."""
SHORT = 16
"""Entries up to which `short_repr` prints an array, such as the matrix of a camera."""


def short_repr(self: Any) -> str:
    """A line with the fields of a dataclass: arrays as `float32[1000, 3]`, the rest shortened."""

    def shown(value: Any) -> str:
        if getattr(value, "size", 0) > SHORT:
            return f"{value.dtype}{list(value.shape)}"
        return " ".join(repr(value).split()) if hasattr(value, "shape") else reprlib.repr(value)

    values = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
    fields = ", ".join(f"{name}={shown(value)}" for name, value in values.items())
    return f"{type(self).__name__}({fields})"


@dataclass_transform(frozen_default=True, kw_only_default=True)
def pytree(cls: type[T]) -> type[T]:
    """Declare an immutable dataclass whose fields are the leaves of a pytree."""
    cls.__repr__ = short_repr
    declare: Any = chex.dataclass  # type checkers do not understand its own annotations
    return declare(cls, frozen=True, kw_only=True, mappable_dataclass=False)
