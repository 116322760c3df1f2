"""The whole workflow for one scene: a forest, hybrid frames, their references, measurements."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from compose.camera.camera import View
from compose.image.colour import Image
from hybrid.base.identity import machine
from hybrid.base.progress import Bars, Steps, no_bars
from hybrid.evaluation.comparison import compare
from hybrid.evaluation.quickstart_page import write_page
from hybrid.measure.image_metrics import quality, registration_px
from hybrid.measure.reference import REFERENCE_SEED
from hybrid.preparation.forest_errors import held_out_quality
from hybrid.preparation.preparation import make_quick_forest
from hybrid.render.false_colours import weights_picture
from hybrid.render.frame import Frame
from hybrid.render.frame_renderer import Renderer
from hybrid.render.frame_settings import EXTRA_AOVS, FrameSettings
from hybrid.render.image_files import write_png, write_srgb
from pathtrace.dataset.captured_frames import render_frame
from pathtrace.region.neighbourhood import unseen_views
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


def quickstart(
    scene: Scene, folder: Path, settings: FrameSettings, seed: int, bars: Bars = no_bars
) -> dict[str, Any]:
    """Captures, trains, renders and measures; writes images and a page; returns result.json's content.

    All figures of frames are those of views that nothing was fitted to; the images are of the first of them.
    The disc of the settings must contain a pixel of a frame of SIZE x SIZE.
    """
    start = time.perf_counter()
    forest, frames = make_quick_forest(scene, folder, seed, bars)
    seconds = {"prepare": time.perf_counter() - start}
    held_out = held_out_quality(frames, forest)
    before = time.perf_counter()
    views = unseen_views(scene, _VIEWS, SIZE, SIZE)
    renderer = Renderer(scene, forest)
    with bars("references") as bar:
        judged = judged_views(renderer, views, settings, seed, bar)
    with bars("frames (rounds)") as bar:
        times = compare(renderer, views, settings, _REPEATS, _WARM_UP, bar)
    seconds["render"] = time.perf_counter() - before
    shown, reference = judged[0]
    shown.save(folder / "hybrid.exr")
    images = {"hybrid": shown.composite, "reference": reference, "splat": shown.more["splat"]}
    for name, image in images.items():
        write_png(folder / f"{name}.png", image)
    write_srgb(folder / "weights.png", weights_picture(shown))
    seconds["total"] = time.perf_counter() - start
    result = {
        "scene": scene.name,
        "width": shown.camera.width,
        "height": shown.camera.height,
        **{name: getattr(shown.settings, name) for name in ("spp", "fov_a", "fov_b")},
        "seconds": seconds,
        "splat": {name: held_out[-1][name] for name in ("psnr", "ssim")},
        "layers": held_out,
        **judged_quality(judged),
        **{key: times[key] for key in _TIMES},
        "gaussians": len(forest.finest),
        "reference_spp": _REFERENCE_SPP,
        "machine": machine(),
    }
    write_page(folder / "index.html", folder, result)
    return result


def judged_views(
    renderer: Renderer, views: list[View], settings: FrameSettings, seed: int, progress: Steps
) -> list[tuple[Frame, Image]]:
    """Frames of views with all AOVs, and denoised path tracing of each; same seed, same on one machine."""
    found = []
    for number, view in enumerate(views):
        progress(number, len(views))
        own = replace(settings, camera=view.camera, time=view.time, aovs=EXTRA_AOVS)
        renderer.scene.show(view.time)
        truth_seed = seed + REFERENCE_SEED + number
        truth = render_frame(renderer.tracer, view.camera, _REFERENCE_SPP, truth_seed).radiance
        found.append((renderer.frame(own, seed + number), truth))
    progress(len(views), len(views))
    return found


def judged_quality(views: list[tuple[Frame, Image]]) -> dict[str, Any]:
    """Entries of result.json: means over the views, and the least and the greatest value of a view.

    `views`, their number; `hybrid` and `splats_alone`, psnr in dB and ssim; `registration_px`, unless no view
    has a window with enough texture; and of each of these its `..._range`.
    """
    found: dict[str, Any] = {"views": len(views)}
    splats, truths = [frame.more["splat"] for frame, _ in views], [truth for _, truth in views]
    images = {"hybrid": [frame.composite for frame, _ in views], "splats_alone": splats}
    for name, shown in images.items():
        rows = [quality(image, truth) for image, truth in zip(shown, truths, strict=True)]
        values = {metric: [row[metric] for row in rows] for metric in rows[0]}
        found[name] = {metric: float(np.mean(each)) for metric, each in values.items()}
        found[f"{name}_range"] = {metric: (min(each), max(each)) for metric, each in values.items()}
    shifts = [registration_px(image, truth) for image, truth in zip(splats, truths, strict=True)]
    known = [shift for shift in shifts if shift is not None]
    if known:
        found |= {"registration_px": float(np.mean(known)), "registration_px_range": (min(known), max(known))}
    return found
