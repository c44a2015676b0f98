"""Every public name: documentation, keyword-only options, immutability, float32."""

import dataclasses
import inspect
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest
from strategies import camera, random_scene

import gsc_jax
from gsc_jax.evidence.masks import Labelled

PUBLIC = {name: getattr(gsc_jax, name) for name in gsc_jax.__all__}
CLASSES = {name: value for name, value in PUBLIC.items() if inspect.isclass(value)}
FUNCTIONS = {name: value for name, value in PUBLIC.items() if inspect.isfunction(value)}
CALLABLES = {
    name: value
    for name, value in (CLASSES | FUNCTIONS).items()
    if not (inspect.isclass(value) and issubclass(value, Exception))
}
DATACLASSES: dict[str, Any] = {
    name: value for name, value in CLASSES.items() if dataclasses.is_dataclass(value)
}
RENDERERS = {
    name: value
    for name, value in FUNCTIONS.items()
    if list(inspect.signature(value).parameters)[:2] == ["gaussians", "camera"]
}
DATA_WITH_A_DEFAULT = {("OnnxDetector", "spec")}
"""Second argument of a constructor that may be left out."""
LAZY = ["gsply", "jax", "matplotlib", "onnxruntime", "plyfile", "pycolmap", "scipy", "skimage"]


def parameters(function) -> list[inspect.Parameter]:
    return list(inspect.signature(function).parameters.values())


def members(cls) -> dict:
    """Public methods and properties that a class of ours defines itself."""
    return {
        name: value
        for name, value in vars(cls).items()
        if not name.startswith("_")
        and (inspect.isfunction(value) or isinstance(value, property))
        and (getattr(value, "fget", None) or value).__module__.startswith("gsc_jax")
    }


def test_all_lists_the_public_names():
    stub = Path(gsc_jax.__file__).with_suffix(".pyi").read_text("utf-8")
    declared = set(re.findall(r'"(\w+)"', stub.partition("__all__")[2]))
    assert set(gsc_jax.__all__) == declared
    assert {"Camera", "Gaussians", "accumulate", "render", "render_features"} <= declared
    with pytest.raises(AttributeError, match="nothing"):
        gsc_jax.nothing  # noqa: B018 # pyright: ignore[reportAttributeAccessIssue]


@pytest.mark.parametrize("name", CLASSES | FUNCTIONS)
def test_public_names_are_documented(name):
    value = PUBLIC[name]
    doc = inspect.getdoc(value) or ""
    # A dataclass without a docstring is given its signature as one.
    assert doc, f"{name} has no docstring"
    assert not doc.startswith(f"{name}("), f"{name} has no docstring"
    assert doc.splitlines()[0].endswith("."), f"the first line on {name} is no sentence"
    for member, method in members(value).items() if name in CLASSES else ():
        assert inspect.getdoc(method), f"{name}.{member} has no docstring"


@pytest.mark.parametrize("name", FUNCTIONS)
def test_every_argument_and_result_is_documented(name):
    doc = inspect.getdoc(FUNCTIONS[name]) or ""
    for parameter in parameters(FUNCTIONS[name]):
        assert f"    {parameter.name}: " in doc, f"{name} does not say what {parameter.name} is"
    if inspect.signature(FUNCTIONS[name]).return_annotation is not None:
        assert "Returns:" in doc, f"{name} does not say what it returns"


@pytest.mark.parametrize("name", DATACLASSES)
def test_every_field_is_documented(name):
    # A class documents its own fields; those that it inherits are in the docs of its bases.
    doc = "\n".join(inspect.getdoc(cls) or "" for cls in DATACLASSES[name].__mro__)
    for field in dataclasses.fields(DATACLASSES[name]):
        assert f"    {field.name}: " in doc, f"{name} does not say what {field.name} is"


@pytest.mark.parametrize("name", CALLABLES)
def test_options_are_keyword_only(name):
    for parameter in parameters(CALLABLES[name]):
        if (name, parameter.name) not in DATA_WITH_A_DEFAULT:
            is_option = parameter.default is not inspect.Parameter.empty
            assert not is_option or parameter.kind is inspect.Parameter.KEYWORD_ONLY, (
                f"{name}: the option {parameter.name} can be given by position"
            )


@pytest.mark.parametrize("name", DATACLASSES)
def test_results_and_parameters_are_immutable(name):
    cls = DATACLASSES[name]
    instance = object.__new__(cls)
    with pytest.raises(dataclasses.FrozenInstanceError):
        setattr(instance, dataclasses.fields(cls)[0].name, None)


@pytest.mark.parametrize("name", RENDERERS)
def test_results_are_float32_whatever_the_type_of_the_arguments(name):
    gaussians, view = random_scene(20), camera()
    known = {
        "features": np.ones((20, 2)),
        "feature": np.ones(20),
        "maps": np.ones((15, 17, 2)),
        "scored": Labelled(np.ones(20), np.ones(20, bool)),
    }
    required = [p.name for p in parameters(RENDERERS[name])[2:] if p.default is p.empty]
    result = RENDERERS[name](gaussians, view, *(known[parameter] for parameter in required))
    dtypes = {leaf.dtype for leaf in jax.tree.leaves(result)}
    assert dtypes
    assert dtypes <= {np.dtype(t) for t in ("float32", "int32", "bool")}


def test_the_renderers_of_the_contract_are_among_those_checked():
    assert {"accumulate", "render", "render_features"} <= set(RENDERERS)


def test_importing_the_package_is_lazy():
    code = f"import sys, gsc_jax; print([m for m in {LAZY} if m in sys.modules])"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"


def test_functions_keep_their_names_when_modules_of_the_same_name_are_imported():
    code = "import gsc_jax.locate, gsc_jax.render.tiles; print(gsc_jax.locate, gsc_jax.render)"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.count("<function") == 2
