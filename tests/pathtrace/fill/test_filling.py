"""Filled caches against closed forms, across thin walls, and at the ends; guided directions and links."""

from __future__ import annotations

from dataclasses import replace

import mitsuba as mi
import numpy as np
import pytest

from compose.camera.coordinate_systems import opencv_from_mitsuba
from pathtrace.cache.cells import SIDES, Cells, Grid, Points
from pathtrace.fill.filling import Guide, cells_hit, even_squares, fill_cache, links_of
from pathtrace.fill.gather import Seen
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


REGIONS, RAYS = 40, 200


def light(square: np.ndarray) -> np.ndarray:
    """Light from a few directions: half of a bin, 1 / 128 of all of them."""
    return np.where((square[:, 0] < 1 / 16) & (square[:, 1] < 1 / 8), 128.0, 0.0).astype(np.float32)


def region_of_rays() -> np.ndarray:
    return np.repeat(np.arange(REGIONS), RAYS)


def test_even_directions_have_one_ray_of_each_point_in_each_stratum():
    square = even_squares(5000, 2, small.rng())
    assert square.dtype == np.float32
    assert ((square >= 0) & (square < 1)).all()
    np.testing.assert_array_equal((2 * square[:, 0]).astype(int), np.tile([0, 1], 5000))
    np.testing.assert_allclose(square.mean(axis=0), 0.5, atol=0.02)


def test_half_of_the_guided_rays_go_where_light_came_from():
    region = np.repeat([0, 1], 4000)
    square = even_squares(4000, 2, small.rng())
    # The second region is dark.
    guide = Guide(region, square, np.where(region == 0, light(square), 0))
    found = guide.squares(region, small.rng(1))
    assert ((found >= 0) & (found < 1)).all()
    assert found.dtype == np.float32
    bright = (found < 1 / 8).all(axis=1)
    assert bright[region == 0].mean() == pytest.approx(0.5 + 0.5 / 64, abs=0.03)
    assert bright[region == 1].mean() == pytest.approx(1 / 64, abs=0.01)
    # Within a bin and outside of it, directions are even.
    np.testing.assert_allclose(8 * found[bright].mean(axis=0), 0.5, atol=0.03)
    np.testing.assert_allclose(found[region == 1].mean(axis=0), 0.5, atol=0.02)


def test_weights_are_those_of_the_balance_heuristic():
    region, square = np.zeros(3, dtype=np.int64), np.float32([[0.05, 0.05], [0.3, 0.9], [0.9, 0.9]])
    guide = Guide(region, square, np.float32([3, 1, 0]))
    expected = [2 / (1.5 + 0.5 * 64 * share) for share in (0.75, 0.25, 0)]
    np.testing.assert_allclose(guide.weights(region, square), expected, rtol=1e-6)
    # Each ray as if it had brought nothing.
    brought = np.float32([3, 1, 0])
    expected = [2 / 1.5, 2 / 1.5, 2 / 1.5]
    np.testing.assert_allclose(guide.weights(region, square, brought), expected, rtol=1e-6)


def test_a_ray_alone_with_its_light_has_the_weight_of_an_even_one():
    region, square, brought = np.zeros(1, dtype=np.int64), np.float32([[0.5, 0.5]]), np.float32([0.1])
    np.testing.assert_allclose(Guide(region, square, brought).weights(region, square, brought), 1)


def estimates(seed: int) -> np.ndarray:
    """Mean light of each region by even and guided rays; it is 1."""
    random, region = small.rng(seed), region_of_rays()
    even = even_squares(REGIONS * RAYS, 1, random)
    brought = light(even)
    guide = Guide(region, even, brought)
    guided = guide.squares(region, random)
    parts = guide.weights(region, even, brought) * brought + guide.weights(region, guided) * light(guided)
    return np.bincount(region, parts) / (2 * RAYS)


def test_means_stay_what_they_are_and_noise_falls():
    """Were rays weighed by what they brought themselves, a tenth of the light would be missing."""
    found = np.concatenate([estimates(seed) for seed in range(100)])
    error = found.std() / np.sqrt(len(found))
    assert error < 0.01
    assert found.mean() == pytest.approx(1, abs=4 * float(error) + 0.02)
    # As many even rays: a share of 1 / 128 finds a light of 128.
    assert found.std() < 0.75 * np.sqrt(127 / (2 * RAYS))


