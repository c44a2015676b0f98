"""The one way in which types are declared here: frozen, keyword-only, a pytree of arrays."""

import functools
from typing import TYPE_CHECKING, TypeVar, dataclass_transform

import chex

T = TypeVar("T")

if TYPE_CHECKING:

    @dataclass_transform(frozen_default=True, kw_only_default=True)
    def pytree(cls: type[T]) -> type[T]:
        """Declare an immutable dataclass whose fields are the leaves of a pytree."""
        ...
else:
    # chex's own annotations do not survive a type checker, hence the declaration above.
    pytree = functools.partial(chex.dataclass, frozen=True, kw_only=True, mappable_dataclass=False)
