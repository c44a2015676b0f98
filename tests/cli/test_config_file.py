"""--config: a run repeated, another one like it, a file written by hand, and what is refused."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from cli_case import FIXTURES, contents, given, network, refused, report, run

from gsc_jax.cli import main as cli
from gsc_jax.cli.config_file import read_settings
from gsc_jax.estimators.gschecker import CONFIGS
from gsc_jax.estimators.robust.estimator import RobustConfig

case, found, own_cache = FIXTURES
pytestmark = pytest.mark.usefixtures("own_cache")


def again(file: Path, out: Path, *argv: object) -> dict:
    """The report of a run that is told by a file, and by what else is typed."""
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
def test_a_result_fed_back_gives_the_same_labels(case, tmp_path, argv):
    one, other = tmp_path / "one", tmp_path / "other"
    assert run(*given(case), *argv, "--out", one).code == 0
    first, second = report(one), again(one / "result.json", other)
    assert same(one, other)
    assert second["config"] == first["config"]
    changed = {"out": str(other), "config": str(one / "result.json")}
    assert second["command"] == first["command"] | changed
    # From a file that came from a file, and in place: the folder is as it was before.
    before = {name: data for name, data in contents(other).items() if name.endswith(".npy")}
    assert run("locate", "--config", other).code == 0
    assert {name: contents(other)[name] for name in before} == before


def test_a_network_fed_back_is_asked_alike(case, tmp_path):
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
    assert third["config"]["tolerance"] == RobustConfig().tolerance


def test_what_is_typed_goes_before_the_file_and_that_before_the_defaults(case, tmp_path):
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
    said = again(file, tmp_path / "a")
    assert (said["views"], said["per_view"][0]["width"]) == (2, 24)
    config = said["config"]
    assert (config["threshold"], config["classes"], config["smoothing"]) == (0.6, [2, 3], 2.0)
    assert (config["seed"], config["restarts"]) == (5, RobustConfig().restarts)
    typed = ["--threshold", 0.7, "--seed", 6, "--views", "None", "--scale", 1]
    said = again(file, tmp_path / "b", *typed)
    assert (said["views"], said["per_view"][0]["width"]) == (3, 48)
    config = said["config"]
    assert (config["threshold"], config["classes"], config["seed"]) == (0.7, [2, 3], 6)


def test_fields_without_a_flag(case, tmp_path):
    file = tmp_path / "run.json"
    told = {
        "command": {"method": "paper", "cameras": str(case / "cameras.json")},
        "config": {"consensus": "official", "loop": {"lambda1": 2, "learning_rate": 0.5}},
    }
    file.write_text(json.dumps(told))
    scene = [case / "scene.ply", "--masks", case / "masks"]
    assert run("locate", *scene, "--config", file, "--out", tmp_path / "out").code == 0
    config = report(tmp_path / "out")["config"]
    assert (config["consensus"], config["loop"]["lambda1"]) == ("official", 2.0)
    assert config["loop"]["lambda2"] == CONFIGS["paper"].loop.lambda2  # pyright: ignore


def test_another_method_on_the_same_scene(case, tmp_path):
    one = tmp_path / "one"
    argv = ["--threshold", 0.7, "--near", 0.1, "--seed", 3]
    assert run(*given(case), *argv, "--out", one).code == 0
    answer = run("locate", "--config", one, "--method", "paper", "--out", tmp_path / "other")
    assert answer.code == 0
    assert "is about the method robust" in answer.err
    config = report(tmp_path / "other")["config"]
    assert config["threshold"] == CONFIGS["paper"].threshold
    assert (config["near"], config["seed"]) == (0.1, 3)
    alone = tmp_path / "alone"
    assert run(*given(case), *argv[2:], "--method", "paper", "--out", alone).code == 0
    assert same(tmp_path / "other", alone)


def test_what_followed_from_the_number_of_views_follows_it_again(case, tmp_path):
    one = tmp_path / "one"
    assert run(*given(case, method="paper"), "--out", one).code == 0
    assert report(one)["config"]["loop"]["contrastive_start"] == 5 * 3 // 2
    fewer = again(one, tmp_path / "fewer", "--views", 2)
    assert fewer["config"]["loop"]["contrastive_start"] == 5 * 2 // 2
    file = tmp_path / "own.toml"
    file.write_text("[command]\nmethod = 'paper'\n[config.loop]\ncontrastive_start = 1\n")
    assert run(*given(case), "--config", file, "--out", tmp_path / "own").code == 0
    assert report(tmp_path / "own")["config"]["loop"]["contrastive_start"] == 1


def test_the_gaussians_may_be_given_no_say(case, tmp_path):
    file = tmp_path / "run.toml"
    file.write_text("[config]\nnative = 0\n")
    assert run(*given(case), "--config", file, "--out", tmp_path / "out").code == 0
    assert report(tmp_path / "out")["native"] is None
    alone = given(case, masks=None, config=file)
    assert "nothing to go by" in refused(*alone, "--out", tmp_path / "no")
    assert "config.native" in refused(*alone, "--detector", "native", "--out", tmp_path / "no")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("[command]\nvews = 3", ("command: unknown key 'vews'", "'views'?")),
        ("[config]\ntreshold = 0.3", ("config: unknown key 'treshold'", "'threshold'?")),
        ("views = 3", ("'views' is in no table", "[command]")),
        ("[command]\nviews = 'all'", ("command.views:", "a whole number or null", "'all'")),
        ("[command]\nviews = true", ("command.views:", "a whole number", "True")),
        ("[command]\nscale = 'big'", ("command.scale:", "a number", "'big'")),
        ("[command]\nscale = nan", ("command.scale:", "a number", "nan")),
        ("[command]\nmethod = 'magic'", ("command.method:", "robust, paper, official", "'magic'")),
        ("[command]\ndetector = 'native'", ("command.detector:", "a list", "'native'")),
        ("[command]\nall_views = 1", ("command.all_views:", "true or false", "found 1")),
        ("[command]\nviews = 0", ("--views 0",)),
        ("command = 3", ("command: expected a table", "found 3")),
        ("[config]\nclasses = [1]", ("config: classes must be", "(1,)")),
        ("[config]\nclasses = ['a']", ("config.classes:", "a list, each a whole number")),
        ("[config]\nthreshold = 2", ("config: threshold must be", "2")),
        ("[config]\nepochs = 3", ("config.epochs: is of the method paper", "robust")),
        ("[config.loop]\nlambda1 = 3", ("config.loop: is of the method paper",)),
        (
            "[command]\nmethod = 'paper'\n[config.loop]\nlamda1 = 3",
            ("config.loop: unknown key 'lamda1'", "'lambda1'?"),
        ),
        ("[config]\nname = 'mine'", ("config.name:", "robust, paper, official", "'mine'")),
        ("[command]\nmethod = 'paper'\n[config]\nname = 'robust'", ("paper", "config of robust")),
        (
            "[command]\nthreshold = 0.3\n[config]\nthreshold = 0.4",
            ("threshold twice", "0.3 in command", "0.4 in config"),
        ),
        ("[command]\nseed = 1\n[config]\nseed = 2", ("seed twice",)),
        ("[command]\nviews = 2\n[config]\ntolerance = 0.1", ("config.tolerance 0.1",)),
        ("[command", ("not valid TOML",)),
    ],
)
def test_files_that_say_nothing_sensible(case, tmp_path, text, expected):
    file = tmp_path / "run.toml"
    file.write_text(text)
    message = refused(*given(case), "--config", file, "--out", tmp_path / "out")
    assert all(part in message for part in expected), message
    assert str(file) in message or "--views" in message
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("name", "content", "expected"),
    [
        ("run.yaml", "a: 1", "expected a .toml or .json"),
        ("run.json", "[]", "holds no tables"),
        ("run.json", "{", "not valid JSON"),
        ("run.toml", None, "no such file"),
        ("edit.json", '{"command": {"edit": "removal"}}', "unknown key 'edit'"),
    ],
)
def test_files_that_are_none(case, tmp_path, name, content, expected):
    file = tmp_path / name
    if content is not None:
        file.write_text(content)
    message = refused(*given(case), "--config", file, "--out", tmp_path / "out")
    assert f"{file}: " in message
    assert expected in message


def test_the_scene_and_the_folder_have_to_come_from_somewhere(tmp_path):
    file = tmp_path / "run.toml"
    file.write_text("")
    message = refused("locate", "--config", file)
    assert "SCENE.ply" in message
    assert "--out" in message
    assert "--config" in refused("render", "scene.ply", "--config", file, "--out", "views")


@pytest.mark.parametrize("method", CONFIGS)
def test_every_field_of_every_configuration_can_be_written_and_read(tmp_path, method):
    file = tmp_path / "run.json"
    config = CONFIGS[method]
    table = dataclasses.asdict(config)
    file.write_text(json.dumps({"command": {"method": method}, "config": table}))
    assert read_settings(file).config == config


def test_help_shows_what_the_file_says(case, tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "100")
    file = tmp_path / "run.toml"
    file.write_text('[command]\nscene = "mine.ply"\nviews = 7\nall_views = true\n')
    with pytest.raises(SystemExit):
        cli.main(["locate", "--config", str(file), "--help"])
    text = capsys.readouterr().out
    assert "default: mine.ply" in text
    assert "default: 7" in text
    assert "--no-all-views" in text
    assert not np.char.count(text, "default: all)")


def test_of_a_path_that_nobody_typed_it_is_told_where_it_comes_from(case, tmp_path):
    file = tmp_path / "run.toml"
    file.write_text('[command]\nmasks = "moved/masks"\n')
    typed = given(case, masks=None)
    message = refused(*typed, "--config", file, "--out", tmp_path / "out")
    assert message.count(str(file)) == 1
    assert "relative to where you are" in message
    plain = refused(*given(case, masks=tmp_path / "moved"), "--out", tmp_path / "out")
    assert "relative to where you are" not in plain
