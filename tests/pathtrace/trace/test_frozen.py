"""Frozen functions of scenes give what the functions give, and survive threads and the garbage collector."""

from __future__ import annotations

import gc
import subprocess
import sys
import weakref
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import pytest

from pathtrace.scene.instances import FrozenWithScenes
from tests import small

pytestmark = pytest.mark.usefixtures("backend")
ROOT = Path(__file__).resolve().parents[3]


@dataclass(frozen=True)
class Pair:
    one: Any
    other: Any


@dataclass(frozen=True)
class Swapped(Pair):
    """As a pair, but another type."""


def mixed(pairs: list[Pair], named: dict[str, Any], factor: int) -> tuple[Any, ...]:
    """Dataclasses in a dataclass, a list, a tuple and a dict, and what the function makes of their types."""
    (one, other), scale = pairs, named["scale"].one
    sums = Pair([one.one + other.one], (one.other * scale, mi.Color3f(other.other.one) * factor))
    return type(other.other), sums, {"list": [Swapped(one.one, factor)], "empty": ()}


def arguments(width: int) -> tuple[list[Pair], dict[str, Any]]:
    ramp = dr.arange(mi.Float, width) + 0.5
    dr.eval(ramp)
    pairs = [Pair(ramp, ramp * 2), Pair(ramp + 1, Swapped(ramp * 3, (ramp,)))]
    dr.eval(pairs)
    return pairs, {"scale": Pair(dr.opaque(mi.Float, 3), None)}


def assert_alike(found: Any, expected: Any) -> None:
    """Of the same types throughout, with the same numbers."""
    assert type(found) is type(expected)
    if isinstance(found, Pair):
        found, expected = list(vars(found).items()), list(vars(expected).items())
    if isinstance(found, dict):
        found, expected = list(found.items()), list(expected.items())
    if isinstance(found, (list, tuple)):
        assert len(found) == len(expected)
        for one, other in zip(found, expected, strict=True):
            assert_alike(one, other)
    elif dr.is_array_v(found):
        assert dr.all(found == expected, axis=None)
    else:
        assert found == expected


@pytest.mark.usefixtures("no_garbage")
def test_a_frozen_function_gives_what_the_function_gives():
    frozen = FrozenWithScenes(mixed)
    # The second call replays the first one's recording with other numbers.
    for width in (100, 50):
        given = *arguments(width), 5
        assert_alike(frozen(*given), mixed(*given))
    assert frozen._recorded.n_recordings == 1


@pytest.mark.usefixtures("no_garbage")
def test_results_are_told_apart_by_types_and_values():
    """Where two arguments hold the same arrays but differ in structure, each has its own recording."""
    frozen = FrozenWithScenes(lambda value: [type(value), value])
    array = dr.opaque(mi.Float, 2)
    values = [[array, array], (array, array), Pair(array, array), Swapped(array, array), {"a": array}, array]
    for _ in range(2):
        for value in values:
            assert_alike(frozen(value), [type(value), value])
    assert frozen._recorded.n_recordings == len(values)
    for number in (1, 2, 1, 2):
        assert frozen(Pair(number, array))[1].one == number
    assert frozen._recorded.n_recordings == len(values) + 2


@pytest.mark.usefixtures("no_garbage")
def test_scenes_and_interactions_pass_as_they_are():
    scene = mi.load_dict(small.corner())

    def depth(scene: Any, hits: Pair) -> Pair:
        other = scene.ray_intersect(mi.Ray3f(mi.Point3f(0, 0, -1), hits.other))
        return Pair(other, hits.one.t + other.t)

    frozen, drjits_own = FrozenWithScenes(depth), dr.freeze(depth)
    for width in (64, 128, 192):
        direction = mi.Vector3f(dr.linspace(mi.Float, 0, 0.3, width), 0, 1)
        hit = scene.ray_intersect(mi.Ray3f(mi.Point3f(0, 0, -1), direction))
        dr.eval(hit, direction)
        found, expected = (function(scene, Pair(hit, direction)) for function in (frozen, drjits_own))
        assert type(found.one) is mi.SurfaceInteraction3f
        assert_alike(found.one.p, expected.one.p)
        assert_alike(found.other, expected.other)
    # The first time, Dr.Jit takes what it can for constants.
    assert frozen._recorded.n_recordings == drjits_own.n_recordings == 2


def distance_in(scene: Any, x: Any) -> Any:
    """Distance of what rays along z hit, times the red that their surface reflects."""
    hit = scene.ray_intersect(mi.Ray3f(0, mi.Vector3f(x, 0, 1)))
    return hit.t * hit.bsdf().eval_diffuse_reflectance(hit).x


