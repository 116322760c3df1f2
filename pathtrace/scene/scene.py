"""Scenes: a bundled one by name, a Mitsuba 3 XML file by path, or a dictionary."""

from __future__ import annotations

import logging
import threading
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any

import mitsuba as mi

from compose.base.errors import UserError, scene_name
from compose.camera.camera import Camera
from compose.camera.coordinate_systems import WORLD, Place
from pathtrace.scene.instances import AnyScene, InstancedScene
from pathtrace.scene.loading import Source, in_good_coordinates, load_whole_parts
from pathtrace.scene.motion_file import read_motion
from pathtrace.scene.moving_scene import MovingScene
from pathtrace.scene.optics import Optics, camera_of_sensor, perspective_sensor
from pathtrace.scene.panes import with_thin_glass
from pathtrace.scene.scene_xml import (
    SceneDescription,
    dictionary_fingerprint,
    read_description,
    referenced_files,
    text_fingerprint,
)
from pathtrace.scene.sunsky import balanced_dictionary
from pathtrace.scene.triangles import Surfaces

_LOG = logging.getLogger("hybrid")
_LOADING = threading.RLock()
_REPOSITORY_SCENES = Path(__file__).resolve().parents[2] / "scenes"
_INSTALLED_SCENES = Path(__file__).resolve().parents[1] / "scenes"
# Of the motion file beside a scene's file.
_MOTION = ".motion.json"
RUSSIAN_ROULETTE_DEPTH = 5
# Beyond these path depths hardly any energy is left: in a closed room, and in a cloud.
DEFAULT_MAX_DEPTH, _DEPTH_OF_MEDIA = 8, 64


def bundled_scenes() -> dict[str, Path]:
    """Names and files of the scenes that come with the project."""
    folder = _INSTALLED_SCENES if _INSTALLED_SCENES.is_dir() else _REPOSITORY_SCENES
    return {path.parent.name: path for path in sorted(folder.glob("*/*.xml"))}


def scene_file(source: str | Path) -> Path:
    """The XML file of a bundled scene by name, of a path, or of a folder with a scene.xml; else UserError."""
    bundled = bundled_scenes()
    if str(source) in bundled:
        return bundled[str(source)]
    path = Path(source)
    if path.is_dir():
        path = path / "scene.xml"
    if not path.is_file():
        raise UserError(f"{source}: no such scene; name one of {', '.join(bundled)} or a Mitsuba XML file")
    # Not where links lead: the files that it names lie beside the link.
    return path.absolute()


def xml_of(source: str | Path) -> tuple[Path, str | None]:
    """The XML file of a scene; of one that is XML text, a file that might hold it, and the text."""
    if isinstance(source, str) and source.lstrip().startswith("<"):
        return Path("text.xml").absolute(), source
    return scene_file(source), None


def files_of_scene(source: str | Path) -> list[Path]:
    """All files that `load_scene` reads of a scene, none of XML text; UserError if one is missing."""
    path, text = xml_of(source)
    if text is not None:
        return []
    motion = path.with_suffix(_MOTION)
    return [*referenced_files(path), *([motion] if motion.is_file() else [])]


def with_ordered_shapes(scene: mi.Scene) -> tuple[Any, dict[str, str]]:
    """The same scene with its shapes sorted, and the new ids of its shapes and lights by the old ones.

    Where Mitsuba merges meshes, their order differs each time a scene is loaded, and with it the noise of the
    same seed. Scenes with instances keep the order in which they were loaded.
    """
    if any(shape.class_name() == "Instance" for shape in scene.shapes()):
        # Instances cannot leave the scene that holds what they repeat.
        return scene, {part.id(): part.id() for part in (*scene.shapes(), *scene.emitters())}
    parts = {f"sensor_{number}": sensor for number, sensor in enumerate(scene.sensors())}
    # Area lights belong to their shapes.
    emitters = [emitter for emitter in scene.emitters() if emitter.get_shape() is None]
    parts |= {f"emitter_{number}": emitter for number, emitter in enumerate(emitters)}
    key = lambda shape: (*shape.bbox().min, *shape.bbox().max, shape.primitive_count())  # noqa: E731
    parts |= {f"shape_{number:06}": shape for number, shape in enumerate(sorted(scene.shapes(), key=key))}
    names = {part.id(): name for name, part in parts.items()}
    return mi.load_dict({"type": "scene", **parts}, optimize=False), names


# Items of a plan that concern paths.
DEPTH, ROULETTE = "path depth", "roulette depth"


