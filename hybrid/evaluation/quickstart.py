"""The whole workflow for one scene: a forest, hybrid frames, their references, measurements."""

from __future__ import annotations

import base64
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from compose.base.files import write_text
from compose.camera.camera import View
from compose.eye.gaze import Gaze
from compose.fovea.foveation import FoveaMode
from compose.image.colour import Image
from hybrid.base.identity import machine
from hybrid.base.progress import Bars, Steps, no_bars
from hybrid.evaluation.baselines_traced import FullTrace
from hybrid.evaluation.evaluation_page import rendered
from hybrid.evaluation.sweep_catalogue import with_range
from hybrid.measure.frame_times import (
    covered,
    interleaved_passes,
    jittered_view,
    medians_by_view,
    percentiles,
    ratio_of_medians,
    reach_for,
)
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
        **times,
        "gaussians": len(forest.finest),
        "reference_spp": _REFERENCE_SPP,
        "machine": machine(),
    }
    write_page(folder, result)
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


def _timed(method: Callable[[Gaze, int], object], gaze: Gaze, seed: int) -> dict[str, float]:
    """Milliseconds until a method returns, which it does when its frame is complete."""
    start = time.perf_counter()
    method(gaze, seed)
    return {"total": (time.perf_counter() - start) * 1000}


def compare(
    renderer: Renderer,
    views: Sequence[View],
    settings: FrameSettings,
    repeats: int,
    warm_up: int,
    progress: Steps,
) -> dict[str, Any]:
    """One row: times of the hybrid frame, of the full path-traced frame, and of the disc alone.

    The full frame is traced as the disc is, and denoised if that is. The gaze moves only so far that the disc
    stays in the frame. Frames go through the views, all of one size, in turn, each with a camera of its own,
    so that it pays for all it shows.

    Returns percentiles hybrid_ms, path_traced_ms and disc_ms; hybrid_ms_range and so on, the least and the
    greatest median of a view; `ratio` (path-traced over hybrid) with `ratio_range`, and `ceiling`
    (path-traced over disc); and `covered`, the mean fraction of the frame that the disc covers.
    """
    is_denoised = settings.fovea is not FoveaMode.RAW
    full = FullTrace(renderer.tracer_of(settings.used_integrator), settings.spp, is_denoised)
    camera = views[0].camera
    reach = reach_for(settings.fov_a, camera)

    def next_view(seed: int, place: int) -> View:
        return jittered_view(views[seed % len(views)], 3 * seed + place)

    def at(gaze: Gaze, seed: int, place: int) -> FrameSettings:
        view = next_view(seed, place)
        return replace(settings, gaze=gaze, camera=view.camera, time=view.time)

    methods: dict[str, Callable[[Gaze, int], object]] = {
        "hybrid": lambda gaze, seed: renderer.frame(at(gaze, seed, 0), seed),
        "path_traced": lambda gaze, seed: full.render(next_view(seed, 1), gaze, seed),
        "disc": lambda gaze, seed: renderer.disc_alone(at(gaze, seed, 2), seed),
    }
    timed = [partial(_timed, method) for method in methods.values()]
    found = interleaved_passes(timed, repeats, warm_up, progress, reach)
    times = {name: [frame["total"] for frame in frames] for name, frames in zip(methods, found, strict=True)}
    by_view = {name: medians_by_view(values, len(views)) for name, values in times.items()}
    ratios = [full / ours for full, ours in zip(by_view["path_traced"], by_view["hybrid"], strict=True)]
    return {
        **{f"{name}_ms": percentiles(values) for name, values in times.items()},
        **{f"{name}_ms_range": (min(medians), max(medians)) for name, medians in by_view.items()},
        "ratio": ratio_of_medians(times["path_traced"], times["hybrid"]),
        "ratio_range": (min(ratios), max(ratios)),
        "ceiling": ratio_of_medians(times["path_traced"], times["disc"]),
        "covered": covered(settings.fov_a, camera, repeats, reach),
    }


# Name of the PNG file, title and caption.
_IMAGES = (
    (
        "hybrid",
        "Hybrid frame",
        "path-traced inside the inner circle, splats outside the outer one; hover to see the circles",
    ),
    ("reference", "Reference", "path-traced, {reference_spp} samples per pixel, denoised"),
    ("splat", "Splats alone", "{gaussians:,} Gaussians"),
    (
        "weights",
        "Weights of the fused fovea",
        "red: path-traced samples, green: the same denoised, blue: splats, light blue: relit by the samples",
    ),
)


def write_page(folder: Path, result: dict[str, Any]) -> None:
    """Writes index.html, which embeds the folder's four images; UserError if it cannot be written."""
    machine = result["machine"]
    page = rendered(
        "quickstart.html",
        title=f"Foveated hybrid frame of {result['scene']}",
        subtitle=f"{result['width']} × {result['height']}, {result['spp']} samples per pixel in the disc, "
        f"fov-a {result['fov_a']:g} %, fov-b {result['fov_b']:g} % of the height. Measured on "
        f"{machine['cpu']}, {machine['cores']} cores.",
        # fov-a and fov-b are circles that appear under the pointer.
        aspect=100 * result["width"] / result["height"],
        radii=(result["fov_a"], result["fov_b"]),
        figures=[
            {
                "title": title,
                "caption": caption.format(**result),
                "data": base64.b64encode((folder / f"{name}.png").read_bytes()).decode(),
            }
            for name, title, caption in _IMAGES
        ],
        rows=_rows(result),
        views=f"Measured in {result['views']} views near the scene's own to which nothing was fitted; the "
        "images show the first of them. Quality is the mean over the views and times are medians of all "
        "their frames; in brackets the least and the greatest value of a view.",
    )
    write_text(folder / "index.html", page)


def _rows(result: dict[str, Any]) -> list[tuple[str, str]]:
    seconds = ", ".join(f"{name} {value:.0f} s" for name, value in result["seconds"].items())
    ceiling = f"at most {result['ceiling']:.2f}×, if splats took no time"
    speed_up = with_range(result["ratio"], result.get("ratio_range"), ".2f", "×")
    rows = [
        ("Quality of the hybrid frame, against the reference", _quality(result, "hybrid")),
        ("Quality of the splats alone, against the reference", _quality(result, "splats_alone")),
        ("The same in held-out views, at the resolution of training", _quality(result, "splat")),
        ("Time of the hybrid frame", _time(result, "hybrid_ms")),
        ("Time of a full path-traced frame, same samples, also denoised", _time(result, "path_traced_ms")),
        ("Time of the disc alone", _time(result, "disc_ms")),
        ("Speed-up over full path tracing", f"{speed_up}; {ceiling}"),
        ("Gaussians", f"{result['gaussians']:,}"),
        ("Duration", seconds),
    ]
    if "registration_px" in result:
        offset = with_range(result["registration_px"], result.get("registration_px_range"), ".3f", " px")
        rows.insert(3, ("Offset between splats and path-traced frame", offset))
    return rows


def _quality(result: dict[str, Any], name: str) -> str:
    values, ranges = result[name], result.get(f"{name}_range", {})
    psnr = with_range(values["psnr"], ranges.get("psnr"), ".2f", " dB")
    return f"{psnr}, SSIM {with_range(values['ssim'], ranges.get('ssim'), '.4f')}"


def _time(result: dict[str, Any], name: str) -> str:
    median = with_range(result[name]["p50"], result.get(f"{name}_range"), ".0f", " ms")
    return f"{median}, p95 {result[name]['p95']:.0f} ms"
