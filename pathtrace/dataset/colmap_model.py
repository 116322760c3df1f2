"""Sparse models of COLMAP, binary or text: cameras, images with their poses, and points.

cameras, images and points3D are files of one folder, .bin or .txt (COLMAP's documentation, "Output format").
Poses lead from the world to the camera, whose axes are right, down and forward; pixel centres lie at +0.5.
Read here, and not by pycolmap: that is 37 MB of native code, for three files of a plain layout.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from compose.base.errors import UserError, one_line
from compose.base.files import require_size_below, write_whole
from compose.camera.camera import Array

_CAMERAS, _IMAGES, _POINTS = "cameras", "images", "points3D"
_BINARY, _TEXT = ".bin", ".txt"
# Of a file: ten million points, each seen in a hundred images.
_MOST_BYTES = 1 << 34
# What is seen where: x, y and the point's number, -1 if it is none. Of points, image and number in it.
_SEEN_BYTES, _TRACK_BYTES = 24, 8
_NAMES = [
    ("SIMPLE_PINHOLE", "f cx cy"),
    ("PINHOLE", "fx fy cx cy"),
    ("SIMPLE_RADIAL", "f cx cy k1"),
    ("RADIAL", "f cx cy k1 k2"),
    ("OPENCV", "fx fy cx cy k1 k2 p1 p2"),
    ("OPENCV_FISHEYE", "fx fy cx cy k1 k2 k3 k4"),
    ("FULL_OPENCV", "fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6"),
    ("FOV", "fx fy cx cy omega"),
    ("SIMPLE_RADIAL_FISHEYE", "f cx cy k"),
    ("RADIAL_FISHEYE", "f cx cy k1 k2"),
    ("THIN_PRISM_FISHEYE", "fx fy cx cy k1 k2 p1 p2 k3 k4 sx1 sy1"),
    ("RAD_TAN_THIN_PRISM_FISHEYE", "fx fy cx cy k0 k1 k2 k3 k4 k5 p0 p1 s0 s1 s2 s3"),
    ("SIMPLE_DIVISION", "f cx cy k"),
    ("DIVISION", "fx fy cx cy k"),
    ("SIMPLE_FISHEYE", "f cx cy"),
    ("FISHEYE", "fx fy cx cy"),
    ("EUCM", "fx fy cx cy alpha beta"),
    ("EQUIRECTANGULAR", "w h"),
]
# Parameters of each model by its name; in binary files, models have their place in this list.
_Content = TypeVar("_Content")
MODELS = {name: tuple(parameters.split()) for name, parameters in _NAMES}


@dataclass(frozen=True)
class ModelCamera:
    """A camera: the name of its model, its size in pixels, and its parameters in the order of `MODELS`."""

    model: str
    width: int
    height: int
    parameters: tuple[float, ...]


@dataclass(frozen=True)
class ModelImage:
    """An image: its file's name, the number of its camera, and (4, 4) from the world to the camera."""

    name: str
    camera: int
    world_to_camera: Array


@dataclass(frozen=True)
class ModelPoints:
    """M points, each of which is known from one image."""

    positions: Array  # (M, 3) in the world
    colours: NDArray[np.uint8]  # (M, 3) uint8, sRGB
    images: NDArray[np.int64]  # (M,) index of the image, ascending
    pixels: Array  # (M, 2) where it is seen there


@dataclass(frozen=True)
class ColmapModel:
    """What is read of a model: cameras by their number, images, and the positions (M, 3) of points."""

    cameras: dict[int, ModelCamera]
    images: list[ModelImage]
    points: Array = field(default_factory=lambda: np.zeros((0, 3)))


def has_model(folder: Path) -> bool:
    """Whether there are cameras and images of a model in a folder."""
    return _kind(folder) is not None


def _kind(folder: Path) -> str | None:
    """The ending of a model's files, binary ones before texts, as COLMAP has it."""
    kinds = (_BINARY, _TEXT)
    return next((k for k in kinds if all((folder / f"{n}{k}").is_file() for n in (_CAMERAS, _IMAGES))), None)


def read_model(folder: Path) -> ColmapModel:
    """Reads a model; its points may be missing. UserError if there is none, or a file of it is damaged."""
    kind = _kind(folder)
    if kind is None:
        raise UserError(f"{folder}: has no cameras and images of a COLMAP model (.bin or .txt)")
    is_binary = kind == _BINARY
    cameras = _read(folder / f"{_CAMERAS}{kind}", _cameras if is_binary else _text_cameras)
    images = _read(folder / f"{_IMAGES}{kind}", _images if is_binary else _text_images)
    points = folder / f"{_POINTS}{kind}"
    if not points.is_file():
        return ColmapModel(cameras, images)
    return ColmapModel(cameras, images, _read(points, _points if is_binary else _text_points))


def _read(path: Path, reader: Callable[[bytes], _Content]) -> _Content:
    try:
        require_size_below(path, _MOST_BYTES)
        return reader(path.read_bytes())
    except (OSError, ValueError, LookupError, OverflowError, struct.error) as error:
        raise UserError(f"{path}: not a file of a COLMAP model ({one_line(error)})") from error


