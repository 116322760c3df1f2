"""The readers of files, each with a good file, and what it may do with a bad one: refuse it in one line."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import torch

from compose.base.errors import UserError, one_line
from compose.base.files import read_json
from compose.camera.coordinate_systems import camera_from_json, camera_to_json
from compose.eye.display import display_named
from compose.eye.gaze import load_gaze_trace
from compose.image.exr import write_channels
from hybrid.base.identity import Journal
from hybrid.base.parts import Part, begin, stored_part
from hybrid.render.image_files import read_exr
from hybrid.study.design import load_design
from hybrid.study.observations import load_choices, load_ratings
from hybrid.study.session import StudySession, observer_file
from pathtrace.dataset.captured_frames import CapturedFrame, read_frame, write_frame
from pathtrace.dataset.colmap_model import ModelPoints, read_model, write_model
from pathtrace.dataset.frame_set import FORMAT_VERSION, read_frame_set
from pathtrace.dataset.posed_images import read_pixels
from pathtrace.dataset.posed_layouts import read_posed_folder
from pathtrace.gltf.document import read_document
from pathtrace.gltf.gaussians import read_gaussians
from pathtrace.gltf.importing import import_gltf
from pathtrace.region.camera_path import read_path
from pathtrace.scene.scene_xml import read_description
from splat.io.compact import compact
from splat.io.forest_file import load_forest, save_forest
from splat.io.gltf_gaussians import gaussians_from, save_glb
from splat.io.ply import load_ply, save_ply
from splat.io.tensors import load_tensors, save_tensors
from splat.model.forest import Forest, forest_of
from splat.model.trees import build_forest, static_layer
from tests import posed, small
from tests.hybrid.study.studies import design, finish
from tests.pathtrace.gltf.building import QUAD, QUAD_FACES, Building, bending_tube
from tests.splat.samples import camera, gaussians

IDENTITY = {"scene": "a", "settings": {"size": [4, 5]}}


@dataclass(frozen=True)
class Reader:
    """A reader.

    Attributes:
        name: of the file that it reads.
        make: writes a good file.
        read: reads one.
        errors: with which it refuses one; what calls it puts them into one line.
    """

    name: str
    make: Callable[[Path], Any]
    read: Callable[[Path], Any]
    errors: tuple[type[Exception], ...] = (UserError,)


def _made() -> Forest:
    layers = build_forest(static_layer(gaussians("overlap", n=8, degree=1)), 0.2, 2)
    made = forest_of(layers, 120.5, "somewhere", "ab" * 32)
    return replace(made, attached={"x": torch.ones(2)})


def _frame(path: Path) -> None:
    rng = small.rng()
    image = lambda: rng.uniform(size=(4, 6, 3)).astype(np.float32)  # noqa: E731
    plane = lambda: rng.uniform(1, 2, (4, 6)).astype(np.float32)  # noqa: E731
    write_frame(path, CapturedFrame(image(), image(), image(), plane(), plane(), np.ones((4, 6), np.int32)))


def _frame_set(path: Path) -> None:
    """The description, with its frames beside it."""
    (path.parent / "frames").mkdir(exist_ok=True)
    entry = {**camera_to_json(camera()), "samples": 4, "held_out": False}
    entry["file_path"] = "frames/0000.exr"
    _frame(path.parent / "frames" / "0000.exr")
    document = {
        "format_version": FORMAT_VERSION,
        "scene": {"name": "attic", "hash": "ab" * 32, "max_depth": 8},
        "integrator": "path",
        "frames": [entry, {**entry, "held_out": True}],
    }
    path.write_text(json.dumps(document))


def _all_pixels(path: Path) -> None:
    """Reads the folder of posed images that a file describes, with all pixels."""
    for image in read_posed_folder(path.parent).images:
        read_pixels(image)


def _colmap(path: Path) -> None:
    """A data set of COLMAP with a binary model, which is that of a text."""
    folder = posed.write_colmap(path.parent, 2, ".")
    model = read_model(folder)
    seen = np.zeros(len(model.points), np.int64)
    colours = np.zeros((len(seen), 3), np.uint8)
    write_model(folder, model, ModelPoints(model.points, colours, seen, model.points[:, :2]))


def _deep_image(path: Path) -> None:
    """Frames of which one has 16 bits per channel."""
    file = posed.write_synthetic(path.parent, 1, 0) / "transforms_train.json"
    file.write_text(file.read_text().replace("./train/r_000", path.name))
    values = small.rng().integers(0, 1 << 16, (posed.HEIGHT, posed.WIDTH, 3)).astype(np.uint16)
    mi.Bitmap(values).write(str(path))


def _part(path: Path) -> None:
    identity = {**IDENTITY, "code": {"source": "1a"}, "machine": {"cpu": "c", "cores": 2, "gpu": None}}
    shutil.copy(begin(path.parent / "parts", "sweep", Part(1, 2), identity).folder / path.name, path)


def _journal(path: Path) -> None:
    Journal(path, IDENTITY)["first"] = [1, 2.5, {"a": None}]


def _gltf(path: Path) -> None:
    building = Building()
    bending_tube(building)
    light = building.add("images", uri="data:image/png;base64,iVBORw0KGgo=")
    building.add("textures", source=light)
    building.add(
        "materials", emissiveFactor=[1, 1, 0], pbrMetallicRoughness={"baseColorFactor": [1, 0, 0, 1]}
    )
    lift = np.zeros((4, 3))
    lift[2:, 2] = 1
    node = building.node(mesh=building.mesh(QUAD, QUAD_FACES, [lift], material=0), name="quad")
    lights = [{"type": "spot", "intensity": 3, "spot": {"outerConeAngle": 0.5}}]
    building.tree["extensions"] = {"KHR_lights_punctual": {"lights": lights}}
    lens = building.add(
        "cameras", type="perspective", perspective={"yfov": 0.7, "aspectRatio": 1.2, "znear": 0.1}
    )
    shining = {"KHR_lights_punctual": {"light": 0}}
    building.node(extensions=shining, camera=lens, translation=[0, 0, 5], children=[node])
    building.tree["scenes"] = [{"nodes": [1, 2, 4]}]
    turn = [[0, 0, 0, 1], [0, 0.6, 0, 0.8]]
    building.animation(
        (node, "weights", [0, 1], [0, 0, 0.5, 1, 0, 0], "CUBICSPLINE"),
        (4, "rotation", [0, 1], turn, "STEP"),
    )
    building.save(path)


def _import(path: Path) -> None:
    folder = path.parent / "imported"
    shutil.rmtree(folder, ignore_errors=True)
    import_gltf(read_document(path), folder, fps=2)


def _splats(path: Path) -> None:
    parts = read_gaussians(read_document(path), [])
    try:
        for part in parts:
            gaussians_from(**vars(part))
    except ValueError as error:
        raise UserError(one_line(error)) from error


_SCENE = """<scene version="3.0.0"><default name="d" value="a"/><path value="b"/>
<include filename="$d.xml"/>
<sensor type="perspective"><float name="fov" value="40"/></sensor><shape type="obj">
<string name="filename" value="$d/m.obj"/></shape>
<integrator type="path"><integer name="max_depth" value="6"/></integrator></scene>"""
_PATH = json.dumps(
    {
        "radius": 0.5,
        "frames": [
            {"position": [0, 1, 2], "look_at": [0, 1, 0], "up": [0, 1, 0]},
            {"transform_matrix": np.eye(4).tolist()},
        ],
    }
)
_TRACE = "seconds,x,y\n0.0000,0.460000,0.600000\n0.2500,0.520000,0.410000\n"
_VOTES = "observer,scene,condition,vote\nA,room,ours,5\nA,room,other,3\nB,room,ours,4\n"
_CHOICES = "observer,scene,first,second,chosen\nA,room,ours,other,1\nB,room,other,ours,other\n"
_TENSORS = {"a": torch.arange(6.0).reshape(2, 3), "b": torch.tensor([True]), "c": torch.zeros(3, 0)}
_DISPLAY = '{"width": 2560, "height": 1440, "fov": 60, "luminance": 120.5}'


def _answers(path: Path) -> None:
    finish(StudySession(path.parent, design(), 1))
    shutil.copy(observer_file(path.parent, 1), path)


def _resume(path: Path) -> None:
    """Reads it where the session looks for it."""
    found = observer_file(path.parent, 1)
    found.parent.mkdir(exist_ok=True)
    found.unlink(missing_ok=True)
    # Not a copy: it may be a terabyte.
    found.hardlink_to(path)
    StudySession(path.parent, design(), 1).close()


READERS = {
    "forest": Reader("a.forest", lambda p: save_forest(p, _made()), load_forest),
    "compact forest": Reader("c.forest", lambda p: save_forest(p, compact(_made())), load_forest),
    "tensors": Reader("a.safetensors", lambda p: save_tensors(p, _TENSORS, {"n": [1]}), load_tensors),
    "PLY": Reader("a.ply", lambda p: save_ply(p, gaussians("overlap", n=5, degree=1)), load_ply),
    "frame": Reader("a.exr", _frame, lambda p: read_frame(p, (6, 4))),
    "EXR": Reader(
        "b.exr", lambda p: write_channels(p, {"R": np.ones((3, 2), np.float32)}), lambda p: read_exr(p)
    ),
    "frame set": Reader("transforms.json", _frame_set, lambda p: read_frame_set(p.parent)),
    "camera": Reader(
        "camera.json",
        lambda p: p.write_text(json.dumps(camera_to_json(camera()))),
        lambda p: camera_from_json(read_json(p)),
        (OSError, ValueError, KeyError, TypeError),
    ),
    "camera path": Reader(
        "path.json", lambda p: p.write_text(_PATH), lambda p: read_path(p, np.array([0.0, 1, 0]))
    ),
    "display": Reader("display.json", lambda p: p.write_text(_DISPLAY), lambda p: display_named(str(p))),
    "gaze trace": Reader("gaze.csv", lambda p: p.write_text(_TRACE), load_gaze_trace),
    "votes": Reader("votes.csv", lambda p: p.write_text(_VOTES), load_ratings),
    "choices": Reader("choices.csv", lambda p: p.write_text(_CHOICES), load_choices),
    "design of a study": Reader(
        "study.json", lambda p: design().save(p.parent), lambda p: load_design(p.parent)
    ),
    "answers of an observer": Reader("observer-001.csv", _answers, _resume),
    "journal": Reader("journal.json", _journal, lambda p: Journal(p, IDENTITY)),
    "part of a job": Reader("part.json", _part, stored_part),
    "glTF": Reader("a.gltf", _gltf, _import),
    "GLB": Reader("a.glb", _gltf, _import),
    "GLB of Gaussians": Reader("g.glb", lambda p: save_glb(p, gaussians("overlap", n=5, degree=1)), _splats),
    **{
        f"frames of others, {name}": Reader(name, make, _all_pixels)
        for name, make in (
            ("transforms_train.json", lambda p: posed.write_synthetic(p.parent, 2, 0)),
            ("dataset.json", lambda p: posed.write_nerfies(p.parent, 2, 1)),
            ("metadata.json", lambda p: posed.write_nerfies(p.parent, 2, 1)),
            ("scene.json", lambda p: posed.write_nerfies(p.parent, 2, 1)),
            ("points.npy", lambda p: posed.write_nerfies(p.parent, 2, 1)),
            ("cameras.txt", lambda p: posed.write_colmap(p.parent, 2, ".")),
            ("images.txt", lambda p: posed.write_colmap(p.parent, 2, ".")),
            ("points3D.txt", lambda p: posed.write_colmap(p.parent, 2, ".")),
            ("cameras.bin", _colmap),
            ("images.bin", _colmap),
            ("points3D.bin", _colmap),
            ("deep.png", _deep_image),
        )
    },
    "scene": Reader("scene.xml", lambda p: p.write_text(_SCENE), read_description),
}


def outcome(reader: Reader, folder: Path, content: bytes) -> bool:
    """Whether a reader takes a content; raises what it may not raise.

    Raises:
        AssertionError: it refused it in more than one line.
    """
    file = folder / reader.name
    file.write_bytes(content)
    try:
        reader.read(file)
        return True
    except reader.errors as refusal:
        said = str(refusal)
    if UserError in reader.errors and ("\n" in said or len(said) > 2000):
        raise AssertionError(f"not one line: {said[:200]!r}")
    return False


def good(reader: Reader, folder: Path) -> bytes:
    """The content of a good file, which the reader takes."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    reader.make(folder / reader.name)
    reader.read(folder / reader.name)
    return (folder / reader.name).read_bytes()
