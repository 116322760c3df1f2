"""EXR files of frames: channels that other programs know, and values that read back equal."""

from __future__ import annotations

import numpy as np
import OpenEXR
import pytest

from compose.base.errors import UserError
from pathtrace.dataset.captured_frames import CapturedFrame, read_frame, read_radiance, write_frame
from tests import small


@pytest.fixture
def frame() -> CapturedFrame:
    """Five rows and seven columns of values that half and single precision can hold."""
    rng = small.rng()
    return CapturedFrame(
        rng.uniform(0, 20_000, (5, 7, 3)).astype(np.float32),
        rng.uniform(size=(5, 7, 3)).astype(np.float16).astype(np.float32),
        rng.normal(size=(5, 7, 3)).astype(np.float16).astype(np.float32),
        np.where(rng.uniform(size=(5, 7)) < 0.2, np.inf, 2.5).astype(np.float32),
        rng.uniform(1, 9, (5, 7)).astype(np.float32),
        rng.integers(-1, 40, (5, 7)).astype(np.int32),
    )


def channels(path) -> dict[str, np.ndarray]:
    file = OpenEXR.File(str(path), separate_channels=True)
    return {name: channel.pixels for name, channel in file.channels().items()}


def test_a_frame_reads_back_equal(tmp_path, frame):
    write_frame(tmp_path / "f.exr", frame)
    back = read_frame(tmp_path / "f.exr")
    for name in frame.__dataclass_fields__:
        found, expected = getattr(back, name), getattr(frame, name)
        assert found.dtype == expected.dtype
        np.testing.assert_array_equal(found, expected, err_msg=name)
    assert [p.name for p in tmp_path.iterdir()] == ["f.exr"]


def test_channels_of_a_frame(tmp_path, frame):
    write_frame(tmp_path / "f.exr", frame)
    found = channels(tmp_path / "f.exr")
    assert {name: str(values.dtype) for name, values in found.items()} == {
        **dict.fromkeys(["R", "G", "B", "Z", "unfolded.V"], "float32"),
        **dict.fromkeys(["albedo.R", "albedo.G", "albedo.B"], "float16"),
        **dict.fromkeys(["normal.X", "normal.Y", "normal.Z"], "float16"),
        "shape.V": "uint32",
    }
    np.testing.assert_array_equal(found["G"], frame.radiance[..., 1])
    np.testing.assert_array_equal(found["normal.Z"], frame.normal[..., 2])
    np.testing.assert_array_equal(found["Z"], frame.depth)
    # 0 is "nothing hit".
    np.testing.assert_array_equal(found["shape.V"].astype(int) - 1, frame.shape)


def test_radiance_alone_has_no_geometry(tmp_path, frame):
    write_frame(tmp_path / "r.exr", frame.radiance)
    assert len(channels(tmp_path / "r.exr")) == 3
    np.testing.assert_array_equal(read_radiance(tmp_path / "r.exr"), frame.radiance)
    with pytest.raises(UserError, match=r"r\.exr: not a readable frame .*; capture it again"):
        read_frame(tmp_path / "r.exr")


@pytest.mark.parametrize("read", [read_frame, read_radiance])
def test_missing_and_damaged_files_are_named(tmp_path, frame, read):
    (tmp_path / "text.exr").write_bytes(b"not an image")
    write_frame(tmp_path / "cut.exr", frame)
    whole = (tmp_path / "cut.exr").read_bytes()
    (tmp_path / "cut.exr").write_bytes(whole[: len(whole) // 2])
    OpenEXR.File({}, {"R": np.zeros((2, 2), dtype=np.float32)}).write(str(tmp_path / "red.exr"))
    for name in ("text", "cut", "red", "missing"):
        with pytest.raises(UserError, match=rf"{name}\.exr: not a readable frame"):
            read(tmp_path / f"{name}.exr")


def test_a_folder_that_is_a_file_is_refused(tmp_path, frame):
    (tmp_path / "frames").write_text("")
    with pytest.raises(UserError, match="cannot be written"):
        write_frame(tmp_path / "frames" / "f.exr", frame)
