"""Frames whose paths end in the scene's irradiance cache."""

from __future__ import annotations

import numpy as np
import pytest

from hybrid.frame import irradiance
from hybrid.frame.irradiance import cache_for
from hybrid.frame.live import LiveRenderer
from hybrid.frame.renderer import Renderer
from hybrid.frame.settings import FrameSettings
from hybrid.store.cache import scene_folder
from pathtrace.trace.integrator import Integrator

pytestmark = pytest.mark.usefixtures("backend", "own_home")


def settings(scene, **changes) -> FrameSettings:
    camera = scene.camera.resized(48, 48)
    return FrameSettings(fov_a=60, fov_b=50, spp=8, fovea="raw", camera=camera, **changes)


def test_a_scenes_cache_is_filled_once(scene, monkeypatch):
    cache = cache_for(scene)
    assert len(cache.cells) > 100
    assert (scene_folder(scene.name, scene.hash) / "irradiance.safetensors").is_file()
    monkeypatch.setattr(irradiance, "filled_cache", None)
    np.testing.assert_array_equal(cache_for(scene).irradiance, cache.irradiance)


def test_cached_frames_are_close_to_unbiased_ones(scene, forest):
    renderer = Renderer(scene, forest)
    path, cached = (
        np.stack([renderer.frame(settings(scene, integrator=one), seed).composite for seed in range(12)])
        for one in Integrator
    )
    assert cached.mean() == pytest.approx(path.mean(), rel=0.02)
    # Not merely the same samples.
    assert (cached != path).any(axis=-1).mean() > 0.5


def test_frames_without_the_cached_integrator_fill_no_cache(scene, forest):
    Renderer(scene, forest).frame(settings(scene))
    assert not scene_folder(scene.name, scene.hash).exists()


def test_the_tracers_of_the_integrators_differ_and_are_kept(scene, forest):
    renderer = Renderer(scene, forest)
    assert renderer.tracer_of(Integrator.PATH) is renderer.tracer
    cached = renderer.tracer_of(Integrator.CACHED)
    assert cached is not renderer.tracer
    assert renderer.tracer_of(Integrator.CACHED) is cached


def test_histories_of_integrators_are_never_mixed(scene, forest):
    live = LiveRenderer(scene, forest)
    path, cached = (settings(scene, integrator=one) for one in Integrator)
    live.frame(path, 0)
    frames = [live.frame(one, seed) for seed, one in enumerate((path, cached, path), 1)]
    assert [frame.fovea.samples.count.mean() for frame in frames] == [16, 8, 24]


def test_forgetting_drops_the_samples_of_every_integrator(scene, forest):
    live = LiveRenderer(scene, forest)
    for one in Integrator:
        live.frame(settings(scene, integrator=one), 0)
    live.forget()
    for one in Integrator:
        assert live.frame(settings(scene, integrator=one), 1).fovea.samples.count.mean() == 8
