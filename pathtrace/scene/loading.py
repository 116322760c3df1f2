"""Loads Mitsuba scenes, in coordinates of their own where Mitsuba would spoil those of the file.

Mitsuba starts rays off the surfaces by 9e-5 (1 + |p|) at a point p, and holds vertices in float32. So a room
of a millimetre, and one that is a thousand rooms away from the origin, leak light and lose their shadows.
Measured on a corner of a room, 2.5 units from its camera, at equal seeds: scaled by 0.1, 0.01, 1e-3 and 1e-4,
its picture is 62, 49, 38 and 26 dB from the unscaled one, moved by 10, 100, 1e3 and 1e4 as much, moved by 1e6
22 dB; scaled by 10 to 1e6, 89 dB. In coordinates of their own, all of them come to 89 dB and more.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import mitsuba as mi
import numpy as np

from compose.base.errors import UserError
from compose.camera.camera import Array, Camera
from compose.camera.coordinate_systems import TYPICAL_DISTANCE, WORLD, Place
from pathtrace.scene.backend import threads_to_read
from pathtrace.scene.optics import camera_of_sensor, perspective_sensor
from pathtrace.scene.scene_xml import mitsuba_folder
from pathtrace.scene.sunsky import PLUGIN as BALANCED_SUNSKY
from pathtrace.scene.triangles import Surfaces

_FILES = "ply", "obj"
# What Mitsuba 3.9 says of a mesh with NaN or infinity.
_NOT_FINITE = re.compile("invalid vertex (position|normal) data")
_PLY_FACES = re.compile(rb"element\s+face\s+(\d+)")
# Bytes in which the header of a PLY file ends.
_HEADER = 1 << 16
# What scales with its to_world alone; for other plugins, another unit of length would change how they look.
_SHAPES = ("obj", "ply", "serialized", "cube", "rectangle", "disk", "sphere", "cylinder", "instance")
_POINTS = ("point", "spot")
_CAMERAS = ("perspective", "thinlens")
_ENDLESS = ("constant", "envmap", "directional", "sunsky", "sun", "sky", BALANCED_SUNSKY)
# Of scenes whose parameters had other names.
_OLD = re.compile(r'<scene[^>]* version="([0-2]\.[^"]*)"')
# Where float32 has this many steps to a power of two.
_STEPS = 2.0**23
# Mitsuba's RayEpsilon in float32.
_RAY_OFFSET = 1500 * 2.0**-24
# Largest offset, and largest step of float32 at a vertex, as shares of how far away surfaces are.
_TOLERANCE = 1e-3
# A scene of at least this size whose camera is no farther from the origin is good as it is.
_ORDINARY_SIZE, _ORDINARY_DISTANCE = 1.0, 20.0

_Found = TypeVar("_Found")


class ImmovableError(ValueError):
    """A scene has a part that cannot be moved or scaled; says which."""


def _degenerate_meshes(state: mi.parser.ParserState) -> dict[int, str]:
    """What is wrong with each mesh for which Mitsuba refuses a whole scene, by the number of its node.

    Such meshes have no faces, or numbers that are not finite.
    """
    found = {}
    for number, node in enumerate(state.nodes):
        plugin, is_shape = node.props.plugin_name(), node.type == mi.ObjectType.Shape
        if is_shape and plugin in _FILES and "filename" in node.props:
            name = str(node.props["filename"])
            file = Path(str(mi.file_resolver().resolve(name)))  # type: ignore[operator]  # a function
            if file.is_file() and (wrong := _wrong(node.props, file)):
                found[number] = f"the mesh {name} {wrong}"
    return found


def _wrong(properties: mi.Properties, file: Path) -> str | None:
    """What is wrong with a mesh; None if that is nothing, or something else."""
    with file.open("rb") as opened:
        if file.suffix.lower() == ".ply":
            count = _PLY_FACES.search(opened.read(_HEADER))
            has_faces = count is None or int(count[1]) > 0
        else:
            has_faces = any(line.lstrip().startswith(b"f") for line in opened)
    if not has_faces:
        return "has no faces"
    shape: dict[str, object] = {"type": properties.plugin_name(), "filename": str(file)}
    if "to_world" in properties:
        if not np.isfinite(_to_world(properties)).all():
            return "has a to_world that is not finite"
        shape["to_world"] = properties["to_world"]
    try:
        mi.load_dict(shape)
    except RuntimeError as error:
        if _NOT_FINITE.search(str(error)):
            return "has vertices that are not finite"
    return None


def _leave_out(state: mi.parser.ParserState, numbers: Collection[int]) -> None:
    """Takes nodes out of a parsed scene, and instances of groups in which nothing is left."""
    # With an empty group in memory, Dr.Jit refuses to record kernels of any scene.
    left_out, kinds = set(numbers), mi.Properties.Type
    plugins = [node.props.plugin_name() for node in state.nodes]
    parts = [_of_kind(node.props, kinds.ResolvedReference) for node in state.nodes]
    held = [{part.index() for part in found.values()} for found in parts]
    empty = {n for n, plugin in enumerate(plugins) if plugin == "shapegroup" and held[n] <= left_out}
    ids = {state.nodes[number].props.id() for number in empty}
    for number, node in enumerate(state.nodes):
        named = {part.id() for part in _of_kind(node.props, kinds.Reference).values()}
        if plugins[number] == "instance" and (named & ids or held[number] & empty):
            left_out.add(number)
    for node, found in zip(state.nodes, parts, strict=True):
        for name, part in found.items():
            if part.index() in left_out | empty:
                del node.props[name]


def _of_kind(properties: mi.Properties, kind: mi.Properties.Type) -> dict[str, Any]:
    return {name: properties[name] for name in list(properties.keys()) if properties.type(name) == kind}


def _camera_position(state: mi.parser.ParserState) -> Array:
    """(3,) position in world space, float64, of the first perspective camera of a parsed scene."""
    for node in state.nodes:
        if node.type == mi.ObjectType.Sensor and node.props.plugin_name() in _CAMERAS:
            return _to_world(node.props)[:3, 3]
    return np.zeros(3)


def _relocate(state: mi.parser.ParserState, place: Place) -> None:
    """Puts a parsed scene into the coordinates of a place; ImmovableError if a part of it cannot be.

    Light stays as it is: that of point lights is divided by the square of the unit.
    """
    groups = (node.props for node in state.nodes if node.props.plugin_name() == "shapegroup")
    kinds = mi.Properties.Type
    inside = {part.index() for g in groups for part in _of_kind(g, kinds.ResolvedReference).values()}
    for index, node in enumerate(state.nodes):
        kind, plugin = node.type, node.props.plugin_name()
        # Dictionaries may hold objects that are loaded already.
        if kind in (mi.ObjectType.Medium, mi.ObjectType.Volume) or _of_kind(node.props, kinds.Object):
            raise ImmovableError(f"a {plugin or 'loaded object'}")
        if kind == mi.ObjectType.BSDF and plugin == "bumpmap" and place.unit != 1:
            raise ImmovableError("a bumpmap")
        moved = kind in (mi.ObjectType.Sensor, mi.ObjectType.Shape, mi.ObjectType.Emitter)
        if index in inside or plugin == "shapegroup" or not moved:
            continue
        if kind == mi.ObjectType.Shape and plugin not in _SHAPES:
            raise ImmovableError(f"a {plugin}")
        if kind == mi.ObjectType.Emitter:
            _relocate_emitter(node.props, place)
        else:
            _relocate_to_world(node.props, place)


def _coarsest_step(state: mi.parser.ParserState) -> float:
    """Step of float32 at vertices of mesh files, if they, and not to_world, carry their distance."""
    camera = _camera_position(state)
    far = float(np.linalg.norm(camera))
    shapes = (node.props for node in state.nodes if node.type == mi.ObjectType.Shape)
    files = (shape for shape in shapes if "filename" in shape)
    unmoved = any(np.linalg.norm(_to_world(file)[:3, 3] - camera) > 0.5 * far for file in files)
    return far / _STEPS if unmoved else 0.0


def _relocate_emitter(properties: mi.Properties, place: Place) -> None:
    plugin = properties.plugin_name()
    if plugin == "area" or plugin in _ENDLESS:
        return
    if plugin not in _POINTS:
        raise ImmovableError(f"a {plugin}")
    if place.unit != 1:
        intensity: Any = properties.get("intensity", 1.0)
        kinds = mi.Properties.Type
        kind = properties.type("intensity") if "intensity" in properties else kinds.Float
        if kind not in (kinds.Float, kinds.Color):
            raise ImmovableError(f"a {plugin} light with a spectrum or a texture")
        scaled = [float(channel) * place.unit**-2 for channel in np.ravel(intensity)]
        properties["intensity"] = scaled[0] if kind == kinds.Float else mi.ScalarColor3d(*scaled)
    if "position" in properties:
        properties["position"] = place.from_world(np.array(properties["position"])).tolist()
    else:
        _relocate_to_world(properties, place)


def _relocate_to_world(properties: mi.Properties, place: Place) -> None:
    matrix = _to_world(properties)
    matrix[:3] /= place.unit
    matrix[:3, 3] -= np.array(place.origin) / place.unit
    if properties.plugin_name() in _CAMERAS:
        # A camera has no scale.
        matrix[:3, :3] *= place.unit
        for clip in {"near_clip", "far_clip"} & set(properties.keys()):
            depth: Any = properties[clip]
            properties[clip] = float(depth) / place.unit
    properties["to_world"] = mi.ScalarTransform4d(matrix)


def _to_world(properties: mi.Properties) -> Array:
    """(4, 4) float64; a copy."""
    if "to_world" not in properties:
        return np.eye(4)
    transform: Any = properties["to_world"]
    return np.array(transform.matrix, dtype=np.float64).reshape(4, 4)


@dataclass(frozen=True)
class Source:
    """What a scene is loaded from."""

    name: str  # for error messages
    content: str | dict[str, Any]  # XML text, or a dictionary
    folder: Path | None = None  # that files of the text are relative to
    left_out: frozenset[int] = frozenset()  # numbers of nodes of the parsed scene


def _load_in_place(source: Source, unit: float, apart: Collection[str]) -> tuple[mi.Scene, Place, float]:
    """A scene whose origin is its first camera, in a unit of length, with its place and `_coarsest_step`.

    UserError if Mitsuba refuses the scene, or it has a part that cannot be moved or scaled.
    """
    place, step = WORLD, 0.0

    def moved(state: mi.parser.ParserState) -> None:
        nonlocal place, step
        x, y, z = _camera_position(state).tolist()
        place, step = Place((x, y, z), unit), _coarsest_step(state)
        _relocate(state, place)

    try:
        return _parsed(source, apart, moved), place, step
    except UserError as error:
        if isinstance(error.__cause__, ImmovableError):
            raise UserError(
                f"{source.name}: too small or too far from the origin for Mitsuba's float32, and "
                f"{error.__cause__} in it cannot be moved or scaled; place the scene near the origin, in a "
                "unit of length in which it is 1 to 1000 large"
            ) from error
        raise


def load_mitsuba(source: Source, apart: Collection[str] = ()) -> mi.Scene:
    """A Mitsuba scene; UserError if Mitsuba refuses it. Its meshes are merged, which is twice as fast.

    Shapes whose ids are to stay `apart` are not merged with others, and keep their ids.
    """
    if apart or source.left_out:
        return _parsed(source, apart, lambda state: None)
    # As this loads in parallel.
    content = source.content
    return _checked(
        source, lambda: mi.load_dict(content) if isinstance(content, dict) else mi.load_string(content)
    )


def load_whole_parts(source: Source, apart: Collection[str] = ()) -> tuple[mi.Scene, Source, list[str]]:
    """As `load_mitsuba`, without meshes that Mitsuba refuses; also the source then, and their faults."""
    try:
        return load_mitsuba(source, apart), source, []
    except UserError:
        try:
            wrong = _in_folder(source, lambda: _degenerate_meshes(_state(_configuration(), source)))
        except Exception:
            wrong = {}
        if not wrong:
            raise
    source = replace(source, left_out=frozenset(wrong))
    return load_mitsuba(source, apart), source, list(wrong.values())


def _configuration() -> mi.parser.ParserConfig:
    found = mi.parser.ParserConfig(mi.variant() or "")
    # In parallel, Mitsuba 3.9.1 makes scenes of which Dr.Jit may stumble over the arrays later, and crash.
    found.parallel = False
    return found


def _state(configuration: mi.parser.ParserConfig, source: Source) -> mi.parser.ParserState:
    if isinstance(source.content, dict):
        return mi.parser.parse_dict(configuration, source.content)
    return mi.parser.parse_string(configuration, source.content)


def _parsed(
    source: Source, apart: Collection[str], change: Callable[[mi.parser.ParserState], None]
) -> mi.Scene:
    """A Mitsuba scene from its parsed description, which is changed before anything is made of it."""

    def load() -> object:
        configuration = _configuration()
        state = _state(configuration, source)
        if source.left_out:
            _leave_out(state, source.left_out)
        change(state)
        _simplify(configuration, state, apart)
        loaded = mi.parser.instantiate(configuration, state)
        return loaded[0] if isinstance(loaded, list) and len(loaded) == 1 else loaded

    return _checked(source, load)


def _simplify(
    configuration: mi.parser.ParserConfig, state: mi.parser.ParserState, apart: Collection[str]
) -> None:
    """Mitsuba's own simplifications of a parsed scene, but for shapes that are to stay as they are."""
    if not apart:
        mi.parser.transform_all(configuration, state)
        return
    mi.parser.transform_upgrade(configuration, state)
    mi.parser.transform_resolve(configuration, state)
    # While the whole scene is there: what does not hang on it would go on referring to what was merged.
    mi.parser.transform_merge_equivalent(configuration, state)
    root = state.root.props
    # Mitsuba merges what hangs on the scene.
    parts = _of_kind(root, mi.Properties.Type.ResolvedReference)
    nodes = {key: state.nodes[part.index()] for key, part in parts.items()}
    held = {key: parts[key] for key, node in nodes.items() if node.props.id() in apart}
    # Mitsuba 3.9.1 crashes where there is no shape to merge.
    if any(node.type == mi.ObjectType.Shape for key, node in nodes.items() if key not in held):
        for key in held:
            del root[key]
        mi.parser.transform_merge_meshes(configuration, state)
        for key, reference in held.items():
            root[key] = reference
    mi.parser.transform_reorder(configuration, state)


