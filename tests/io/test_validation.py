"""Errors of pydantic as one line for people."""

from typing import Literal

import pydantic
import pytest

from gsc_jax.io.validation import one_line


class Inner(pydantic.BaseModel, extra="forbid"):
    rates: list[float] = []


class Outer(pydantic.BaseModel, extra="forbid"):
    name: Literal["a", "b"]
    inner: Inner = Inner()
    either: int | list[int] | None = None


@pytest.mark.parametrize(
    ("given", "line"),
    [
        ({"name": "c"}, "run.toml: name: expected 'a' or 'b', found 'c'"),
        ({}, "run.toml: 'name' is missing"),
        ({"name": "a", "nane": 1}, "run.toml: unknown key 'nane' (did you mean 'name'?)"),
        ({"name": "a", "inner": {"x": 1}}, "run.toml: unknown key 'inner.x'"),
        (
            {"name": "a", "inner": {"rates": [1, "x"]}},
            "run.toml: inner.rates[1]: expected a valid number, unable to parse string as a "
            "number, found 'x'",
        ),
    ],
)
def test_line_names_file_key_expected_and_found(given, line):
    with pytest.raises(pydantic.ValidationError) as caught:
        Outer.model_validate(given)
    assert one_line(caught.value, "run.toml", given, known=["name"]).startswith(line)


def test_line_names_all_types_of_a_union():
    given = {"name": "a", "either": "x"}
    with pytest.raises(pydantic.ValidationError) as caught:
        Outer.model_validate(given)
    line = one_line(caught.value, "run.toml", given)
    assert line.startswith("run.toml: either: expected a valid integer")
    assert "or expected a valid list" in line
    assert line.endswith("found 'x'")
