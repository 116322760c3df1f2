"""Moves what has a track in a loaded scene."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import product
from pathlib import Path
from typing import Any, TypeAlias

import drjit as dr
import mitsuba as mi
import numpy as np
import torch
from numpy.typing import DTypeLike, NDArray

from compose.base.errors import UserError, one_line
from compose.base.traced_samples import UNSTEADY, Moment
from compose.camera.camera import Array, between_steps, unit
from compose.camera.coordinate_systems import Place
from pathtrace.scene.courses import (
    Course,
    course_of_poses,
    courses_of_pieces,
    is_unchanged,
    spread_over_faces,
)
from pathtrace.scene.instances import AnyScene, InstancedScene, of_mitsuba
from pathtrace.scene.motion_file import Formula, LightTrack, MeshTrack, RigidTrack, SceneMotion, ShapeTrack

# Parameters by name that have a value of their own at a time.
_Part: TypeAlias = Callable[[float], dict[str, Any]]

_POSITIONS, _NORMALS = "vertex_positions", "vertex_normals"
# Poses of a course: linear between them, a turn of ten times is off by next to nothing.
_STEPS = 129
# Meshes of fewer vertices, such as a quad's four, are taken to pieces with as many points on their faces.
_COARSE = 1000
# What a light's brightness is called, in that order.
_BRIGHTNESS = ("radiance", "intensity", "irradiance", "scale")


class MovingScene:
    """A Mitsuba scene in which shapes and lights follow their tracks, from 0 to 1; it is at t = 0 at first.

    It is changed in place, only where something has moved, and no kernel is compiled again. UserError if a
    track is for what does not exist or cannot move that way.

    Args:
        scene, motion, place: the scene, its tracks, and its coordinates.
        names: the id that a shape or light of the scene has, by the one that it has in the scene's file.
        source: name of the scene, for error messages.
    """

    def __init__(
        self, scene: AnyScene, motion: SceneMotion, names: dict[str, str], place: Place, source: str
    ):
        self.motion, self.time = motion, 0.0
        self._scene, self._names = scene, names
        self._parameters = mi.traverse(of_mitsuba(scene))
        self._tracked = _Tracked(self._parameters, names, place, source)
        self._rest = self._tracked.vertices_of(motion)
        self._parts = self._tracked.parts(motion, self._rest)
        self._shown: dict[str, bytes] = {}
        self._show(0.0)

    def set_time(self, time: float) -> None:
        """Shows the scene at a time; UserError if that is not from 0 to 1."""
        if not 0 <= time <= 1:
            raise UserError(f"time {time:g}: must be from 0 to 1")
        if time != self.time:
            self._show(time)
            self.time = time

    @property
    def shapes(self) -> list[Any]:
        """The Mitsuba shapes that have a track, of whatever kind."""
        tracked = {self._names[name] for name in self.motion.shapes}
        return [shape for shape in self._scene.shapes() if shape.id() in tracked]

    def movers(self) -> list[tuple[Any, int]]:
        """The Mitsuba shapes that have a track, with the numbers of their samples (`Moment`)."""
        rigid = {self._names[name]: number for number, (name, _) in enumerate(self._rigid_tracks(), 1)}
        return [(shape, rigid.get(shape.id(), UNSTEADY)) for shape in self.shapes]

    def moment(self) -> Moment:
        """The time that the scene shows, and where its movers are."""
        poses = [self._tracked.pose(track, self.time)[:3] for _, track in self._rigid_tracks()]
        return Moment(self.time, np.stack([np.eye(4)[:3], *poses]))

    def _rigid_tracks(self) -> list[tuple[str, RigidTrack]]:
        return [(name, track) for name, track in self.motion.shapes.items() if isinstance(track, RigidTrack)]

    def courses(self, steps: int = _STEPS) -> list[Course]:
        """Courses of all that moves, of pieces of what deforms; nobody sees turns of plain balls."""
        shapes = {shape.id(): (number, shape) for number, shape in enumerate(self._scene.shapes())}
        times, found = np.linspace(0, 1, steps), []
        for name, track in self.motion.shapes.items():
            if self._names[name] not in shapes:
                continue
            number, shape = shapes[self._names[name]]
            rest = self._rest.get(name)
            if isinstance(track, RigidTrack):
                poses = np.stack([self._tracked.pose(track, time) for time in times])
                centre = self._tracked.place.from_world(np.array(track.about))
                mesh = () if rest is None else (rest, self._tracked.faces_of(name))
                if mesh and not _is_textured(shape) and is_unchanged(*mesh, centre, poses[:, :3, :3]):
                    # Its highlights stay where they are while it turns.
                    poses[:, :3, 3] = poses[:, :3, :3] @ centre + poses[:, :3, 3] - centre
                    poses[:, :3, :3] = np.eye(3)
                found.append(course_of_poses(name, number, poses, centre))
            elif rest is not None:
                at = self._tracked.deforming(name, rest, track)
                moved = np.stack([at(time) for time in times])
                if len(rest) < _COARSE:
                    # With points on the faces between the vertices.
                    corners, shares = spread_over_faces(rest, self._tracked.faces_of(name), _COARSE)
                    between = np.einsum("nc,tnci->tni", shares, moved[:, corners])
                    rest = np.concatenate([rest, np.einsum("nc,nci->ni", shares, rest[corners])])
                    moved = np.concatenate([moved, between], axis=1)
                found += courses_of_pieces(name, number, rest, moved)
        return found

    def _show(self, time: float) -> None:
        for part in self._parts:
            for key, value in part(time).items():
                content = np.asarray(value, dtype=np.float64).tobytes()
                if self._shown.get(key) != content:
                    self._set(key, value)
                    self._shown[key] = content
        self._parameters.update()
        if isinstance(self._scene, InstancedScene):
            self._scene.follow()

    def _set(self, key: str, value: Array) -> None:
        """Gives a parameter a value; recordings may go on reading the memory of vertices (Dr.Jit 1.5)."""
        if key.endswith((_POSITIONS, _NORMALS)):
            torch.from_dlpack(self._parameters[key])[:] = torch.from_numpy(value.astype(np.float32))
            self._parameters.set_dirty(key)
            return
        kind, numbers = type(self._parameters[key]), np.ravel(value)
        if value.shape == (4, 4):
            self._parameters[key] = kind(value.tolist())
        elif len(numbers) in (1, 3) and kind is not mi.Float:
            self._parameters[key] = kind(*numbers.tolist())
        else:
            self._parameters[key] = kind(np.ascontiguousarray(value, dtype=np.float32))


class _Tracked:
    """What tracks make of a scene's parameters, as functions of time.

    These functions hold it, and it holds none of them: whatever holds a Mitsuba scene must be freed at once,
    and not by the garbage collector, which may come while Dr.Jit goes through all scenes.
    """

    def __init__(self, parameters: mi.SceneParameters, names: dict[str, str], place: Place, source: str):
        self.place, self._parameters, self._names, self._source = place, parameters, names, source

    def parts(self, motion: SceneMotion, rest: Mapping[str, Array]) -> list[_Part]:
        """What each track makes of the parameters; `rest` is what `vertices_of` gave."""
        shapes = [self._moving(name, track, rest.get(name)) for name, track in motion.shapes.items()]
        return shapes + [self._shining(name, track) for name, track in motion.lights.items()]

    def vertices_of(self, motion: SceneMotion) -> dict[str, Array]:
        """Vertices (N, 3) of each mesh with a track as they are now, by its name in the scene's file."""
        keys = {name: f"{self._key(name, 'shape or light')}.{_POSITIONS}" for name in motion.shapes}
        return {name: _rows(self._parameters[key]) for name, key in keys.items() if self._has(key)}

    def faces_of(self, name: str) -> NDArray[np.int64]:
        """(F, 3) indices of the vertices of a mesh."""
        return _rows(self._parameters[f"{self._names[name]}.faces"], np.int64)

    def _key(self, name: str, what: str) -> str:
        if name not in self._names:
            raise self._refused(name, f"there is no such {what} in the scene")
        return self._names[name]

    def _refused(self, name: str, why: str) -> UserError:
        return UserError(f"{self._source}: motion of {one_line(name)}: {why}")

    def _has(self, key: str) -> bool:
        return key in self._parameters.properties

    def _moving(self, name: str, track: ShapeTrack, rest: Array | None) -> _Part:
        """What a track makes of a shape's, or light's, parameters; `rest` are the vertices of a mesh."""
        key = self._key(name, "shape or light")
        if rest is not None:
            return self._mesh_part(name, key, track, rest)
        if not isinstance(track, RigidTrack):
            raise self._refused(name, "it has no vertices; must have keyframes")
        # Shapes and lights without vertices.
        to_world, position = f"{key}.to_world", f"{key}.position"
        if self._has(to_world):
            matrix = np.array(self._parameters[to_world].matrix, dtype=np.float64).reshape(4, 4)
            return lambda time: {to_world: self.pose(track, time) @ matrix}
        if self._has(position):
            point = np.ravel(self._parameters[position]).astype(np.float64)
            return lambda time: {position: (self.pose(track, time) @ [*point, 1])[:3]}
        raise self._refused(name, "it has no place that could change")

    def _mesh_part(self, name: str, key: str, track: ShapeTrack, rest: Array) -> _Part:
        """What a track makes of the vertices and, if it has some, the normals of a mesh."""
        positions, normals = f"{key}.{_POSITIONS}", f"{key}.{_NORMALS}"
        upright = _rows(self._parameters[normals]) if self._has(normals) else np.zeros((0, 3))
        faces = self.faces_of(name)
        at = None if isinstance(track, RigidTrack) else self.deforming(name, rest, track)

        def moved(time: float) -> dict[str, Any]:
            if isinstance(track, RigidTrack):
                pose = self.pose(track, time)
                vertices, turned = rest @ pose[:3, :3].T + pose[:3, 3], upright @ pose[:3, :3].T
            elif at is not None:
                vertices = at(time)
                # Mitsuba would put its own into other memory.
                turned = _vertex_normals(vertices, faces) if len(upright) else upright
            return {positions: vertices.ravel(), **({normals: turned.ravel()} if len(turned) else {})}

        return moved

    def deforming(self, name: str, rest: Array, track: Formula | MeshTrack) -> Callable[[float], Array]:
        """Positions (N, 3) of a shape's vertices in the scene's coordinates, as a function of time."""
        if isinstance(track, Formula):
            in_file = self.place.in_world(rest)

            def by_formula(time: float) -> Array:
                try:
                    return self.place.from_world(track.positions(in_file, time))
                except ValueError as error:
                    raise self._refused(name, str(error)) from error

            return by_formula
        meshes = [self.place.from_world(self._mesh(name, file, len(rest))) for file in track.files]

        def between_meshes(time: float) -> Array:
            first, share = between_steps(time, len(meshes))
            return meshes[first] + share * (meshes[first + 1] - meshes[first])

        return between_meshes

    def _mesh(self, name: str, file: Path, count: int) -> Array:
        kind = file.suffix.lower().lstrip(".")
        if kind not in ("ply", "obj"):
            raise self._refused(name, f"{file}: must be a PLY or OBJ file")
        try:
            loaded = mi.load_dict({"type": kind, "filename": str(file)})
        except Exception as error:
            raise self._refused(name, f"{file}: cannot be read ({one_line(error)})") from error
        vertices = _rows(mi.traverse(loaded)[_POSITIONS])
        if len(vertices) != count:
            raise self._refused(name, f"{file}: has {len(vertices):,} vertices; the shape has {count:,}")
        return vertices

    def pose(self, track: RigidTrack, time: float) -> Array:
        """(4, 4) from rest to a time in the scene's coordinates."""
        pose = track.pose(time)
        pose[:3, 3] = self.place.from_world(pose[:3, :3] @ np.array(self.place.origin) + pose[:3, 3])
        return pose

    def _shining(self, name: str, track: LightTrack) -> _Part:
        """What a track makes of the brightness of a light, or of a shape that shines."""
        key = self._key(name, "light")
        parts = product((key, f"{key}.emitter"), _BRIGHTNESS, (".value", ""))
        found = [full for owner, kind, value in parts if self._has(full := f"{owner}.{kind}{value}")]
        if not found:
            raise self._refused(name, "it has no radiance that could change")
        rest = np.ravel(self._parameters[found[0]]).astype(np.float64)

        def at(time: float) -> dict[str, Any]:
            factor = track.factor(time)
            if len(rest) == 1 and np.ptp(factor):
                raise self._refused(name, "its radiance has no colour; factor must be one number")
            return {found[0]: rest * (factor if len(rest) == 3 else factor[0])}

        return at


def _rows(values: dr.ArrayBase, dtype: DTypeLike = np.float64) -> NDArray[Any]:
    """(N, 3) what a parameter is now: a copy, since its memory is written to at each time."""
    return np.reshape(values.numpy(), (-1, 3)).astype(dtype)


def _is_textured(shape: mi.Shape) -> bool:
    """Whether colours are painted on a shape, by an image or at its vertices."""
    bsdf = shape.bsdf()
    images = bsdf is not None and any(key.endswith(".data") for key in mi.traverse(bsdf).properties)
    return images or any("_color" in key for key in mi.traverse(shape).properties)


def _vertex_normals(vertices: Array, faces: NDArray[np.int64]) -> Array:
    """(N, 3) normals of vertices (N, 3): those of their faces (F, 3), weighed by area."""
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    of_faces = np.cross(b - a, c - a)
    sums = np.zeros_like(vertices)
    for corner in range(3):
        np.add.at(sums, faces[:, corner], of_faces)
    return unit(sums, [0.0, 0.0, 1.0])
