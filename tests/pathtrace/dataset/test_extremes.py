"""Views, captured frames and irradiance caches of scenes at the ends."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import mitsuba as mi
import numpy as np
import pytest

from compose.base.errors import UserError
from pathtrace.dataset.capture import capture
from pathtrace.dataset.captured_frames import CapturedFrame, read_frame
from pathtrace.dataset.frame_set import CaptureSettings, read_frame_set
from pathtrace.fill.filling import fill_cache
from pathtrace.region.neighbourhood import choose_views
from pathtrace.scene.scene import Scene, load_scene
from tests import small
from tests.extremes import extreme
from tests.placed import placed

pytestmark = pytest.mark.usefixtures("backend")
SETTINGS = CaptureSettings(views=1, held_out=0, width=24, height=24, spp=2)


def light(power: float = 8.0, z: float = 0.0) -> dict[str, Any]:
    intensity = {"type": "rgb", "value": power}
    return {"type": "point", "position": [0.2, 0.8, z], "intensity": intensity}


def seen_with(fov: float) -> dict[str, Any]:
    """The corner in another field of view; a wall of 40 fills that of 179 degrees for the most part."""
    wall = mi.ScalarTransform4f().translate([0, 0, 2]).scale(40)
    description = small.corner()
    return {**description, "sensor": small.sensor(fov=fov), "back": {**description["back"], "to_world": wall}}


def unlit() -> dict[str, Any]:
    lamp = {**small.corner()["lamp"], "emitter": {"type": "area", "radiance": {"type": "rgb", "value": 0.0}}}
    return {**small.corner(), "lamp": lamp}


def lit_by_a_point() -> dict[str, Any]:
    return {**small.corner(), "lamp": light()}


def before_a_mirror() -> dict[str, Any]:
    """A mirror at z = 2 fills the view and shows a wall at z = -6."""
    turned = mi.ScalarTransform4f().translate([0, 0, 2]).rotate([0, 1, 0], 180).scale(40)
    wall = mi.ScalarTransform4f().translate([0, 0, -6]).scale(40)
    return {
        "type": "scene",
        "sensor": small.sensor(),
        "mirror": {
            "type": "rectangle",
            "to_world": turned,
            "bsdf": {"type": "conductor", "material": "none"},
        },
        "wall": {"type": "rectangle", "to_world": wall},
        "lamp": light(30.0, -2.0),
    }


def inside_a_box() -> dict[str, Any]:
    box = {"type": "cube", "to_world": mi.ScalarTransform4f().translate([0.3, 0.2, -1.0]).scale(0.3)}
    return {**small.corner(), "around": box}


def nothing() -> dict[str, Any]:
    return {"type": "scene", "sensor": small.sensor(), "lamp": light()}


def only_sky() -> dict[str, Any]:
    return {"type": "scene", "sensor": small.sensor(), "sky": {"type": "constant"}}


def turned_to_the_sky() -> dict[str, Any]:
    away = mi.ScalarTransform4f().look_at(origin=[0, 0, -10], target=[0, 0, -20], up=[0, 1, 0])
    return {**small.corner(), "sensor": {**small.sensor(), "to_world": away}, "sky": {"type": "constant"}}


def captured(description: dict[str, Any], folder) -> tuple[Scene, list[CapturedFrame]]:
    """A scene and its frames, whose paths end in a cache that is filled for its own camera."""
    scene = load_scene(description)
    cache = fill_cache(scene, [scene.camera], points=1 << 10)
    assert np.isfinite(cache.irradiance).all()
    frames = capture(scene, folder, SETTINGS, lambda done, total: None, cache)
    return scene, [read_frame(entry.file) for entry in frames.entries]


def check_finite(frames: list[CapturedFrame]) -> None:
    for frame in frames:
        assert np.isfinite(frame.radiance).all()
        assert np.isfinite(frame.normal).all()
        assert np.isfinite(frame.albedo).all()
        assert (frame.unfolded > 0).all()
        assert (frame.depth > 0).all()


def case(name: str, given: str, make: Callable[[], dict[str, Any]], least: float, most: float) -> object:
    expected = f"finite, mean radiance {least:g} to {most:g}"
    return pytest.param(make, least, most, marks=extreme(name, given=given, expected=expected))


@pytest.mark.parametrize(
    ("make", "least", "most"),
    [
        case("capture at a scale of 1e-4", "corner, 1e-4", lambda: placed(small.corner(), 1e-4), 0.1, 0.3),
        case("capture at a scale of 1e6", "corner, 1e6", lambda: placed(small.corner(), 1e6), 0.1, 0.3),
        case("capture in a field of view of 0.1 degrees", "corner", lambda: seen_with(0.1), 0.05, 0.3),
        case("capture in a field of view of 179 degrees", "corner", lambda: seen_with(179.0), 0.0, 2.0),
        case("capture without light", "a lamp of radiance 0", unlit, 0.0, 1e-5),
        case("capture with a point light", "a light of zero size", lit_by_a_point, 0.1, 0.3),
        case("capture before a mirror", "a mirror fills the view", before_a_mirror, 0.01, 1.0),
        case("capture inside a box", "a closed, unlit box around the camera", inside_a_box, 0.0, 1e-5),
    ],
)
def test_frames_at_the_ends_are_finite(make, least, most, tmp_path, got):
    _, frames = captured(make(), tmp_path / "frames")
    check_finite(frames)
    assert least <= got(float(np.mean([frame.radiance.mean() for frame in frames])), ".2g") <= most


@extreme(
    "distances in a mirror that fills the view",
    given="mirror 3 ahead, which shows a wall 5 behind the camera",
    expected="11 along the axis within 1e-4",
)
def test_distances_are_unfolded_in_a_mirror_that_fills_the_view(tmp_path, got):
    scene, frames = captured(before_a_mirror(), tmp_path / "frames")
    camera = scene.camera.resized(24, 24)
    along = (camera.rays(camera.pixel_centres())[:, 2] * frames[0].unfolded.ravel()).astype(float)
    assert got(float(np.abs(along / 11 - 1).max()), ".1e") < 1e-4


@pytest.mark.parametrize(
    "make",
    [
        pytest.param(m, marks=extreme(name, given=given, expected="capture refused in one line"))
        for m, name, given in [
            (nothing, "an empty scene", "a point light and nothing else"),
            (only_sky, "a scene of sky alone", "a constant sky and nothing else"),
            (turned_to_the_sky, "a camera turned to the sky", "all surfaces lie behind it"),
        ]
    ],
)
def test_scenes_without_a_visible_surface_are_refused(make, tmp_path, got):
    with pytest.raises(UserError, match="the scene's own camera sees no surface") as caught:
        captured(make(), tmp_path / "frames")
    assert "\n" not in got(str(caught.value))
    assert not (tmp_path / "frames").exists()


@pytest.mark.parametrize(
    "fov",
    [
        pytest.param(
            f, marks=extreme(f"overlap of views of {f:g} degrees", given="24 views", expected="over 0.25")
        )
        for f in (0.1, 1.0, 20.0, 60.0)
    ],
)
def test_views_overlap_in_any_field_of_view(fov, got):
    """Share of what the scene's own camera sees that a view sees as well, on the wall behind all things."""
    scene = load_scene(seen_with(fov))
    views = choose_views(scene, scene.surfaces(), 24, 24, 24, seed=0)
    home = views.fixed[0]
    rays = home.rays(home.pixel_centres())
    points = home.position + rays * ((2 - home.position[2]) / rays[:, 2])[:, None]
    shares = []
    for view in views.spread:
        pixel, depth = view.project(points)
        shares.append(float(np.mean(((pixel >= 0) & (pixel < 24)).all(axis=1) & (depth > 0))))
    assert got(float(np.mean(shares)), ".2f") > 0.25


