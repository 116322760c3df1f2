"""The rasterizer alone, on random Gaussians; and what each acuity model saves in the periphery, and costs."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import drjit as dr
import numpy as np

from compose.base.arrays import Arrays
from compose.camera.camera import Camera
from compose.eye.acuity import ACUITY_MODELS
from compose.eye.display import Display
from compose.eye.gaze import Gaze
from hybrid.base.compute_device import device_arrays
from hybrid.base.progress import Steps
from hybrid.measure.frame_times import percentiles
from hybrid.measure.image_metrics import ssim
from hybrid.measure.perceptual_metrics import jod
from hybrid.render.frame_settings import FrameSettings
from hybrid.render.periphery import Periphery
from splat.lod.layer_images import SplatImage
from splat.model.forest import Forest
from splat.raster.binning import Candidates
from splat.raster.blending import gradients_from_sums
from splat.raster.blocks import CHANNELS
from splat.raster.parts import Parts, rasterize_parts, sums_of_parts
from splat.raster.projection import Splats
from splat.raster.tiles import TileGrid


def bench_raster(
    gaussians: int, size: tuple[int, int], seed: int, repeats: int, warm_up: int, progress: Steps
) -> dict[str, Any]:
    """Times of binning and blending (forward) and of the gradient (backward), with all data on the device.

    The same seed gives the same splats. Returns the arguments, percentiles forward_ms and backward_ms, and
    pairs of splats and tiles.
    """
    arrays, (width, height), rng = device_arrays(), size, np.random.default_rng(seed)
    splats = random_splats(arrays, gaussians, width, height, rng)
    grid = TileGrid(width, height)
    # Of the loss by the padded image.
    values = rng.normal(size=grid.padded_width * grid.padded_height * CHANNELS)
    gradient = arrays.plain.Float(values.astype(np.float32))
    dr.eval(gradient)
    forward, backward = [], []
    for step in range(-warm_up, repeats):
        start = time.perf_counter()
        parts = Parts(Candidates.of(arrays, splats, grid))
        (image,) = rasterize_parts(arrays, parts)
        dr.sync_thread()
        middle = time.perf_counter()
        dr.eval(gradients_from_sums(splats, sums_of_parts(arrays, parts, image, gradient)))
        dr.sync_thread()
        if step >= 0:
            forward.append((middle - start) * 1000)
            backward.append((time.perf_counter() - middle) * 1000)
        progress(step + warm_up + 1, warm_up + repeats)
    return {
        "gaussians": gaussians,
        "width": width,
        "height": height,
        "pairs": sum(bins.pairs for bins in parts),
        "forward_ms": percentiles(forward),
        "backward_ms": percentiles(backward),
        "repeats": repeats,
    }


def random_splats(arrays: Arrays, count: int, width: int, height: int, rng: np.random.Generator) -> Splats:
    """Splats in random positions, of random sizes and colours.

    Means are uniform over the frame, standard deviations 0.5 px + lognormal(0.7, 0.6), opacities uniform in
    0.05..0.99, depths uniform in 1..10.
    """
    x, y = rng.uniform(0, width, count), rng.uniform(0, height, count)
    sd = 0.5 + rng.lognormal(0.7, 0.6, (2, count))
    turn = rng.uniform(0, np.pi, count)  # of the longer axis
    opacity, colour = rng.uniform(0.05, 0.99, count), rng.uniform(0, 1, (3, count))
    depth = rng.uniform(1, 10, count)
    cosine, sine, (a, b) = np.cos(turn), np.sin(turn), 1 / sd**2
    # Entries of the inverse covariance, whose determinant is a b.
    xx, xy = cosine**2 * a + sine**2 * b, cosine * sine * (a - b)
    values = (x, y, xx, xy / xx, a * b / xx, opacity, *colour, depth)
    splats = Splats(*(arrays.plain.Float(v.astype(np.float32)) for v in values))
    dr.eval(splats.__dict__)
    return splats


GAZES = (Gaze(0.5, 0.5), Gaze(0.2, 0.2))
# The acuity model that the others are compared with: full level and rate everywhere.
FULL = "none"
# Units of the scene that the camera moves per pass: enough to make it another camera, too little to see.
_STEP = 1e-4
# Milliseconds of each pass by acuity model.
Times = dict[str, list[float]]


def display_camera(scene_camera: Camera, display: Display) -> Camera:
    """The scene's own view on a display: its pose, with the display's size and field of view."""
    eye = display.viewer(display.width, display.height)
    return replace(eye, world_to_camera=scene_camera.world_to_camera)


def bench_periphery(
    forest: Forest, camera: Camera, settings: FrameSettings, repeats: int, warm_up: int, progress: Steps
) -> list[dict[str, Any]]:
    """One row per gaze and acuity model, whose passes are interleaved with those at full level and rate.

    A pass is everything from the gaze to the composited image of what lies outside fov-b. Footprints and
    saliency are kept as in the window. Rows have percentiles of periphery_ms and full_ms, with a still
    camera, and of moving_ms and moving_full_ms, with another camera in each pass; their ratios (full over
    periphery); and jod and ssim against a frame that differs only in having a full periphery.
    """
    models = [replace(settings, acuity_model=name) for name in ACUITY_MODELS]
    # One per model, so that none reuses what another one has kept.
    peripheries = [Periphery(device_arrays(), forest) for _ in models]
    turns = range(-warm_up, repeats)
    rows: list[dict[str, Any]] = []
    for number, gaze in enumerate(GAZES):
        at_gaze = [replace(model, gaze=gaze) for model in models]
        kinds: list[Times] = []
        for moving in (True, False):
            times: Times = {name: [] for name in ACUITY_MODELS}
            for turn in turns:
                view = camera.moved_right(turn * _STEP) if moving else camera
                drawn: dict[str, SplatImage] = {}
                for periphery, one in zip(peripheries, at_gaze, strict=True):
                    region = one.foveation.region(view.width, view.height)
                    start, name = time.perf_counter(), one.acuity_model
                    drawn[name] = periphery.draw(view, periphery.detail(view, one, moving), region)
                    dr.sync_thread()
                    if turn >= 0:
                        times[name].append((time.perf_counter() - start) * 1000)
                done = (2 * number + len(kinds)) * len(turns) + turn + warm_up + 1
                progress(done, 2 * len(GAZES) * len(turns))
            kinds.append(times)
        common = {"fov_b": settings.fov_b, "repeats": repeats, "layers": list(forest.counts)}
        rows += [{**row, **common} for row in _rows(at_gaze, camera, drawn, *kinds)]
    return rows


def _rows(
    models: Sequence[FrameSettings], camera: Camera, drawn: dict[str, SplatImage], moving: Times, still: Times
) -> list[dict[str, Any]]:
    """Compares each periphery with that at full level and rate: its quality, and the times of passes."""
    full = drawn[FULL].numpy().copy()
    rows = []
    for settings in models:
        name, gaze = settings.acuity_model, settings.gaze
        fovea = settings.foveation.region(camera.width, camera.height).weight_image()[..., None]
        image = drawn[name].numpy() * (1 - fovea) + full * fovea
        rows.append(
            {
                "acuity_model": name,
                "gaze": [gaze.x, gaze.y],
                "width": camera.width,
                "height": camera.height,
                "nodes_drawn": drawn[name].nodes,
                "jod": jod(image, full, settings.display, gaze),
                "ssim": ssim(image, full),
                "periphery_ms": percentiles(still[name]),
                "full_ms": percentiles(still[FULL]),
                "ratio": float(np.median(still[FULL]) / np.median(still[name])),
                "moving_ms": percentiles(moving[name]),
                "moving_full_ms": percentiles(moving[FULL]),
                "moving_ratio": float(np.median(moving[FULL]) / np.median(moving[name])),
            }
        )
    return rows
