"""The tracer at the ends: few and many samples, more positions than lanes, black and broken scenes."""

from __future__ import annotations

from dataclasses import fields

import mitsuba as mi
import numpy as np
import pytest

from compose.base.errors import UserError
from pathtrace.scene.scene import Scene, load_scene
from pathtrace.trace import tracer as module
from pathtrace.trace.film import Lanes, box_positions, frame_positions, interleaved, pixel_positions
from pathtrace.trace.tracer import AuxiliaryFeatures, Tracer
from tests import small
from tests.extremes import extreme

pytestmark = pytest.mark.usefixtures("backend")


@pytest.fixture(scope="module")
def corner(backend) -> Scene:
    return load_scene(small.corner())


@pytest.fixture
def lanes(monkeypatch) -> list[int]:
    """How many lanes each launch has, with room for 500 at once."""
    found: list[int] = []
    of = Lanes.of

    def counted(positions, spp):
        made = of(positions, spp)
        found.append(made.count)
        return made

    monkeypatch.setattr(Lanes, "of", staticmethod(counted))
    monkeypatch.setattr(module, "_MAX_LANES", 500)
    return found


def arrays_of(features: AuxiliaryFeatures) -> list[np.ndarray]:
    return [interleaved(getattr(features, name)) for name in ("albedo", "normal", "position")]


@pytest.mark.parametrize("spp", [1, 16, 700])
def test_auxiliary_features_keep_to_the_bound_on_lanes(corner, lanes, monkeypatch, spp):
    """To the bit as without it, unless the samples of one position alone are more."""
    tracer, camera = Tracer(corner), corner.camera
    positions = pixel_positions(mi.UInt32(np.arange(100, 700 if spp < 100 else 103)), camera.width)
    offset = np.arange(positions.count)
    bounded = tracer.auxiliary(camera, positions, spp, 3, offset)
    assert max(lanes) <= 500
    assert sum(lanes) == spp * positions.count
    monkeypatch.setattr(module, "_MAX_LANES", 1 << 22)
    whole = tracer.auxiliary(camera, positions, spp, 3, offset)
    for found, expected in zip(arrays_of(bounded), arrays_of(whole), strict=True):
        if spp < 500:
            np.testing.assert_array_equal(found, expected)
        np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-6)
    assert (bounded.gloss.numpy() == whole.gloss.numpy()).all()