class _Records:
    """The records of a binary file: a number of them, then one after the other."""

    def __init__(self, content: bytes):
        self._content, self._at = content, 0

    def __iter__(self) -> Iterator[None]:
        (count,) = self.take("<Q")
        for number in range(count):
            if self._at >= len(self._content):
                raise ValueError(f"ends after {number:,} of {count:,}")
            yield

    def take(self, form: str) -> tuple[Any, ...]:
        """The next numbers."""
        found = struct.unpack_from(form, self._content, self._at)
        self._at += struct.calcsize(form)
        return found

    def skip(self, size: int) -> None:
        """Leaves out so many bytes."""
        self._at += size
        if self._at > len(self._content):
            raise ValueError("ends too early")

    def text(self) -> str:
        """The text up to the next zero."""
        end = self._content.index(b"\0", self._at)
        found = self._content[self._at : end].decode()
        self._at = end + 1
        return found


def _cameras(content: bytes) -> dict[int, ModelCamera]:
    records, found = _Records(content), {}
    for _ in records:
        number, model, width, height = records.take("<IiQQ")
        if not 0 <= model < len(_NAMES):
            raise ValueError(f"camera {number} is of model {model}; 0 to {len(_NAMES) - 1} are known")
        name = _NAMES[model][0]
        found[number] = ModelCamera(name, width, height, records.take(f"<{len(MODELS[name])}d"))
    return found


def _images(content: bytes) -> list[ModelImage]:
    records, found = _Records(content), []
    for _ in records:
        _, *pose, camera = records.take("<I7dI")
        found.append(ModelImage(records.text(), camera, _world_to_camera(pose)))
        records.skip(records.take("<Q")[0] * _SEEN_BYTES)
    return found


def _points(content: bytes) -> Array:
    records, found = _Records(content), []
    for _ in records:
        found.append(records.take("<Q3d3Bd")[1:4])
        records.skip(records.take("<Q")[0] * _TRACK_BYTES)
    return _rows(found)


def _rows(points: list[tuple[float, ...]]) -> Array:
    """(M, 3) of M points; ValueError if one is not three finite numbers."""
    found = np.array(points, dtype=np.float64).reshape(len(points), 3)
    if not np.isfinite(found).all():
        raise ValueError("holds a point that is not finite")
    return found


def _lines(content: bytes) -> Iterator[str]:
    return (line for line in content.decode("utf-8-sig").splitlines() if not line.lstrip().startswith("#"))


def _text_cameras(content: bytes) -> dict[int, ModelCamera]:
    found = {}
    for line in filter(str.strip, _lines(content)):
        number, model, width, height, *parameters = line.split()
        if model not in MODELS or len(parameters) != len(MODELS[model]):
            raise ValueError(f"camera {number} is of model {model} with {len(parameters)} parameters")
        found[int(number)] = ModelCamera(model, int(width), int(height), tuple(map(float, parameters)))
    return found


def _text_images(content: bytes) -> list[ModelImage]:
    lines, found = _lines(content), []
    for line in lines:
        if line.strip():
            _, *pose, camera, name = line.split(maxsplit=9)
            found.append(ModelImage(name.strip(), int(camera), _world_to_camera(list(map(float, pose)))))
            # What is seen there, in a line that may be empty.
            next(lines, None)
    return found


def _text_points(content: bytes) -> Array:
    return _rows([tuple(map(float, line.split()[1:4])) for line in filter(str.strip, _lines(content))])


def _world_to_camera(pose: list[float]) -> Array:
    """(4, 4) of a quaternion (w, x, y, z) and a translation."""
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_quat(pose[:4], scalar_first=True).as_matrix()
    matrix[:3, 3] = pose[4:]
    return matrix


def write_model(folder: Path, model: ColmapModel, points: ModelPoints) -> None:
    """Writes a binary model of cameras and images, with points in place of its own; numbers start at 1."""
    count = len(points.positions)
    ids = np.arange(1, count + 1)
    cameras = [
        struct.pack("<IiQQ", number, list(MODELS).index(camera.model), camera.width, camera.height)
        + struct.pack(f"<{len(camera.parameters)}d", *camera.parameters)
        for number, camera in model.cameras.items()
    ]
    bounds = np.searchsorted(points.images, np.arange(len(model.images) + 1))
    images = []
    for number, image in enumerate(model.images):
        part = slice(bounds[number], bounds[number + 1])
        turn = Rotation.from_matrix(image.world_to_camera[:3, :3]).as_quat(scalar_first=True)
        pose = *turn, *image.world_to_camera[:3, 3]
        seen = np.zeros(part.stop - part.start, [("at", "<f8", 2), ("point", "<i8")])
        seen["at"], seen["point"] = points.pixels[part], ids[part]
        head = struct.pack("<I7dI", number + 1, *pose, image.camera) + image.name.encode() + b"\0"
        images.append(head + struct.pack("<Q", len(seen)) + seen.tobytes())
    table = np.zeros(count, [
        *(("id", "<u8"), ("at", "<f8", 3), ("colour", "u1", 3), ("error", "<f8"), ("views", "<u8")),
        *(("image", "<u4"), ("index", "<u4")),
    ])  # fmt: skip
    table["id"], table["at"], table["colour"], table["views"] = ids, points.positions, points.colours, 1
    table["image"], table["index"] = points.images + 1, np.arange(count) - bounds[points.images]
    for name, number, records in (
        (_POINTS, count, table.tobytes()),
        (_CAMERAS, len(cameras), b"".join(cameras)),
        (_IMAGES, len(images), b"".join(images)),
    ):
        _write(folder / f"{name}{_BINARY}", number, records)


def _write(path: Path, count: int, records: bytes) -> None:
    write_whole(path, lambda part: part.write_bytes(struct.pack("<Q", count) + records))
