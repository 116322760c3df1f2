"""Paths that end in a cache: unbiased without cells, close to the truth and less noisy with them."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from compose.camera.camera import Camera
from pathtrace.cache.irradiance_cache import IrradianceCache
from pathtrace.fill.filling import fill_cache
from pathtrace.scene.scene import load_scene
from pathtrace.trace.cached_paths import PathSettings, path_radiance
from pathtrace.trace.film import (
    Sequences,
    frame_positions,
    interleaved,
    opaque_camera,
    ray_through,
    sobol_tables,
)
from pathtrace.trace.tracer import Tracer
from tests import small

pytestmark = pytest.mark.usefixtures("backend")

MATERIALS = {
    "diffuse": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.6}},
    "roughconductor": {"type": "roughconductor", "alpha": 0.2},
    "plastic": {"type": "plastic"},
    "roughplastic": {"type": "roughplastic", "alpha": 0.3},
    "dielectric": {"type": "dielectric"},
    "mask": {"type": "mask", "opacity": 0.5, "nested": {"type": "diffuse"}},
}
# A scene of them all, so that the kernels are compiled once; each is seen in a frame of its own.
CENTRES = {
    name: np.array([0.55 * (number % 3 - 1), 0.5 * (number // 3) - 0.35, 1.0])
    for number, name in enumerate(MATERIALS)
}


def room(balls: dict[str, dict]) -> dict:
    """The corner with a second lamp, a sky, and balls of some materials."""
    scene = small.corner()
    del scene["ball"]
    for name, material in balls.items():
        scene[name] = {"type": "sphere", "center": list(CENTRES[name]), "radius": 0.24, "bsdf": material}
    scene["sky"] = {"type": "constant", "radiance": {"type": "rgb", "value": 0.1}}
    scene["spot"] = {"type": "point", "position": [1, 1, 0], "intensity": {"type": "rgb", "value": 1.0}}
    return scene


@pytest.fixture(scope="module")
def all_materials(backend):
    return load_scene(room(MATERIALS))


@pytest.fixture(scope="module")
def filled(all_materials):
    return fill_cache(all_materials, [all_materials.camera], points=1 << 15)


def camera_at(scene, ball: str) -> Camera:
    """A camera whose frame one ball fills to two thirds."""
    camera = scene.camera.resized(128, 128)
    (x, y), _ = (found[0] for found in camera.project(CENTRES[ball][None]))
    return camera.cropped(round(x) - 20, round(y) - 20, 40, 40)


def samples(
    scene, settings: PathSettings, cache: IrradianceCache, count: int, camera: Camera | None = None
) -> np.ndarray:
    """(count, 3) radiance of as many paths, spread over a frame, that of the scene's camera by default."""
    camera = camera or scene.camera
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(1, count)
    ray = ray_through(
        opaque_camera(camera), sampler.next_1d() * camera.width, sampler.next_1d() * camera.height
    )
    lane = dr.arange(mi.UInt32, count)
    sequences = Sequences(sobol_tables(), lane & 15, (lane >> 4, mi.UInt32(1)))
    known = cache.arrays(scene.mitsuba)
    surface, active = scene.mitsuba.ray_intersect(ray), mi.Bool(True)
    radiance = path_radiance(scene.mitsuba, sampler, ray, surface, active, settings, sequences, known)
    channels = list(radiance)
    sampler.schedule_state()
    dr.eval(channels)
    return np.stack([channel.numpy() for channel in channels], axis=1)


def truth(scene, camera: Camera, spp: int, depth: int) -> tuple[float, float]:
    """Mean radiance of Mitsuba's own paths, and its standard error."""
    tracer = Tracer(scene.at_depth(depth))
    means = [
        interleaved(tracer.trace(camera, frame_positions(camera), spp, seed).radiance).mean()
        for seed in range(8)
    ]
    return float(np.mean(means)), float(np.std(means) / np.sqrt(7))


@pytest.mark.parametrize("ball", MATERIALS)
@pytest.mark.parametrize(("depth", "shadow_rays"), [(2, 3), (5, 1), (5, 3)])
def test_without_cells_the_mean_is_that_of_mitsubas_paths(all_materials, ball, depth, shadow_rays):
    camera = camera_at(all_materials, ball)
    empty = IrradianceCache.empty(3)
    found = samples(all_materials, PathSettings(depth, 3, shadow_rays), empty, 1 << 17, camera)
    # Means over the 16 samples of a sequence are independent of each other.
    groups = found.mean(axis=1).reshape(-1, 16).mean(axis=1)
    mean, error = truth(all_materials, camera, 80, depth)
    assert found.mean() == pytest.approx(mean, abs=4.5 * np.hypot(error, groups.std() / np.sqrt(len(groups))))


