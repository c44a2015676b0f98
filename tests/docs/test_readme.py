"""The README: its commands and its Python run as written, on a made scene."""

import contextlib
import io
import json
import re
import shlex
import shutil
from pathlib import Path

import numpy as np
import pytest
from numpy.lib import recfunctions
from scipy.spatial.transform import Rotation

from gsc_jax.benchmark.scenes import make_room, room_cameras
from gsc_jax.cli.main import main
from gsc_jax.io.cameras import load_cameras, save_cameras
from gsc_jax.io.ply import save_ply
from gsc_jax.scene import Camera

README = (Path(__file__).resolve().parents[2] / "README.md").read_text(encoding="utf-8")
SHOWN = re.findall(r"^    (gsc-jax .*)$", README, flags=re.MULTILINE)
COMMANDS = [shlex.split(line, comments=True)[1:] for line in SHOWN]
TAMPER = [command for command in COMMANDS if command[0] == "tamper"]
LOCATE = [command for command in COMMANDS if command[0] == "locate"]
OUTPUTS = README.partition("[start:outputs]")[2].partition("[end:outputs]")[0]
PROMISED = [
    name
    for row in re.findall(r"^\| (`.*?) \|", OUTPUTS, flags=re.MULTILINE)
    for name in re.findall(r"`([^`]+)`", row)
]
LIKE_CAMERAS = ("--scale", "0.15")
"""Makes the views of an orbit as small as those of the cameras here."""


def run(*argv: str) -> str:
    """What a command prints; it has to end well."""
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        assert main(argv) == 0
    return printed.getvalue()


@pytest.fixture(scope="module")
def desk(tmp_path_factory) -> Path:
    """A folder with all the files that the commands name, made by the README's own `tamper`."""
    folder = tmp_path_factory.mktemp("desk")
    save_ply(folder / "scene.ply", make_room(count=6_000))
    save_cameras(folder / "cameras.json", room_cameras(6, width=96, height=72))
    with contextlib.chdir(folder):
        for command in TAMPER:
            run(*command, "--no-cache")
        for name in ("scene.ply", "cameras.json"):
            shutil.copy(Path("edited") / name, name)
        shutil.copytree("edited/masks", "masks")
        write_colmap(Path("sparse/0"), load_cameras("cameras.json"))
        write_network(Path("iml_vit.onnx"))
    return folder


def write_colmap(folder: Path, cameras: list[Camera]) -> None:
    """A COLMAP model in text, without points."""
    folder.mkdir(parents=True)
    lenses, images = [], []
    for number, camera in enumerate(cameras, start=1):
        (fx, _, cx), (_, fy, cy), _ = np.asarray(camera.K).tolist()
        pose = np.asarray(camera.viewmat, np.float64)
        quaternion = Rotation.from_matrix(pose[:3, :3]).as_quat(scalar_first=True)
        numbers = " ".join(map(str, [*quaternion.tolist(), *pose[:3, 3].tolist()]))
        lenses.append(f"{number} PINHOLE {camera.width} {camera.height} {fx} {fy} {cx} {cy}\n")
        images.append(f"{number} {numbers} {number} {camera.name}\n\n")
    (folder / "cameras.txt").write_text("".join(lenses))
    (folder / "images.txt").write_text("".join(images))
    (folder / "points3D.txt").write_text("")


def write_network(path: Path) -> None:
    """A network with the tensors of IML-ViT, which flags what is red."""
    import onnx
    from onnx import TensorProto, helper, numpy_helper

    weights = np.array([4, -2, -2], np.float32).reshape(1, 3, 1, 1)
    side = 1024
    graph = helper.make_graph(
        [
            helper.make_node("Conv", ["image", "weights", "bias"], ["logit"]),
            helper.make_node("Sigmoid", ["logit"], ["map"]),
        ],
        "red",
        [helper.make_tensor_value_info("image", TensorProto.FLOAT, [1, 3, side, side])],
        [helper.make_tensor_value_info("map", TensorProto.FLOAT, [1, 1, side, side])],
        [
            numpy_helper.from_array(weights, "weights"),
            numpy_helper.from_array(np.array([-8], np.float32), "bias"),
        ],
    )
    opset = [helper.make_opsetid("", 17)]
    onnx.save(helper.make_model(graph, opset_imports=opset, ir_version=8), path)


