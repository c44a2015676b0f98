"""How the package declares its types: frozen, keyword-only pytrees."""

import functools
from typing import TYPE_CHECKING, TypeVar, dataclass_transform

import chex

T = TypeVar("T")

STATIC = {"static": True}
"""Metadata of the fields that `jax.tree_util.register_dataclass` makes static; chex has none."""

if TYPE_CHECKING:

    @dataclass_transform(frozen_default=True, kw_only_default=True)
    def pytree(cls: type[T]) -> type[T]:
        """Declare an immutable dataclass whose fields are the leaves of a pytree."""
        ...
else:
    # Type checkers do not understand chex's own annotations, hence the declaration above.
    pytree = functools.partial(chex.dataclass, frozen=True, kw_only=True, mappable_dataclass=False)