def _checked(source: Source, load: Callable[[], object]) -> mi.Scene:
    try:
        with threads_to_read():
            loaded = _in_folder(source, load)
    except Exception as error:
        lines = [line.strip() for line in str(error).splitlines() if line.strip()]
        # Mitsuba's first lines name a position in its own code; the last ones say what is wrong.
        said = [line for line in lines if not line.startswith("-")][-1:]
        said += [line for line in lines if line.startswith("-")]
        old = isinstance(source.content, str) and _OLD.search(source.content)
        advice = f" (a scene of Mitsuba {old[1]}: `mitsuba -u FILE` updates it)" if old else ""
        raise UserError(
            f"{source.name}: Mitsuba refuses the scene: {' '.join(said) or error}{advice}"
        ) from error
    if not isinstance(loaded, mi.Scene):
        raise UserError(f"{source.name}: not a complete scene; the top element must be <scene>")
    return loaded


def _in_folder(source: Source, load: Callable[[], _Found]) -> _Found:
    """What a function finds in the folder of a scene, to which its files are relative."""
    if source.folder is None:
        return load()
    resolver = mi.file_resolver()  # type: ignore[operator]  # a function
    before = [resolver[i] for i in range(len(resolver))]
    resolver.prepend(str(source.folder))
    # Before the scene's folder, from which plugins, which are native code, would be loaded as well.
    resolver.prepend(str(mitsuba_folder()))
    try:
        return load()
    finally:
        # The resolver is shared by the process; a folder left in it would shadow the next scene's files.
        resolver.clear()
        for entry in before:
            resolver.append(entry)


