"""Writes a glTF file as a folder with a Mitsuba scene and its motion."""

from __future__ import annotations

import json
import re
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from compose.base.files import whole_folder, write_whole
from compose.camera.camera import Array, unit
from pathtrace.gltf.animated_nodes import Nodes, chosen_animation
from pathtrace.gltf.document import EXTENSIONS, Document, undamaged
from pathtrace.gltf.lights import Light, brightness, camera, read_lights
from pathtrace.gltf.materials import Materials, plugin, value
from pathtrace.gltf.meshes import Primitive, read_primitives, write_mesh
from pathtrace.gltf.movement import (
    Movement,
    Times,
    as_json,
    keyframes_of,
    movement_of,
    require_few,
    without_scale,
)

# Steps of time a second in which what deforms is written, as films have them.
DEFAULT_FPS = 24.0
_SCENE, _MOTION, _MESHES = "scene.xml", "scene.motion.json", "meshes"
_LONGEST_NAME = 60
_DEPTH = 8


@dataclass(frozen=True)
class Imported:
    """What was written: of how many triangles at one time, and how many parts move rigidly or deform."""

    scene: Path
    triangles: int
    rigid: int
    deforming: int
    seconds: float
    remarks: list[str]


def import_gltf(
    document: Document, folder: Path, fps: float = DEFAULT_FPS, animation: str | None = None
) -> Imported:
    """Imports a glTF document; the folder, which must be missing or empty, appears whole or not at all.

    Meshes that deform are written in `fps` steps of time a second. Without the name or number of an
    animation, all play that move different things, else the first one. UserError if the file is damaged, or
    needs what is not known here; or the folder cannot be written.
    """
    with whole_folder(folder, _SCENE) as part, undamaged(document.file):
        return _Import(document, part, fps, animation).run(folder / _SCENE)