@dataclass(frozen=True)
class Scene:
    """A loaded scene, in the world's coordinates, or in its own if it is very small or far from the origin.

    Attributes:
        name: its name in files and reports.
        hash: SHA-256 of the scene's description and every file that it names; also of path depth, coordinates
            and thin glass if these are not the scene's own.
        mitsuba: the Mitsuba scene, in the scene's coordinates.
        camera: the scene's own camera at its own film size, in the scene's coordinates.
        max_depth: path depth: the one requested, else `own_depth`.
        own_depth: path depth of the scene's file, DEFAULT_MAX_DEPTH at most; 64 in participating media.
        own_hash: `hash` at that depth.
        place: the scene's coordinates; `place.camera` converts cameras of the world to them.
        thin_glass: whether panes of glass let shadow rays pass (pathtrace.scene.panes).
        moving: what moves in it; None if nothing does.
        roulette_depth: path depth from which on Russian roulette may end paths.
        plan: what is planned for it, by name; empty if nothing is. Frames take it down.
        keeps_depth: whether its path depth was asked for, so that no plan changes it.
        optics: what its cameras see besides surfaces and their light.
        left_out: what Mitsuba would show otherwise, a line each.
        instanced: finds what rays hit in a Mitsuba scene with instances; None if it has none.
    """

    name: str
    hash: str
    mitsuba: Any
    camera: Camera
    max_depth: int
    own_depth: int
    own_hash: str
    place: Place = WORLD
    thin_glass: bool = False
    moving: MovingScene | None = None
    roulette_depth: int = RUSSIAN_ROULETTE_DEPTH
    plan: Mapping[str, Any] = field(default_factory=dict)
    keeps_depth: bool = False
    optics: Optics = field(default_factory=Optics)
    left_out: tuple[str, ...] = ()
    instanced: InstancedScene | None = None
    # Found once, for all scenes that differ in their plan or depth only.
    _surfaces: list[Surfaces] = field(default_factory=list, repr=False, compare=False)

    @property
    def traced(self) -> AnyScene:
        """What kernels trace rays through: the Mitsuba scene, or what stands in for it."""
        return self.mitsuba if self.instanced is None else self.instanced

    def surfaces(self) -> Surfaces:
        """Its surfaces as they are now."""
        if self.moving is not None:
            return Surfaces(self.traced)
        if not self._surfaces:
            self._surfaces.append(Surfaces(self.traced))
        return self._surfaces[0]

    def at_depth(self, depth: int) -> Scene:
        """The scene with another path depth, 1 or more, or -1 for no bound; it shares all else."""
        own = depth == self.own_depth
        fingerprint = self.own_hash if own else text_fingerprint(f"{self.own_hash} at depth {depth}")
        return replace(self, max_depth=depth, hash=fingerprint)

    def planned(self, plan: Mapping[str, Any]) -> Scene:
        """The scene as a plan has it, whose values have names; a path depth that was asked for stays."""
        scene = self if self.keeps_depth else self.at_depth(plan[DEPTH])
        return replace(scene, roulette_depth=plan[ROULETTE], plan={**plan, DEPTH: scene.max_depth})

    def set_time(self, time: float) -> None:
        """Shows a time from 0 to 1, in place; at first it is 0. UserError beyond, or if nothing moves."""
        if self.moving is None:
            raise UserError(f"{self.name}: nothing moves in this scene; it has no motion file")
        self.moving.set_time(time)

    def show(self, time: float) -> None:
        """As `set_time`, of a scene that moves; one that stands still is the same at all times."""
        if self.moving is not None:
            self.moving.set_time(time)

    @property
    def triangles(self) -> int:
        """Number of triangles of all meshes, of each instance of one; analytic shapes have none."""
        if self.instanced is not None:
            return self.instanced.triangles
        return sum(shape.face_count() for shape in self.mitsuba.shapes() if shape.is_mesh())


def load_scene(
    source: str | Path | dict[str, Any],
    max_depth: int | None = None,
    thin_glass: bool = False,
    motion: Path | None = None,
    sensor: str | None = None,
) -> Scene:
    """Loads a scene and checks that it can be rendered; logs what Mitsuba would show otherwise, once.

    Threads load one after the other, since Mitsuba's search folders are those of the process.

    Args:
        source: a bundled scene's name, the path of a Mitsuba 3 XML file or of a folder with a scene.xml, XML
            text, whose files are relative to the working folder, or a dictionary as for `mitsuba.load_dict`.
        max_depth: path depth, at least 1, instead of the scene's own.
        thin_glass: whether panes of glass pass light straight on, so that shadow rays reach lights behind
            them: with far less noise, but without the shift of what is seen through thick ones.
        motion: a motion file (pathtrace.scene.motion_file); by default the one beside the scene's file whose
            name ends in .motion.json instead of .xml, if there is one.
        sensor: the id of the perspective camera to use; by default the first.

    Raises:
        UserError: the scene is missing, refused by Mitsuba, has no light, camera or panes as asked for, or
            cannot be brought to good coordinates; or its motion is damaged, or not of this scene.
    """
    with _LOADING:
        return _loaded(source, max_depth, thin_glass, motion, sensor)