def in_good_coordinates(
    source: Source, loaded: mi.Scene, camera: Camera, apart: Collection[str] = (), sensor: str | None = None
) -> tuple[mi.Scene, Camera, Place]:
    """A scene, given as loaded and its camera, in coordinates that Mitsuba can trace it in, with its place.

    UserError if it cannot be moved or scaled as far as it would have to be.
    """
    if _is_ordinary(loaded, camera):
        return loaded, camera, WORLD
    unit = 1.0
    while True:
        moved, place, step = _load_in_place(source, unit, apart)
        own = camera_of_sensor(perspective_sensor(moved, source.name, sensor), source.name)
        distance = Surfaces(moved).median_distance(own)
        if not 0 < distance < np.inf:
            # It sees nothing: whoever needs surfaces says so.
            return loaded, camera, WORLD
        if step > _TOLERANCE * distance * unit:
            far, seen = np.linalg.norm(place.origin), distance * unit
            raise UserError(
                f"{source.name}: meshes have vertices {far:.3g} from the origin, where float32 has steps "
                f"of {step:.2g}, too coarse for what the camera sees {seen:.3g} away; keep vertices near the "
                "origin and place meshes by to_world"
            )
        if unit != 1 or distance >= _RAY_OFFSET / _TOLERANCE:
            return moved, own, place
        # A power of two: scaling by it is exact.
        unit = float(2.0 ** np.round(np.log2(distance / TYPICAL_DISTANCE)))


def _is_ordinary(loaded: mi.Scene, camera: Camera) -> bool:
    far, box = float(np.linalg.norm(camera.position)), loaded.bbox()
    size = float(np.max(np.array(box.max) - np.array(box.min)))
    if size >= _ORDINARY_SIZE and far <= _ORDINARY_DISTANCE:
        return True
    distance = Surfaces(loaded).median_distance(camera)
    if not np.isfinite(distance) and far <= _ORDINARY_DISTANCE:
        return True
    return _RAY_OFFSET * (1 + far) <= _TOLERANCE * distance < np.inf