@pytest.fixture
def at_the_desk(desk, monkeypatch) -> Path:
    monkeypatch.chdir(desk)
    return desk


@pytest.mark.parametrize("command", LOCATE, ids=" ".join)
def test_locate_runs_and_leaves_what_is_promised(command, at_the_desk):
    if "sparse/0" in command:
        pytest.importorskip("pycolmap")
    shutil.rmtree("found", ignore_errors=True)
    alone = "--cameras" not in command
    assert "report.html" in run(*command, "--no-cache", *(LIKE_CAMERAS if alone else ()))
    left = {name for name in PROMISED if (at_the_desk / "found" / name).exists()}
    # Of the Gaussians alone there is no 2D detector that could have said anything.
    assert left == set(PROMISED) - ({"detector/"} if alone else set())


@pytest.fixture
def found(at_the_desk) -> Path:
    """The results of the README's run on masks."""
    folder = at_the_desk / "found"
    if not (folder / "detector").exists():
        run(*next(command for command in LOCATE if "--masks" in command), "--no-cache")
    return folder


def test_the_results_are_graded(found):
    (command,) = [command for command in COMMANDS if command[0] == "evaluate"]
    assert "F1" in run(*command)


def test_the_results_become_a_page(found):
    pytest.importorskip("viser")
    (command,) = [command for command in COMMANDS if command[0] == "view"]
    run(*command, "--html", "found.html")
    assert Path("found.html").read_text(encoding="utf-8").lstrip().lower().startswith("<!doctype")


def test_what_would_be_done_is_said_and_can_be_done_again(found):
    labels = np.load(found / "labels.npy")
    before = (found / "result.json").read_text(encoding="utf-8")
    assert "--dry-run" in README
    assert run(*LOCATE[1], "--dry-run", "--no-cache")
    assert (found / "result.json").read_text(encoding="utf-8") == before
    assert "--config found/result.json" in README
    run("locate", "--config", "found/result.json", "--out", "again")
    np.testing.assert_array_equal(np.load("again/labels.npy"), labels)
    assert (
        json.loads(Path("again/result.json").read_text())["config"] == json.loads(before)["config"]
    )


def test_the_python_runs_as_written(at_the_desk):
    (code,) = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)
    assert len([line for line in code.splitlines() if line]) <= 15
    names: dict = {}
    exec(compile(code, "README.md", "exec"), names)
    assert names["result"].labels.shape == (len(names["gaussians"]),)
    from plyfile import PlyData

    written = recfunctions.structured_to_unstructured(
        PlyData.read("found.ply")["vertex"].data[["tamper"]]
    )
    np.testing.assert_array_equal(written[:, 0], names["result"].tamper)


def test_the_demo_is_known():
    # Only asked for its help: it takes a minute and a half, and test_demo.py runs a smaller one.
    (command,) = [command for command in COMMANDS if command[0] == "demo"]
    with contextlib.redirect_stdout(io.StringIO()) as printed, pytest.raises(SystemExit) as end:
        main([*command, "--help"])
    assert end.value.code in (0, None)
    assert "demo" in printed.getvalue()


def test_every_command_that_is_shown_is_run_here():
    assert {command[0] for command in COMMANDS} == {"demo", "locate", "tamper", "view", "evaluate"}
    assert len(LOCATE) == 3
    assert len(TAMPER) == 1
    assert len(PROMISED) >= 10


def test_the_readme_is_short():
    assert len(README.splitlines()) <= 170
