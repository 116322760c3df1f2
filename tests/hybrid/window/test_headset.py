"""The scene in a headset: what eyes see of it, and frames along a recorded session; OpenXR where it runs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from compose.base.errors import UserError
from compose.camera.camera import Camera, turned
from compose.image.colour import radiance_from_srgb
from hybrid.render.frame_settings import INTERACTIVE
from hybrid.window.controls import Playback
from hybrid.window.frame_source import SceneSource
from hybrid.window.headset import Eye, HeadsetFrame, display_of, gaze_in, levelled, show_in_headset
from hybrid.window.messages import Request
from tests.hybrid.command import run

# Of a session with Monado's simulated headset: positions and quaternions (x, y, z, w) of both eyes,
# moved from the floor to where the head began, and the angles at which their views end.
SESSION = [
    ([-0.0315, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0], [0.0315, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]),
    (
        [0.0148, -0.0257, -0.0031, -0.011843, -0.049823, -0.012456, 0.998610],
        [0.0775, -0.0271, 0.0031, -0.011843, -0.049823, -0.012456, 0.998610],
    ),
]
ANGLES = (-0.741765, 0.741765, -0.778764, 0.778764)


def pose_of(numbers: Sequence[float]) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = Rotation.from_quat(numbers[3:]).as_matrix(), numbers[:3]
    return pose


def eye_of(numbers: Sequence[float]) -> Eye:
    return Eye(pose_of(numbers), *np.tan(ANGLES))


class Recorded:
    """A headset that plays a session, and keeps what it is shown."""

    def __init__(self, gaze: np.ndarray | None = None):
        self.shown: list[list[np.ndarray]] = []
        self._gaze = gaze

    def frames(self) -> Iterator[HeadsetFrame]:
        for eyes in SESSION:
            yield HeadsetFrame([eye_of(eye) for eye in eyes], self._gaze, self._show)

    def _show(self, images: Sequence[np.ndarray]) -> None:
        self.shown.append([image.copy() for image in images])


def turned_by(axis: str, degrees: float) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_euler(axis, degrees, degrees=True).as_matrix()
    return pose


@pytest.fixture
def home() -> Camera:
    """A camera somewhere, looking along the world's x axis, with y down."""
    pose = np.array([[0, 0, 1, 5.0], [0, 1, 0, 6], [-1, 0, 0, 7], [0, 0, 0, 1]])
    return Camera(np.linalg.inv(pose), 64, 48, 40, 40, 32, 24)


def test_the_room_begins_at_the_scenes_camera(home):
    eye = Eye(np.eye(4), -1, 1, -0.75, 0.75).camera(home, 48)
    np.testing.assert_allclose(eye.world_to_camera, home.world_to_camera, atol=1e-12)
    assert (eye.width, eye.height) == (64, 48)
    # A metre to the right, two up, three ahead.
    pose = np.eye(4)
    pose[:3, 3] = 1, 2, -3
    moved = Eye(pose, -1, 1, -1, 1).camera(home, 48)
    right, down, ahead = home.camera_to_world[:3, :3].T
    np.testing.assert_allclose(moved.position, home.position + right - 2 * down + 3 * ahead)
    # Turned to the left, it looks to where the left was.
    left = Eye(turned_by("y", 90), -1, 1, -1, 1).camera(home, 48)
    np.testing.assert_allclose(left.camera_to_world[:3, 2], -right, atol=1e-12)
    up = Eye(turned_by("x", 90), -1, 1, -1, 1).camera(home, 48)
    np.testing.assert_allclose(up.camera_to_world[:3, 2], -down, atol=1e-12)


@pytest.mark.parametrize("pitch", [-40, 0, 40])
def test_the_room_is_level(home, pitch):
    pose = home.camera_to_world
    pose[:3, :3] = turned(pose[:3, :3], 0, pitch)
    found = levelled(home.at(pose))
    np.testing.assert_allclose(found.position, home.position)
    np.testing.assert_allclose(found.camera_to_world[:3, :3], home.camera_to_world[:3, :3], atol=1e-9)


def test_views_end_where_the_headset_says(home):
    eye = Eye(np.eye(4), -1.2, 0.8, -0.9, 1.1)
    camera = eye.camera(home, 100)
    assert camera.width == 100
    rays = camera.rays(np.array([[0.0, 0.0], [100.0, 100.0]])) @ home.camera_to_world[:3, :3]
    (left, up), (right, down) = (ray[:2] / ray[2] for ray in rays)
    # Of cameras, y points down.
    np.testing.assert_allclose([left, right, -up, -down], [-1.2, 0.8, 1.1, -0.9])
    assert display_of(camera, 100).focal == pytest.approx(camera.fx)


@pytest.mark.parametrize(
    ("gaze", "expected"),
    [
        (None, (0.6, 0.55)),
        (np.eye(4), (0.6, 0.55)),
        (turned_by("y", -30), (0.6 + np.tan(np.radians(30)) / 2, 0.55)),
        (turned_by("x", 20), (0.6, 0.55 - np.tan(np.radians(20)) / 2)),
        (turned_by("y", 180), (0.5, 0.5)),
    ],
)
def test_the_gaze_lies_where_the_eyes_look(home, gaze, expected):
    eye = Eye(np.eye(4), -1.2, 0.8, -0.9, 1.1)
    found = gaze_in(eye.camera(home, 100), home, eye, gaze)
    assert (found.x, found.y) == pytest.approx(expected)


