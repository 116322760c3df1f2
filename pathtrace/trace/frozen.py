"""Frozen functions of scenes: Dr.Jit records them once and replays them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi

from compose.base.frozen import Frozen, Passed, collector_paused
from pathtrace.scene.instances import InstancedScene, array_indices, of_mitsuba

# Array types by whose entries one gets at all objects that Mitsuba has registered.
_REGISTERED = "BSDF", "Emitter", "Medium", "PhaseFunction", "Sensor", "Shape", "Texture"
# More objects than there are, and what stands for one that there is not.
_NO_NUMBER = 1 << 30
_MISSING = object()


class FrozenWithScenes(Frozen):
    """A frozen function that takes scenes, as arguments of their own, in nothing else.

    A scene is walked through at each call, each shape with all that it refers to: 2 ms for 38 shapes. So its
    arrays pass in its place, and are only looked for again if one of them has been replaced.
    """

    def __init__(self, function: Callable[..., Any]):
        super().__init__(function)
        self._scenes: dict[int, _Scene] = {}

    def __call__(self, *arguments: Any) -> Any:
        with collector_paused():
            scenes = mi.Scene, InstancedScene
            given = tuple(self._known(each) if type(each) in scenes else each for each in arguments)
            try:
                return self.replayed(given)
            except RuntimeError:
                # Another recording, where scenes came into memory since the arrays were looked for.
                if not sum(each.renewed() for each in given if type(each) is _Scene):
                    raise
                return self.replayed(given)

    def _known(self, scene: Any) -> _Scene:
        """A scene with its arrays as they are now."""
        # What is kept holds the scene, so that no other one gets its address.
        known = self._scenes.setdefault(id(scene), _Scene(scene))
        known.follow()
        return known


class _Scene(Passed):
    """A scene as an argument of a recording: told apart by identity, with its arrays beside it."""

    def __init__(self, scene: Any):
        self.value = scene
        self._indices: list[int] = []
        self._held: list[int] = []
        self.flat: tuple[Any, ...] = ()

    def follow(self) -> None:
        """Looks for the arrays again if one of the scene's has been replaced since the last time."""
        scene = self.value
        indices = array_indices(scene.parts if isinstance(scene, InstancedScene) else [scene])
        if indices != self._indices:
            self._indices = indices
            self.renewed()

    def renewed(self) -> bool:
        """Looks for the arrays again; whether there are others."""
        # A recording has the functions of all objects in memory in it, and reads the arrays of all.
        objects, scene = _registered_objects(), self.value
        found = dict.fromkeys(array_indices([of_mitsuba(scene), *objects]))
        if isinstance(scene, InstancedScene):
            found = dict.fromkeys(scene.read(found, objects))
        of_all = [index for index in found if index]
        if of_all == self._held:
            return False
        # What is held keeps its number: none that is freed meanwhile can be taken for it.
        held = dr.detail.update_indices([mi.Float(0)] * len(of_all), of_all)
        dr.eval(held)
        # Constants are compiled in; one string is compared sooner than their numbers.
        constants = repr([array.index for array in held if array.state != dr.VarState.Evaluated])
        self._held, self.flat = of_all, (_Scene, self, constants, *held)
        return True


def _registered_objects() -> list[Any]:
    """All objects of Mitsuba whose methods kernels call."""
    found: list[Any] = []
    for name in _REGISTERED:
        kind = getattr(mi, f"{name}Ptr")
        # Beyond the last number of a kind is an error, but of a kind that has none, all are None.
        if _of_number(kind, _NO_NUMBER) is not _MISSING:
            continue
        number = 1
        while (each := _of_number(kind, number)) is not _MISSING:
            found += [] if each is None else [each]
            number += 1
    return found


def _of_number(kind: Any, number: int) -> Any:
    """The registered object of a kind with a number; None if it was freed, _MISSING beyond the last one."""
    try:
        return dr.reinterpret_array(kind, mi.UInt32(number))[0]
    except RuntimeError:
        return _MISSING
