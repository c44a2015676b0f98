"""Descriptions of networks and configurations of runs with damage, and checks of them."""

import dataclasses
import functools
import json
import math
from pathlib import Path
from random import Random
from typing import Any

from fuzz.damage import damaged_utf8
from fuzz.mutate import damaged_text, damaged_tree, json_text, toml_text

from gsc_jax.cli.config_file import read_config_file
from gsc_jax.detectors.specs import read_spec
from gsc_jax.estimators import METHODS


def _spec_tree() -> Any:
    tree = {"size": [64, 32], "fit": "pad", "multiple_of": 2, "channels": "bgr", "layout": "NHWC"}
    tree |= {"scale": 0.5, "mean": [0.1, 0.2, 0.3], "std": [1.0, 2.0, 3.0], "input": "image"}
    return tree | {"output": 1, "activation": "softmax", "channel": 1, "threshold": 0.4}


@functools.cache
def _config_trees() -> list[Any]:
    """Of the kind that people write, and as in the result.json of every method."""
    own = {"command": {"scene": "a.ply", "views": 3, "scale": 0.5, "masks": "m", "near": 0.1}}
    trees: list[Any] = [own | {"config": {"classes": [4, 8], "smoothing": 5.0}}]
    for method, estimator in METHODS.items():
        config = json.loads(json.dumps(dataclasses.asdict(estimator)))  # pyright: ignore[reportArgumentType]
        command = {"method": method, "detector": ["native"], "seed": config["seed"]}
        report = {"versions": {}, "outputs": [], "judged_views": 7, "verdict": 0.5}
        trees.append({"command": command, "config": config} | report)
    return trees


def make_config(rng: Random | None, folder: Path) -> Path:
    if rng is None:
        return _write(folder / "run.json", json.dumps(_config_trees()[1]))
    tree = damaged_tree(rng, rng.choice(_config_trees()))
    if rng.random() < 0.5:
        return _write(folder / "run.json", json_text(rng, tree))
    text = toml_text(rng, tree)
    return _write(folder / "run.toml", damaged_text(rng, text) if rng.random() < 0.3 else text)


def check_config(path: Path) -> None:
    content = read_config_file(path)
    content.options()
    for method in METHODS:
        _check_finite(dataclasses.asdict(content.for_method(method).estimator))  # pyright: ignore[reportArgumentType]


def check_spec(path: Path) -> None:
    _check_finite(dataclasses.asdict(read_spec(path)))


def _check_finite(value: Any) -> None:
    if isinstance(value, dict | list | tuple):
        for entry in value.values() if isinstance(value, dict) else value:
            _check_finite(entry)
    elif isinstance(value, int | float):
        assert math.isfinite(value)
        assert abs(value) < 2**63


def spec_seeds() -> list[bytes]:
    return [toml_text(Random(0), _spec_tree()).encode()]


def damaged_spec(rng: Random, data: bytes) -> bytes:
    if rng.random() < 0.3:
        return damaged_utf8(rng, data)
    return toml_text(rng, damaged_tree(rng, _spec_tree())).encode("utf-8", "replace")


def _write(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8", errors="replace")
    return path
