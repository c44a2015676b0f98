"""Valid and invalid specs, and the specs that the documentation shows."""

import dataclasses
import re
import tomllib
from pathlib import Path

import pytest

from gsc_jax.detectors.specs import PRESETS, OnnxSpec, read_spec, spec_beside
from gsc_jax.scene import InputError

PAGE = (Path(__file__).parents[2] / "docs" / "detectors.md").read_text(encoding="utf-8")


def test_toml_table_is_a_spec():
    table = tomllib.loads(
        'size = [384, 512]\nfit = "pad"\noutput = "m"\n'
        "mean = [0.485, 0.456, 0.406]\nstd = [1, 1, 1]\n"
    )
    spec = OnnxSpec.from_table(table)
    assert spec == OnnxSpec(
        size=(384, 512), fit="pad", mean=(0.485, 0.456, 0.406), std=(1, 1, 1), output="m"
    )
    assert hash(spec)
    assert OnnxSpec(size=512).size == (512, 512)
    assert dataclasses.replace(PRESETS["mvss-net"], output=0).channels == "bgr"


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("size", 0),
        ("size", 65_537),
        ("scale", 1e300),
        ("size", True),
        ("fit", "crop"),
        ("channels", "RGB"),
        ("scale", 0.0),
        ("scale", float("nan")),
        ("mean", (0.5, 0.5)),
        ("input", 3),
        ("output", -1),
        ("activation", "relu"),
        ("channel", -1),
        ("threshold", 1),
    ],
)
def test_invalid_value_is_refused_with_its_field(field, value):
    with pytest.raises(InputError) as caught:
        OnnxSpec.from_table({field: value})
    message = str(caught.value)
    assert message.startswith(f"detector spec: {field}: ")
    assert message.endswith(f"found {value!r}")
    assert "\n" not in message
    with pytest.raises(ValueError, match=field):
        OnnxSpec(**{field: value})


@pytest.mark.parametrize(
    ("table", "reason"),
    [
        ({"std": (1.0, 0.0, 1.0)}, r"std\[1\]: .*found 0"),
        ({"std": (1.0, "1", 1.0)}, r"std\[1\]: .*found '1'"),
        ({"size": (512, -1)}, r"size"),
        ({"size": 500, "multiple_of": 32}, "size: expected multiples of 32"),
        ({"size": 512, "fit": "none"}, "size and multiple_of"),
        ({"multiple_of": 8, "fit": "none"}, "size and multiple_of"),
        ({"Sice": 3}, r"unknown key 'Sice' \(did you mean 'size'\?\)"),
        ({"qqq": 1}, "unknown key 'qqq', expected one of size, fit"),
    ],
)
def test_invalid_table_is_refused(table, reason):
    with pytest.raises(InputError, match=reason):
        OnnxSpec.from_table(table)


def test_file_is_a_spec(tmp_path):
    path = tmp_path / "net.toml"
    path.write_text('# as exported\nsize = 512\nchannels = "bgr"\n', encoding="utf-8")
    assert read_spec(path) == OnnxSpec(size=512, channels="bgr")
    path.write_text("")
    assert read_spec(str(path)) == OnnxSpec()


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"size = \n", "not valid TOML"),
        (b"size = 512\nsize = 3\n", "not valid TOML"),
        (b"\xff\xfe\x00", "not valid TOML"),
        (b"size = 0\n", "size: expected greater than 0"),
        (b"[net]\nsize = 3\n", "unknown key 'net'"),
    ],
)
def test_invalid_file_is_refused(tmp_path, content, reason):
    path = tmp_path / "net.toml"
    path.write_bytes(content)
    with pytest.raises(InputError, match=reason) as caught:
        read_spec(path)
    assert str(caught.value).startswith(f"{path}: ")
    with pytest.raises(InputError, match=r"other\.toml: no such file"):
        read_spec(tmp_path / "other.toml")


def test_spec_beside_a_model_has_its_name(tmp_path):
    model = tmp_path / "net.v2.onnx"
    for name in ("net.toml", "net.v2.onnx.toml", "other.toml"):
        (tmp_path / name).touch()
    assert spec_beside(model) is None
    (tmp_path / "net.v2.toml").touch()
    assert spec_beside(model) == tmp_path / "net.v2.toml"
    assert spec_beside(".") is None
    assert spec_beside("") is None


def test_documented_defaults_are_the_defaults():
    table = dict(re.findall(r"^\| `(\w+)` \| (none|`[^`]*`) \|", PAGE, flags=re.MULTILINE))
    given = {
        name: tomllib.loads(f"it = {default.strip('`')}")["it"]
        for name, default in table.items()
        if default != "none"
    }
    assert list(table) == [field.name for field in dataclasses.fields(OnnxSpec)]
    assert OnnxSpec.from_table(given) == OnnxSpec()


def test_documented_specs_and_presets_exist():
    specs = re.findall(r"```toml\n(.*?)```", PAGE, flags=re.DOTALL)
    resized = dataclasses.replace(PRESETS["trufor"], fit="resize", size=(480, 640))
    assert resized in [OnnxSpec.from_table(tomllib.loads(spec)) for spec in specs]
    assert set(re.findall(r"--detector \S+ --preset ([\w-]+)", PAGE)) == set(PRESETS)