def test_without_rays_there_is_no_guide():
    nothing = np.zeros(0, dtype=np.int64)
    guide = Guide(nothing, np.zeros((0, 2), np.float32), np.zeros(0, np.float32))
    assert guide.squares(nothing, small.rng()).shape == (0, 2)
    assert guide.weights(nothing, np.zeros((0, 2), np.float32)).shape == (0,)


UP = np.float32([0, 1, 0])


def points(*position: tuple[float, float, float], normal: np.ndarray = UP) -> Points:
    return Points(np.float32(position), np.tile(normal, (len(position), 1)))


def cells_of(some: Points) -> Cells:
    grid = Grid(np.zeros(3, dtype=np.float32), 1.0)
    return Cells.of(some, grid, lambda one, other, side: np.ones(len(one), dtype=bool))


def seen(hits: Points, valid: list[bool] | None = None) -> Seen:
    count = len(hits)
    arrived = np.ones(count, dtype=bool) if valid is None else np.array(valid)
    reflectance = small.rng().uniform(0.1, 0.5, (count, 3)).astype(np.float32) * arrived[:, None]
    return Seen(
        np.arange(count),
        np.zeros((count, 2), np.float32),
        np.zeros((count, 3), np.float32),
        np.ones(count, dtype=np.int64),
        hits,
        arrived,
        np.zeros(count, dtype=bool),
        np.arange(count) % 2,
        reflectance,
    )


def test_a_hit_in_cells_belongs_to_the_smallest():
    known = points((0.01, 0, 0.01), (0.3, 0, 0.3))
    cells = cells_of(known)
    hits = points((0.015, 0, 0.012), (0.07, 0, 0.07), (0.39, 0, 0.1))
    indices = cells.indices(hits)
    assert cells_hit(seen(hits), known, cells).tolist() == [indices[0, 0], indices[1, 1], indices[2, 2]]


@pytest.mark.parametrize("normal", [UP, -UP])
def test_a_hit_in_no_cell_belongs_to_the_nearest_point_that_faces_the_same_way(normal):
    floor, ceiling = points((0, 0, 0), (2, 0, 0)), points((0, 0.01, 0), (2.1, 0.01, 0), normal=-UP)
    known = Points(
        np.concatenate([floor.position, ceiling.position]), np.concatenate([floor.normal, ceiling.normal])
    )
    cells = cells_of(known)
    far = points((1.95, 0, 0), normal=normal)
    assert (cells.indices(far) == -1).all()
    nearest = points((2 if normal is UP else 2.1, 0 if normal is UP else 0.01, 0), normal=normal)
    assert cells_hit(seen(far), known, cells) == cells.indices(nearest)[0]


def test_a_ray_that_leaves_the_scene_hits_no_cell():
    known = points((0, 0, 0))
    hits = points((0, 0, 0), (0, 0, 0))
    assert cells_hit(seen(hits, [False, True]), known, cells_of(known))[0] == -1


def test_links_keep_rays_that_leave_and_weigh_what_others_bring():
    found = seen(points((0, 0, 0), (1, 0, 0), (2, 0, 0), (3, 0, 0)), [True, False, True, True])
    weight = np.float32([0.5, 1.5, 2, 1])
    links = links_of(found, np.array([4, -1, -1, 2]), weight)
    # The third hit something of which nothing can be said.
    assert links.point.tolist() == [0, 1, 3]
    assert links.cell.tolist() == [4, -1, 2]
    assert links.bounces.tolist() == [0, 1, 1]
    np.testing.assert_allclose(links.reflectance, (weight[:, None] * found.reflectance)[[0, 1, 3]])


def test_cells_are_of_several_sizes():
    """What the cases above rely on."""
    assert tuple(sorted(SIDES)) == SIDES
    assert SIDES[0] < 0.06 < SIDES[1] < 0.2 < SIDES[2] <= 0.4
