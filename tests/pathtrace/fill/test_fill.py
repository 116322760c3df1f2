"""Filled caches against closed forms, across thin walls, and at the ends."""

from __future__ import annotations

from dataclasses import replace

import mitsuba as mi
import numpy as np
import pytest

from compose.camera.coordinate_systems import opencv_from_mitsuba
from pathtrace.fill.filling import fill_cache
from pathtrace.scene.scene import load_scene
from pathtrace.trace.film import frame_positions, interleaved
from pathtrace.trace.tracer import Tracer
from tests import small

pytestmark = pytest.mark.usefixtures("backend")
REFLECTANCE = 0.5


@pytest.fixture(scope="module")
def furnace(backend):
    scene = load_scene(small.furnace(REFLECTANCE), max_depth=6)
    return fill_cache(scene, [scene.camera], points=1 << 15)


def test_in_a_closed_sphere_irradiance_is_a_geometric_series(furnace):
    """Radiance 1 - rho from the wall itself, rho times that after one reflection, and so on."""
    assert furnace.irradiance.shape[0] == 4
    for segments, irradiance in enumerate(furnace.irradiance, 1):
        expected = np.pi * (1 - REFLECTANCE**segments)
        assert irradiance.mean() == pytest.approx(expected, rel=0.01)
        # Cells differ by noise only.
        assert irradiance.std() < 0.15 * expected


def test_the_same_seed_gives_the_same_cache(furnace):
    scene = load_scene(small.furnace(REFLECTANCE), max_depth=6)
    again = fill_cache(scene, [scene.camera], points=1 << 15)
    assert (again.irradiance == furnace.irradiance).all()
    other = fill_cache(scene, [scene.camera], seed=1, points=1 << 15)
    assert (
        other.irradiance.shape != furnace.irradiance.shape or (other.irradiance != furnace.irradiance).any()
    )


def test_progress_ends_at_its_total():
    scene = load_scene(small.corner())
    steps = []
    fill_cache(
        scene, [scene.camera], progress=lambda done, total: steps.append((done, total)), points=1 << 10
    )
    assert steps == sorted(set(steps))
    assert steps[-1][0] == steps[-1][1]


def test_a_camera_that_sees_nothing_gets_an_empty_cache():
    away = mi.ScalarTransform4f().look_at(origin=[0, 0, -2], target=[0, 0, -3], up=[0, 1, 0])
    scene = load_scene({**small.corner(), "sensor": {**small.sensor(), "to_world": away}})
    cache = fill_cache(scene, [scene.camera], points=1 << 10)
    assert len(cache.cells) == 0
    positions = frame_positions(scene.camera)
    radiance = interleaved(Tracer(scene, cache=cache).trace(scene.camera, positions).radiance)
    assert (radiance == 0).all()


def box(low, high, reflectance: float = 0.7) -> dict:
    low, high = np.array(low, float), np.array(high, float)
    place = mi.ScalarTransform4f().translate(((low + high) / 2).tolist()).scale(((high - low) / 2).tolist())
    bsdf = {
        "type": "twosided",
        "b": {"type": "diffuse", "reflectance": {"type": "rgb", "value": reflectance}},
    }
    return {"type": "cube", "to_world": place, "bsdf": bsdf}


def two_rooms() -> dict:
    """Two closed rooms of 3 x 3 x 3 m beside each other, a wall of 1 cm between them, a lamp in one."""
    down = mi.ScalarTransform4f().translate([-1.5, 2.9, 1.5]).rotate([1, 0, 0], 90).scale(0.4)
    look = mi.ScalarTransform4f().look_at(origin=[2.7, 1.5, 2.7], target=[0, 1.2, 0.5], up=[0, 1, 0])
    return {
        "type": "scene",
        "sensor": {**small.sensor(48, 48, 75.0), "to_world": look},
        "shell": box([-3, 0, 0], [3, 3, 3]),
        "wall": box([-0.005, 0, 0], [0.005, 3, 3]),
        "lamp": {
            "type": "rectangle",
            "to_world": down,
            "emitter": {"type": "area", "radiance": {"type": "rgb", "value": 20.0}},
        },
    }


def test_no_light_leaks_through_a_wall_of_a_centimetre():
    """The cache knows both rooms: points of one lie in the same cells of floor and ceiling as the other's."""
    scene = load_scene(two_rooms())
    dark = scene.camera
    pose = mi.ScalarTransform4f().look_at(origin=[-2.7, 1.5, 2.7], target=[0, 1.2, 0.5], up=[0, 1, 0])
    bright = replace(dark, world_to_camera=np.linalg.inv(opencv_from_mitsuba(np.array(pose.matrix))))
    cache = fill_cache(scene, [dark, bright], points=1 << 16)
    assert len(cache.cells) > 1000
    tracer = Tracer(scene, cache=cache)
    seen = [
        interleaved(tracer.trace(camera, frame_positions(camera), 64).radiance).mean()
        for camera in (dark, bright)
    ]
    assert seen[1] > 0.1
    assert seen[0] < 0.01 * seen[1]


def room_with_floor(bsdf: dict) -> dict:
    """A closed room of 4 x 3 x 4 m under a small lamp, with a floor of some material."""
    down = mi.ScalarTransform4f().translate([0, 2.9, 0]).rotate([1, 0, 0], 90).scale(0.2)
    flat = mi.ScalarTransform4f().translate([0, 0.01, 0]).rotate([1, 0, 0], -90).scale(2)
    look = mi.ScalarTransform4f().look_at(origin=[1.7, 1.5, 1.7], target=[-0.5, 1, -0.6], up=[0, 1, 0])
    return {
        "type": "scene",
        "sensor": {**small.sensor(32, 32, 75.0), "to_world": look},
        "shell": box([-2, 0, -2], [2, 3, 2]),
        "floor": {"type": "rectangle", "to_world": flat, "bsdf": {"type": "twosided", "b": bsdf}},
        "lamp": {
            "type": "rectangle",
            "to_world": down,
            "emitter": {"type": "area", "radiance": {"type": "rgb", "value": 30.0}},
        },
    }


@pytest.mark.parametrize("depth", [3, 8])
@pytest.mark.parametrize(
    "bsdf",
    [
        {"type": "roughconductor", "alpha": 0.3, "specular_reflectance": 0.6},
        {"type": "roughplastic", "alpha": 0.2},
        {"type": "principled", "roughness": 0.4, "specular": 0.8, "metallic": 0.4},
    ],
    ids=lambda bsdf: bsdf["type"],
)
def test_glossy_floors_do_not_make_a_room_brighter(bsdf, depth):
    """Their lobes were once counted twice, and light by way of metal as if it had come directly."""
    scene = load_scene(room_with_floor(bsdf), max_depth=depth)
    cache = fill_cache(scene, [scene.camera], points=1 << 14)
    spp = 512
    means, errors = [], []
    for tracer in (Tracer(scene), Tracer(scene, cache=cache)):
        frames = [
            interleaved(
                tracer.trace(scene.camera, frame_positions(scene.camera), spp // 8, seed=seed).radiance
            )
            for seed in range(8)
        ]
        values = np.array([frame.mean() for frame in frames])
        means.append(values.mean())
        errors.append(values.std(ddof=1) / np.sqrt(len(values)))
    assert np.hypot(*errors) < 0.004 * means[0]
    assert means[1] == pytest.approx(means[0], rel=0.01)
