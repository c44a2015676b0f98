"""Observation of all views: input is checked before anything is rendered, and work is kept."""

import dataclasses
import pickle
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from hypothesis import given
from hypothesis.extra import numpy as hnp
from strategies import blobs, camera, cameras_in_a_row, random_scene

from gsc_jax import InputError, observe
from gsc_jax.evidence.observation import EVIDENCE, MAP, half_precision
from gsc_jax.evidence.storage import ArrayStore

SCENE = blobs([[0, 0, 2]])
CAMERA = dataclasses.replace(camera(16, 12), name="one")
MASK = np.zeros((12, 16))


@pytest.mark.parametrize(
    ("cameras", "detector", "message"),
    [
        ([], {"one": MASK}, "no cameras"),
        ([CAMERA, CAMERA], {"one": MASK}, "Two cameras have the name 'one'"),
        ([CAMERA], {"other": MASK}, "'one' has no mask"),
    ],
)
def test_unusable_input_is_one_clear_error(cameras, detector, message):
    with pytest.raises(InputError, match=message):
        observe(SCENE, cameras, detector)


def test_a_detector_that_cannot_be_called_is_an_error():
    with pytest.raises(ValueError, match="got int"):
        observe(SCENE, [CAMERA], 3)  # type: ignore[arg-type]


def test_an_error_of_a_detector_names_the_view():
    with pytest.raises(ZeroDivisionError) as caught:
        observe(SCENE, [CAMERA], lambda _: 1 / 0)
    assert caught.value.__notes__ == ["The detector was shown view 'one'."]


VIEWS = [dataclasses.replace(camera(16, 12), name=name) for name in ("a", "b", "c")]
CLOUD = random_scene(50)


class Network:
    """A detector that counts its calls and stops the run at one of them."""

    needs_image = True

    def __init__(self, fails_at=None):
        self.judged, self.fails_at = [], fails_at
        self.diagnostics: dict = {}

    def select(self, cameras):
        return list(cameras)

    def __call__(self, image, camera):
        if camera.name == self.fails_at:
            raise KeyboardInterrupt
        self.judged.append(camera.name)
        return image[..., 0].clip(0, 1)


def equal(one, other):
    """Whether two observations are the same to the bit."""
    pairs = [(one.evidence.total, other.evidence.total)]
    pairs += [(one.evidence.tampered, other.evidence.tampered)]
    pairs += [(one.votes.tampered, other.votes.tampered)]
    pairs += [(one.probabilities[name], other.probabilities[name]) for name in one.masks]
    return all(np.array_equal(*pair) for pair in pairs)


@pytest.mark.parametrize("fails_at", ["a", "b", "c"])
def test_an_interrupted_observation_continues_and_is_the_same(tmp_path, fails_at):
    expected, first, second = observe(CLOUD, VIEWS, Network()), Network(fails_at), Network()
    with pytest.raises(KeyboardInterrupt):
        observe(CLOUD, VIEWS, first, store=ArrayStore(tmp_path))
    continued = observe(CLOUD, VIEWS, second, store=ArrayStore(tmp_path))
    assert first.judged + second.judged == ["a", "b", "c"], "no view is judged twice"
    assert equal(continued, expected)


def test_nothing_is_rendered_for_views_that_were_judged(tmp_path, monkeypatch):
    store = ArrayStore(tmp_path)
    expected = observe(CLOUD, VIEWS, Network(), store=store)
    for file in tmp_path.glob(f"{EVIDENCE}-*"):
        file.unlink()
    monkeypatch.setattr("gsc_jax.evidence.observation.render_view", None)
    assert equal(observe(CLOUD, VIEWS, Network("a"), store=store), expected)


@pytest.mark.parametrize("limit", [0, 500, 10_000, 2**30])
def test_a_bound_on_memory_changes_no_result(limit):
    bounded = observe(CLOUD, VIEWS, Network(), store=ArrayStore(max_bytes=limit))
    assert equal(bounded, observe(CLOUD, VIEWS, Network()))


def test_a_temporary_folder_goes_with_its_store(monkeypatch, tmp_path):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    store = ArrayStore(max_bytes=10)
    store.put(MAP, "small", np.zeros(10, np.uint8))
    assert not list(tmp_path.iterdir())
    store.put(MAP, "large", np.arange(9))
    assert len(list(tmp_path.iterdir())) == 1
    assert store.get(MAP, "large").tolist() == list(range(9))
    del store
    assert not list(tmp_path.iterdir())


