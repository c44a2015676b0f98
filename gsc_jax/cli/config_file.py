"""`--config`: options of `locate` and the configuration of its estimator, from a file.

The file has two tables: `command`, the options of `locate` with underscores for dashes, and
`config`, the fields of the estimator. The result.json of a run is such a file. The command line
overrides the file, the file defaults.
"""

import dataclasses
import functools
import json
import typing
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pydantic
import tyro

from gsc_jax.cli.options import Locate
from gsc_jax.cli.results import result_file
from gsc_jax.estimators import METHODS, Method
from gsc_jax.estimators.protocol import Estimator
from gsc_jax.io.files import existing_file
from gsc_jax.io.tables import PARSERS, read_table
from gsc_jax.io.validation import naming, one_line, shown
from gsc_jax.scene import InputError

Table = dict[str, Any]
METHOD_OPTIONS = ("threshold", "mask_rule", "lambda2", "epochs")
"""Options whose meaning or default depends on the method."""
SHARED_FIELDS = ("near", "seed")
"""Options that are fields of every estimator."""
STRICT = pydantic.ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)
_File = pydantic.create_model("_File", __config__=STRICT, command=(Table, {}), config=(Table, {}))


@dataclasses.dataclass(frozen=True, kw_only=True)
class ConfigFile:
    """The method that a file for `--config` configures, options of `locate`, and the estimator."""

    method: Method
    command: Table
    estimator: Estimator

    def options(self) -> Locate:
        """Defaults for the command line; `tyro.MISSING` for required options that are not set."""
        shared = {name: getattr(self.estimator, name) for name in SHARED_FIELDS}
        return Locate(**{"scene": tyro.MISSING, "out": tyro.MISSING, **shared, **self.command})

    def for_method(self, method: Method) -> "ConfigFile":
        """The file without what depends on its method, if that is another one."""
        if method == self.method:
            return self
        kept = {k: v for k, v in self.command.items() if k not in METHOD_OPTIONS}
        shared = {name: getattr(self.estimator, name) for name in SHARED_FIELDS}
        estimator = replaced(METHODS[method], shared)
        return ConfigFile(method=method, command={**kept, "method": method}, estimator=estimator)


def read_config_file(path: str | Path) -> ConfigFile:
    """Read a result.json, its folder, or a .toml or .json file with `command` and `config`.

    An unknown key, a wrong type or a contradiction raises InputError.
    """
    path = Path(path)
    path = result_file(path, "result.json") if path.is_dir() else path
    existing_file(path, expected="a configuration (.toml or .json)")
    if path.suffix.lower() not in PARSERS:
        raise InputError(f"{path}: expected a .toml or .json, or a result.json of `locate`")
    content = read_table(path, remedy="correct the file")
    if not isinstance(content, dict):
        raise InputError(f"{path}: expected the tables command and config")
    report = {"versions", "outputs"} <= set(content)
    tables = {name: content.get(name, {}) for name in ("command", "config")} if report else content
    tables = _checked(_File, tables, str(path), hint="options go below a line [command]")
    command = _checked(_model(Locate), tables.get("command", {}), f"{path}: command")
    command.pop("config", None)  # its content is in the table `config`
    method = _method(path, command, tables.get("config", {}))
    base = METHODS[method]
    fields = _model(type(base))
    hint = f"fields of the method {method}: {', '.join(fields.model_fields)}"
    config = _checked(fields, tables.get("config", {}), f"{path}: config", hint=hint)
    if command.get("all_views") or command.get("views"):
        if config.get("tolerance"):
            raise InputError(f"{path}: config.tolerance and a number of views exclude each other")
        config.pop("tolerance", None)  # 0 in a result.json, as it follows from the options
    _check_settings(path, command, config)
    with naming(f"{path}: config", errors=ValueError):
        if report:
            _reopen_schedule(base, config, content.get("judged_views"))
        estimator = replaced(base, config)
    return ConfigFile(method=method, command=command, estimator=estimator)


@functools.cache
def _model(kind: type) -> type[pydantic.BaseModel]:
    """A model with the fields of a dataclass, all of them optional."""
    hints = typing.get_type_hints(kind)
    kinds = [(field.name, hints[field.name]) for field in dataclasses.fields(kind)]
    fields: Table = {k: (_model(x) if dataclasses.is_dataclass(x) else x, None) for k, x in kinds}
    return pydantic.create_model(kind.__name__, __config__=STRICT, **fields)


def _checked(model: type[pydantic.BaseModel], table: Table, where: str, *, hint: str = "") -> Table:
    """The keys of a table with values of the types of a model."""
    try:  # as JSON, in which strict types still allow a list for a tuple and a text for a path
        valid = model.model_validate_json(json.dumps(table, default=str))
    except pydantic.ValidationError as error:
        nested = len(error.errors()[0]["loc"]) > 1  # in a table that has other keys than this one
        line = one_line(error, where, table, known=() if nested else model.model_fields)
        unknown = error.errors()[0]["type"] == "extra_forbidden" and not nested
        raise InputError(f"{line}; {hint}" if hint and unknown else line) from error
    return valid.model_dump(exclude_unset=True)


def _method(path: Path, command: Table, config: Mapping[str, Any]) -> Method:
    """The method of a file, which both of its tables may name."""
    name = config.get("name")
    if name is not None and name not in list(METHODS):
        raise InputError(f"{path}: config.name: expected {', '.join(METHODS)}, found {shown(name)}")
    method = command.get("method", name or "robust")
    if name not in (None, method):
        raise InputError(f"{path}: command.method is {method}, but config.name is {name}")
    return method


def _check_settings(path: Path, command: Table, config: Table) -> None:
    """Refuse different values of one setting, and texts that --help could not show as they are."""
    given = {**config, "lambda2": config.get("loop", {}).get("lambda2")}
    for name in (*SHARED_FIELDS, *METHOD_OPTIONS):
        one, other = command.get(name), given.get(name)
        if None not in (one, other) and one != other:
            raise InputError(f"{path}: {name} is {one} in command and {other} in config")
    for name, value in command.items():
        parts = value if isinstance(value, tuple) else (value,)
        if not all(str(part).isprintable() for part in parts):
            raise InputError(f"{path}: command.{name}: expected printable text, found {value!r}")


def _reopen_schedule(base: Estimator, config: Table, views: Any) -> None:
    """Unset the start of the 3D loss if it is the default for the number of views of the run."""
    loop = config.get("loop")
    if loop is None or not isinstance(views, int):
        return
    unset = replaced(base, {**config, "loop": {**loop, "contrastive_start": None}})
    default = typing.cast(Any, unset.for_views(views)).loop.contrastive_start
    if loop.get("contrastive_start") == default:
        loop["contrastive_start"] = None


def replaced(base: Any, changes: Table) -> Any:
    """A dataclass with some fields replaced; a table replaces fields of a nested dataclass."""
    nested = {
        name: replaced(getattr(base, name), value)
        for name, value in changes.items()
        if dataclasses.is_dataclass(getattr(base, name))
    }
    return dataclasses.replace(base, **{**changes, **nested})
