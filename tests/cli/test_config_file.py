"""--config: repeat a run, override its options, files written by hand, and invalid files."""

import contextlib
import dataclasses
import json
from pathlib import Path

import pytest
from cli_case import FIXTURES, contents, given, network, refused, report, run, unparsable

from gsc_jax.cli.config_file import read_config_file
from gsc_jax.estimators import METHODS, RobustEstimator
from gsc_jax.scene import InputError

case, found, own_cache = FIXTURES
pytestmark = pytest.mark.usefixtures("own_cache")


def again(file: Path, out: Path, *argv: object) -> dict:
    """The report of a run with --config and further arguments."""
    assert run("locate", "--config", file, "--out", out, *argv).code == 0
    return report(out)


def same(one: Path, other: Path) -> bool:
    files = ("labels.npy", "tamper.npy", "tamper.ply")
    return all((one / name).read_bytes() == (other / name).read_bytes() for name in files)


@pytest.mark.parametrize(
    "argv",
    [
        [],
        ["--method", "paper", "--lambda2", 2, "--epochs", 3, "--seed", 4, "--scale", 0.5],
        ["--method", "official", "--threshold", 0.3, "--mask-rule", "share", "--views", 2],
        ["--detector", "none", "--near", 0.1],
    ],
    ids=["robust", "paper", "official", "masks alone"],
)
def test_a_repeated_run_gives_the_same_labels(case, tmp_path, argv):
    one, other = tmp_path / "one", tmp_path / "other"
    assert run(*given(case), *argv, "--out", one).code == 0
    first, second = report(one), again(one / "result.json", other)
    assert same(one, other)
    assert second["config"] == first["config"]
    changed = {"out": str(other), "config": str(one / "result.json")}
    assert second["command"] == first["command"] | changed
    # Repeated in place, from a report of a repeated run.
    before = {name: data for name, data in contents(other).items() if name.endswith(".npy")}
    assert run("locate", "--config", other).code == 0
    assert {name: contents(other)[name] for name in before} == before


def test_a_repeated_run_with_a_network_keeps_its_spec_and_views(case, tmp_path):
    model, spec = network(tmp_path / "red.onnx"), tmp_path / "red.toml"
    spec.write_text('channels = "bgr"\n')
    argv = given(case, masks=None)
    one = tmp_path / "one"
    assert run(*argv, "--detector", "native", model, "--all-views", "--out", one).code == 0
    second = again(one, tmp_path / "other")
    assert same(one, tmp_path / "other")
    assert second["command"]["spec"] == str(spec)
    assert (second["command"]["all_views"], second["config"]["tolerance"]) == (True, 0)
    third = again(one, tmp_path / "third", "--no-all-views")
    assert third["config"]["tolerance"] == RobustEstimator().tolerance


def test_options_override_the_file_and_the_file_overrides_defaults(case, tmp_path):
    file = tmp_path / "run.toml"
    file.write_text(
        f"""
        [command]
        scene = "{case / "scene.ply"}"
        cameras = "{case / "cameras.json"}"
        masks = "{case / "masks"}"
        views = 2
        scale = 0.5
        [config]
        threshold = 0.6
        classes = [2, 3]
        smoothing = 2
        seed = 5
        """
    )
    result = again(file, tmp_path / "a")
    assert (result["views"], result["per_view"][0]["width"]) == (2, 24)
    config = result["config"]
    assert (config["threshold"], config["classes"], config["smoothing"]) == (0.6, [2, 3], 2.0)
    assert (config["seed"], config["restarts"]) == (5, RobustEstimator().restarts)
    typed = ["--threshold", 0.7, "--seed", 6, "--views", "None", "--scale", 1]
    result = again(file, tmp_path / "b", *typed)
    assert (result["views"], result["per_view"][0]["width"]) == (3, 48)
    config = result["config"]
    assert (config["threshold"], config["classes"], config["seed"]) == (0.7, [2, 3], 6)


def test_another_method_drops_the_settings_of_the_method_of_the_file(case, tmp_path):
    one = tmp_path / "one"
    argv = ["--threshold", 0.7, "--near", 0.1, "--seed", 3]
    assert run(*given(case), *argv, "--out", one).code == 0
    answer = run("locate", "--config", one, "--method", "paper", "--out", tmp_path / "other")
    assert answer.code == 0
    assert "method robust" in answer.err
    config = report(tmp_path / "other")["config"]
    assert config["threshold"] == METHODS["paper"].threshold
    assert (config["near"], config["seed"]) == (0.1, 3)
    alone = tmp_path / "alone"
    assert run(*given(case), *argv[2:], "--method", "paper", "--out", alone).code == 0
    assert same(tmp_path / "other", alone)


def test_defaults_that_depend_on_the_number_of_views_are_resolved_again(case, tmp_path):
    one = tmp_path / "one"
    assert run(*given(case, method="paper"), "--out", one).code == 0
    assert report(one)["config"]["loop"]["contrastive_start"] == 5 * 3 // 2
    fewer = again(one, tmp_path / "fewer", "--views", 2)
    assert fewer["config"]["loop"]["contrastive_start"] == 5 * 2 // 2


def test_fields_of_a_nested_table(case, tmp_path):
    file = tmp_path / "own.toml"
    file.write_text("[command]\nmethod = 'paper'\n[config.loop]\ncontrastive_start = 1\n")
    assert run(*given(case), "--config", file, "--out", tmp_path / "own").code == 0
    loop = report(tmp_path / "own")["config"]["loop"]
    assert (loop["contrastive_start"], loop["lambda2"]) == (1, 10.0)


