"""Tables that cannot be printed, validated or held in memory are refused when they are read."""

import pytest

from gsc_jax.io.tables import MAX_DEPTH, read_table
from gsc_jax.scene import InputError

NESTED = "[" * 10**5 + "]" * 10**5


def test_values_are_read_with_and_without_a_byte_order_mark(tmp_path):
    for name, text in (("a.json", '{"a": [1, 2.5]}'), ("a.toml", "a = [1, 2.5]")):
        (tmp_path / name).write_text(text, encoding="utf-8-sig")
        assert read_table(tmp_path / name, remedy="") == {"a": [1, 2.5]}
    deep = "[" * MAX_DEPTH + "]" * MAX_DEPTH
    (tmp_path / "deep.json").write_text(deep)
    assert str(read_table(tmp_path / "deep.json", remedy="")) == deep


@pytest.mark.parametrize(
    ("name", "content", "problem"),
    [
        ("a.json", b"{", r"not valid JSON \(Expecting .*\); export it"),
        ("a.json", b'"\xff"', "not valid JSON"),
        ("a.json", NESTED.encode(), "not valid JSON"),
        ("a.json", b"[" * (MAX_DEPTH + 1) + b"]" * (MAX_DEPTH + 1), "levels deep"),
        ("a.json", b'{"width": 1' + b"0" * 400 + b"}", "64 bits"),
        ("a.json", b"1" * 5000, "not valid JSON"),
        ("a.toml", b"a = " + NESTED.encode(), "not valid TOML"),
        ("a.toml", b"a = 0x" + b"f" * 5000, "64 bits"),
        ("a.toml", b".".join([b"a"] * 500) + b" = 1", "levels deep"),
        ("missing.json", None, "no such file"),
    ],
)
def test_damaged_files_are_refused_in_one_line(tmp_path, name, content, problem):
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=problem) as error:
        read_table(tmp_path / name, remedy="export it")
    assert str(error.value).startswith(f"{tmp_path / name}: ")
    assert len(str(error.value)) < 600
    assert "\n" not in str(error.value)


def test_a_tree_beyond_the_memory_is_refused_before_it_is_parsed(tmp_path):
    (tmp_path / "a.json").write_text("[" + "{}," * 1000 + "{}]")
    with pytest.raises(InputError, match="of memory"):
        read_table(tmp_path / "a.json", remedy="", max_bytes=10**5)
    assert len(read_table(tmp_path / "a.json", remedy="", max_bytes=10**6)) == 1001
