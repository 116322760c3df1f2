"""The whole workflow for one scene: capture, training, a hybrid frame, its reference, measurements."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import Any

from hybrid.frame.frame import Frame
from hybrid.frame.renderer import Renderer
from hybrid.frame.settings import FrameSettings
from hybrid.measure.metrics.registration import registration_px
from hybrid.measure.metrics.similarity import quality
from hybrid.measure.reference import REFERENCE_SEED
from hybrid.output.images import write_png, write_srgb
from hybrid.pictures.weights import weights_picture
from hybrid.quickstart.page import write_page
from hybrid.runtime.machine import machine
from hybrid.runtime.progress import progress_bar
from hybrid.sweeps.comparison import compare
from hybrid.training.held_out import held_out_quality
from hybrid.training.quick import make_quick_forest
from pathtrace.dataset.rendering import render_frame
from pathtrace.scene.scene import Scene

# Width and height of the frame, which shows the scene's own view.
SIZE = 512
_REFERENCE_SPP = 64
_REPEATS, _WARM_UP = 7, 2
# Entries of the comparison with full path tracing that are reported.
_TIMES = ("hybrid_ms", "path_traced_ms", "disc_ms", "ratio", "ceiling", "covered")


def quickstart(scene: Scene, folder: Path, settings: FrameSettings, seed: int) -> dict[str, Any]:
    """Captures, trains, renders and measures; writes images and a page.

    Args:
        scene: what to render.
        folder: for everything that is written, including frame set and forest.
        settings: of the frame; the disc must contain a pixel of a frame of SIZE x SIZE.
        seed: same seed, same images on the same machine.

    Returns:
        The content of result.json.
    """
    start = time.perf_counter()
    made = make_quick_forest(scene, folder, seed)
    held_out = held_out_quality(made.frames, made.forest)
    before = time.perf_counter()
    camera = scene.camera.resized(SIZE, SIZE)
    settings = replace(settings, camera=camera)
    renderer = Renderer(scene, made.forest)
    with progress_bar("reference") as bar:
        bar(0, 1)
        reference = render_frame(renderer.tracer, camera, _REFERENCE_SPP, seed + REFERENCE_SEED).radiance
        bar(1, 1)
    with progress_bar("frames (rounds)") as bar:
        times = compare(renderer, camera, settings, _REPEATS, _WARM_UP, bar)
    frame = renderer.frame(settings, seed)
    splats = renderer.splats(settings)
    seconds = {**made.seconds, "render": time.perf_counter() - before}
    frame.save(folder / "hybrid.exr")
    for name, image in (("hybrid", frame.composite), ("reference", reference), ("splat", splats)):
        write_png(folder / f"{name}.png", image)
    write_srgb(folder / "weights.png", weights_picture(frame))
    seconds["total"] = time.perf_counter() - start
    result = {
        **_facts(scene, frame),
        "seconds": seconds,
        "splat": {name: held_out[-1][name] for name in ("psnr", "ssim")},
        "layers": held_out,
        "hybrid": quality(frame.composite, reference),
        **{key: times[key] for key in _TIMES},
        "gaussians": len(made.forest.finest),
        "reference_spp": _REFERENCE_SPP,
        "machine": machine(),
    }
    registration = registration_px(splats, reference)
    if registration is not None:
        result["registration_px"] = registration
    write_page(folder / "index.html", folder, result)
    return result


def _facts(scene: Scene, frame: Frame) -> dict[str, Any]:
    """What was rendered."""
    settings = frame.settings
    return {
        "scene": scene.name,
        "width": frame.camera.width,
        "height": frame.camera.height,
        "spp": settings.spp,
        "fov_a": settings.fov_a,
        "fov_b": settings.fov_b,
    }
