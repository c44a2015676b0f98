"""How the package declares its types: frozen, keyword-only pytrees."""

import dataclasses
from typing import TypeVar, dataclass_transform

import jax

T = TypeVar("T")

STATIC = {"static": True}
"""Metadata of a field that is no leaf: a function is compiled for each of its values."""


@dataclass_transform(
    frozen_default=True, kw_only_default=True, field_specifiers=(dataclasses.field,)
)
def pytree(cls: type[T]) -> type[T]:
    """Declare an immutable dataclass whose fields are the leaves of a pytree, if not `STATIC`."""
    return jax.tree_util.register_dataclass(dataclasses.dataclass(frozen=True, kw_only=True)(cls))
