"""The irradiance cache of a forest: saved and restored whole, refused if damaged, used by frames."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from compose.base.errors import UserError
from compose.fusion.network import Fusion
from hybrid.frame.fusion import attach_fusion, fusion_of
from hybrid.frame.irradiance import attach_cache, cache_for, cache_of
from hybrid.frame.live import LiveRenderer
from hybrid.frame.renderer import Renderer
from hybrid.frame.settings import FrameSettings
from pathtrace.cache.cache import IrradianceCache
from pathtrace.trace.integrator import Integrator
from splat.io.forest_file import load_forest, save_forest

pytestmark = pytest.mark.usefixtures("backend")


@pytest.fixture(scope="module")
def cache(renderer) -> IrradianceCache:
    return cache_for(renderer.scene)


def test_a_cache_is_the_same_after_a_file(renderer, cache, tmp_path):
    forest = attach_cache(renderer.periphery.forest, cache)
    save_forest(tmp_path / "a.forest", forest)
    found = cache_of(load_forest(tmp_path / "a.forest"))
    np.testing.assert_array_equal(found.irradiance, cache.irradiance)
    np.testing.assert_array_equal(found.lights.chances, cache.lights.chances)
    np.testing.assert_array_equal(found.lights.keys, cache.lights.keys)
    for one, other in zip(
        found.cells.keys + found.cells.counts, cache.cells.keys + cache.cells.counts, strict=True
    ):
        np.testing.assert_array_equal(one, other)
    assert found.cells.grid.scale == cache.cells.grid.scale
    np.testing.assert_array_equal(found.cells.grid.origin, cache.cells.grid.origin)


def test_network_and_cache_of_a_forest_do_not_displace_each_other(forest, cache):
    both = attach_fusion(attach_cache(attach_fusion(forest, Fusion()), cache), Fusion())
    assert fusion_of(both) is not None
    assert cache_of(both) is not None


def test_a_forest_without_a_cache_has_none(renderer):
    assert cache_of(renderer.periphery.forest) is None


@pytest.mark.parametrize("damage", ["missing", "short", "infinite"])
def test_a_damaged_cache_is_refused(renderer, cache, damage):
    forest = attach_cache(renderer.periphery.forest, cache)
    attached, name = dict(forest.attached), "irradiance.values"
    if damage == "missing":
        del attached["irradiance.keys.1"]
    elif damage == "short":
        attached[name] = attached[name][:, 1:]
    else:
        attached[name] = torch.full_like(attached[name], torch.inf)
    with pytest.raises(UserError, match="irradiance cache is damaged; train the forest again"):
        cache_of(replace(forest, attached=attached))


def settings(renderer, **changes) -> FrameSettings:
    camera = renderer.scene.camera.resized(48, 48)
    return FrameSettings(fov_a=60, fov_b=50, spp=8, fovea="raw", camera=camera, **changes)


def test_cached_frames_are_close_to_unbiased_ones(renderer, cache):
    forest = attach_cache(renderer.periphery.forest, cache)
    own = Renderer(renderer.scene, forest)
    frames = {
        integrator: np.stack(
            [own.frame(settings(renderer, integrator=integrator), seed).composite for seed in range(12)]
        )
        for integrator in Integrator
    }
    path, cached = frames[Integrator.PATH], frames[Integrator.CACHED]
    assert cached.mean() == pytest.approx(path.mean(), rel=0.02)
    # Not merely the same samples.
    assert (cached != path).any(axis=-1).mean() > 0.5


def test_the_tracers_of_the_integrators_differ_and_are_kept(renderer, cache):
    own = Renderer(renderer.scene, attach_cache(renderer.periphery.forest, cache))
    assert own.tracer_of(Integrator.PATH) is own.tracer
    cached = own.tracer_of(Integrator.CACHED)
    assert cached is not own.tracer
    assert own.tracer_of(Integrator.CACHED) is cached


def test_histories_of_integrators_are_never_mixed(renderer, cache):
    live = LiveRenderer(renderer.scene, attach_cache(renderer.periphery.forest, cache))
    path, cached = (settings(renderer, integrator=integrator) for integrator in Integrator)
    live.frame(path, 0)
    counts = [
        live.frame(one, seed).fovea.samples.count.mean() for seed, one in enumerate((path, cached, path), 1)
    ]
    assert counts == [16, 8, 24]
