"""Reads folders of posed images in several layouts, which it recognizes.

That of NeRF's synthetic scenes, and of D-NeRF: transforms_train.json and transforms_test.json. Frames are
`file_path` (of synthetic scenes without .png), `transform_matrix` (camera to world in OpenGL axes) and, of
scenes that move, `time`; `camera_angle_x` is the horizontal field of view in radians (Mildenhall et al. 2020;
Pumarola et al. 2021). Focal lengths `fl_x` and `fl_y`, principal point `cx` and `cy`, and distortion k1, k2,
k3, p1, p2, in pixels of images of `w` by `h`, are those of instant-ngp; frames may have their own.

That of nerfstudio and instant-ngp: one transforms.json of that kind, which may say which frames are held out
(`test_filenames`, else `val_filenames`).

That of Nerfies, HyperNeRF (Park et al. 2021) and NeRF-DS (Yan et al. 2023), which adds labels:

dataset.json     train_ids, val_ids
metadata.json    by id: time_id, or warp_id in older folders
scene.json       scale and center: a point p of the cameras lies at (p - center) scale; near and far, scaled
camera/ID.json   orientation (rows are the axes x right, y down, z forward), position, and the lens
rgb/1x/ID.png    images, also at 1/2, 1/4 ... of their size: 2x, 4x ...
mask/1x/ID.png   label images: what is not 0 moves; named ID.png.png, masks of COLMAP: what is dark moves
points.npy       some points that the images show

That of COLMAP's data sets is in `colmap_layout`.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compose.base.errors import UserError, file_inside, one_line, reading, scene_name
from compose.base.files import read_json, require_size_below
from compose.camera.camera import Camera, camera_from_pose
from compose.camera.coordinate_systems import opencv_from_opengl
from pathtrace.dataset.colmap_layout import LAYOUT as COLMAP
from pathtrace.dataset.colmap_layout import model_of, read_colmap
from pathtrace.dataset.frame_set import time_of
from pathtrace.dataset.posed_images import HELD_OUT_EVERY, Lens, PosedFolder, PosedImage, read_size

# Name of a scene whose folder has one that no scene can have.
_UNNAMED = "frames"
SYNTHETIC = "NeRF-synthetic or D-NeRF"
TRAINING = "transforms_train.json"
# Held out are test images; of a folder without any, those for validation.
_HELD_OUT = "transforms_test.json", "transforms_val.json"
NERFSTUDIO = "nerfstudio or instant-ngp"
TRANSFORMS = "transforms.json"
_IMAGES = ".png", ".jpg", ".jpeg"
# Lenses without distortion, or with that of OpenCV; others are refused.
_LENSES = "OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL"
NERFIES = "Nerfies, HyperNeRF or NeRF-DS"
DATASET = "dataset.json"
_SCALES = (1, 2, 4, 8, 16)
# Of several sizes, the largest images are read that have at most so many pixels each, as those have that
# HyperNeRF's figures are of, and so many in all: a training keeps them in memory.
_MOST_PIXELS, _MOST_IN_ALL = 1 << 20, 1 << 26
_LABEL_FOLDERS = "mask", "resized_mask"
_POINTS = "points.npy"
_MOST_BYTES = 1 << 30
# By how many pixels images may differ from the size that their camera says: folders round differently.
_ROUNDING = 2


def is_posed_folder(folder: Path) -> bool:
    """Whether a folder has one of the layouts that can be read."""
    described = (folder / TRAINING).is_file() or (folder / DATASET).is_file()
    return described or _nerfstudio(folder) is not None or model_of(folder) is not None


def _nerfstudio(folder: Path) -> dict[str, Any] | None:
    """The folder's only description; None if there is none, or it is one of this project's own frame sets."""
    try:
        content = read_json(folder / TRANSFORMS)
    except (OSError, ValueError):
        return None
    is_own = not isinstance(content, dict) or "frames" not in content or "format_version" in content
    return None if is_own else content


def read_posed_folder(folder: Path) -> PosedFolder:
    """Reads a folder of posed images, but not their pixels.

    UserError if the layout is unknown, there is no training image, or a file is missing or damaged.
    """
    points = bounds = None
    if (folder / TRAINING).is_file():
        layout, images = SYNTHETIC, read_synthetic(folder)
    elif (folder / DATASET).is_file():
        layout = NERFIES
        images, points, bounds = read_nerfies(folder)
    elif (content := _nerfstudio(folder)) is not None:
        layout, images = NERFSTUDIO, read_nerfstudio(folder, content)
    elif (model := model_of(folder)) is not None:
        layout = COLMAP
        images, points = read_colmap(folder, model)
    else:
        raise UserError(
            f"{folder}: unknown layout; must be that of {SYNTHETIC} ({TRAINING}), of {NERFSTUDIO} "
            f"({TRANSFORMS}), of {NERFIES} ({DATASET}) or of {COLMAP} (sparse/0/cameras.bin)"
        )
    if all(image.held_out for image in images):
        raise UserError(f"{folder}: holds no frames to train on")
    name = scene_name(folder.resolve().name, _UNNAMED)
    return PosedFolder(folder, layout, name, _hash(images), images, points, bounds)


def _hash(images: list[PosedImage]) -> str:
    state = hashlib.sha256()
    for image in images:
        state.update(repr((image.camera.key, image.lens, image.time, image.held_out)).encode())
        for file in (image.file, image.labels):
            if file is not None:
                with reading(file):
                    require_size_below(file, _MOST_BYTES)
                    state.update(hashlib.sha256(file.read_bytes()).digest())
    return state.hexdigest()


def document(path: Path) -> dict[str, Any]:
    """The content of a JSON file; UserError if it is missing, cannot be read, or is no JSON."""
    try:
        return read_json(path)
    except FileNotFoundError as error:
        raise UserError(f"{path}: this file is missing") from error
    except (OSError, ValueError) as error:
        raise UserError(f"{path}: not a JSON file that can be read ({one_line(error)})") from error


@contextmanager
def described_by(path: Path, what: str = "") -> Iterator[None]:
    """Says of a mistake in a file's content which file it is in, and of what, such as "frame 3"."""
    try:
        yield
    except KeyError as error:
        raise UserError(f"{path}: {what or 'it'} has no {one_line(error)}") from error
    except (ValueError, TypeError, LookupError, AttributeError, OverflowError) as error:
        raise UserError(f"{path}: {what + ': ' if what else ''}{one_line(error)}") from error


