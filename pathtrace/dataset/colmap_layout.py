"""Data sets of COLMAP: a folder with images and a sparse model, read as posed images, and written.

images/          images, also in folders; where there is no such folder, beside the model's own
sparse/0/        the model; else in sparse/, or in the folder itself
  test.txt       names of held-out images, as 3D Gaussian splatting has them (Kerbl et al. 2023)
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image as PillowImage

from compose.base.errors import UserError, file_inside, one_line, reading
from compose.base.files import require_size_below, whole_folder, write_whole
from compose.camera.camera import Array, Camera
from compose.image.colour import bytes_from_radiance
from pathtrace.dataset.captured_frames import read_frame
from pathtrace.dataset.colmap_model import (
    MODELS,
    ColmapModel,
    ModelCamera,
    ModelImage,
    ModelPoints,
    has_model,
    read_model,
    write_model,
)
from pathtrace.dataset.frame_set import FrameEntry, FrameSet
from pathtrace.dataset.posed_images import HELD_OUT_EVERY, Lens, PosedImage, read_size

LAYOUT = "COLMAP"
_MODEL_FOLDER = "sparse"
_PLACES = f"{_MODEL_FOLDER}/0", _MODEL_FOLDER, "."
_IMAGES, _HELD_OUT = "images", "test.txt"
_PERSPECTIVE = "SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "FULL_OPENCV"
# By how many pixels an image may differ from a smaller copy of what its camera says: programs round.
_ROUNDING = 2
_MOST_NAMES = 1 << 26
# Of missing images, so many are named.
_MOST_NAMED = 3
# Of all points that are written: about as many as COLMAP finds in a few hundred photographs.
_MOST_POINTS = 100_000


def model_of(folder: Path) -> Path | None:
    """Where the model of a data set lies; None if it has none."""
    return next((folder / place for place in _PLACES if has_model(folder / place)), None)


def read_colmap(folder: Path, model: Path) -> tuple[list[PosedImage], Array]:
    """The images of a data set in the order of their names, and points (M, 3) that they show.

    UserError if images are missing, a file is damaged, or a camera is not a perspective one.
    """
    found = read_model(model)
    root = folder / _IMAGES if (folder / _IMAGES).is_dir() else folder
    shots = sorted(found.images, key=lambda image: image.name)
    try:
        files = [file_inside(root, image.name) for image in shots]
    except ValueError as error:
        raise UserError(f"{model}: {error}") from error
    if missing := [str(file.relative_to(root)) for file in files if not file.is_file()]:
        named = ", ".join(missing[:_MOST_NAMED]) + (", ..." if len(missing) > _MOST_NAMED else "")
        raise UserError(f"{root}: {len(missing):,} of {len(files):,} images are missing: {one_line(named)}")
    names, path = [image.name for image in shots], model / _HELD_OUT
    held_out = set(names[::HELD_OUT_EVERY] if len(names) > HELD_OUT_EVERY else [])
    if path.is_file():
        with reading(path):
            require_size_below(path, _MOST_NAMES)
            held_out = {line.strip() for line in path.read_text(encoding="utf-8-sig").splitlines()}
    images = []
    for image, file in zip(shots, files, strict=True):
        if image.camera not in found.cameras:
            raise UserError(f"{model}: {one_line(image.name)} has camera {image.camera}, which is missing")
        try:
            camera, lens = _view(found.cameras[image.camera], image.world_to_camera, read_size(file))
        except (ValueError, OverflowError) as error:
            raise UserError(f"{model}: {one_line(image.name)}: {one_line(error)}") from error
        images.append(PosedImage(camera, lens, file, None, 0.0, image.name in held_out))
    return images, found.points


def _view(camera: ModelCamera, pose: Array, size: tuple[int, int]) -> tuple[Camera, Lens | None]:
    """The camera of an image of a size, and its lens if that distorts."""
    if camera.model not in _PERSPECTIVE:
        raise ValueError(
            f"its camera is of model {camera.model}; must be one of {', '.join(_PERSPECTIVE)}: undistort the "
            "images first (colmap image_undistorter)"
        )
    if not (min(camera.width, camera.height) > 0 and np.isfinite(camera.parameters).all()):
        raise ValueError("its camera has a size of 0, or a number that is not finite")
    # Images may be smaller copies of those that were calibrated.
    across, down = size[0] / camera.width, size[1] / camera.height
    if abs(across - down) * max(camera.width, camera.height) > _ROUNDING:
        raise ValueError(
            f"has {size[0]} x {size[1]} pixels; its camera has {camera.width} x {camera.height}, "
            "of another shape"
        )
    of = dict(zip(MODELS[camera.model], camera.parameters, strict=True))
    number = lambda name: of.get(name, 0.0)  # noqa: E731
    focal = of.get("fx", number("f")), of.get("fy", number("f"))
    intrinsics = focal[0] * across, focal[1] * down, of["cx"] * across, of["cy"] * down
    k1, k2, k3, k4, k5, k6 = (number(f"k{i}") for i in range(1, 7))
    lens = Lens((k1, k2, k3), (number("p1"), number("p2")), divisor=(k4, k5, k6))
    return Camera(pose, *size, *intrinsics), None if lens == Lens() else lens


def write_colmap(found: FrameSet, folder: Path) -> tuple[int, int]:
    """Writes the frames of a frame set as a data set; how many images and points it has.

    Images are PNG files of 8 bits in sRGB, clipped; points are what pixels of a regular grid show first.
    UserError if the folder is not empty, a frame is damaged, the scene moves, or a file cannot be written.
    """
    if len({entry.time for entry in found.entries}) > 1:
        raise UserError(f"{found.folder}: its frames show several times, which COLMAP's format does not have")
    # The step of a grid of pixels, of which all frames together have at most as many as there may be.
    stride, sizes = 1, [entry.size for entry in found.entries]
    while sum(-(-width // stride) * -(-height // stride) for width, height in sizes) > _MOST_POINTS:
        stride += 1
    names = [f"{number:0{len(str(len(found.entries))) + 3}d}.png" for number in range(len(found.entries))]
    cameras: dict[ModelCamera, int] = {}
    images, seen = [], []
    with whole_folder(folder, _MODEL_FOLDER) as part:
        for number, (name, entry) in enumerate(zip(names, found.entries, strict=True)):
            view = entry.camera
            lens = ModelCamera("PINHOLE", view.width, view.height, (view.fx, view.fy, view.cx, view.cy))
            images.append(ModelImage(name, cameras.setdefault(lens, len(cameras) + 1), view.world_to_camera))
            seen.append(_write_image(part / _IMAGES / name, entry, number, stride))
        points = ModelPoints(*(np.concatenate([getattr(s, name) for s in seen]) for name in vars(seen[0])))
        held_out = "".join(f"{n}\n" for n, e in zip(names, found.entries, strict=True) if e.held_out)
        model = part / _PLACES[0]
        write_whole(model / _HELD_OUT, lambda path: path.write_text(held_out, encoding="utf-8"))
        write_model(
            model, ColmapModel({number: camera for camera, number in cameras.items()}, images), points
        )
    return len(images), len(points.positions)


def _write_image(path: Path, entry: FrameEntry, number: int, stride: int) -> ModelPoints:
    """Writes a frame as a picture; the points that pixels of a grid show in it, which is image `number`."""
    frame, camera = read_frame(entry.file, entry.size), entry.camera
    colours = bytes_from_radiance(frame.radiance)
    write_whole(path, lambda part: PillowImage.fromarray(colours).save(part, format="PNG"))
    grid = slice(stride // 2, None, stride)
    depth = frame.depth[grid, grid].ravel().astype(np.float64)
    hit = np.isfinite(depth)
    pixels = camera.pixel_centres().reshape(camera.height, camera.width, 2)[grid, grid].reshape(-1, 2)[hit]
    rays = camera.rays(pixels)
    distance = depth[hit] / (rays @ camera.camera_to_world[:3, 2])
    return ModelPoints(
        camera.position + rays * distance[:, None],
        colours[grid, grid].reshape(-1, 3)[hit],
        np.full(len(pixels), number),
        pixels,
    )
