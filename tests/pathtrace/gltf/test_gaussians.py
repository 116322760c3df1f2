"""Gaussians in glTF files: what they are is read, and what they cannot be is refused."""

from __future__ import annotations

import numpy as np
import pytest

from compose.base.errors import UserError
from pathtrace.gltf.document import read_document
from pathtrace.gltf.gaussians import read_gaussians
from tests.pathtrace.gltf.building import QUAD, QUAD_FACES, Building, quaternion

NAME = "KHR_gaussian_splatting"
DESCRIBED = {"kernel": "ellipse", "colorSpace": "srgb_rec709_display"}
RNG = np.random.default_rng(0)
POSITIONS, TURNS = RNG.normal(size=(3, 3)).astype("f4"), RNG.normal(size=(3, 4)).astype("f4")
SCALES, OPACITIES = RNG.uniform(0.1, 1, (3, 3)).astype("f4"), np.array([0, 0.5, 1], "f4")
SH = RNG.normal(size=(16, 3, 3)).astype("f4")


def harmonics(count: int) -> dict[str, np.ndarray]:
    orders = [(d, n) for d in range(4) for n in range(2 * d + 1)][:count]
    return {f"{NAME}:SH_DEGREE_{d}_COEF_{n}": SH[k] for k, (d, n) in enumerate(orders)}


def splats(
    building: Building, count: int = 1, described: dict[str, str] = DESCRIBED, **changed: int | None
) -> int:
    """A mesh of three Gaussians; attributes by their last word are replaced by an accessor, or left out."""
    arrays = {f"{NAME}:ROTATION": TURNS, f"{NAME}:SCALE": SCALES, f"{NAME}:OPACITY": OPACITIES}
    arrays = {"POSITION": POSITIONS, **arrays, **harmonics(count)}
    attributes = {name: building.array(values) for name, values in arrays.items()}
    for word, accessor in changed.items():
        name = next(name for name in attributes if name.endswith(word))
        attributes = {k: v for k, v in attributes.items() if k != name}
        if accessor is not None:
            attributes[name] = accessor
    extensions = {NAME: described}
    return building.add(
        "meshes", primitives=[{"mode": 0, "attributes": attributes, "extensions": extensions}]
    )


@pytest.mark.parametrize("suffix", [".glb", ".gltf"])
@pytest.mark.parametrize("count", [1, 4, 9, 16])
def test_all_attributes_are_read(tmp_path, suffix, count):
    building = Building()
    building.tree["extensionsUsed"] = building.tree["extensionsRequired"] = [NAME]
    parent = building.node(children=[1], translation=[1, 2, 3])
    building.node(mesh=splats(building, count), scale=[2, 2, 2])
    building.tree["scenes"] = [{"nodes": [parent]}]
    remarks: list[str] = []
    (found,) = read_gaussians(read_document(building.save(tmp_path / f"a{suffix}")), remarks)
    assert remarks == []
    assert np.array_equal(found.to_world, [[2, 0, 0, 1], [0, 2, 0, 2], [0, 0, 2, 3], [0, 0, 0, 1]])
    for ours, expected in (
        *((found.positions, POSITIONS), (found.rotations, TURNS)),
        *((found.scales, SCALES), (found.opacities, OPACITIES), (found.sh, SH[:count].transpose(1, 0, 2))),
    ):
        assert np.array_equal(ours, expected)
    assert not found.is_linear


def test_integers_stand_for_fractions_or_themselves(tmp_path):
    building = Building()
    turns = building.array([[0, 0, 0, 127], [127, 0, 0, 0], [0, -64, 64, 0]], "int16")
    building.tree["accessors"][turns].update(normalized=True)
    opacities = building.array([0, 51, 255], "uint8", normalized=True)
    scales = building.array(np.full((3, 3), 5), "uint16")
    building.node(mesh=splats(building, ROTATION=turns, OPACITY=opacities, SCALE=scales))
    (found,) = read_gaussians(read_document(building.save(tmp_path / "a.glb")), [])
    assert found.opacities == pytest.approx([0, 0.2, 1])
    assert np.array_equal(found.scales, np.full((3, 3), 5))
    assert found.rotations[2] == pytest.approx(np.array([0, -64, 64, 0]) / 32767)


def test_parts_of_several_degrees_have_the_largest(tmp_path):
    building = Building()
    building.node(mesh=splats(building, 1, {**DESCRIBED, "colorSpace": "lin_rec709_display"}))
    building.node(mesh=splats(building, 9), rotation=quaternion((0, 0, 1), 90))
    one, other = read_gaussians(read_document(building.save(tmp_path / "a.glb")), [])
    assert (one.is_linear, other.is_linear) == (True, False)
    assert one.sh.shape == other.sh.shape == (3, 9, 3)
    assert not one.sh[:, 1:].any()
    assert np.allclose(other.to_world[:3, :3], [[0, -1, 0], [1, 0, 0], [0, 0, 1]])


def test_what_is_shown_otherwise_is_said(tmp_path):
    building = Building()
    node = building.node(mesh=splats(building, 1, {"kernel": "cube", "colorSpace": "aces"}))
    building.animation((node, "translation", [0, 1], [[0, 0, 0], [1, 0, 0]], "LINEAR"))
    remarks: list[str] = []
    assert len(read_gaussians(read_document(building.save(tmp_path / "a.glb")), remarks)) == 1
    assert remarks == [
        "meshes[0].primitives[0] is of the kernel cube, and is shown as ellipse",
        "meshes[0].primitives[0] has the colour space aces, and is read as sRGB",
        "Gaussians stand still; animations are left out",
    ]


def test_a_file_with_triangles_is_a_scene(tmp_path):
    building = Building()
    building.node(mesh=splats(building))
    building.node(mesh=building.mesh(QUAD, QUAD_FACES))
    assert read_gaussians(read_document(building.save(tmp_path / "a.glb")), []) == []


REFUSED = {
    "no scale": ({"SCALE": lambda b: None}, "has no attribute KHR_gaussian_splatting:SCALE"),
    "half a degree": (
        {"DEGREE_1_COEF_2": lambda b: None},
        "has no attribute .*:SH_DEGREE_1_COEF_2",
    ),
    "two of three": ({"SCALE": lambda b: b.array(SCALES[:2])}, "has attributes of several lengths"),
    "columns": ({"SCALE": lambda b: b.array(OPACITIES)}, "is a SCALAR of type 5126"),
    "a negative scale": ({"SCALE": lambda b: b.array(-SCALES)}, "has a negative scale, or an opacity that"),
    "a logit": ({"OPACITY": lambda b: b.array([0, 1, 1.5])}, "an opacity that is not from 0 to 1"),
    "no rotation": ({"ROTATION": lambda b: b.array(0 * TURNS)}, "has a quaternion without length"),
    "a number": ({"POSITION": lambda b: b.array(POSITIONS * np.nan)}, "holds numbers that are not finite"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_not_as_the_extension_says_is_refused(tmp_path, name):
    changed, message = REFUSED[name]
    building = Building()
    building.node(mesh=splats(building, 4, **{word: make(building) for word, make in changed.items()}))
    # What is not finite has no extremes.
    for accessor in building.tree["accessors"]:
        accessor.pop("min"), accessor.pop("max")
    with pytest.raises(UserError, match=message) as refused:
        read_gaussians(read_document(building.save(tmp_path / "a.glb")), [])
    assert "\n" not in str(refused.value)
