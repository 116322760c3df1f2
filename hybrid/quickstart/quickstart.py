"""The whole workflow for one scene: capture, training, a hybrid frame, its reference, measurements."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

from hybrid.frame.frame import Frame
from hybrid.frame.renderer import Renderer
from hybrid.frame.settings import FrameSettings
from hybrid.output.images import write_png, write_srgb
from hybrid.pictures.weights import weights_picture
from hybrid.preparation.quick import make_quick_forest
from hybrid.quickstart.judged import judged_quality, judged_views
from hybrid.quickstart.page import write_page
from hybrid.runtime.machine import machine
from hybrid.runtime.progress import progress_bar
from hybrid.sweeps.comparison import compare
from hybrid.training.held_out import held_out_quality
from pathtrace.dataset.views import unseen_views
from pathtrace.scene.scene import Scene

# Width and height of the frames.
SIZE = 512
# Views that are judged, near the scene's own, to which nothing was fitted. Their references take as long as
# one view of 84 samples per pixel; with more, the whole would take noticeably longer.
_VIEWS, _REFERENCE_SPP = 3, 28
_REPEATS, _WARM_UP = 9, 2
# Entries of the comparison with full path tracing that are reported.
_TIMES = (
    *(f"{name}_ms{suffix}" for name in ("hybrid", "path_traced", "disc") for suffix in ("", "_range")),
    *("ratio", "ratio_range", "ceiling", "covered"),
)


def quickstart(scene: Scene, folder: Path, settings: FrameSettings, seed: int) -> dict[str, Any]:
    """Captures, trains, renders and measures; writes images and a page.

    All figures of frames are those of views that nothing was fitted to; the images are of the first of them.

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
    views = unseen_views(scene, _VIEWS, SIZE, SIZE)
    renderer = Renderer(scene, made.forest)
    with progress_bar("references") as bar:
        judged = judged_views(renderer, views, settings, _REFERENCE_SPP, seed, bar)
    with progress_bar("frames (rounds)") as bar:
        times = compare(renderer, views, settings, _REPEATS, _WARM_UP, bar)
    seconds = {**made.seconds, "render": time.perf_counter() - before}
    shown = judged[0]
    shown.frame.save(folder / "hybrid.exr")
    images = {"hybrid": shown.frame.composite, "reference": shown.reference, "splat": shown.splats}
    for name, image in images.items():
        write_png(folder / f"{name}.png", image)
    write_srgb(folder / "weights.png", weights_picture(shown.frame))
    seconds["total"] = time.perf_counter() - start
    result = {
        **_facts(scene, shown.frame),
        "seconds": seconds,
        "splat": {name: held_out[-1][name] for name in ("psnr", "ssim")},
        "layers": held_out,
        **judged_quality(judged),
        **{key: times[key] for key in _TIMES},
        "gaussians": len(made.forest.finest),
        "reference_spp": _REFERENCE_SPP,
        "machine": machine(),
    }
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
