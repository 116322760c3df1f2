"""Measures what half-precision albedo and normals in captured frames cost.

`python -m tests.properties.half_precision [SCENE ...] [--size N] [--json FILE]` prints a table.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import OpenEXR
from numpy.typing import NDArray

import splat
from compose.camera.camera import Camera
from compose.fusion.parents import Parents
from hybrid.base.compute_device import device_arrays
from pathtrace.dataset.captured_frames import CapturedFrame, read_frame, render_frame, write_frame
from pathtrace.scene.backend import select_backend
from pathtrace.scene.scene import Scene, load_scene
from pathtrace.trace.film import frame_positions, interleaved
from pathtrace.trace.traced_images import denoise
from pathtrace.trace.tracer import Tracer
from splat.model.gaussians import Gaussians
from splat.training.initialization import seed_from_views
from splat.training.training_view import TrainingView
from tests.properties.fused_images import fused_image
from tests.properties.rounding import distribution, markdown

_SEED = 3
_SPP = 4
_SEEDS_OF_SPLATS = 3000


def halved(image: NDArray[np.float32]) -> NDArray[np.float32]:
    """What is left of an image in 16-bit floats."""
    return image.astype(np.float16).astype(np.float32)


def normal_errors(normal: NDArray[np.float32]) -> NDArray[np.float64]:
    """(P,) angles in degrees between normals (H, W, 3) and themselves in 16 bits, where there are any."""
    exact, rounded = (image.reshape(-1, 3).astype(np.float64) for image in (normal, halved(normal)))
    there = np.linalg.norm(exact, axis=1) > 1e-3
    sine = np.linalg.norm(np.cross(exact[there], rounded[there]), axis=1)
    return np.degrees(np.arctan2(sine, (exact[there] * rounded[there]).sum(axis=1)))


def size_in_full(path: Path) -> int:
    """Bytes of a frame's file if all of its channels had 32 bits."""
    channels = OpenEXR.File(str(path), separate_channels=True).channels()
    wide = {
        name: channel.pixels.astype(np.float32) if channel.pixels.dtype == np.float16 else channel.pixels
        for name, channel in channels.items()
    }
    target = path.with_suffix(".full.exr")
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, wide).write(str(target))
    return target.stat().st_size


def seeds(camera: Camera, frame: CapturedFrame, normal: NDArray[np.float32]) -> Gaussians:
    """The Gaussians that training would begin with."""
    view = TrainingView(camera, frame.radiance, frame.unfolded, normal)
    return seed_from_views([view], _SEEDS_OF_SPLATS, 0, np.random.default_rng(0)).gaussians


def relative(found: NDArray[np.float32], expected: NDArray[np.float32]) -> NDArray[np.float64]:
    """(P,) largest difference of a pixel's channels, relative to its radiance where that is above 1."""
    difference = np.abs(found.astype(np.float64) - expected) / np.maximum(1, expected)
    return difference.max(axis=-1).ravel()


def fused(
    scene: Scene, frame: CapturedFrame, splats: NDArray[np.float32], halves: bool
) -> tuple[NDArray, NDArray]:
    """Denoised and fused radiance (H, W, 3) of a few samples, with auxiliary features of 16 bits or not."""
    camera, shape = scene.camera, frame.radiance.shape
    traced, features = Tracer(scene).trace_with_features(camera, frame_positions(camera), _SPP, _SEED)
    image = lambda rows: interleaved(rows).reshape(shape)  # noqa: E731
    radiance, squares = image(traced.radiance), image(traced.squares)
    albedo, normal = image(features.albedo), image(features.normal)
    if halves:
        albedo, normal = halved(albedo), halved(normal)
    variance = np.maximum(squares - radiance**2, 0) / (_SPP - 1)
    count = np.full((*shape[:2], 1), _SPP, dtype=np.float32)
    denoised = denoise(radiance, albedo, normal)
    images = {"traced": radiance, "variance": variance, "splat": splats, "albedo": albedo, "count": count}
    parents = Parents.of_images(device_arrays(), {**images, "earlier": 0 * count, "denoised": denoised})
    return denoised, fused_image(parents)


def measured(name: str, size: int) -> list[dict[str, object]]:
    """The rows of one scene."""
    scene = load_scene(name)
    scene = replace(scene, camera=scene.camera.resized(size, size))
    camera = scene.camera
    frame = render_frame(Tracer(scene), camera, 32, _SEED)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "frame.exr"
        write_frame(path, frame)
        sizes = path.stat().st_size, size_in_full(path)
        read = read_frame(path)
    assert np.array_equal(read.normal, halved(frame.normal))
    begun = [seeds(camera, frame, normal) for normal in (frame.normal, read.normal)]
    splats = [splat.render(gaussians, camera).numpy() for gaussians in begun]
    (denoised, both), (denoised_half, both_half) = (fused(scene, frame, splats[0], h) for h in (False, True))
    errors = {
        "normals, degrees": normal_errors(frame.normal),
        "albedo": np.abs(read.albedo.astype(np.float64) - frame.albedo).max(axis=-1).ravel(),
        "image of the splats that training begins with": relative(splats[1], splats[0]),
        f"denoised fovea, {_SPP} samples": relative(denoised_half, denoised),
        f"fused fovea, {_SPP} samples": relative(both_half, both),
    }
    rows: list[dict[str, object]] = [
        {"scene": name, "error of": what} | distribution(values) for what, values in errors.items()
    ]
    ratio = sizes[1] / sizes[0]
    print(f"{name}: {size} x {size} px, {sizes[0]} bytes; with 32 bits {sizes[1]}: {ratio:.2f} times")
    return rows


def main() -> None:
    """Measures and prints."""
    parser = argparse.ArgumentParser(description="half-precision albedo and normals against single precision")
    parser.add_argument("scenes", nargs="*", default=["cornell", "room"])
    parser.add_argument("--size", type=int, default=192, help="width and height of the frames")
    parser.add_argument("--json", type=Path, help="write the table there as well")
    options = parser.parse_args()
    select_backend()
    rows = [row for name in options.scenes for row in measured(name, options.size)]
    print(f"\n{markdown(rows)}")
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