@pytest.mark.usefixtures("no_garbage")
def test_other_scenes_in_memory_change_nothing():
    scene = mi.load_dict(small.corner())
    frozen = FrozenWithScenes(distance_in)
    x = dr.linspace(mi.Float, 0, 0.3, 64)
    dr.eval(x)
    expected = frozen(scene, x)
    other = mi.load_dict(small.corner())
    assert_alike(frozen(scene, x), expected)
    assert frozen._recorded.n_recordings == 1
    # Recorded with another scene in memory, whose methods are in the kernel then.
    late = FrozenWithScenes(distance_in)
    assert_alike(late(scene, x), expected)
    del other
    assert_alike(late(scene, x), expected)
    assert late._recorded.n_recordings == 1
    # And recorded once more, for another kind of argument, when there are others.
    later = [mi.load_dict(small.corner()) for _ in range(2)]
    assert_alike(late(scene, mi.Float(0.1)), distance_in(scene, mi.Float(0.1)))
    del later


@pytest.mark.usefixtures("no_garbage")
def test_a_function_follows_its_scene():
    """What is replaced in a scene is read by the recording that there is; constants are compiled in."""
    scene = mi.load_dict(small.corner())
    frozen = FrozenWithScenes(distance_in)
    x = dr.linspace(mi.Float, 0, 0.3, 64)
    dr.eval(x)
    parameters = mi.traverse(scene)
    colours = [key for key in parameters.properties if key.endswith("reflectance.value")]
    assert colours
    for level in (0.2, 0.4, 0.8, 0.3):
        for key in colours:
            parameters[key] = type(parameters[key])(level)
        parameters.update()
        assert_alike(frozen(scene, x), distance_in(scene, x))
    assert frozen._recorded.n_recordings <= 2


def test_scenes_are_told_apart():
    first, second = (mi.load_dict(small.corner()) for _ in range(2))
    parameters = mi.traverse(second)
    for key in [key for key in parameters.properties if key.endswith("reflectance.value")]:
        parameters[key] = type(parameters[key])(0.125)
    parameters.update()
    frozen = FrozenWithScenes(distance_in)
    x = dr.linspace(mi.Float, 0, 0.3, 64)
    dr.eval(x)
    for scene in (first, second, first, second):
        assert_alike(frozen(scene, x), distance_in(scene, x))


def test_the_collector_runs_after_an_error():
    def failing(value: Any) -> Any:
        assert not gc.isenabled()
        raise ValueError("no result")

    # Dr.Jit makes it the cause of an error of its own.
    with pytest.raises(RuntimeError, match="recording"):
        FrozenWithScenes(failing)(mi.Float([1, 2]))
    assert gc.isenabled()


def test_an_owner_can_be_collected():
    """An object whose method is frozen refers to itself through Dr.Jit."""

    class Owner:
        def __init__(self) -> None:
            self.run = FrozenWithScenes(self.doubled)

        def doubled(self, value: Pair) -> Pair:
            return Pair(value.one * 2, value.other)

    owner = Owner()
    owner.run(Pair(mi.Float([1, 2]), None))
    gone = weakref.ref(owner)
    del owner
    gc.collect()
    assert gone() is None


def ended(script: str) -> subprocess.CompletedProcess[str]:
    """A script's process, which must not take longer than two minutes."""
    command = [sys.executable, "-c", _PREPARATION + script]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120, check=False)


_PREPARATION = """
import gc, sys, threading
from pathtrace.scene.backend import select_backend
select_backend("llvm")
import drjit as dr, mitsuba as mi
from pathtrace.scene.instances import FrozenWithScenes
from tests import small
"""


def test_another_thread_may_free_arrays_meanwhile():
    """Dr.Jit's own way to freeze this function waits for ever."""
    script = """
from tests.pathtrace.trace.test_frozen import Pair
# Threads take turns far more often than usual.
sys.setswitchinterval(1e-6)
frozen = FrozenWithScenes(lambda pairs: [Pair(pair.other, pair.one + 1) for pair in pairs])
pairs = [Pair(mi.Float([1, 2]), mi.Float([3, 4])) for _ in range(20)]
over = threading.Event()

def allocate_and_free():
    while not over.is_set():
        [mi.Float(number) for number in range(100)]

other = threading.Thread(target=allocate_and_free)
other.start()
for _ in range(500):
    result = frozen(pairs)
over.set()
other.join()
print(result[0].other, frozen._recorded.n_recordings)
"""
    process = ended(script)
    assert process.returncode == 0, process.stderr
    assert process.stdout.split() == ["[2,", "3]", "1"]


def test_a_scene_is_not_collected_during_a_recording():
    """Dr.Jit's own way to freeze this function aborts the process."""
    script = """
held = [mi.load_dict(small.corner())]
scene = mi.load_dict(small.corner())
order = []

class Witness:
    def __del__(self):
        order.append("collected")

def abandon_scene():
    cycle = [held.pop(), Witness()]
    cycle.append(cycle)
    del cycle
    litter = [[] for _ in range(5000)]

def recorded(scene, x):
    abandon_scene()
    order.append("recorded")
    return scene.ray_intersect(mi.Ray3f(mi.Point3f(x, 0, -1), mi.Vector3f(0, 0, 1))).t

gc.collect()
gc.set_threshold(100, 1, 1)
print(FrozenWithScenes(recorded)(scene, mi.Float([0, 0.01])))
litter = [[] for _ in range(5000)]
print(*order)
"""
    process = ended(script)
    assert process.returncode == 0, process.stderr
    assert process.stdout.splitlines() == ["[3, 3]", "recorded collected"]
