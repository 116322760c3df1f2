"""Scenes as kernels have them: those with instances, and those that frozen functions take.

Mitsuba 3.9 compiles code of its own for every instance into every kernel: seconds for a hundred, minutes for
a thousand. Mitsuba 3.10 looks up where an instance is instead, and so do kernels here.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any, TypeAlias, TypeVar

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from compose.base.arrays import uploaded
from compose.base.frozen import Frozen, Passed, collector_paused

# What rays are traced through.
AnyScene: TypeAlias = "mi.Scene | InstancedScene"
_INSTANCE, _GROUP = "Instance", "ShapeGroupPlugin"
_LEAST = 1e-30
# Array types by whose entries one gets at all objects that Mitsuba has registered.
_REGISTERED = "BSDF", "Emitter", "Medium", "PhaseFunction", "Sensor", "Shape", "Texture"
# More objects than there are, and what stands for one that there is not.
_NO_NUMBER = 1 << 30
_MISSING = object()
_Result = TypeVar("_Result")


def _parts(whole: mi.Object) -> list[mi.Shape]:
    """The parts of a Mitsuba scene or group in their order; shapes, as far as they are asked for."""
    found: list[mi.Object] = []

    # Mitsuba has no classes before its variant is chosen.
    class Callback(mi.TraversalCallback):  # type: ignore[misc]
        def put(self, name: str, value: mi.Object, *flags: object) -> None:
            if isinstance(value, mi.Object):
                found.append(value)

    whole.traverse(Callback())
    parts: list[Any] = found.copy()
    # A class waits for the garbage collector, which must not be what frees a scene.
    found.clear()
    return parts


def _groups(scene: mi.Scene) -> list[mi.Shape]:
    return [part for part in _parts(scene) if part.class_name() == _GROUP]


def _instances(scene: mi.Scene) -> list[mi.Shape]:
    return [shape for shape in scene.shapes() if shape.class_name() == _INSTANCE]


def seen_shapes(scene: mi.Scene) -> list[mi.Shape]:
    """The shapes of a Mitsuba scene that rays hit: those of groups, once each, in place of instances."""
    own = [shape for shape in scene.shapes() if shape.class_name() != _INSTANCE]
    if len(own) == len(scene.shapes()):
        return own
    return own + [shape for group in _groups(scene) for shape in _parts(group)]


def array_indices(objects: Sequence[object]) -> list[int]:
    """Numbers of the arrays of Mitsuba's objects, each as often as they refer to it; 0 of empty ones."""
    with dr.scoped_set_flag(dr.JitFlag.EnableObjectTraversal, True):
        return list(dr.detail.collect_indices(objects))


def of_mitsuba(scene: AnyScene) -> mi.Scene:
    """The Mitsuba scene itself, where nothing can stand in for it."""
    return scene.whole if isinstance(scene, InstancedScene) else scene


