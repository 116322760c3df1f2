"""Scenes of one feature each look as Mitsuba renders them, or it is said what does not."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest

from pathtrace.scene.scene import load_scene
from pathtrace.trace import parity as module
from pathtrace.trace.parity import compared, parity
from tests import small

SMOKE = {"type": "homogeneous", "albedo": 0.6, "sigma_t": 1.5}
NULL = {"type": "null"}
CURVES = "-0.5 0 0.8 0.05\n0 0.3 0.8 0.05\n0.3 0 0.8 0.05\n0.5 0.4 0.8 0.05\n"


@pytest.fixture(autouse=True)
def quick(backend, monkeypatch):
    monkeypatch.setattr(module, "_SIDE", 32)


def moved() -> Any:
    return mi.ScalarTransform4f()


def scene(**parts: Any) -> dict[str, Any]:
    """A corner without its lamp: shapes that each feature lights and adds to."""
    base = {**small.corner(), "integrator": {"type": "path", "max_depth": 8}}
    base["ball"] = {**base["ball"], "bsdf": {"type": "diffuse"}}
    return {**base, **parts}


def bitmap(folder: Path, values: np.ndarray) -> dict[str, Any]:
    file = folder / "texture.png"
    mi.Bitmap(values).write(str(file))
    return {"type": "bitmap", "filename": str(file), "to_uv": moved().scale([2, 2, 1])}


def board(bsdf: dict[str, Any]) -> dict[str, Any]:
    return {"type": "rectangle", "to_world": moved().translate([-0.3, 0.1, 1.0]).scale(0.5), "bsdf": bsdf}


def grey(bits: type, shape: tuple[int, ...]) -> np.ndarray:
    return small.rng(3).integers(0, np.iinfo(bits).max, (*shape, 3), endpoint=True).astype(bits)


def curves(folder: Path) -> dict[str, Any]:
    (folder / "hair.txt").write_text(CURVES)
    return scene(hair={"type": "bsplinecurve", "filename": str(folder / "hair.txt")})


def cropped() -> dict[str, Any]:
    film = {"crop_offset_x": 8, "crop_offset_y": 4, "crop_width": 40, "crop_height": 24}
    sensor = small.sensor(64, 48)
    return scene(sensor={**sensor, "film": {**sensor["film"], **film}})


def grid(folder: Path) -> dict[str, Any]:
    density = mi.VolumeGrid(small.rng(2).random((6, 6, 6, 1), dtype=np.float32))
    density.write(str(folder / "density.vol"))
    place = moved().translate([-0.4, -0.2, 0.5]).scale(0.6)
    volume = {"type": "gridvolume", "filename": str(folder / "density.vol"), "to_world": place}
    medium = {"type": "heterogeneous", "sigma_t": volume, "albedo": 0.9, "scale": 6.0}
    cube = {"type": "cube", "to_world": place @ moved().translate(0.5).scale(0.5), "bsdf": NULL}
    return scene(integrator={"type": "volpath"}, cloud={**cube, "interior": medium})


def instances() -> dict[str, Any]:
    group = {"type": "shapegroup", "ball": {"type": "sphere", "radius": 0.2}}
    at = [moved().translate([x, 0, 1]) for x in (-0.4, 0.1)]
    placed = {
        f"i{k}": {"type": "instance", "g": {"type": "ref", "id": "group"}, "to_world": to}
        for k, to in enumerate(at)
    }
    return scene(group=group, **placed)


def lit_by(**emitters: Any) -> dict[str, Any]:
    found = scene(**emitters)
    del found["lamp"]
    return found


def fog() -> dict[str, Any]:
    return scene(
        integrator={"type": "volpath"},
        fog={**SMOKE, "sigma_t": 0.2},
        sensor={**small.sensor(), "medium": {"type": "ref", "id": "fog"}},
        point={"type": "point", "position": [0, 1, 0], "intensity": 2.0},
    )


def hidden() -> dict[str, Any]:
    lamp = {**small.corner()["lamp"], "to_world": moved().translate([0.2, 0.3, 0.6]).scale(0.2)}
    integrator = {"type": "path", "hide_emitters": True}
    return scene(integrator=integrator, lamp=lamp | {"flip_normals": True}, sky={"type": "constant"})


def smoke() -> dict[str, Any]:
    ball = {"type": "sphere", "radius": 0.4, "center": [-0.3, 0, 0.6], "bsdf": NULL}
    return scene(integrator={"type": "volpath", "max_depth": 12}, smoke={**ball, "interior": SMOKE})


SUN = {"type": "directional", "direction": [0.3, -0.6, 1], "irradiance": 2.0}
ENVMAP = np.linspace(0.1, 2, 8 * 16 * 3, dtype=np.float32).reshape(8, 16, 3)
SENSOR = small.sensor
FEATURES: dict[str, Callable[[Path], dict[str, Any]]] = {
    "crop window": lambda folder: cropped(),
    "near clip": lambda folder: scene(sensor={**SENSOR(), "near_clip": 1.9}),
    "far clip": lambda folder: scene(sensor={**SENSOR(), "far_clip": 2.4}, sky={"type": "constant"}),
    "principal point": lambda folder: scene(sensor={**SENSOR(), "principal_point_offset_x": 0.1}),
    "hidden lights and sky": lambda folder: hidden(),
    "homogeneous medium": lambda folder: smoke(),
    "heterogeneous medium": grid,
    "fog around the camera": lambda folder: fog(),
    "curves": curves,
    "instances": lambda folder: instances(),
    "mask": lambda folder: scene(board=board({"type": "mask", "opacity": 0.4, "b": {"type": "diffuse"}})),
    "normal map": lambda folder: scene(
        board=board(
            {
                "type": "normalmap",
                "normalmap": bitmap(folder, grey(np.uint8, (4, 4))) | {"raw": True},
                "b": {"type": "diffuse"},
            }
        )
    ),
    "8-bit texture": lambda folder: scene(
        board=board({"type": "diffuse", "reflectance": bitmap(folder, grey(np.uint8, (4, 4)))})
    ),
    "16-bit texture": lambda folder: scene(
        board=board({"type": "diffuse", "reflectance": bitmap(folder, grey(np.uint16, (4, 4)))})
    ),
    "rough glass": lambda folder: scene(board=board({"type": "roughdielectric", "alpha": 0.3})),
    "spot": lambda folder: lit_by(
        light={
            "type": "spot",
            "intensity": 20.0,
            "to_world": moved().look_at([0, 1, -1], [0, 0, 1], [0, 1, 0]),
        }
    ),
    "point": lambda folder: lit_by(light={"type": "point", "position": [0.5, 1, 0], "intensity": 3.0}),
    "directional": lambda folder: lit_by(light=SUN),
    "constant": lambda folder: lit_by(light={"type": "constant", "radiance": 0.7}),
    "envmap": lambda folder: lit_by(light={"type": "envmap", "bitmap": mi.Bitmap(ENVMAP)}),
}


@pytest.mark.parametrize("feature", FEATURES)
def test_a_scene_looks_as_mitsuba_renders_it(feature, tmp_path):
    description = FEATURES[feature](tmp_path)
    loaded = load_scene(description)
    found = parity(loaded, description)
    assert loaded.left_out == ()
    assert found.holds, found
    assert found.theirs > 0.01


def test_what_is_traced_otherwise_is_found_and_named():
    description = scene(integrator={"type": "path", "max_depth": 2})
    found = parity(load_scene(description, max_depth=8), description)
    assert not found.holds
    assert found.causes == ("paths of its integrator end after 2 segments, here after 8 segments",)
    other = scene(integrator={"type": "direct"})
    assert "DirectIntegrator" in parity(load_scene(other), other).causes[0]


def test_mitsubas_path_stands_for_integrators_that_it_does_not_have():
    text = """<scene version='3.0.0'><integrator type='own'/><sensor type='perspective'/>
    <shape type='sphere'><point name='center' x='0' y='0' z='3'/></shape><emitter type='constant'/></scene>"""
    found = parity(load_scene(text), text)
    assert found.holds, found
    assert found.by == "Mitsuba's path, which does not have its integrator,"


def test_noise_alone_is_no_difference_and_more_light_is_one():
    one, other = small.rng(1).gamma(50, 0.02, (2, 8, 20, 30, 3))
    assert compared(one, other).holds
    found = compared(one, other * 1.3)
    assert found.parts == 3 * 4 + 1
    assert found.differing == found.parts
