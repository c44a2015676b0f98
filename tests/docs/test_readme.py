"""The commands and the Python code of the README run as written, on a generated scene."""

import contextlib
import io
import json
import re
import shlex
import shutil
from pathlib import Path

import numpy as np
import pytest
from camera_files import write_colmap
from numpy.lib import recfunctions
from onnx import helper
from onnx_models import FLOAT, save

from gsc_jax.benchmark.scenes import make_room, room_cameras
from gsc_jax.cli.main import main
from gsc_jax.io.cameras import load_cameras, save_cameras
from gsc_jax.io.ply import save_ply

README = (Path(__file__).resolve().parents[2] / "README.md").read_text(encoding="utf-8")
SHOWN = re.findall(r"^    (gsc-jax .*)$", README, flags=re.MULTILINE)
COMMANDS = [shlex.split(line, comments=True)[1:] for line in SHOWN]
TAMPER = [command for command in COMMANDS if command[0] == "tamper"]
LOCATE = [command for command in COMMANDS if command[0] == "locate"]
OUTPUTS = README.partition("[start:outputs]")[2].partition("[end:outputs]")[0]
DOCUMENTED = {
    name
    for row in re.findall(r"^\| (`.*?) \|", OUTPUTS, flags=re.MULTILINE)
    for name in re.findall(r"`([^`]+)`", row)
}
SMALL_ORBIT = ("--scale", "0.15")
"""Makes the views of an orbit as small as those of the cameras here."""


def run(*argv: str) -> str:
    """Standard output of a command that succeeds."""
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        assert main(argv) == 0
    return printed.getvalue()


def command(name: str) -> list[str]:
    """The only command of that name in the README."""
    (found,) = [command for command in COMMANDS if command[0] == name]
    return found


@pytest.fixture(scope="module")
def inputs(tmp_path_factory) -> Path:
    """A folder with all input files of the commands, edited by the `tamper` of the README."""
    folder = tmp_path_factory.mktemp("inputs")
    save_ply(folder / "scene.ply", make_room(count=6_000))
    save_cameras(folder / "cameras.json", room_cameras(6, width=96, height=72))
    with contextlib.chdir(folder):
        for arguments in TAMPER:
            run(*arguments, "--no-cache")
        for name in ("scene.ply", "cameras.json"):
            shutil.copy(Path("edited") / name, name)
        shutil.copytree("edited/masks", "masks")
        write_network(Path("iml_vit.onnx"))
    return folder


def write_network(path: Path) -> None:
    """Write a network with the tensors of IML-ViT that flags red pixels."""
    nodes = [
        helper.make_node("Conv", ["image", "weights", "bias"], ["logit"]),
        helper.make_node("Sigmoid", ["logit"], ["map"]),
    ]
    weights = np.array([4, -2, -2], np.float32).reshape(1, 3, 1, 1)
    constants = {"weights": weights, "bias": np.array([-8], np.float32)}
    tensors = {name: (FLOAT, [1, n, 1024, 1024]) for name, n in (("image", 3), ("map", 1))}
    save(path, nodes, {"image": tensors["image"]}, {"map": tensors["map"]}, constants)


@pytest.fixture
def folder(inputs, monkeypatch) -> Path:
    """The folder of `inputs` as current folder."""
    monkeypatch.chdir(inputs)
    return inputs


@pytest.mark.parametrize("arguments", LOCATE, ids=" ".join)
def test_locate_writes_the_documented_files(arguments, folder):
    if "sparse/0" in arguments and not Path("sparse/0").exists():
        write_colmap(Path("sparse/0"), load_cameras("cameras.json"), text=True)
    shutil.rmtree("found", ignore_errors=True)
    no_detector = "--cameras" not in arguments
    size = SMALL_ORBIT if no_detector else ()
    assert "report.html" in run(*arguments, "--no-cache", *size)
    written = {name for name in DOCUMENTED if (folder / "found" / name).exists()}
    assert written == DOCUMENTED - ({"detector/"} if no_detector else set())


@pytest.fixture
def found(folder) -> Path:
    """Results of the README's command on masks."""
    found = folder / "found"
    if not (found / "detector").exists():
        run(*next(arguments for arguments in LOCATE if "--masks" in arguments), "--no-cache")
    return found


def test_evaluate_prints_scores(found):
    assert "F1" in run(*command("evaluate"))


def test_view_writes_a_page(found):
    pytest.importorskip("viser")
    run(*command("view"), "--html", "found.html")
    assert Path("found.html").read_text(encoding="utf-8").lstrip().lower().startswith("<!doctype")


def test_dry_run_writes_nothing_and_a_result_repeats_the_run(found):
    labels = np.load(found / "labels.npy")
    before = (found / "result.json").read_text(encoding="utf-8")
    assert "--dry-run" in README
    assert run(*LOCATE[1], "--dry-run", "--no-cache")
    assert (found / "result.json").read_text(encoding="utf-8") == before
    assert "--config found/result.json" in " ".join(README.split())
    run("locate", "--config", "found/result.json", "--out", "again")
    np.testing.assert_array_equal(np.load("again/labels.npy"), labels)
    repeated = json.loads(Path("again/result.json").read_text())
    assert repeated["config"] == json.loads(before)["config"]


def test_the_python_code_runs(folder):
    (code,) = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)
    names: dict = {}
    exec(compile(code, "README.md", "exec"), names)
    assert names["result"].labels.shape == (len(names["gaussians"]),)
    from plyfile import PlyData

    written = recfunctions.structured_to_unstructured(
        PlyData.read("found.ply")["vertex"].data[["tamper"]]
    )
    np.testing.assert_array_equal(written[:, 0], names["result"].tamper)


def test_demo_is_a_command():
    # Only its help: demo takes a minute and a half, and test_demo.py runs a smaller one.
    with contextlib.redirect_stdout(io.StringIO()) as printed, pytest.raises(SystemExit) as end:
        main([*command("demo"), "--help"])
    assert end.value.code in (0, None)
    assert "demo" in printed.getvalue()


def test_every_command_of_the_readme_is_run_here():
    assert {command[0] for command in COMMANDS} == {"demo", "locate", "tamper", "view", "evaluate"}
    assert (len(LOCATE), len(TAMPER)) == (3, 1)
    assert len(DOCUMENTED) >= 10