@pytest.mark.parametrize(
    ("scale", "offset"),
    [
        pytest.param(
            s,
            o,
            marks=extreme(f"views {n}", given="a corner of a room", expected="the ordinary ones to 1e-5"),
        )
        for s, o, n in [
            (1e-4, 0.0, "at a scale of 1e-4"),
            (1e6, 0.0, "at a scale of 1e6"),
            (1.0, 1e6, "1e6 from the origin"),
        ]
    ],
)
def test_views_of_any_size_and_place_are_the_same(scale, offset, got):
    ordinary, scene = load_scene(small.corner()), load_scene(placed(small.corner(), scale, offset))
    expected = choose_views(ordinary, ordinary.surfaces(), 20, 24, 24, seed=3)
    found = choose_views(scene, scene.surfaces(), 20, 24, 24, seed=3)
    worst = 0.0
    for one, other in zip(expected.fixed + expected.spread, found.fixed + found.spread, strict=True):
        position = (scene.place.in_world(other.position[None])[0] - offset) / scale
        worst = max(worst, float(np.abs(position - one.position).max()))
    assert got(worst, ".1e") < 1e-5


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        pytest.param(
            m, message, marks=extreme(f"frames whose pose {n}", given=g, expected="refused in one line")
        )
        for m, message, n, g in [
            (np.diag([-1.0, 1, 1, 1]), "it mirrors", "mirrors", "determinant -1"),
            (np.diag([2.0, 2, 2, 1]), "axes have the lengths 2, 2, 2", "scales", "axes of length 2"),
            (np.full((4, 4), np.nan), "NaN is not a number", "is not finite", "NaN everywhere"),
        ]
    ],
)
def test_frame_sets_with_poses_that_are_not_rigid_are_refused(spoil, message, tmp_path, got):
    capture(load_scene(small.corner()), tmp_path, SETTINGS, lambda done, total: None)
    file = tmp_path / "transforms.json"
    document = json.loads(file.read_text())
    matrix = np.array(document["frames"][0]["transform_matrix"]) @ spoil
    document["frames"][0]["transform_matrix"] = matrix.tolist()
    file.write_text(json.dumps(document))
    with pytest.raises(UserError, match=message) as caught:
        read_frame_set(tmp_path)
    assert "\n" not in str(caught.value)
    got(str(caught.value).split("transforms.json: ")[1])
