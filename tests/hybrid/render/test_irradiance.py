"""Irradiance caches of scenes: filled when frames require them, and stored."""

from __future__ import annotations

import numpy as np
import pytest
from safetensors.numpy import load_file, save_file

from compose.base.errors import UserError
from hybrid.base.cache_folder import scene_folder
from hybrid.render import irradiance
from hybrid.render.frame_renderer import LiveRenderer, Renderer
from hybrid.render.frame_settings import FrameSettings
from hybrid.render.irradiance import cache_for, stored_cache
from pathtrace.cache.irradiance_cache import IrradianceCache
from pathtrace.cache.transport import Transfer
from pathtrace.fill.filling import fill_cache
from pathtrace.scene.scene import load_scene
from pathtrace.trace import Integrator
from tests import small
from tests.compose.arrays_of import host

pytestmark = pytest.mark.usefixtures("backend", "own_home")


def settings(scene, **changes) -> FrameSettings:
    camera = scene.camera.resized(48, 48)
    return FrameSettings(fov_a=60, fov_b=50, spp=8, fovea="raw", camera=camera, **changes)


def test_a_scenes_cache_is_filled_once(scene, monkeypatch):
    # As many points as in use.
    monkeypatch.setattr(irradiance, "fill_cache", fill_cache)
    cache = cache_for(scene)
    assert len(cache.cells) > 100
    assert (scene_folder(scene.name, scene.hash) / "irradiance.safetensors").is_file()
    monkeypatch.setattr(irradiance, "filled_cache", None)
    np.testing.assert_array_equal(cache_for(scene).irradiance, cache.irradiance)


def test_one_fill_serves_all_path_depths(scene):
    cache, shorter, unbounded = (cache_for(at) for at in (scene, scene.at_depth(3), scene.at_depth(-1)))
    assert not scene_folder(scene.name, scene.at_depth(3).hash).exists()
    # Of the same points and rays: light of at most three segments is part of that of all.
    np.testing.assert_array_equal(cache.transfer.direct, shorter.transfer.direct)
    assert (shorter.irradiance[-1] <= cache.irradiance[-1] + 1e-6).all()
    assert (cache.irradiance[-1] <= unbounded.irradiance[-1] + 1e-6).all()
    filled = irradiance.filled_cache(scene.at_depth(3))
    assert len(shorter.irradiance) == len(filled.irradiance)
    assert shorter.irradiance[-1].mean() == pytest.approx(filled.irradiance[-1].mean(), rel=0.05)
    assert shorter.irradiance[-1].mean() < 0.9 * unbounded.irradiance[-1].mean()


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
    assert [frame.fovea.samples.mean_count() for frame in frames] == [16, 8, 24]


def test_forgetting_drops_the_samples_of_every_integrator(scene, forest):
    live = LiveRenderer(scene, forest)
    for one in Integrator:
        live.frame(settings(scene, integrator=one), 0)
    live.forget()
    for one in Integrator:
        assert live.frame(settings(scene, integrator=one), 1).fovea.samples.mean_count() == 8


def mean(renderer, scene, integrator: Integrator = Integrator.CACHED) -> float:
    """Mean radiance of several frames."""
    chosen = settings(scene, integrator=integrator)
    return float(np.mean([host(renderer.frame(chosen, seed).fovea.radiance).mean() for seed in range(6)]))


def test_frames_follow_a_lamp_that_is_dimmed_and_stay_biased(lamp, forest):
    scene, set_lamp = lamp
    renderer = Renderer(scene, forest)
    before = mean(renderer, scene)
    assert renderer.light_renewed == 1
    set_lamp(6.0)
    renderer.lights_changed()
    assert renderer.light_renewed == 0
    frame = renderer.frame(settings(scene, integrator=Integrator.CACHED))
    assert 0 < renderer.light_renewed < 0.1
    assert not frame.settings.is_unbiased
    assert mean(renderer, scene) == pytest.approx(0.5 * before, rel=0.03)
    while renderer.light_renewed < 1:
        renderer.frame(settings(scene, integrator=Integrator.CACHED))
    assert mean(renderer, scene) == pytest.approx(0.5 * before, rel=0.03)


def test_unbiased_frames_renew_no_light(lamp, forest):
    scene, set_lamp = lamp
    renderer = Renderer(scene, forest)
    renderer.tracer_of(Integrator.CACHED)
    set_lamp(6.0)
    renderer.lights_changed()
    renderer.frame(settings(scene))
    assert renderer.light_renewed == 0


def test_the_stored_cache_stays_that_of_the_scene_as_it_was_loaded(lamp, forest):
    scene, set_lamp = lamp
    file = scene_folder(scene.name, scene.hash) / "irradiance.safetensors"
    early = Renderer(scene, forest)
    set_lamp(6.0)
    early.lights_changed()
    dim = mean(early, scene)
    assert not file.exists()
    set_lamp(12.0)
    late = Renderer(scene, forest)
    assert mean(late, scene) == pytest.approx(2 * dim, rel=0.05)
    stored = file.read_bytes()
    set_lamp(6.0)
    late.lights_changed()
    assert mean(late, scene) == pytest.approx(dim, rel=0.05)
    assert file.read_bytes() == stored