def test_without_tracking_it_follows_the_head(home):
    eye = Eye(turned_by("y", 40), -1, 1, -1, 1)
    found = gaze_in(eye.camera(home, 100), home, eye, None)
    assert (found.x, found.y) == pytest.approx((0.5, 0.5))


class TestSession:
    """Frames along a recorded session."""

    def test_each_eye_sees_what_its_camera_would(self, source):
        headset = Recorded()
        meter, size = show_in_headset(headset, source, INTERACTIVE, 48)
        assert size == (45, 48)
        assert len(meter.intervals) == 1
        for eyes, images in zip(SESSION, headset.shown, strict=True):
            for numbers, image in zip(eyes, images, strict=True):
                camera = eye_of(numbers).camera(levelled(source.camera), 48)
                alone = SceneSource(source.renderer)
                alone.forget()
                display = display_of(camera, INTERACTIVE.display.luminance)
                asked = replace(INTERACTIVE, camera=camera, display=display)
                expected = alone.show(Request(asked), quick=True).image.astype(float)
                assert np.abs(image - expected).mean() < 4
        left, right = headset.shown[0]
        assert np.abs(left.astype(float) - right).mean() > 1

    def test_it_ends_after_some_seconds(self, source):
        headset = Recorded()
        show_in_headset(headset, source, INTERACTIVE, 32, seconds=0.0)
        assert len(headset.shown) == 1

    def test_the_disc_is_where_the_eyes_look(self, source, monkeypatch):
        asked: list[Request] = []
        show = SceneSource.show

        def noting(self, request, quick):
            asked.append(request)
            return show(self, request, quick)

        monkeypatch.setattr(SceneSource, "show", noting)
        show_in_headset(Recorded(turned_by("y", 20)), source, INTERACTIVE, 32, Playback(1.0))
        first, other = asked[:2]
        assert first.settings.gaze.x < 0.35
        assert first.settings.gaze.y == pytest.approx(0.5)
        assert other.settings.gaze == first.settings.gaze
        assert other.settings.camera != first.settings.camera


@pytest.mark.parametrize(
    "more", [["--browser"], ["--target", "30"], ["--simulate"], ["--latency", "10"], ["--port", "8000"]]
)
def test_what_says_nothing_of_a_headset_is_refused(monkeypatch, capsys, own_home, more):
    assert run(monkeypatch, "demo", "cornell", "--xr", *more) == 2
    assert f"--xr: leave out {more[0]}" in capsys.readouterr().err


def test_what_is_missing_is_said_in_a_line(monkeypatch, capsys, own_home, made, tmp_path):
    """The package, a runtime or a headset: one of them, where this is tested."""
    monkeypatch.setenv("XR_RUNTIME_JSON", str(tmp_path / "none.json"))
    assert run(monkeypatch, "demo", "cornell", "--xr", "--forest", made / "box.forest") == 2
    (line,) = [one for one in capsys.readouterr().err.splitlines() if "--xr" in one]
    assert "--xr: " in line


class TestOpenXR:
    """With the runtime of this machine, if there is one."""

    @pytest.fixture
    def headset(self):
        reason = "no OpenXR here: requires pyopenxr, and a runtime"
        openxr = pytest.importorskip("hybrid.window.openxr_headset", reason=reason, exc_type=ImportError)
        try:
            with openxr.OpenXRHeadset() as entered:
                yield entered
        except UserError as error:
            pytest.skip(str(error))

    def test_images_arrive_as_they_are(self, headset):
        from OpenGL import GL

        rows, columns = np.mgrid[:48, :64]
        image = np.stack([rows * 5, columns * 3, 255 - rows * 4], axis=2).astype(np.uint8)
        found = []
        draw = headset._target.draw

        def reading(image: np.ndarray, width: int, height: int) -> None:
            draw(image, width, height)
            GL.glBindFramebuffer(GL.GL_READ_FRAMEBUFFER, GL.glGetIntegerv(GL.GL_DRAW_FRAMEBUFFER_BINDING))
            kind = GL.glGetFramebufferAttachmentParameteriv(
                GL.GL_READ_FRAMEBUFFER,
                GL.GL_COLOR_ATTACHMENT0,
                GL.GL_FRAMEBUFFER_ATTACHMENT_COLOR_ENCODING,
            )
            pixels = GL.glReadPixels(0, 0, width, height, GL.GL_RGB, GL.GL_FLOAT)
            found.append((kind == GL.GL_SRGB, np.asarray(pixels).reshape(height, width, 3)[::-1]))

        headset._target.draw = reading
        for number, frame in enumerate(headset.frames()):
            assert len(frame.eyes) == 2
            assert frame.eyes[0].left < 0 < frame.eyes[0].right
            frame.show([image, image])
            if number == 3:
                break
        assert len(found) == 8
        for is_srgb, pixels in found:
            height, width = pixels.shape[:2]
            # At a corner, away from what the scaling blends.
            for row, column in ((4, 6), (40, 50)):
                got = pixels[int((row + 0.5) * height / 48), int((column + 0.5) * width / 64)]
                value = image[row, column] / 255
                expected = value if is_srgb else radiance_from_srgb(value)
                np.testing.assert_allclose(got, expected, atol=0.03)

    def test_a_scene_is_shown(self, headset, source):
        meter, size = show_in_headset(headset, source, INTERACTIVE, 64, seconds=1.0)
        assert size[1] == 64
        assert meter.intervals
