"""Views, frame sets, and a capture that is interrupted."""

from __future__ import annotations

import json

import numpy as np
import pytest

from compose.base.errors import UserError
from pathtrace.dataset.capture import CaptureSettings, capture
from pathtrace.dataset.exr import Frame, read_frame, write_frame
from pathtrace.dataset.frames import read_frame_set
from pathtrace.dataset.views import choose_views
from pathtrace.scene.scene import load_scene
from pathtrace.scene.surfaces import Surfaces
from tests import small

pytestmark = pytest.mark.usefixtures("backend")
SETTINGS = CaptureSettings(views=4, held_out=2, width=24, height=16, spp=2, held_out_spp=4)


def ignore(done: int, total: int) -> None:
    pass


def test_embree_finds_analytic_shapes_and_meshes():
    surfaces = Surfaces(load_scene(small.furnace()))
    directions = np.eye(3)
    distance = surfaces.distance(np.zeros((3, 3)), directions)
    # The sphere is tessellated; worst seen 0.5 % inside.
    np.testing.assert_allclose(distance, 3, rtol=0.01)
    assert not surfaces.untessellated
    assert surfaces.sees(np.zeros(3), np.array([1.0, 1, 1]))
    assert not surfaces.sees(np.zeros(3), np.array([4.0, 0, 0]))
    assert surfaces.clearance(np.array([2.0, 0, 0])) == pytest.approx(1, rel=0.03)


def test_embree_agrees_with_mitsuba_in_the_room():
    from pathtrace.trace.film import frame_positions
    from pathtrace.trace.tracer import Tracer

    scene = load_scene("room")
    camera = scene.camera.resized(64, 64)
    ours = Tracer(scene).hits(camera, frame_positions(camera)).distance
    rays = camera.rays(camera.pixel_centres())
    theirs = Surfaces(scene).distance(np.repeat(camera.position[None], len(rays), axis=0), rays)
    assert np.mean(np.isclose(ours, theirs, rtol=1e-3)) > 0.995


def test_views_stand_in_free_space_and_see_the_scene():
    scene = load_scene("room")
    surfaces = Surfaces(scene)
    views = choose_views(scene, surfaces, 24, 32, 32, seed=1)
    assert np.array_equal(views.fixed[0].world_to_camera, scene.camera.world_to_camera)
    assert len(views.fixed) + len(views.spread) == 24
    for view in views.spread:
        assert surfaces.sees(scene.camera.position, view.position)
        assert surfaces.clearance(view.position) > 0.05
        assert np.linalg.norm(view.position - scene.camera.position) > 0
    again = choose_views(scene, surfaces, 24, 32, 32, seed=1)
    for first, second in zip(views.spread, again.spread, strict=True):
        assert np.array_equal(first.world_to_camera, second.world_to_camera)


def test_more_views_than_fit_are_refused(monkeypatch):
    """Nowhere in the room is a surface farther away than ten times what the camera sees."""
    monkeypatch.setattr("pathtrace.dataset.views._CLEARANCE", 10.0)
    scene = load_scene("room")
    with pytest.raises(UserError, match=r"only 0 of 59 further views fit into the free space"):
        choose_views(scene, Surfaces(scene), 60, 16, 16, seed=0)


def test_a_frame_reads_back_equal(tmp_path):
    rng = small.rng()
    normal = rng.normal(size=(5, 7, 3)).astype(np.float16).astype(np.float32)
    frame = Frame(
        (rng.uniform(0, 20_000, (5, 7, 3))).astype(np.float32),
        rng.uniform(size=(5, 7, 3)).astype(np.float16).astype(np.float32),
        normal,
        np.where(rng.uniform(size=(5, 7)) < 0.2, np.inf, 2.5).astype(np.float32),
        rng.uniform(1, 9, (5, 7)).astype(np.float32),
        rng.integers(-1, 40, (5, 7)).astype(np.int32),
    )
    write_frame(tmp_path / "f.exr", frame)
    back = read_frame(tmp_path / "f.exr")
    for name in frame.__dataclass_fields__:
        assert np.array_equal(getattr(back, name), getattr(frame, name)), name
    assert [p.name for p in tmp_path.iterdir()] == ["f.exr"]


def test_an_interrupted_capture_ends_with_the_same_frames(tmp_path):
    scene = load_scene(small.corner())
    whole = capture(scene, tmp_path / "whole", SETTINGS, ignore)

    class InterruptError(Exception):
        pass

    def interrupt(done: int, total: int) -> None:
        if done > total / 2:
            raise InterruptError

    with pytest.raises(InterruptError):
        capture(scene, tmp_path / "parts", SETTINGS, interrupt)
    with pytest.raises(UserError, match="files are missing"):
        read_frame_set(tmp_path / "parts")
    parts = capture(scene, tmp_path / "parts", SETTINGS, ignore)
    assert len(parts.training) == 4
    assert len(parts.held_out) == 2
    for a, b in zip(whole.entries, parts.entries, strict=True):
        first, second = read_frame(a.file), read_frame(b.file)
        assert np.array_equal(first.radiance, second.radiance)
        assert np.array_equal(first.depth, second.depth)


def test_transforms_json_is_the_nerfstudio_convention(tmp_path):
    """A point projected with nothing but the file's own numbers lands where the camera says."""
    frames = capture(load_scene(small.corner()), tmp_path, SETTINGS, ignore)
    document = json.loads((tmp_path / "transforms.json").read_text())
    point = np.array([0.1, 0.0, 1.5])
    for entry, frame in zip(frames.entries, document["frames"], strict=True):
        to_camera = np.linalg.inv(np.array(frame["transform_matrix"]))
        x, y, z = to_camera[:3, :3] @ point + to_camera[:3, 3]
        u = document["fl_x"] * x / -z + document["cx"]
        v = document["fl_y"] * -y / -z + document["cy"]
        pixels, depth = entry.camera.project(point[None])
        np.testing.assert_allclose([u, v], pixels[0], atol=1e-6)
        assert depth[0] > 0


def test_another_capture_is_not_overwritten(tmp_path):
    scene = load_scene(small.corner())
    capture(scene, tmp_path, SETTINGS, ignore)
    with pytest.raises(UserError, match="another capture"):
        capture(scene, tmp_path, CaptureSettings(views=3, held_out=1, width=24, height=16, spp=2), ignore)


@pytest.mark.parametrize("field", ["views", "width", "spp"])
@pytest.mark.parametrize("value", [0, -3])
def test_senseless_settings_are_refused(field, value):
    with pytest.raises(ValueError, match=field):
        CaptureSettings(**{field: value})


def test_damaged_frames_and_folders_are_named(tmp_path):
    (tmp_path / "f.exr").write_bytes(b"not an image")
    with pytest.raises(UserError, match=r"f\.exr: not a readable frame"):
        read_frame(tmp_path / "f.exr")
    with pytest.raises(UserError, match="not a frame set"):
        read_frame_set(tmp_path)
    (tmp_path / "transforms.json").write_text("{}")
    with pytest.raises(UserError, match=r"transforms\.json"):
        read_frame_set(tmp_path)