def test_changed_surfaces_fill_the_cache_again_at_the_next_frame(lamp, forest):
    scene, _ = lamp
    renderer = Renderer(scene, forest)
    before, tracer = mean(renderer, scene), renderer.tracer_of(Integrator.CACHED)
    small.set_all(scene, "reflectance.value", 0.1)
    renderer.surfaces_changed()
    after = mean(renderer, scene)
    assert after < 0.7 * before
    assert after == pytest.approx(mean(renderer, scene, Integrator.PATH), rel=0.03)
    assert renderer.tracer_of(Integrator.CACHED) is not tracer


def test_old_samples_of_the_fovea_are_dropped_when_lights_change(lamp, forest):
    scene, set_lamp = lamp
    live = LiveRenderer(scene, forest)
    for one in Integrator:
        live.frame(settings(scene, integrator=one), 0)
    set_lamp(6.0)
    live.lights_changed()
    for one in Integrator:
        frame = live.frame(settings(scene, integrator=one), 1)
        assert frame.fovea.samples.mean_count() == 8
    renewed = live.light_renewed
    live.refined(frame, 1, 2, quick=True)
    assert live.light_renewed > renewed > 0


@pytest.fixture(scope="module")
def cache(backend) -> IrradianceCache:
    scene = load_scene(small.corner())
    return fill_cache(scene, [scene.camera], points=1 << 12)


def never() -> IrradianceCache:
    raise AssertionError("filled again")


def parts(transfer: Transfer) -> list[np.ndarray]:
    points, rays, transport = transfer.points, transfer.rays, transfer.transport
    return [
        *(points.position, points.normal, transfer.patch, rays.point, rays.square),
        rays.weight,
        *(transfer.direct, transfer.reflected, transfer.passed, transfer.known),
        *(transport.patches.cells, transport.rays, transport.starts, transport.cells, transport.reflectance),
    ]


def assert_same(one: IrradianceCache, other: IrradianceCache) -> None:
    np.testing.assert_array_equal(one.irradiance, other.irradiance)
    np.testing.assert_array_equal(one.lights.keys, other.lights.keys)
    np.testing.assert_array_equal(one.lights.chances, other.lights.chances)
    np.testing.assert_array_equal(one.cells.grid.origin, other.cells.grid.origin)
    assert one.cells.grid.scale == other.cells.grid.scale
    for mine, yours in zip(parts(one.transfer), parts(other.transfer), strict=True):
        np.testing.assert_array_equal(mine, yours)
        assert mine.dtype == yours.dtype
    ours, theirs = ((*cells.keys, *cells.counts) for cells in (one.cells, other.cells))
    for mine, yours in zip(ours, theirs, strict=True):
        np.testing.assert_array_equal(mine, yours)
        assert mine.dtype == yours.dtype


def test_a_cache_is_filled_once_and_is_the_same_after_a_file(cache, tmp_path):
    file = tmp_path / "new" / "a.safetensors"
    assert stored_cache(file, lambda: cache) is cache
    assert_same(stored_cache(file, never), cache)


@pytest.mark.parametrize("damage", ["truncated", "missing", "short", "infinite", "links", "known", "flipped"])
def test_a_damaged_file_is_replaced(cache, tmp_path, damage):
    file = tmp_path / "a.safetensors"
    stored_cache(file, lambda: cache)
    arrays = load_file(file)
    if damage == "truncated":
        file.write_bytes(file.read_bytes()[:100])
    elif damage == "flipped":
        content = bytearray(file.read_bytes())
        content[-1000] ^= 1
        file.write_bytes(content)
    else:
        if damage == "missing":
            del arrays["keys.1"]
        elif damage == "links":
            arrays["links.cells"] = np.ascontiguousarray(arrays["links.cells"][1:])
        elif damage == "known":
            arrays["known"] = np.zeros_like(arrays["known"])
        elif damage == "short":
            arrays["irradiance"] = np.ascontiguousarray(arrays["irradiance"][:, 1:])
        else:
            arrays["irradiance"] = np.full_like(arrays["irradiance"], np.inf)
        save_file(arrays, file)
    assert stored_cache(file, lambda: cache) is cache
    assert_same(stored_cache(file, never), cache)


def test_an_empty_cache_goes_through_a_file(cache, tmp_path):
    empty = IrradianceCache.empty(1)
    stored_cache(tmp_path / "a.safetensors", lambda: empty)
    assert_same(stored_cache(tmp_path / "a.safetensors", never), empty)


def test_a_folder_that_cannot_be_written_is_named(cache, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(UserError, match="cannot be written"):
        stored_cache(tmp_path / "file" / "a.safetensors", lambda: cache)