def test_a_file_that_was_only_begun_does_not_count(tmp_path):
    store = ArrayStore(tmp_path)
    store.put(MAP, "a", np.arange(100))
    (file,) = tmp_path.iterdir()
    assert store.has(MAP, "a")
    file.write_bytes(file.read_bytes()[:-8])
    assert not store.has(MAP, "a")
    assert not store.has(MAP, "b")


@pytest.mark.parametrize("kind", [EVIDENCE, MAP])
@pytest.mark.parametrize("damage", ["zeroed", "emptied"])
def test_files_that_were_damaged_between_two_runs_are_made_again(tmp_path, kind, damage):
    observe(CLOUD, VIEWS, Network(), store=ArrayStore(tmp_path))
    for path in tmp_path.glob(f"{kind}-*.npy"):
        content = path.read_bytes()
        kept = content[:128] + bytes(len(content) - 128)
        path.write_bytes(kept if damage == "zeroed" else b"")
    again = observe(CLOUD, VIEWS, Network(), store=ArrayStore(tmp_path))
    assert equal(again, observe(CLOUD, VIEWS, Network()))


def test_views_that_were_judged_keep_their_diagnostics(tmp_path):
    detector, again = Network(), Network()
    detector.diagnostics["a"] = {"clipped": np.int64(3)}
    observe(CLOUD, VIEWS, detector, store=ArrayStore(tmp_path))
    observed = observe(CLOUD, VIEWS, again, store=ArrayStore(tmp_path))
    assert (again.diagnostics, again.judged) == ({"a": {"clipped": 3}}, [])
    assert pickle.loads(pickle.dumps(observed.masks)).keys() == observed.masks.keys()


def test_memory_that_was_released_is_used_again():
    store = ArrayStore(max_bytes=100)
    store.put(EVIDENCE, "large", np.zeros(80, np.uint8))
    store.put(EVIDENCE, "too large", np.zeros(101, np.uint8))
    store.release(EVIDENCE)
    store.put(MAP, "small", np.zeros(100, np.uint8))
    assert not isinstance(store.get(MAP, "small"), np.memmap)


def test_a_full_disk_is_one_clear_error(tmp_path, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "save", full)
    with pytest.raises(InputError, match="No space left on device"):
        ArrayStore(tmp_path).put(MAP, "a", np.arange(3))


@given(
    hnp.arrays(
        np.float32, 20, elements=hnp.from_dtype(np.dtype("float32"), min_value=0, max_value=1)
    )
)
def test_rounding_moves_no_pixel_across_the_threshold(probability):
    rounded = half_precision(probability)
    assert np.array_equal(rounded > 0.5, probability > 0.5)
    np.testing.assert_allclose(rounded, probability, atol=5e-4)
    assert half_precision(np.nextafter(np.full(1, 0.5, np.float32), np.float32(1)))[0] > 0.5


def test_masks_in_the_order_of_the_cameras_and_generators_serve_as_well():
    views = cameras_in_a_row(3, 17, 15, step=0.2)
    gaussians = random_scene(20)
    maps = np.random.default_rng(0).random((3, 15, 17)).astype(np.float32)
    named = observe(gaussians, views, {v.name: m for v, m in zip(views, maps, strict=True)})
    for masks in (maps, list(maps), (one for one in maps)):
        found = observe(gaussians, (view for view in views), masks)
        np.testing.assert_array_equal(found.evidence.tampered, named.evidence.tampered)
    with pytest.raises(InputError, match=r"each of 3 cameras, .* got 2"):
        observe(gaussians, views, maps[:2])
    with pytest.raises(InputError, match="cameras must be Camera objects, got str"):
        observe(gaussians, ["a.json"], maps)  # pyright: ignore[reportArgumentType]


def test_stores_of_several_runs_may_share_a_folder(tmp_path):
    array = np.arange(50_000.0)

    def put(run: int) -> None:
        for name in map(str, range(10)):
            ArrayStore(tmp_path).put("map", name, array)

    with ThreadPoolExecutor(4) as pool:
        list(pool.map(put, range(4)))
    assert all(ArrayStore(tmp_path).has("map", name) for name in map(str, range(10)))
    assert np.array_equal(ArrayStore(tmp_path).get("map", "0"), array)