def _loaded(
    source: str | Path | dict[str, Any],
    max_depth: int | None,
    thin_glass: bool,
    motion: Path | None,
    wanted: str | None,
) -> Scene:
    content, name, description, motion = _described(source, motion)
    moves = None if motion is None else read_motion(motion)
    apart = frozenset(() if moves is None else (*moves.shapes, *moves.lights))
    loaded, content, degenerate = load_whole_parts(content, apart)
    sensor, fingerprint = perspective_sensor(loaded, content.name, wanted), description.fingerprint
    if not loaded.emitters():
        raise UserError(f"{content.name}: the scene has no light; add an <emitter>")
    camera = camera_of_sensor(sensor, content.name)
    loaded, camera, place = in_good_coordinates(content, loaded, camera, apart, wanted)
    sensor = perspective_sensor(loaded, content.name, wanted)
    if place != WORLD:
        # Forests and frames of the same scene in other coordinates do not fit it.
        fingerprint = text_fingerprint(f"{fingerprint} at {place.origin} in {place.unit}")
    optics = Optics.of(loaded, sensor, camera, description.hides_emitters)
    wrong = [f"{each}; it is left out" for each in degenerate]
    left_out = *wrong, *_left_out(loaded, sensor, wanted, optics)
    for remark in left_out:
        _say(f"{content.name}: {remark}")
    if thin_glass:
        why = "not where there are participating media" if optics.has_media else ""
        if why or not with_thin_glass(loaded):
            why = why or "the scene has no panes of glass"
            raise UserError(f"{content.name}: thin glass: {why}; leave it out")
        fingerprint = text_fingerprint(f"{fingerprint} with thin glass")
    seen = "" if sensor is perspective_sensor(loaded, content.name) else f" by {wanted}"
    if text := optics.text + seen:
        fingerprint = text_fingerprint(fingerprint + text)
    most = _DEPTH_OF_MEDIA if optics.has_media else DEFAULT_MAX_DEPTH
    depth = min(description.max_depth, most) if description.max_depth > 0 else most
    ordered, names = with_ordered_shapes(loaded)
    # Media are traced by Mitsuba itself.
    instanced = None if optics.has_media else InstancedScene.of(ordered)
    moving = None
    if moves is not None:
        moving = MovingScene(instanced or ordered, moves, names, place, name)
        fingerprint = text_fingerprint(f"{fingerprint} moving by {moves.fingerprint}")
    scene = Scene(
        name,
        fingerprint,
        ordered,
        camera,
        max_depth=depth,
        own_depth=depth,
        own_hash=fingerprint,
        place=place,
        thin_glass=thin_glass,
        moving=moving,
        optics=optics,
        left_out=left_out,
        instanced=instanced,
    )
    return scene if max_depth is None else replace(scene.at_depth(max_depth), keeps_depth=True)


def _described(
    source: str | Path | dict[str, Any], motion: Path | None
) -> tuple[Source, str, SceneDescription, Path | None]:
    """What a scene is loaded from, its name, what is known of it before that, and its motion file."""
    if isinstance(source, dict):
        parts = [part for part in source.values() if isinstance(part, dict)]
        depth = next((int(part["max_depth"]) for part in parts if "max_depth" in part), -1)
        hides = any(part.get("hide_emitters") for part in parts)
        description = SceneDescription("", dictionary_fingerprint(source), depth, hides)
        return Source("dictionary", balanced_dictionary(source)), "dictionary", description, motion
    path, text = xml_of(source)
    name = scene_name(path.parent.name if path.stem == "scene" else path.stem, "scene")
    description = read_description(path, text)
    content = Source(str(source) if text is None else name, description.text, path.parent)
    beside = path.with_suffix(_MOTION)
    motion = beside if motion is None and text is None and beside.is_file() else motion
    return content, name, description, motion


def _left_out(loaded: mi.Scene, sensor: mi.Sensor, wanted: str | None, optics: Optics) -> Iterator[str]:
    if len(loaded.sensors()) > 1 and wanted is None:
        yield f"{len(loaded.sensors())} cameras; {sensor.id()}, the first perspective one, is used"
    if "aperture_radius" in mi.traverse(sensor):
        yield "depth of field is left out; the thin lens counts as a pinhole"
    if not optics.has_media and any(shape.is_medium_transition() for shape in loaded.shapes()):
        yield "participating media are left out: they take less than a twentieth of the light"


@cache
def _say(remark: str) -> None:
    _LOG.info(remark)