def test_depth_below_0_is_no_bound():
    """In a furnace, radiance is 1 if no path is cut."""
    scene = load_scene(small.furnace(0.8))
    empty = IrradianceCache.empty(1)
    found = samples(scene, PathSettings(-1, 5, 1), empty, 1 << 14)
    assert found.mean() == pytest.approx(1, abs=0.01)
    cut = samples(scene, PathSettings(4, 5, 1), empty, 1 << 14)
    assert cut.mean() == pytest.approx(1 - 0.8**4, abs=0.01)


@pytest.mark.parametrize("ball", MATERIALS)
def test_with_a_cache_the_mean_hardly_changes_and_noise_falls(all_materials, filled, ball):
    camera = camera_at(all_materials, ball)
    empty = IrradianceCache.empty(3)
    settings = PathSettings(8, 5, 2)
    cached, traced = (samples(all_materials, settings, each, 1 << 16, camera) for each in (filled, empty))
    mean, error = truth(all_materials, camera, 40, 8)
    assert cached.mean() == pytest.approx(mean, abs=0.015 * mean + 4 * error)
    assert cached.var() < 1.05 * traced.var()


@pytest.mark.parametrize("reflectance", [0.3, 0.8])
def test_a_furnace_stays_at_its_radiance(reflectance):
    scene = load_scene(small.furnace(reflectance), max_depth=6)
    tracer = Tracer(scene, cache=fill_cache(scene, [scene.camera], points=1 << 14))
    radiance = interleaved(tracer.trace(scene.camera, frame_positions(scene.camera), 16).radiance)
    assert radiance.mean() == pytest.approx(1 - reflectance**6, rel=0.01)


@pytest.mark.parametrize("shadow_rays", [1, 2])
def test_a_glowing_sphere_is_as_bright_as_its_light(shadow_rays):
    """Light that is sampled on a sphere from a point of it may have no direction."""
    glow = {"type": "area", "radiance": {"type": "rgb", "value": 3.0}}
    ball = {"type": "sphere", "radius": 0.5, "emitter": glow, "bsdf": {"type": "diffuse"}}
    scene = load_scene({"type": "scene", "sensor": small.sensor(), "ball": ball})
    camera = scene.camera.cropped(13, 13, 6, 6)
    found = samples(scene, PathSettings(4, 5, shadow_rays), IrradianceCache.empty(1), 4096, camera)
    assert found == pytest.approx(3.0)


def test_more_shadow_rays_mean_less_noise():
    scene = load_scene(room({"diffuse": MATERIALS["diffuse"]}))
    empty = IrradianceCache.empty(3)
    one, four = (samples(scene, PathSettings(2, 5, rays), empty, 1 << 15).var() for rays in (1, 4))
    assert four < 0.6 * one


def lit_by_a_caustic() -> dict:
    """A glass ball between a small lamp and the floor: light that only scattered paths find, by chance."""
    scene = room({"dielectric": MATERIALS["dielectric"]})
    scene["dielectric"] |= {"center": [0.5, -0.1, 1.0], "radius": 0.35}
    del scene["spot"]
    scene["small"] = {
        "type": "sphere",
        "center": [0.3, 0.9, 0.2],
        "radius": 0.06,
        "emitter": {"type": "area", "radiance": {"type": "rgb", "value": 300.0}},
    }
    return scene


def test_a_bound_that_nothing_exceeds_changes_nothing():
    scene = load_scene(room({"diffuse": MATERIALS["diffuse"]}))
    cache = IrradianceCache.empty(len(scene.mitsuba.emitters()))
    free = samples(scene, PathSettings(6, 5, 1), cache, 4096)
    np.testing.assert_array_equal(samples(scene, PathSettings(6, 5, 1, False, 1e6), cache, 4096), free)


def test_a_bound_holds_for_each_contribution_and_removes_fireflies():
    scene = load_scene(lit_by_a_caustic())
    cache = IrradianceCache.empty(len(scene.mitsuba.emitters()))
    # The tracer counts the few samples that are not finite as black.
    free, bounded = (
        np.nan_to_num(samples(scene, PathSettings(6, 9, 1, False, most), cache, 1 << 18), posinf=0)
        for most in (None, 2.0)
    )
    assert (bounded <= free * (1 + 1e-5) + 1e-5).all()
    # Paths of six segments add indirect light five times at most.
    is_firefly = free.max(axis=1) - bounded.max(axis=1) > 20
    assert 3 < is_firefly.sum() < 300
    assert 0.001 < 1 - bounded.mean() / free.mean() < 0.5


def test_what_is_seen_directly_or_lit_directly_has_no_bound():
    """Two segments: the lamp itself, and surfaces in its direct light."""
    scene = load_scene(lit_by_a_caustic())
    camera, positions = scene.camera, frame_positions(scene.camera)
    direct = [
        interleaved(Tracer(scene.at_depth(2), most_indirect=most).trace(camera, positions, 4, 0).radiance)
        for most in (1e-3, 1e9)
    ]
    np.testing.assert_allclose(direct[0], direct[1], rtol=1e-5, atol=1e-6)
    assert direct[0].max() > 1.0
