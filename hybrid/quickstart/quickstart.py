"""The main job from nothing: capture, training, a foveated frame, its reference, and the numbers."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

from compose.eye.gaze import Gaze
from compose.fovea.region import Foveation
from hybrid.frame.aovs import frame_layers
from hybrid.frame.renderer import HybridRenderer
from hybrid.measure.metrics.registration import registration_px
from hybrid.measure.metrics.similarity import quality
from hybrid.measure.reference import REFERENCE_SEED
from hybrid.output.images import write_bytes, write_layers, write_png
from hybrid.pictures.weights import weights_picture
from hybrid.quickstart.page import write_page
from hybrid.runtime.device import device_arrays
from hybrid.runtime.machine import machine
from hybrid.runtime.progress import progress_bar
from hybrid.sweeps.comparison import compare
from hybrid.training.forest import held_out_quality
from hybrid.training.quick import make_quick_forest
from pathtrace.dataset.capture import render_frame
from pathtrace.dataset.frames import read_frame_set
from pathtrace.scene.scene import Scene

# What is shown: the scene's own view.
SIZE = 512
_SPP = 4
_REFERENCE_SPP = 64
_REPEATS, _WARM_UP = 7, 2
# Of the comparison with full path tracing.
_TIMES = ("hybrid_ms", "path_traced_ms", "disc_ms", "ratio", "ceiling", "covered")


def quickstart(scene: Scene, folder: Path, fov_a: float, fov_b: float, seed: int) -> dict[str, Any]:
    """Does it all and writes pictures, result.json's content and the page.

    Args:
        scene: what to render.
        folder: where to; the frame set and the forest lie in it as well.
        fov_a, fov_b: radii in percent of the height; the gaze is in the middle. The disc must hold a pixel of
            a frame of SIZE x SIZE.
        seed: same seed, same pictures on the same machine.

    Returns:
        The content of result.json.
    """
    start = time.perf_counter()
    seconds: dict[str, float] = {}
    arrays = device_arrays()
    forest, frames_folder = make_quick_forest(scene, folder, seed, seconds)
    held_out = held_out_quality(arrays, read_frame_set(frames_folder), forest)

    before = time.perf_counter()
    camera = scene.camera.resized(SIZE, SIZE)
    renderer = HybridRenderer(scene, forest, mode="fused")
    with progress_bar("reference") as bar:
        bar(0, 1)
        reference = render_frame(renderer.tracer, camera, _REFERENCE_SPP, seed + REFERENCE_SEED).radiance
        bar(1, 1)
    with progress_bar("frames (rounds)") as bar:
        times = compare(renderer, camera, fov_a, fov_b, _SPP, _REPEATS, _WARM_UP, bar)
    frame = renderer.frame(camera, Foveation(Gaze(), fov_a, fov_b), _SPP, seed)
    whole = renderer.splat_frame(camera)
    seconds["render"] = time.perf_counter() - before

    write_layers(folder / "hybrid.exr", frame_layers(renderer, camera, Gaze(), frame))
    for name, image in (("hybrid", frame.composite), ("reference", reference), ("splat", whole)):
        write_png(folder / f"{name}.png", image)
    write_bytes(folder / "weights.png", weights_picture(frame))
    seconds["total"] = time.perf_counter() - start
    result = {
        "scene": scene.name,
        "width": camera.width,
        "height": camera.height,
        "spp": _SPP,
        "fov_a": fov_a,
        "fov_b": fov_b,
        "seconds": seconds,
        "splat": {name: held_out[-1][name] for name in ("psnr", "ssim")},
        "layers": held_out,
        "hybrid": quality(frame.composite, reference),
        **{key: times[key] for key in _TIMES},
        "gaussians": len(forest.finest),
        "reference_spp": _REFERENCE_SPP,
        "machine": machine(),
    }
    registration = registration_px(whole, reference)
    if registration is not None:
        result["registration_px"] = registration
    write_page(folder / "index.html", folder, result)
    return result
