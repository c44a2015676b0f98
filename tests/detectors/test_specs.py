"""Specs: files and tables that make one, and what is said of those that do not."""

import tomllib

import pytest

from gsc_jax.detectors.specs import OnnxSpec, read_spec, spec_beside
from gsc_jax.scene import InputError


def one_line(caught) -> str:
    message = str(caught.value)
    assert "\n" not in message
    return message


def test_a_toml_table_makes_a_spec():
    table = tomllib.loads(
        'size = [384, 512]\nfit = "pad"\noutput = "m"\n'
        "mean = [0.485, 0.456, 0.406]\nstd = [1, 1, 1]\n"
    )
    spec = OnnxSpec.from_table(table)
    assert spec == OnnxSpec(
        size=(384, 512), fit="pad", mean=(0.485, 0.456, 0.406), std=(1, 1, 1), output="m"
    )
    assert hash(spec)
    with pytest.raises(InputError, match="unknown field 'sise'"):
        OnnxSpec.from_table({"sise": 3})


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("size", 0),
        ("size", "512"),
        ("size", (512,)),
        ("size", (512, -1)),
        ("size", True),
        ("fit", "crop"),
        ("multiple_of", 0),
        ("channels", "RGB"),
        ("layout", "CHW"),
        ("scale", 0.0),
        ("scale", float("nan")),
        ("mean", (0.5, 0.5)),
        ("mean", 0.5),
        ("std", (1.0, 0.0, 1.0)),
        ("std", (1.0, "1", 1.0)),
        ("input", 3),
        ("output", -1),
        ("output", 1.5),
        ("activation", "relu"),
        ("channel", -1),
        ("threshold", 0.0),
        ("threshold", 1),
    ],
)
def test_values_that_make_no_spec_are_refused(field, value):
    with pytest.raises(InputError, match=f"detector spec: {field} is ") as caught:
        OnnxSpec.from_table({field: value})
    assert repr(value) in one_line(caught)


def test_contradictions_are_refused():
    with pytest.raises(InputError, match="multiples of multiple_of = 32"):
        OnnxSpec(size=500, multiple_of=32)
    with pytest.raises(InputError, match=r"size is .* expected nothing with fit"):
        OnnxSpec(size=512, fit="none")
    with pytest.raises(InputError, match="multiple_of is 8, expected 1 with fit"):
        OnnxSpec(multiple_of=8, fit="none")


def test_a_file_makes_a_spec(tmp_path):
    path = tmp_path / "net.toml"
    path.write_text('# as exported\nsize = 512\nchannels = "bgr"\n', encoding="utf-8")
    assert read_spec(path) == OnnxSpec(size=512, channels="bgr")
    path.write_text("")
    assert read_spec(str(path)) == OnnxSpec()


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("size = \n", "no TOML"),
        ("size = 512\nsize = 3\n", "no TOML"),
        ("size = 0\n", "size is 0, expected a positive integer"),
        ("Sice = 3\n", "unknown field 'Sice' (did you mean 'size'?), expected some of size, fit"),
        ("treshold = 0.3\n", "(did you mean 'threshold'?)"),
        ("qqq = 1\n", "unknown field 'qqq', expected some of"),
        ("[size]\nheight = 3\n", "size is {'height': 3}, expected"),
        ("[net]\nsize = 3\n", "unknown field 'net', expected"),
    ],
)
def test_files_that_make_no_spec_are_refused(tmp_path, text, reason):
    path = tmp_path / "net.toml"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        read_spec(path)
    assert one_line(caught).startswith(f"{path}: ")
    assert reason in one_line(caught)


def test_files_that_are_no_text_are_refused(tmp_path):
    (tmp_path / "net.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="no TOML"):
        read_spec(tmp_path / "net.toml")
    with pytest.raises(InputError, match=r"other.toml: no such file, expected a detector spec"):
        read_spec(tmp_path / "other.toml")


def test_the_spec_beside_a_model_has_its_name(tmp_path):
    model = tmp_path / "net.v2.onnx"
    for name in ("net.toml", "net.v2.onnx.toml", "other.toml"):
        (tmp_path / name).touch()
    assert spec_beside(model) is None
    (tmp_path / "net.v2.toml").touch()
    assert spec_beside(model) == tmp_path / "net.v2.toml"
    assert spec_beside(".") is None
    assert spec_beside("") is None
