"""The bundled room in any size, place and field of view: captured and trained as users do."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest

from hybrid.preparation.forest_errors import held_out_quality
from hybrid.preparation.forest_training import train
from pathtrace.dataset.capture import capture
from pathtrace.dataset.frame_set import CaptureSettings
from pathtrace.scene.scene import bundled_scenes, load_scene
from splat.training.trainer import TrainingSettings
from tests.extremes import extreme
from tests.hybrid.preparation.conftest import ignore

_CAPTURE = CaptureSettings(views=16, held_out=3, width=60, height=60, spp=8, held_out_spp=64)
_TRAINING = TrainingSettings(iterations=400, gaussians=3000, layers=2, degree=1)


def room(folder: Path, scale: float = 1.0, offset: float = 0.0, fov: float = 60.0) -> Path:
    """The room scaled, then moved along all axes; the light is the same."""
    source = bundled_scenes()["room"]
    root = ET.parse(source).getroot()
    for file in root.iter("string"):
        if file.get("name") == "filename":
            file.set("value", str(source.parent / file.get("value", "")))
    moved = lambda values: [scale * float(value) + offset for value in values]  # noqa: E731
    for look in root.iter("lookat"):
        for name in ("origin", "target"):
            look.set(name, ", ".join(map(repr, moved(look.get(name, "").split(",")))))
    for shape in root.findall("shape"):
        transform = ET.SubElement(shape, "transform", name="to_world")
        ET.SubElement(transform, "scale", value=repr(scale))
        ET.SubElement(transform, "translate", {axis: repr(offset) for axis in "xyz"})
    for light in root.findall("emitter[@type='point']"):
        for point in light.findall("point"):
            point.set("value", ", ".join(map(repr, moved(point.get("value", "").split(",")))))
        for colour in light.findall("rgb"):
            bright = [scale**2 * float(value) for value in colour.get("value", "").replace(",", " ").split()]
            colour.set("value", ", ".join(map(repr, bright)))
    for number in root.iter("float"):
        if number.get("name") == "fov":
            number.set("value", repr(fov))
    (folder / "room.xml").write_text(ET.tostring(root, encoding="unicode"))
    return folder / "room.xml"


def held_out_psnr(scene_file: Path, folder: Path) -> float:
    frames = capture(load_scene(scene_file), folder / "frames", _CAPTURE, ignore)
    return float(held_out_quality(frames, train(frames, folder / "forest", _TRAINING))[-1]["psnr"])


@pytest.fixture(scope="module")
def ordinary(backend, tmp_path_factory) -> float:
    folder = tmp_path_factory.mktemp("ordinary")
    return held_out_psnr(room(folder), folder)


@pytest.mark.long
@pytest.mark.parametrize(
    ("scale", "offset"),
    [
        pytest.param(
            s, o, marks=extreme(f"the room {name}", given=given, expected="held-out PSNR within 0.3 dB")
        )
        for s, o, name, given in [
            (1e-4, 0.0, "at a scale of 1e-4", "captured and trained as it is"),
            (1e6, 0.0, "at a scale of 1e6", "captured and trained as it is"),
            (1.0, 1e6, "1e6 from the origin", "captured and trained as it is"),
        ]
    ],
)
def test_the_room_is_learnt_in_any_size_and_place(scale, offset, ordinary, tmp_path, got):
    found = held_out_psnr(room(tmp_path, scale, offset), tmp_path)
    assert got(f"{found:.2f} dB, ordinary {ordinary:.2f} dB")
    assert found == pytest.approx(ordinary, abs=0.3)


@pytest.mark.long
@extreme(
    "the room in a field of view of 0.1 degrees",
    given="other pictures, of one thousandth of the wall",
    expected="held-out PSNR of no less than the ordinary room's",
)
def test_the_room_is_learnt_in_a_narrow_field_of_view(ordinary, tmp_path, got):
    found = held_out_psnr(room(tmp_path, fov=0.1), tmp_path)
    assert got(f"{found:.2f} dB, ordinary {ordinary:.2f} dB")
    assert np.isfinite(found)
    assert found >= ordinary