def read_synthetic(folder: Path) -> list[PosedImage]:
    """The images of a folder, training ones first; UserError if a file is damaged or values make no view."""
    images = _frames(folder / TRAINING, document(folder / TRAINING), False)
    for name in _HELD_OUT:
        if (folder / name).is_file():
            return images + _frames(folder / name, document(folder / name), True)
    return images


def read_nerfstudio(folder: Path, content: dict[str, Any]) -> list[PosedImage]:
    """The images of a folder in the order of its description; UserError as in `read_synthetic`."""
    images = _frames(folder / TRANSFORMS, content, False)
    with described_by(folder / TRANSFORMS):
        if named := content.get("test_filenames") or content.get("val_filenames"):
            chosen = {_image_file(folder, name) for name in named}
            return [replace(image, held_out=image.file in chosen) for image in images]
    if len(images) <= HELD_OUT_EVERY:
        return images
    return [replace(image, held_out=number % HELD_OUT_EVERY == 0) for number, image in enumerate(images)]


def _frames(path: Path, content: dict[str, Any], held_out: bool) -> list[PosedImage]:
    with described_by(path):
        frames = list(content["frames"])
    found = []
    for number, frame in enumerate(frames):
        with described_by(path, f"frame {number}"):
            file = _image_file(path.parent, frame["file_path"])
            camera, lens = _camera({**content, **frame}, read_size(file))
            found.append(PosedImage(camera, lens, file, None, time_of(frame), held_out))
    return found


def _image_file(folder: Path, name: object) -> Path:
    """The image of a frame: as it is named, or of the first kind that there is if only the stem is named."""
    file = file_inside(folder, name.replace("\\", "/") if isinstance(name, str) else name)
    if file.suffix.lower() in _IMAGES:
        return file
    kinds = [file.with_name(file.name + suffix) for suffix in _IMAGES]
    return next((kind for kind in kinds if kind.is_file()), kinds[0])


