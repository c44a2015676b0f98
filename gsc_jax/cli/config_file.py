"""`--config`: what a run of `locate` shall be, from a file instead of from who types.

The file has two tables: `command`, the options of `locate` with underscores for dashes, and
`config`, the configuration of the method, some of whose fields have no flag. The result.json of a
run is such a file, so a run can be repeated, with something else typed or not. What is typed goes
before what the file says, and that before the defaults.

Where another method is typed than the file is about, what only the other one understands is left
out, and said: the same scene, cameras and masks, once more by another method.
"""

import dataclasses
import json
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import tyro

from gsc_jax.cli.fields import changed, checked, known_keys
from gsc_jax.cli.options import Locate
from gsc_jax.estimators.gschecker import CONFIGS, Config, Method, MethodConfig
from gsc_jax.io.files import existing_file
from gsc_jax.loop import resolved
from gsc_jax.scene import InputError

OF_A_METHOD = ("threshold", "mask_rule", "lambda2", "epochs")
"""Options that mean something else to another method, or nothing."""
SHARED = ("near", "seed")
"""Options that have a value of their own, typed or not, and a field in every configuration."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Settings:
    """What a file says.

    Attributes:
        path: The file.
        method: The method that it is about.
        command: Some options of `locate`, by name.
        config: The configuration of the method.
    """

    path: Path
    method: Method
    command: dict[str, Any]
    config: Config

    def default(self) -> Locate:
        """The options for who types none; `tyro.MISSING` where they cannot do without."""
        required = {"scene": tyro.MISSING, "out": tyro.MISSING}
        own = {name: getattr(self.config, name) for name in SHARED}
        return Locate(**{**required, **own, **self.command})

    def about(self, method: Method) -> "Settings":
        """What of it is true of a method, be it another one."""
        if method == self.method:
            return self
        command = {name: said for name, said in self.command.items() if name not in OF_A_METHOD}
        shared = {name: getattr(self.config, name) for name in SHARED}
        config = dataclasses.replace(CONFIGS[method], **shared)
        return Settings(
            path=self.path, method=method, command={**command, "method": method}, config=config
        )


def read_settings(path: str | Path) -> Settings:
    """Reads a file for `--config`.

    Args:
        path: A result.json, the folder of one, or a .toml or .json with `command` and `config`.

    Raises:
        InputError: if there is none, or a key or value in it is none that `locate` understands.
    """
    path = Path(path)
    path = path / "result.json" if path.is_dir() else path
    said = _read(existing_file(path, expected="a configuration (.toml or .json)"))
    report = "versions" in said and "outputs" in said  # by its other keys a result.json
    if not report:
        _refuse_bare_options(path, said)
        known_keys(said, ["command", "config"], str(path))
    command = checked(said.get("command", {}), Locate, f"{path}: command")
    command.pop("config", None)  # what that one said is in the other table
    table = _explicit(command, said.get("config", {}))
    method = _method(path, command, table)
    config = changed(_base(path, method, table), table, f"{path}: config")
    _refuse_contradictions(path, command, table)
    if report and isinstance(config, MethodConfig):
        config = _unresolved(config, said.get("judged_views"))
    return Settings(path=path, method=method, command=command, config=config)


def _refuse_bare_options(path: Path, said: Mapping[str, Any]) -> None:
    """Refuses options that belong into the table `command`."""
    options = {field.name for field in dataclasses.fields(Locate)}
    for key in said:
        if key in options - {"config"}:
            raise InputError(f"{path}: {key!r} is in no table; put it below a line [command]")


def _read(path: Path) -> dict[str, Any]:
    readers = {".json": json.loads, ".toml": tomllib.loads}
    read = readers.get(path.suffix.lower())
    if read is None:
        raise InputError(f"{path}: expected a .toml or .json, or a result.json of `locate`")
    try:
        said = read(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:  # also of text that is not UTF-8
        kind = path.suffix[1:].upper()
        raise InputError(
            f"{path}: is not valid {kind} ({error}); mend it or write it again"
        ) from error
    if not isinstance(said, dict):
        raise InputError(f"{path}: holds no tables, expected command and config")
    return said


def _method(path: Path, command: Mapping[str, Any], table: Any) -> Method:
    """The method that a file is about, which it may name twice."""
    name = table.get("name") if isinstance(table, Mapping) else None
    if name is not None and name not in CONFIGS:
        raise InputError(
            f"{path}: config.name: expected one of {', '.join(CONFIGS)}, found {name!r}"
        )
    method = command.get("method", name or "robust")
    if name not in (None, method):
        raise InputError(f"{path}: command is of the method {method}, but config of {name}")
    return method


def _base(path: Path, method: Method, table: Any) -> Config:
    """The method as it is by default, once no key of the table is one of the others' alone."""
    base = CONFIGS[method]
    own = {field.name for field in dataclasses.fields(base)}
    for other, config in CONFIGS.items():
        theirs = {field.name for field in dataclasses.fields(config)} - own
        for key in table if isinstance(table, Mapping) else ():
            if key in theirs:
                raise InputError(
                    f"{path}: config.{key}: is of the method {other}, found in a configuration of "
                    f'{method}; say method = "{other}" in command, or leave it out'
                )
    return base


def _refuse_contradictions(path: Path, command: Mapping[str, Any], config: Mapping) -> None:
    """Refuses a file that says one thing in the one table and another in the other."""
    loop = config.get("loop", {})
    there = {**config, "lambda2": loop.get("lambda2")}
    for name in (*SHARED, *OF_A_METHOD):
        one, other = command.get(name), there.get(name)
        if one is not None and other is not None and one != other:
            raise InputError(
                f"{path}: says {name} twice, {one} in command and {other} in config; change both, "
                "or leave one of them out"
            )
    if (command.get("all_views") or command.get("views")) and config.get("tolerance"):
        raise InputError(
            f"{path}: config.tolerance {config['tolerance']} is for looking at no more views than "
            "it takes, but command says how many; leave one of them out"
        )


def _explicit(command: Mapping[str, Any], table: Any) -> Any:
    """The configuration without the tolerance that follows from a number of views."""
    follows = command.get("all_views") or command.get("views")
    if follows and isinstance(table, Mapping) and table.get("tolerance") == 0:
        return {name: value for name, value in table.items() if name != "tolerance"}
    return table


def _unresolved(config: MethodConfig, views: Any) -> MethodConfig:
    """The configuration with that left open which the number of views decided."""
    if not isinstance(views, int):
        return config
    left_open = dataclasses.replace(config.loop, contrastive_start=None)
    by_default = resolved(left_open, config.epochs * views)
    return dataclasses.replace(config, loop=left_open) if by_default == config.loop else config
