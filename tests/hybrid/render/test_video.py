"""Video files: H.264 in MP4."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from compose.base.errors import UserError
from hybrid.render.image_files import check_video, write_mp4
from tests import small

av = pytest.importorskip("av", reason="videos require PyAV")

RED, GREY = (200, 30, 40), (128, 128, 128)


def plain(*colours: tuple[int, int, int]) -> list[np.ndarray]:
    """Images of one colour each, 32 x 16."""
    return [np.full((16, 32, 3), colour, dtype=np.uint8) for colour in colours]


def test_a_video_shows_every_image_in_order_at_its_rate(tmp_path):
    write_mp4(tmp_path / "a.mp4", iter(plain(RED, RED, GREY)), (32, 16), 8)
    with av.open(str(tmp_path / "a.mp4")) as video:
        stream = video.streams.video[0]
        assert (stream.width, stream.height, float(stream.average_rate)) == (32, 16, 8)
        assert (stream.codec_context.name, stream.pix_fmt) == ("h264", "yuv420p")
        frames = [frame.to_ndarray(format="rgb24") for frame in video.decode(video=0)]
    assert len(frames) == 3
    # Colours are stored as limited-range YUV with 8 bits per channel.
    for frame, colour in zip(frames, (RED, RED, GREY), strict=True):
        np.testing.assert_allclose(frame.reshape(-1, 3).mean(axis=0), colour, atol=6)


def test_detail_and_noise_survive_encoding(tmp_path):
    y, x = np.mgrid[0:64, 0:64]
    waves = np.stack([128 + 60 * np.sin(x / 3), 128 + 60 * np.cos(y / 4), 128 + 50 * np.sin((x + y) / 5)], 2)
    noise = small.rng().normal(0, 12, (4, 64, 64, 3))
    images = np.clip(waves + noise, 0, 255).astype(np.uint8)
    write_mp4(tmp_path / "a.mp4", iter(images), (64, 64), 8)
    with av.open(str(tmp_path / "a.mp4")) as video:
        shown = np.stack([frame.to_ndarray(format="gray") for frame in video.decode(video=0)])
    error = shown - images @ [0.299, 0.587, 0.114]
    # Seen: 2.4 of 255; 6.1 at the encoder's own quality.
    assert np.sqrt(np.mean(error**2)) < 4


def test_a_video_appears_complete_or_not_at_all(tmp_path):
    def interrupted():
        yield plain(RED)[0]
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_mp4(tmp_path / "a.mp4", interrupted(), (32, 16), 8)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("size", "refused"), [((32, 16), False), ((33, 16), True), ((32, 15), True)])
def test_odd_sizes_are_refused_before_the_work(size, refused):
    if not refused:
        check_video(*size)
        return
    message = f"frame size {size[0]} x {size[1]}: width and height of a video must be even"
    with pytest.raises(UserError, match=message):
        check_video(*size)


def test_without_pyav_the_command_that_installs_it_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(UserError, match=r"videos require PyAV: pip install '.*\[demo\]'"):
        check_video(32, 16)