def _camera(values: dict[str, Any], size: tuple[int, int]) -> tuple[Camera, Lens | None]:
    """The camera of an image of a size, and its lens if that distorts, by what the file says of it."""
    pose = np.asarray(values["transform_matrix"], dtype=np.float64)
    if pose.shape != (4, 4) or not np.isfinite(pose).all():
        raise ValueError("transform_matrix must be 4 x 4 finite numbers")
    model = values.get("camera_model", _LENSES[0])
    if model not in _LENSES or values.get("is_fisheye"):
        raise ValueError(
            f"camera_model {model}: must be one of {', '.join(_LENSES)}; undistort the images first"
        )
    number = lambda name, default: float(values.get(name, default) or 0)  # noqa: E731
    width, height = number("w", size[0]), number("h", size[1])
    if "fl_x" in values:
        focal = number("fl_x", 0), number("fl_y", values["fl_x"])
    else:
        across = _focal(values, "camera_angle_x", width)
        has_other = "camera_angle_y" in values
        focal = across, _focal(values, "camera_angle_y", height) if has_other else across
    centre = number("cx", width / 2), number("cy", height / 2)
    coefficients = [number(name, 0) for name in ("k1", "k2", "k3", "k4", "p1", "p2")]
    if not (
        min(width, height, *focal) > 0 and np.isfinite([width, height, *focal, *centre, *coefficients]).all()
    ):
        raise ValueError("w, h, fl_x and fl_y must be positive, and all numbers of the lens finite")
    k1, k2, k3, k4, p1, p2 = coefficients
    if k4:
        raise ValueError(f"k4 {k4:g}: only k1, k2, k3, p1 and p2 are known; undistort the images first")
    # Images may be smaller copies of those that were calibrated.
    across, down = size[0] / width, size[1] / height
    intrinsics = focal[0] * across, focal[1] * down, centre[0] * across, centre[1] * down
    lens = Lens((k1, k2, k3), (p1, p2))
    return camera_from_pose(opencv_from_opengl(pose), *size, *intrinsics), None if lens == Lens() else lens


def _focal(values: dict[str, Any], name: str, side: float) -> float:
    """Focal length in pixels of a field of view in radians along a side in pixels."""
    angle = float(values[name])
    if not 0 < angle < math.pi:
        raise ValueError(f"{name} {angle:g}: must be in radians, above 0 and below pi")
    return side / 2 / math.tan(angle / 2)


def read_nerfies(
    folder: Path,
) -> tuple[list[PosedImage], NDArray[np.float64] | None, tuple[float, float] | None]:
    """Images, points (M, 3) of their cameras' coordinates, and bounds of distances; UserError if damaged."""
    content = document(folder / DATASET)
    with described_by(folder / DATASET):
        held_out = [str(name) for name in content.get("val_ids", [])]
        # What is both is held out.
        ids = [*(name for name in map(str, content["train_ids"]) if name not in held_out), *held_out]
    times = _times(folder / "metadata.json", ids)
    centre, scale, bounds = _scene(folder / "scene.json")
    level = _level(folder, ids)
    labels = _labels_folder(folder, level)
    images = []
    for name, time in zip(ids, times, strict=True):
        file = _file(folder / "rgb" / f"{level}x", name, ".png")
        path = _file(folder / "camera", name, ".json")
        size, content = read_size(file), document(path)
        with described_by(path):
            camera, lens = _nerfies_camera(content, centre, scale, level, size)
        label = None if labels is None else _label(labels, name, size)
        images.append(PosedImage(camera, lens, file, label, time, name in held_out))
    if not (folder / _POINTS).is_file():
        return images, None, bounds
    return images, (_points(folder / _POINTS) - centre) * scale, bounds


def _times(path: Path, ids: list[str]) -> list[float]:
    """The time of each image: its number over the largest one."""
    content = document(path)
    numbers = []
    for name in ids:
        with described_by(path, name):
            entry = content[name]
            numbers.append(float(entry["time_id"] if "time_id" in entry else entry["warp_id"]))
    last = max(numbers, default=0.0)
    with described_by(path):
        return [time_of({"time": number / last if last else number}) for number in numbers]


