"""Loads a scene: a bundled one by name, a Mitsuba 3 XML file by path, or a dictionary."""

from __future__ import annotations

import hashlib
import re
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

from compose.base.errors import UserError
from compose.camera.axes import opencv_from_mitsuba
from compose.camera.camera import Camera, camera_from_pose
from pathtrace.scene.bundled import bundled_scenes
from pathtrace.scene.fingerprint import fingerprint
from pathtrace.scene.ordering import in_order

DEFAULT_MAX_DEPTH = 8


@dataclass(frozen=True)
class Scene:
    """A loaded scene and the facts that the rest needs.

    Attributes:
        name: what to call it in files and reports.
        hash: SHA-256 of the scene's description, of every file that it names, and of a path depth in place of
            its own: what was made at another depth shows other light.
        mitsuba: the Mitsuba scene.
        camera: the scene's own camera at its own film size.
        max_depth: path depth: what was asked for, else what the scene asks for, else DEFAULT_MAX_DEPTH.
    """

    name: str
    hash: str
    mitsuba: Any
    camera: Camera
    max_depth: int

    @property
    def triangles(self) -> int:
        """Triangles over all meshes; an analytic shape counts as none."""
        return sum(shape.face_count() for shape in self.mitsuba.shapes() if shape.is_mesh())


def load_scene(source: str | Path | dict[str, Any], max_depth: int | None = None) -> Scene:
    """Loads a scene and checks that it can be rendered.

    Args:
        source: a bundled scene's name, the path of a Mitsuba 3 XML file, or a scene dictionary.
        max_depth: path depth in place of the scene's own.

    Raises:
        UserError: the scene is missing, refused by Mitsuba, or has no camera or no light.
    """
    if isinstance(source, dict):
        name, own_depth = "dictionary", DEFAULT_MAX_DEPTH
        loaded = _guarded(name, lambda: mi.load_dict(source))
        digest = hashlib.sha256(repr(source).encode()).hexdigest()
    else:
        path = _find(str(source))
        name = path.parent.name if path.stem == "scene" else path.stem
        text, digest, own_depth = _prepare(path)
        # optimize=True merges meshes: shapes cannot be told apart any more, tracing is twice as fast.
        loaded = _guarded(str(path), lambda: _load_text(text, path.parent))
    if not loaded.sensors():
        raise UserError(f"{source}: the scene has no camera; add a <sensor type='perspective'>")
    if not loaded.emitters():
        raise UserError(f"{source}: the scene has no light; add an <emitter>")
    depth = max_depth or own_depth
    if depth != own_depth:
        digest = hashlib.sha256(f"{digest} at depth {depth}".encode()).hexdigest()
    return Scene(name, digest, in_order(loaded), _camera(loaded.sensors()[0], str(source)), depth)


def _find(source: str) -> Path:
    bundled = bundled_scenes()
    if source in bundled:
        return bundled[source]
    path = Path(source)
    if path.is_dir():
        path = path / "scene.xml"
    if not path.is_file():
        raise UserError(f"{source}: no such scene; name one of {', '.join(bundled)} or a Mitsuba XML file")
    return path.resolve()


def _guarded(source: str, load: Any) -> Any:
    """Runs a Mitsuba loader and turns its many-line refusal into one line."""
    try:
        loaded = load()
    except Exception as error:
        lines = [line.strip() for line in str(error).splitlines() if line.strip()]
        # Mitsuba's first lines say where in its own code it was; the last one says what is wrong.
        raise UserError(f"{source}: Mitsuba refuses the scene: {lines[-1] if lines else error}") from error
    if isinstance(loaded, list) or not isinstance(loaded, mi.Scene):
        raise UserError(f"{source}: this is not a whole scene; the top element must be <scene>")
    return loaded


def _load_text(text: str, folder: Path) -> Any:
    resolver = mi.file_resolver()
    resolver.prepend(str(folder))
    try:
        return mi.load_string(text)
    finally:
        # The resolver is shared by the process; a folder left in it would shadow the next scene's files.
        remaining = [resolver[i] for i in range(len(resolver))][1:]
        resolver.clear()
        for entry in remaining:
            resolver.append(entry)


def _prepare(path: Path) -> tuple[str, str, int]:
    """Scene text without its integrator (ours replaces it), its hash, and the path depth it asks for.

    Scenes in the wild name integrators that only their author has; radiance here always comes from
    Mitsuba's `path`, so the element is taken out before Mitsuba reads it.
    """
    try:
        root = ET.parse(path).getroot()
    except ET.ParseError as error:
        raise UserError(f"{path}: not well-formed XML: {error}") from error
    defaults = {e.get("name"): e.get("value") for e in root.iter("default")}
    depth = DEFAULT_MAX_DEPTH
    for integrator in root.findall("integrator"):
        value = next(
            (e.get("value") for e in integrator.iter("integer") if e.get("name") == "max_depth"), None
        )
        if value and value.startswith("$"):
            value = defaults.get(value[1:])
        if value and re.fullmatch(r"-?\d+", value.strip()):
            # -1 is Mitsuba's "no limit"; past this depth hardly any energy is left in a closed room.
            depth = min(int(value), DEFAULT_MAX_DEPTH) if int(value) > 0 else DEFAULT_MAX_DEPTH
        root.remove(integrator)
    for default in [e for e in root.findall("default") if e.get("name") == "integrator"]:
        root.remove(default)
    return ET.tostring(root, encoding="unicode"), fingerprint(path, root), depth


def _camera(sensor: Any, source: str) -> Camera:
    parameters = mi.traverse(sensor)
    if "x_fov" not in parameters:
        raise UserError(f"{source}: the camera is not a perspective one; use <sensor type='perspective'>")
    width, height = (int(v) for v in sensor.film().size())
    focal = 0.5 * width / np.tan(np.radians(float(parameters["x_fov"][0])) / 2)
    offset = [float(parameters[f"principal_point_offset_{axis}"][0]) for axis in "xy"]
    to_world = np.array(sensor.world_transform().matrix, dtype=np.float64).reshape(4, 4)
    return camera_from_pose(
        opencv_from_mitsuba(to_world),
        width,
        height,
        focal,
        focal,
        width * (0.5 - offset[0]),
        height * (0.5 - offset[1]),
    )