class InstancedScene:
    """A Mitsuba scene with instances, which finds out by itself what rays hit; the rest is the whole's."""

    def __init__(self, scene: mi.Scene):
        self.whole, self._instances = scene, _instances(scene)
        # Each has a BSDF that nothing shows, but that kernels would have.
        unseen = mi.load_dict({"type": "diffuse"})
        for instance in self._instances:
            instance.set_bsdf(unseen)
        # Mitsuba does not tell the group of an instance, but the arrays of all that an instance refers to.
        held, group_of = [set(array_indices([group])) for group in _groups(scene)], []
        for instance in self._instances:
            arrays = set(array_indices([instance]))
            group_of.append(next(number for number, own in enumerate(held) if own <= arrays))
        groups = [_parts(group) for group in _groups(scene)]
        self._repeated = [groups[number] for number in group_of]
        self._targets = seen_shapes(scene)
        self.arrays = self._tables(groups, group_of)

    @staticmethod
    def of(scene: mi.Scene) -> InstancedScene | None:
        """What stands in for a Mitsuba scene; None if it has no instances, or nothing in them."""
        return InstancedScene(scene) if _instances(scene) and seen_shapes(scene) else None

    def __getattr__(self, name: str) -> Callable[..., Any]:
        """A method of the scene's."""
        return getattr(self.whole, name)

    @property
    def triangles(self) -> int:
        """Number of triangles as they are seen: those of groups once for each instance."""
        own = [shape for shape in self.whole.shapes() if shape.class_name() != _INSTANCE]
        return sum(shape.face_count() for part in (own, *self._repeated) for shape in part if shape.is_mesh())

    @property
    def parts(self) -> list[object]:
        """What holds the arrays that may be replaced by others, and that kernels read."""
        return [*self._targets, *self.whole.emitters(), *self.arrays.values()]

    def read(self, arrays: Iterable[int], objects: list[mi.Object]) -> list[int]:
        """Which of the arrays of the scene, and of all objects in memory, kernels read; and its own."""
        unseen, seen = list[mi.Object](), list[mi.Object]()
        for each in objects:
            (unseen if each.class_name() in (_INSTANCE, _GROUP) else seen).append(each)
        unread = set(array_indices(unseen)) - set(array_indices(seen))
        return [*(index for index in arrays if index not in unread), *array_indices(self.parts)]

    def _tables(self, groups: list[list[mi.Shape]], group_of: list[int]) -> dict[str, Any]:
        """Arrays by name: of each registered shape, and of what groups consist of.

        A shape's `place` is where its case stands among all `cases`, an instance's where those of its group
        begin; `row` is that of its matrices, 0 if it is not an instance. The `shape` is that of each case.
        """
        numbers = [registered(shape) for shape in self._targets]
        case = {number: index for index, number in enumerate(numbers)}
        instances = [registered(instance) for instance in self._instances]
        size = max((*numbers, *instances)) + 1
        place, row = np.arange(size, dtype=np.uint32), np.zeros(size, dtype=np.uint32)
        cases = [case.get(number, 0) for number in range(size)]
        starts = []
        for group in groups:
            starts.append(len(cases))
            cases += [case[registered(shape)] for shape in group]
        place[instances] = [starts[number] for number in group_of]
        row[instances] = np.arange(1, len(instances) + 1)
        tables = {"place": place, "row": row, "cases": cases, "shape": numbers}
        found = {name: uploaded(mi.UInt32, np.array(table, np.uint32)) for name, table in tables.items()}
        return {**found, "matrices": uploaded(mi.Float, self._matrices())}

    def _matrices(self) -> NDArray[np.float32]:
        """(N + 1, 2, 3, 4) to_world of each instance and its inverse; the first row leaves all as it is."""
        to_world = [np.eye(4)]
        for instance in self._instances:
            matrix = mi.traverse(instance)["to_world"].matrix
            to_world.append(np.array(matrix, np.float64).reshape(4, 4))
        # Nothing hits what has no volume.
        flat = [abs(np.linalg.det(matrix)) == 0 for matrix in to_world]
        inverse = np.linalg.inv(np.where(np.array(flat)[:, None, None], np.eye(4), to_world))
        return np.stack([to_world, inverse], axis=1)[:, :, :3].astype(np.float32)

    def follow(self) -> None:
        """Takes down where instances are now."""
        self.arrays["matrices"] = uploaded(mi.Float, self._matrices())

    def ray_intersect(
        self,
        ray: mi.Ray3f,
        ray_flags: int | None = None,
        coherent: bool = False,
        active: mi.Bool | bool = True,
    ) -> mi.SurfaceInteraction3f:
        """What Mitsuba's function of this name returns."""
        ray_flags = mi.RayFlags.All if ray_flags is None else ray_flags
        found = self.whole.ray_intersect_preliminary(ray, coherent, active)
        active = mi.Bool(active) & found.is_valid()
        shape, instance = (
            mi.UInt32(dr.reinterpret_array(mi.UInt32, x)) for x in (found.shape, found.instance)
        )
        place, row, cases, shapes = (self.arrays[name] for name in ("place", "row", "cases", "shape"))
        start = dr.select(instance == 0, shape, instance)
        at = dr.gather(mi.UInt32, place, start, active)
        if dr.backend_v(mi.Float) == dr.JitBackend.LLVM:
            # Embree says which part of the group it is, OptiX which shape.
            at += dr.select(instance == 0, 0, found.shape_index)
        else:
            at = shape
        case = dr.gather(mi.UInt32, cases, at, active)
        first = 6 * dr.gather(mi.UInt32, row, instance, active)
        rows = [dr.gather(mi.Vector4f, self.arrays["matrices"], first + n, active) for n in range(6)]
        to_world, to_object = rows[:3], rows[3:]
        local = mi.Ray3f(ray)
        local.o, local.d = _moved(to_object, ray.o), _turned(to_object, ray.d)
        found.shape = found.instance = dr.zeros(mi.ShapePtr, dr.width(case))
        hit = dr.switch(
            case, [_interaction(target, ray_flags) for target in self._targets], local, found, active
        )
        _place(hit, to_world, to_object)
        hit.shape = dr.reinterpret_array(mi.ShapePtr, dr.gather(mi.UInt32, shapes, case, active))
        hit.instance = dr.reinterpret_array(mi.ShapePtr, dr.select(active, instance, 0))
        hit.t, hit.prim_index = dr.select(active, found.t, dr.inf), found.prim_index
        hit.time, hit.wavelengths = ray.time, ray.wavelengths
        hit.initialize_sh_frame()
        hit.wi = dr.select(active, hit.to_local(-ray.d), -ray.d)
        return hit