def _scene(path: Path) -> tuple[NDArray[np.float64], float, tuple[float, float] | None]:
    """Centre (3,), scale, and the bounds of distances after scaling."""
    content = document(path)
    with described_by(path):
        centre, scale = np.asarray(content["center"], dtype=np.float64), float(content["scale"])
        if centre.shape != (3,) or not np.isfinite(centre).all() or scale <= 0:
            raise ValueError("center must be three finite numbers, and scale positive")
        near, far = (content.get(name) for name in ("near", "far"))
        if near is None or far is None:
            return centre, scale, None
        if not 0 < float(near) < float(far):
            raise ValueError(f"near {near}, far {far}: must be positive, near the smaller one")
        return centre, scale, (float(near), float(far))


def _level(folder: Path, ids: list[str]) -> int:
    """By how much the images are reduced that are read; those with labels first, if there are any."""
    found = [level for level in _SCALES if (folder / "rgb" / f"{level}x").is_dir()]
    if not found:
        raise UserError(f"{folder / 'rgb'}: has no folder of images (1x, 2x, 4x, 8x or 16x)")
    found = [level for level in found if _labels_folder(folder, level) is not None] or found
    for level in found if ids else []:
        width, height = read_size(_file(folder / "rgb" / f"{level}x", ids[0], ".png"))
        if width * height <= min(_MOST_PIXELS, _MOST_IN_ALL / len(ids)):
            return level
    return found[-1]


def _labels_folder(folder: Path, level: int) -> Path | None:
    places = [folder / name / f"{level}x" for name in _LABEL_FOLDERS]
    return next((place for place in places if place.is_dir()), None)


def _label(folder: Path, name: str, size: tuple[int, int]) -> Path:
    mask = _file(folder, name, ".png.png")
    path = mask if mask.is_file() else _file(folder, name, ".png")
    (width, height), wanted = read_size(path), f"{size[0]} x {size[1]}"
    if (width, height) != size:
        raise UserError(f"{path}: {width} x {height} pixels; must be {wanted}, as of the image")
    return path


def _nerfies_camera(
    content: dict[str, Any], centre: NDArray[np.float64], scale: float, level: int, size: tuple[int, int]
) -> tuple[Camera, Lens | None]:
    """The camera of an image, and its lens if that distorts."""
    rotation = np.asarray(content["orientation"], dtype=np.float64)
    position = (np.asarray(content["position"], dtype=np.float64) - centre) * scale
    if rotation.shape != (3, 3) or position.shape != (3,):
        raise ValueError("orientation must be 3 x 3 numbers, and position three")
    full = [float(side) for side in content["image_size"]]
    if any(abs(whole / level - side) > _ROUNDING for whole, side in zip(full, size, strict=True)):
        raise ValueError(
            f"image_size {full[0]:g} x {full[1]:g}: its image at {level}x has {size[0]} x {size[1]} pixels"
        )
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, -rotation @ position
    across, down = size[0] / full[0], size[1] / full[1]
    focal, (x, y) = float(content["focal_length"]), content["principal_point"]
    aspect = float(content.get("pixel_aspect_ratio", 1.0))
    camera = Camera(pose, *size, focal * across, focal * aspect * down, float(x) * across, float(y) * down)
    # Older folders call them `tangential`.
    tangential = content.get("tangential_distortion", content.get("tangential", (0, 0)))
    k1, k2, k3 = map(float, content.get("radial_distortion", (0, 0, 0)))
    p1, p2 = map(float, tangential)
    lens = Lens((k1, k2, k3), (p1, p2), float(content.get("skew", 0.0)) * across)
    if not np.isfinite([k1, k2, k3, p1, p2, lens.skew]).all():
        raise ValueError("distortion has a number that is not finite")
    return camera, None if lens == Lens() else lens


def _points(path: Path) -> NDArray[np.float64]:
    """(M, 3) points of a NumPy file, in the coordinates of the cameras' files."""
    try:
        require_size_below(path, _MOST_BYTES)
        # Mapped: what the header declares is compared with the file's size, and not allocated.
        points = np.load(path, mmap_mode="r", allow_pickle=False)
        if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
            raise ValueError(
                f"{points.dtype} of shape {points.shape}; must be finite numbers of shape (M, 3)"
            )
        return points.astype(np.float64)
    # A damaged header is compiled as Python, which fails with nearly anything.
    except Exception as error:
        raise UserError(f"{path}: not a file of points ({one_line(error)})") from error


def _file(folder: Path, name: str, suffix: str) -> Path:
    with described_by(folder):
        return file_inside(folder, name + suffix)
