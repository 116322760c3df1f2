"""Light that comes through panes: the same with shadow rays that pass them, with less noise."""

from __future__ import annotations

import numpy as np
import pytest

from pathtrace.fill.filling import fill_cache
from pathtrace.scene.scene import load_scene
from pathtrace.trace.film import frame_positions, interleaved
from pathtrace.trace.tracer import Tracer
from tests.pathtrace.scene.test_panes import scene, slab

pytestmark = pytest.mark.usefixtures("backend")


def mean_and_error(description: dict, spp: int, thin: bool) -> tuple[float, float]:
    loaded = load_scene(description, thin_glass=thin)
    traced = Tracer(loaded).trace(loaded.camera, frame_positions(loaded.camera), spp, 1)
    radiance, squares = (interleaved(channels) for channels in (traced.radiance, traced.squares))
    variance = np.maximum(squares - radiance**2, 0).mean()
    return float(radiance.mean()), float(np.sqrt(variance / spp / len(radiance)))


def test_thin_dielectrics_are_unbiased_and_less_noisy():
    """The one thing that shadow rays leave out is nothing: such glass does not shift light."""
    pane = slab(0.0001, "thindielectric") | {"type": "rectangle"}
    plain, its_error = mean_and_error(scene(pane), 512, False)
    thin, error = mean_and_error(scene(pane), 128, True)
    assert abs(thin - plain) < 4 * np.hypot(error, its_error)
    assert error < its_error


@pytest.mark.long
def test_paths_that_end_in_a_cache_pass_it_too():
    loaded = load_scene(scene(slab(0.02)), thin_glass=True)
    cache = fill_cache(loaded, [loaded.camera], 0, lambda done, total: None)
    truth, its_error = mean_and_error(scene(slab(0.02)), 128, True)
    traced = Tracer(loaded, cache=cache).trace(loaded.camera, frame_positions(loaded.camera), 32, 1)
    assert float(interleaved(traced.radiance).mean()) == pytest.approx(truth, rel=0.03, abs=4 * its_error)


def test_slabs_keep_nearly_all_their_light():
    plain, its_error = mean_and_error(scene(slab(0.02)), 512, False)
    thin, error = mean_and_error(scene(slab(0.02)), 128, True)
    assert abs(thin / plain - 1) < 0.03 + 4 * np.hypot(error, its_error) / plain
    assert error < its_error
