"""Every script in quick mode."""

import importlib
import inspect

import pytest
from tables import read_csv

from gsc_jax.scene import InputError

SCRIPTS = (
    "ablation",
    "adaptive",
    "authentic",
    "beyond",
    "calibration",
    "departures",
    "backbones",
    "beside_masks",
    "editing",
    "enough",
    "fusion",
    "heldout",
    "importance",
    "leave_out",
    "mask_checks",
    "parsimony",
    "partial_views",
    "published",
    "published_fit",
    "robustness",
    "sources",
    "speed_accuracy",
    "stability",
    "unseen",
)
WITHOUT_CHART = (
    "adaptive",
    "beside_masks",
    "departures",
    "fusion",
    "heldout",
    "leave_out",
    "mask_checks",
    "partial_views",
    "published",
    "published_fit",
    "unseen",
)


@pytest.mark.slow
@pytest.mark.parametrize("name", SCRIPTS)
def test_every_script_runs_in_quick_mode(name, tmp_path):
    script = importlib.import_module(name)
    (takes,) = inspect.signature(script.main).parameters.values()
    script.main(takes.annotation(quick=True, out=tmp_path))
    with pytest.raises(InputError, match="another --out"):
        script.main(takes.annotation(quick=True, out=tmp_path))
    page = (tmp_path / "results.md").read_text()
    script.main(takes.annotation(quick=True, reprint=True, out=tmp_path))
    assert (tmp_path / "results.md").read_text() == page, "reprinting changed the page"
    assert f"<!-- {name} -->" in page
    assert name in WITHOUT_CHART or (tmp_path / f"{name}.png").stat().st_size > 5_000
    assert len(read_csv(tmp_path / f"{name}.csv"))
