"""Caches that follow lights: dimmed, switched on, seen in mirrors; and no light that changes by itself."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest

from pathtrace.cache.irradiance_cache import IrradianceCache
from pathtrace.fill.filling import fill_cache
from pathtrace.fill.relight import PARTS, Relighting
from pathtrace.scene.scene import Scene, load_scene
from pathtrace.trace.film import frame_positions
from pathtrace.trace.tracer import Tracer
from tests import small

pytestmark = pytest.mark.usefixtures("backend")
REFLECTANCE = 0.5


def filled(scene: Scene, seed: int = 0) -> IrradianceCache:
    return fill_cache(scene, [scene.camera], seed, points=1 << 15)


def emit(scene: Scene, radiance: float, name: str = "emitter.radiance.value") -> None:
    """Sets the radiance of the only lamp whose parameter has that name."""
    parameters = mi.traverse(scene.mitsuba)
    (key,) = (key for key in parameters.keys() if key.endswith(name))  # noqa: SIM118
    parameters[key] = mi.Color3f(radiance)
    parameters.update()


def renewed(relighting: Relighting) -> IrradianceCache:
    """The cache after all updates."""
    for _ in range(PARTS + 8):
        cache = relighting.update()
    assert relighting.renewed == cache.renewed == 1
    return cache


@pytest.fixture(scope="module")
def filled_corner(backend) -> tuple[Scene, IrradianceCache]:
    scene = load_scene(small.corner(), max_depth=5)
    return scene, filled(scene)


@pytest.fixture
def corner(filled_corner):
    """Walls and a mirror ball under a lamp of radiance 12, and their cache."""
    yield filled_corner
    emit(filled_corner[0], 12.0)


def weighted(cache: IrradianceCache, values: np.ndarray) -> float:
    """Mean over cells by their numbers of points."""
    return float(np.average(values.mean(axis=-1), weights=np.concatenate(cache.cells.counts)))


def test_in_a_closed_sphere_a_dimmed_wall_gives_half_of_the_closed_form():
    scene = load_scene(small.furnace(REFLECTANCE), max_depth=6)
    cache = filled(scene)
    emit(scene, 0.5 * (1 - REFLECTANCE))
    relighting = Relighting(scene, cache)
    first, last = relighting.update(), renewed(relighting)
    for segments in range(4):
        expected = 0.5 * np.pi * (1 - REFLECTANCE ** (segments + 1))
        assert weighted(cache, first.irradiance[segments]) == pytest.approx(expected, rel=0.02)
        assert weighted(cache, last.irradiance[segments]) == pytest.approx(expected, rel=0.01)


def test_light_that_does_not_change_stays_within_its_noise(corner):
    scene, cache = corner
    other = filled(scene, seed=1)
    last = renewed(Relighting(scene, cache))
    relative = weighted(cache, last.irradiance[-1]) / weighted(cache, cache.irradiance[-1]) - 1
    assert abs(relative) < 0.02
    # Of cells that both caches have: as different as a second filling is, or less.
    ours, theirs = (np.concatenate(one.cells.keys) for one in (cache, other))
    _, mine, yours = np.intersect1d(ours, theirs, return_indices=True)
    assert len(mine) > 50
    spread = np.abs(cache.irradiance[-1][mine] - other.irradiance[-1][yours]).mean()
    assert 0 < np.abs(last.irradiance[-1] - cache.irradiance[-1])[mine].mean() < 1.2 * spread


def test_a_lamp_that_is_alone_dims_all_light_by_its_factor(corner):
    scene, cache = corner
    emit(scene, 6.0)
    relighting = Relighting(scene, cache)
    before = weighted(cache, cache.irradiance[-1])
    assert weighted(cache, relighting.update().irradiance[-1]) == pytest.approx(0.5 * before, rel=0.05)
    assert weighted(cache, renewed(relighting).irradiance[-1]) == pytest.approx(0.5 * before, rel=0.02)


def test_a_lamp_that_is_switched_off_and_on_is_known_again(corner):
    scene, cache = corner
    emit(scene, 0.0)
    relighting = Relighting(scene, cache)
    assert renewed(relighting).irradiance.max() == 0
    emit(scene, 12.0)
    relighting.change()
    assert relighting.renewed == 0
    last = renewed(relighting)
    mean = weighted(cache, cache.irradiance[-1])
    assert weighted(cache, last.irradiance[-1]) == pytest.approx(mean, rel=0.02)
    difference = np.abs(last.irradiance[-1] - cache.irradiance[-1]).mean()
    assert difference < 0.5 * np.abs(cache.irradiance[-1]).mean()


def mirrored() -> dict:
    """A floor that gets all of its light from a lamp below it, by way of a ceiling that is a mirror."""
    turned = lambda height, angle: (  # noqa: E731
        mi.ScalarTransform4f().translate([0, height, 0]).rotate([1, 0, 0], angle).scale(20)
    )
    look = mi.ScalarTransform4f().look_at(origin=[0, 0.9, -1], target=[0, 0, 0], up=[0, 1, 0])
    floor = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.5}}
    return {
        "type": "scene",
        "sensor": {**small.sensor(), "to_world": look},
        "floor": {
            "type": "rectangle",
            "to_world": mi.ScalarTransform4f().rotate([1, 0, 0], -90).scale(2),
            "bsdf": {"type": "twosided", "b": floor},
        },
        "ceiling": {"type": "rectangle", "to_world": turned(1, 90), "bsdf": {"type": "conductor"}},
        "lamp": {
            "type": "rectangle",
            "to_world": turned(-1, -90),
            "emitter": {"type": "area", "radiance": {"type": "rgb", "value": 2.0}},
        },
    }


def test_light_seen_in_a_mirror_follows():
    scene = load_scene(mirrored())
    cache = filled(scene)
    assert len(cache.transfer.rays) > 1000
    transfer = cache.transfer
    above = (transfer.points.position[:, 1] > -0.5) & (transfer.points.normal[:, 1] > 0.5)
    inside = transfer.transport.patches.cells.max(axis=0)[transfer.patch] >= 0
    assert (transfer.direct[transfer.patch[above & inside]] == 0).all()
    assert cache.transfer.reflected.max() > 0
    emit(scene, 1.0)
    last = renewed(Relighting(scene, cache))
    ratio = weighted(cache, last.irradiance[-1]) / weighted(cache, cache.irradiance[-1])
    assert ratio == pytest.approx(0.5, rel=0.03)


def test_a_lamp_that_is_switched_on_is_chosen_more_often():
    spot = {"type": "point", "position": [-0.6, 0.1, 1.0], "intensity": {"type": "rgb", "value": 0.0}}
    scene = load_scene({**small.corner(), "spot": spot})
    cache = filled(scene)
    emit(scene, 50.0, "intensity.value")
    last = renewed(Relighting(scene, cache))
    number = ["Point" in light.class_name() for light in scene.mitsuba.emitters()].index(True)
    assert cache.lights.chances[-1, number] == pytest.approx(0.1)
    assert last.lights.chances[-1, number] > 0.5
    np.testing.assert_allclose(last.lights.chances.sum(axis=1), 1, rtol=1e-5)


def test_the_updates_end_and_say_how_far_they_are(corner):
    relighting = Relighting(*corner)
    assert relighting.renewed == 0
    shares = [relighting.update().renewed for _ in range(PARTS + 2)]
    assert shares == pytest.approx(np.arange(1, PARTS + 3) / (PARTS + 2))
    assert relighting.update() is relighting.update()


def test_the_same_seed_gives_the_same_light(corner):
    scene, cache = corner
    one, same, other = (Relighting(scene, cache, seed).update().irradiance for seed in (3, 3, 4))
    assert (one == same).all()
    assert (one != other).any()


@pytest.mark.usefixtures("no_garbage")
def test_new_light_is_traced_without_recording_anything_again(corner):
    scene, cache = corner
    tracer, positions = Tracer(scene, cache=cache), frame_positions(scene.camera)
    tracer.trace(scene.camera, positions)
    recordings = tracer._trace_radiance._recorded.n_recordings
    relighting = Relighting(scene, cache)
    for number in range(4):
        emit(scene, 12.0 / (number + 1))
        relighting.change()
        tracer.relight(relighting.update())
        tracer.trace(scene.camera, positions, seed=number)
    assert tracer._trace_radiance._recorded.n_recordings == recordings
    resampling = relighting._resampling
    assert max(resampling._light._recorded.n_recordings, resampling._show._recorded.n_recordings) == 1