def test_hits_keep_to_the_bound_on_lanes(corner, monkeypatch):
    tracer, camera = Tracer(corner), corner.camera
    sides = np.linspace(0.5, 1.5, 1024)
    boxes = box_positions(np.arange(1024) % 32, np.arange(1024) // 32, sides, sides)
    whole = tracer.hits(camera, boxes)
    monkeypatch.setattr(module, "_MAX_LANES", 300)
    for field in fields(whole):
        found = getattr(tracer.hits(camera, boxes), field.name)
        np.testing.assert_array_equal(found, getattr(whole, field.name))


@pytest.mark.parametrize("spp", [1, 3, np.arange(1024, dtype=np.int32) % 3])
def test_more_positions_than_lanes_are_traced_in_parts(lanes, spp):
    """In a furnace, whatever the random numbers are, the mean is 1; each part has its own."""
    scene = load_scene(small.furnace(0.5), max_depth=40)
    traced = Tracer(scene).trace(scene.camera, frame_positions(scene.camera), spp, seed=1, features=True)
    assert max(lanes) <= 1000
    assert sum(lanes) == np.sum(np.broadcast_to(spp, 1024))
    radiance = traced.radiance[0].numpy()
    assert len(radiance) == 1024
    lit = np.broadcast_to(spp, 1024) > 0
    assert (radiance[~lit] == 0).all()
    assert radiance[lit].mean() == pytest.approx(1, abs=0.1)
    assert len(np.unique(radiance[lit])) > 50
    assert not np.array_equal(radiance[:500], radiance[500:1000])
    assert all(np.isfinite(one).all() for one in arrays_of(traced.features))


@extreme(
    "auxiliary features of 3840x2160",
    given="16 spp, everything inside fov-a",
    expected="at most 4,194,304 lanes",
)
def test_the_largest_frames_are_seen_in_parts(corner, monkeypatch, got):
    """Which batches there are, without tracing them."""
    found = []
    monkeypatch.setattr(
        Tracer,
        "_features",
        lambda self, batch: found.append(batch.positions.count * batch.spp) or [mi.Float(0)] * 10,
    )
    camera = corner.camera.resized(3840, 2160)
    Tracer(corner).auxiliary(camera, frame_positions(camera), 16, 0)
    assert sum(found) == 3840 * 2160 * 16
    assert got(max(found)) <= 1 << 22


@pytest.mark.parametrize(
    "spp",
    [
        pytest.param(
            spp, marks=extreme(f"{spp:,} spp of one pixel", given="a lamp of radiance 12", expected="12")
        )
        for spp in (1, 16384)
    ],
)
def test_any_number_of_samples_keeps_the_mean(spp, got):
    """Seen from inside a lamp."""
    description = small.furnace(0.0)
    description["sphere"]["emitter"]["radiance"]["value"] = 12.0
    scene = load_scene(description)
    one = pixel_positions(mi.UInt32([500]), scene.camera.width)
    for count in (spp, np.int64(spp), np.array([spp])):
        traced = Tracer(scene).trace(scene.camera, one, count, seed=2**63 - 1)
        assert traced.radiance[0].numpy()[0] == pytest.approx(12, rel=1e-5)
        assert traced.squares[0].numpy()[0] == pytest.approx(144, rel=1e-5)
    assert got(float(traced.radiance[0].numpy()[0]), ".5g") == pytest.approx(12, rel=1e-5)


def test_no_samples_are_refused(corner):
    with pytest.raises(ValueError, match="spp is 0, must be at least 1"):
        Tracer(corner).trace(corner.camera, frame_positions(corner.camera), 0)


@extreme("counts that are all 0", given="1,024 positions", expected="black, finite")
def test_counts_of_zero_are_black(corner, got):
    nothing = np.zeros(1024, dtype=np.int64)
    traced = Tracer(corner).trace(corner.camera, frame_positions(corner.camera), nothing, features=True)
    assert got(float(interleaved(traced.radiance).max())) == 0
    assert all(np.isfinite(one).all() for one in arrays_of(traced.features))


def bitmap(texels: np.ndarray) -> dict:
    """A texture that is not interpolated."""
    return {
        "type": "bitmap",
        "bitmap": mi.Bitmap(texels.astype(np.float32)),
        "raw": True,
        "filter_type": "nearest",
    }


def lamp(radiance: float, scale: float = 0.7) -> dict:
    """A square lamp above the corner."""
    place = mi.ScalarTransform4f().look_at(origin=[0, 2.5, -1], target=[0, 0, 1], up=[0, 0, 1]).scale(scale)
    glow = {"type": "area", "radiance": {"type": "rgb", "value": radiance}}
    return {"type": "rectangle", "to_world": place, "emitter": glow}


def described(name: str) -> dict:
    """A corner at one of its ends."""
    description = small.corner()
    if name == "NaN texels":
        texels = np.full((4, 4, 3), 0.5)
        texels[1:3, 1:3] = np.nan
        description["back"]["bsdf"]["b"]["reflectance"] = bitmap(texels)
    elif name == "a black scene":
        description["lamp"] = lamp(0.0)
    elif name == "a lamp of no size":
        description["lamp"] = lamp(12.0, 1e-20)
    elif name == "a lamp of 1e30":
        description["lamp"] = lamp(1e30)
    elif name == "a mirror that fills the view":
        place = mi.ScalarTransform4f().translate([0, 0, 0.5]).rotate([0, 1, 0], 180).scale(50)
        description["mirror"] = {"type": "rectangle", "to_world": place, "bsdf": {"type": "conductor"}}
    return description


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(
            name, marks=extreme(f"traced: {name}", given="corner, 4 spp", expected="finite, features too")
        )
        for name in (
            "NaN texels",
            "a black scene",
            "a lamp of no size",
            "a lamp of 1e30",
            "a mirror that fills the view",
        )
    ],
)
def test_scenes_at_their_ends_are_traced(name, got):
    scene = load_scene(described(name))
    tracer, positions = Tracer(scene), frame_positions(scene.camera)
    traced, features = tracer.trace_with_features(scene.camera, positions, 4, 0)
    radiance = interleaved(traced.radiance)
    assert np.isfinite(radiance).all()
    assert got(float(radiance.max()), ".2g") >= 0
    assert not np.isnan(interleaved(traced.squares)).any()
    assert all(np.isfinite(one).all() for one in arrays_of(features))
    assert all(np.isfinite(one).all() for one in arrays_of(tracer.auxiliary(scene.camera, positions, 4, 0)))


@extreme("a texture that is missing", given="bitmap of no file", expected="refused by name")
def test_a_missing_texture_is_refused_by_name(got):
    description = small.corner()
    description["back"]["bsdf"]["b"]["reflectance"] = {"type": "bitmap", "filename": "nowhere.png"}
    with pytest.raises(UserError, match=r"nowhere\.png") as refusal:
        load_scene(description)
    assert "\n" not in got(str(refusal.value))