def test_a_prior_weight_of_zero_disables_the_attributes(case, tmp_path):
    file = tmp_path / "run.toml"
    file.write_text("[config]\nprior_weight = 0\n")
    assert run(*given(case), "--config", file, "--out", tmp_path / "out").code == 0
    assert report(tmp_path / "out")["attributes"] is None
    alone = given(case, masks=None, config=file)
    assert "no evidence" in refused(*alone, "--out", tmp_path / "no")
    assert "prior_weight" in refused(*alone, "--detector", "native", "--out", tmp_path / "no")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("[command]\nvews = 3", ("command: unknown key 'vews'", "'views'?")),
        ("[config]\ntreshold = 0.3", ("config: unknown key 'treshold'", "'threshold'?")),
        ("views = 3", ("unknown key 'views'", "[command]")),
        ("[command]\nviews = true", ("command: views:", "integer", "True")),
        ("[command]\nscale = nan", ("command: scale:", "finite number", "nan")),
        ("[command]\nmethod = 'magic'", ("command: method:", "'robust'", "'magic'")),
        ("[command]\ndetector = 'native'", ("command: detector:", "array", "'native'")),
        ("[command]\nviews = 0", ("--views 0",)),
        ("command = 3", ("command:", "found 3")),
        ("[config]\nclasses = [1]", ("config: classes must be", "(1,)")),
        ("[config]\nclasses = ['a']", ("config: classes[0]:", "integer")),
        ("[config.loop]\nlambda1 = 3", ("unknown key 'loop'", "the method robust")),
        ("[command]\nmethod = 'paper'\n[config.loop]\nlamda1 = 3", ("'loop.lamda1'",)),
        ("[command]\nmethod = 'paper'\n[config.loop]\nlambda2 = -3.0", ("lambda2 must be",)),
        ("[config]\nname = ['a']", ("config.name:", "['a']")),
        ("[config]\nname = 'mine'", ("config.name:", "robust, official, paper", "'mine'")),
        ("[command]\nmethod = 'paper'\n[config]\nname = 'robust'", ("paper", "robust")),
        ("[command]\nseed = 1\n[config]\nseed = 2", ("1 in command", "2 in config")),
        ("[command]\nviews = 2\n[config]\ntolerance = 0.1", ("config.tolerance",)),
        ("[command", ("not valid TOML",)),
    ],
)
def test_invalid_content(case, tmp_path, text, expected):
    file = tmp_path / "run.toml"
    file.write_text(text)
    message = refused(*given(case), "--config", file, "--out", tmp_path / "out")
    assert all(part in message for part in expected), message
    assert str(file) in message or "--views" in message
    assert not (tmp_path / "out").exists()


def test_an_unknown_key_of_the_loop_is_not_followed_by_the_names_of_the_outer_table(case, tmp_path):
    file = tmp_path / "run.toml"
    file.write_text("[command]\nmethod = 'paper'\n[config.loop]\nfoo = 1")
    message = refused(*given(case), "--config", file, "--out", tmp_path / "out")
    assert message.rstrip().endswith("unknown key 'loop.foo'"), message


@pytest.mark.parametrize(
    ("name", "content", "expected"),
    [
        ("run.yaml", "a: 1", "expected a .toml or .json"),
        ("run.json", "[]", "expected the tables"),
        ("edit.json", '{"command": {"edit": "removal"}}', "unknown key 'edit'"),
        ("run.json", '{"config": ' + "[" * 10**5 + "]" * 10**5 + "}", "not valid JSON"),
        ("run.json", '{"command": {"views": 1' + "0" * 400 + "}}", "64 bits"),
        ("run.toml", "a." * 500 + "a = 1", "levels deep"),
        ("run.toml", "[command]\nviews = 0x" + "f" * 5000, "64 bits"),
        ("run.toml", "x" * 5000 + " = 1", "unknown key 'xxx"),
    ],
)
def test_files_of_another_kind(case, tmp_path, name, content, expected):
    file = tmp_path / name
    assert "no such file" in refused(*given(case), "--config", file, "--out", tmp_path / "out")
    file.write_text(content)
    message = refused(*given(case), "--config", file, "--out", tmp_path / "out")
    assert f"{file}: " in message
    assert expected in message


def test_the_scene_and_the_folder_are_required(tmp_path):
    file = tmp_path / "run.toml"
    file.write_text("")
    message = unparsable("locate", "--config", file)
    assert "SCENE.ply" in message
    assert "--out" in message
    assert "--config" in unparsable("render", "scene.ply", "--config", file, "--out", "views")


@pytest.mark.parametrize("method", METHODS)
def test_every_field_of_every_estimator_survives_writing_and_reading(tmp_path, method):
    file = tmp_path / "run.json"
    config = METHODS[method]
    table = dataclasses.asdict(config)
    file.write_text(json.dumps({"command": {"method": method}, "config": table}))
    assert read_config_file(file).estimator == config


@pytest.mark.parametrize("change", [{"judged_views": 2**40}, {"config": {"loop": {}}}])
def test_a_changed_report_is_read_or_refused(tmp_path, change):
    """Findings of the fuzzer."""
    table = {"command": {"method": "paper"}, "config": dataclasses.asdict(METHODS["paper"])}
    table |= {"versions": {}, "outputs": [], "judged_views": 7} | change
    file = tmp_path / "run.json"
    file.write_text(json.dumps(table))
    with contextlib.suppress(InputError):
        assert read_config_file(file).method == "paper"