def registered(shape: mi.Shape) -> int:
    """The number by which kernels know a shape."""
    return int(mi.UInt32(dr.reinterpret_array(mi.UInt32, mi.ShapePtr(shape)))[0])


def _interaction(shape: mi.Shape, flags: int) -> Callable[..., mi.SurfaceInteraction3f]:
    def found(ray: mi.Ray3f, hit: mi.PreliminaryIntersection3f, active: mi.Bool) -> mi.SurfaceInteraction3f:
        at = shape.compute_surface_interaction(ray, hit, flags, active)
        # Mitsuba's kernels have the same code for all shapes that differ in nothing else.
        at.shape = dr.zeros(mi.ShapePtr)
        return at

    return found


def _turned(rows: list[mi.Vector4f], vector: mi.Vector3f) -> mi.Vector3f:
    """Vectors (3,) by the first three columns of a matrix."""
    return mi.Vector3f(*(row.x * vector.x + row.y * vector.y + row.z * vector.z for row in rows))


def _moved(rows: list[mi.Vector4f], point: mi.Point3f) -> mi.Point3f:
    return mi.Point3f(*(row.x * point.x + row.y * point.y + row.z * point.z + row.w for row in rows))


def _place(hit: mi.SurfaceInteraction3f, to_world: list[mi.Vector4f], to_object: list[mi.Vector4f]) -> None:
    """Takes an interaction in the space of a shape to the world's."""
    x, y, z = to_object
    # The inverse, transposed: normals stay upright on what is stretched.
    upright = [mi.Vector3f(x[n], y[n], z[n]) for n in range(3)]
    lean = lambda vector: mi.Normal3f(*(dr.dot(column, mi.Vector3f(vector)) for column in upright))  # noqa: E731
    shading, normal = lean(hit.sh_frame.n), lean(hit.n)
    # Both are 0 where nothing is hit.
    length, other = (dr.maximum(dr.norm(each), _LEAST) for each in (shading, normal))
    hit.p, hit.n, hit.sh_frame.n = _moved(to_world, hit.p), normal / other, shading / length
    hit.dp_du, hit.dp_dv = _turned(to_world, hit.dp_du), _turned(to_world, hit.dp_dv)
    for name in ("dn_du", "dn_dv"):
        change = lean(getattr(hit, name)) / length
        setattr(hit, name, mi.Vector3f(change - hit.sh_frame.n * dr.dot(hit.sh_frame.n, change)))


class FrozenWithScenes(Frozen[_Result]):
    """A frozen function that takes scenes, as arguments of their own, in nothing else.

    To walk through a scene of 38 shapes at each call takes 2 ms. So its arrays pass in its place, and are
    only looked for again if one of them has been replaced.
    """

    def __init__(self, function: Callable[..., _Result]):
        super().__init__(function)
        self._scenes: dict[int, _Scene] = {}

    def __call__(self, *arguments: object) -> _Result:
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

    def _known(self, scene: AnyScene) -> _Scene:
        # What is kept holds the scene, so that no other one gets its address.
        known = self._scenes.setdefault(id(scene), _Scene(scene))
        known.follow()
        return known


class _Scene(Passed):
    """A scene as an argument of a recording: told apart by identity, with its arrays beside it."""

    def __init__(self, scene: AnyScene):
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
        held: Any = dr.detail.update_indices([mi.Float(0)] * len(of_all), of_all)
        dr.eval(held)
        # Constants are compiled in; one string is compared sooner than their numbers.
        constants = repr([array.index for array in held if array.state != dr.VarState.Evaluated])
        self._held, self.flat = of_all, (_Scene, self, constants, *held)
        return True


def _registered_objects() -> list[mi.Object]:
    found = []
    for name in _REGISTERED:
        kind = getattr(mi, f"{name}Ptr")
        # Beyond the last number of a kind is an error, but of a kind that has none, all are None.
        if _of_number(kind, _NO_NUMBER) is not _MISSING:
            continue
        number = 1
        while (each := _of_number(kind, number)) is not _MISSING:
            if each is not None:
                found.append(each)
            number += 1
    return found


def _of_number(kind: type[dr.ArrayBase], number: int) -> mi.Object | object | None:
    """The registered object of a kind with a number; None if it was freed, _MISSING beyond the last one."""
    try:
        found: Any = dr.reinterpret_array(kind, mi.UInt32(number))
        return found[0]
    except RuntimeError:
        return _MISSING
