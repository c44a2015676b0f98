"""Lists of cameras in JSON files: field types, and errors that name file, camera and field."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import pydantic
from pydantic import Field, FiniteFloat

from gsc_jax.io.validation import one_line
from gsc_jax.scene import Camera, InputError

Pixels = Annotated[int, Field(ge=1)]
FocalLength = Annotated[FiniteFloat, Field(gt=0)]
Vector3 = Annotated[list[FiniteFloat], Field(min_length=3, max_length=3)]
Vector4 = Annotated[list[FiniteFloat], Field(min_length=4, max_length=4)]


def read_json(path: Path) -> Any:
    """Parse a JSON file; raise InputError if it is not valid JSON."""
    try:
        return json.loads(path.read_text(encoding="utf-8-sig"))
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: not valid JSON ({error}); export the cameras again") from error


def construct_cameras(
    items: list[Any], construct: Callable[[Any], Camera], *, place: str, name_key: str
) -> list[Camera]:
    """Convert each item of a JSON list; raise errors as InputError of `place`, index and name."""
    cameras = []
    for index, item in enumerate(items):
        where = f"{place} {index}"
        if not isinstance(item, dict):
            raise InputError(f"{where}: expected a JSON object, found {item!r}")
        if isinstance(name := item.get(name_key), str):
            where += f" ({name!r})"
        try:
            cameras.append(construct(item))
        except pydantic.ValidationError as error:
            message = one_line(error, where, item)
            raise InputError(f"{message}; export the cameras again") from error
        except (OSError, ValueError) as error:
            raise InputError(f"{where}: {error}") from error
    return cameras