class _Import:
    def __init__(self, document: Document, folder: Path, fps: float, animation: str | None):
        self._document, self._folder = document, folder
        self._remarks: list[str] = []
        self._nodes = Nodes(document, chosen_animation(document, animation, self._remarks))
        self._times = Times(self._nodes, fps)
        self._to_world = self._nodes.to_world(self._times.dense)
        self._materials = Materials(document, folder, self._remarks)
        self._names = {"camera", "surroundings"}
        self._tracks: dict[str, Any] = {}

    def run(self, scene: Path) -> Imported:
        """Writes everything; the scene will then lie at that path."""
        primitives = read_primitives(self._document, self._nodes, self._remarks)
        if not primitives:
            raise self._document.refused("; ".join(["shows no triangles", *self._remarks]))
        require_few(primitives, self._nodes, self._times, self._to_world)
        shapes, bounds = [], []
        for primitive in primitives:
            movement = movement_of(primitive, self._nodes, self._times, self._to_world)
            shapes.append(self._shape(primitive, movement))
            bounds.append(movement.bounds)
        self._write_scene(shapes, np.stack([np.min(bounds, axis=0)[0], np.max(bounds, axis=0)[1]]))
        deforming = sum("meshes" in track for track in self._tracks.values())
        seconds = self._nodes.animation.seconds if self._tracks else 0.0
        if self._tracks:
            self._write(_MOTION, json.dumps({"seconds": seconds, "shapes": self._tracks}, indent=1) + "\n")
        left_out = sorted(set(self._document.tree.get("extensionsUsed", [])) - set(EXTENSIONS))
        self._remarks += [f"the extension {name} is left out" for name in left_out]
        triangles = sum(len(primitive.faces) for primitive in primitives)
        rigid = len(self._tracks) - deforming
        return Imported(scene, triangles, rigid, deforming, seconds, self._remarks)

    def _write_scene(self, shapes: Sequence[ET.Element], bounds: Array) -> None:
        root = ET.Element("scene", {"version": "3.0.0"})
        root.append(plugin("integrator", "path", value("integer", "max_depth", str(_DEPTH))))
        root.append(camera(self._document, self._nodes, self._to_world, bounds, self._remarks))
        root.extend(self._materials.bsdfs.values())
        root.extend(shapes)
        root.extend(self._lights(bounds))
        ET.indent(root, "\t")
        self._write(_SCENE, ET.tostring(root, encoding="unicode") + "\n")

    def _shape(self, primitive: Primitive, movement: Movement) -> ET.Element:
        name = self._name(primitive.name)
        user = f"the material of {primitive.name}"
        pbr = self._materials.item(primitive.material, user).get("pbrMetallicRoughness", {})
        colours = None if "baseColorTexture" in pbr else primitive.colours
        if colours is not None:
            colours = colours * np.array(pbr.get("baseColorFactor", [1, 1, 1])[:3])
        mirrors = np.linalg.det(self._to_world[primitive.node][0, :3, :3]) < 0
        # A node that mirrors turns fronts to the back, if nothing turns them again (3.7.4).
        faces = primitive.faces[:, ::-1] if mirrors and primitive.skin is None else primitive.faces
        uvs = primitive.uvs.get(self._materials.uv_set(primitive.material, user))
        file = f"{_MESHES}/{name}.ply"
        write_mesh(self._folder / file, faces, movement.rest, self._normals(primitive), uvs, colours)
        if len(movement.meshes):
            meshes = [f"{_MESHES}/{name}-{step:04d}.ply" for step in range(len(movement.meshes))]
            for mesh, vertices in zip(meshes, movement.meshes, strict=True):
                write_mesh(self._folder / mesh, faces, vertices)
            self._tracks[name] = {"meshes": meshes}
        elif movement.keyframes:
            self._tracks[name] = as_json(movement.keyframes, movement.about)
        shape = plugin("shape", "ply", value("string", "filename", file), id=name)
        if primitive.normals is None:
            shape.append(value("boolean", "face_normals", "true"))
        shape.append(self._materials.reference(primitive.material, colours is not None, user))
        if (emitter := self._materials.emitter(primitive.material, user)) is not None:
            shape.append(emitter)
        return shape

    def _normals(self, primitive: Primitive) -> Array | None:
        """(V, 3) in the world at time 0; none of what deforms: they are made of its faces, at each time."""
        if primitive.normals is None or primitive.skin is not None or len(primitive.targets):
            return None
        matrix = self._to_world[primitive.node][0, :3, :3]
        # Of what is flat in a direction, no inverse exists.
        return unit(primitive.normals @ np.linalg.pinv(matrix), [0.0, 0.0, 1.0])

    def _lights(self, bounds: Array) -> list[ET.Element]:
        lights = read_lights(self._document, self._nodes)
        if not lights:
            self._remarks.append("the file has no lights; light comes from all directions")
            white = value("rgb", "radiance", [1.0, 1.0, 1.0])
            return [plugin("emitter", "constant", white, id="surroundings")]
        scale = brightness(lights, self._to_world, bounds)
        if scale != 1:
            self._remarks.append(
                f"lights are dimmed to {scale:.3g} of what the file says, which would be white"
            )
        return [self._light(light, scale, bounds) for light in lights]

    def _light(self, light: Light, scale: float, bounds: Array) -> ET.Element:
        item = self._document.section("nodes")[light.node]
        name = self._name(str(item.get("name") or light.kind))
        poses = without_scale(self._to_world[light.node])
        if np.ptp(poses, axis=0).any():
            # As if something as large as a tenth of the scene hung on it.
            arms = 0.1 * np.linalg.norm(bounds[1] - bounds[0]) * np.concatenate([np.eye(3), -np.eye(3)])
            about = poses[0, :3, 3]
            from_rest = poses @ np.linalg.inv(poses[0])
            keyframes = keyframes_of(self._times.shares, from_rest, about, about + arms)
            self._tracks[name] = as_json(keyframes, about)
        return light.element(name, poses[0], scale)

    def _name(self, wanted: str) -> str:
        """A name like that, which nothing else has, for ids and files."""
        plain = re.sub(r"[^A-Za-z0-9]+", "_", wanted)[:_LONGEST_NAME].strip("_") or "shape"
        name, number = plain, 2
        # Some systems do not tell capitals apart.
        while name.lower() in self._names:
            name, number = f"{plain}_{number}", number + 1
        self._names.add(name.lower())
        return name

    def _write(self, name: str, text: str) -> None:
        write_whole(self._folder / name, lambda part: part.write_text(text, encoding="utf-8"))
