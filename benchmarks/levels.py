"""Continuous levels of detail at as many Gaussians, against each other and a forest's layers.

python -m benchmarks.levels SCENE --forest FOREST [--json FILE]

`hybrid levels` has fitted the forest's levels. Quality is that of splats alone against the finest layer at
full rate, over views that nothing was fitted to, each with another gaze.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np

import hybrid
from benchmarks import measure_forest
from compose.camera.camera import Camera, turned
from compose.eye.display import DISPLAYS
from compose.eye.gaze import Gaze
from hybrid.base.compute_device import device_arrays
from hybrid.evaluation.splat_bench import display_camera
from hybrid.evaluation.verdicts import mean_interval
from hybrid.measure.image_metrics import psnr
from hybrid.measure.perceptual_metrics import jod
from hybrid.render.forest_attachments import views_of
from hybrid.render.frame_settings import FrameSettings
from hybrid.render.periphery import Periphery
from splat.lod.layer_images import SplatImage
from splat.model.forest import Forest

_REPEATS, _VIEWS = 9, 8
# Standard deviations, in degrees of views from those of the training, and of gazes in parts of the frame.
_TURN, _GAZE = 12.0, 0.15
# Units of the scene that the camera moves per frame: enough to make it another one.
_STEP = 1e-4
# Gaussians that are drawn, as parts of those that a view shows.
_SHARES = (0.2, 0.5)
# Qualities that are asked for, in JOD.
_ASKED = (8.5, 9.0, 9.5, 9.8)
# Nothing is path-traced.
_SPLATS = FrameSettings(fov_a=0.0, fov_b=0.0, fill=False)
_OURS, _EXTENTS, _ALIKE = "continuous", "continuous, by extent alone", "continuous, alike everywhere"


def measured(scene_name: str, file: Path) -> dict[str, Any]:
    """Qualities by display, number of Gaussians and method, and times."""
    forest, scene = hybrid.load_forest(file), hybrid.load_scene(scene_name)
    by_extent = replace(forest.own_hierarchy, contrast=None)
    methods = {
        _OURS: Periphery(device_arrays(), forest),
        _EXTENTS: Periphery(device_arrays(), replace(forest, hierarchy=by_extent)),
    }
    qualities, own = [], list(_views(forest, display_camera(scene.camera, _SPLATS.display)))
    for name, display in DISPLAYS.items():
        found: dict[tuple[str, str], list[dict[str, float]]] = {}
        settings = replace(_SPLATS, display=display)
        for view, gaze in _views(forest, display_camera(scene.camera, display)):
            for against, method, row in _compared(methods, view, replace(settings, gaze=gaze)):
                found.setdefault((against, method), []).append(row)
        qualities += [
            {"display": name, "gaussians": against, "method": method, **_summary(rows, found[against, _OURS])}
            for (against, method), rows in found.items()
        ]
    times = _times(methods[_OURS], display_camera(scene.camera, _SPLATS.display))
    asked = [_given(methods[_OURS], own, asked) for asked in _ASKED]
    return {"scene": scene.name, "views": _VIEWS, "qualities": qualities, "asked": asked, "times": times}


def _views(forest: Forest, like: Camera) -> Iterator[tuple[Camera, Gaze]]:
    """Turned views of the training, with the size and angles of a camera."""
    rng, poses = np.random.default_rng(0), [view.camera_to_world for view in views_of(forest)]
    for index in rng.integers(0, len(poses), _VIEWS):
        pose = poses[index].copy()
        pose[:3, :3] = turned(pose[:3, :3], *(_TURN * rng.normal(size=2)))
        yield like.at(pose), Gaze(*np.clip(0.5 + _GAZE * rng.normal(size=2), 0, 1).tolist())


def _given(periphery: Periphery, views: list[tuple[Camera, Gaze]], asked: float) -> dict[str, float]:
    """What is drawn for a quality: Gaussians, its quality, and how far that is off, over the views."""
    rows = [
        _quality(
            periphery, view, replace(_SPLATS, gaze=gaze, level_jod=asked), periphery.whole(view, _SPLATS)
        )
        for view, gaze in views
    ]
    off = float(np.mean([abs(row["jod"] - asked) for row in rows]))
    means = {name: float(np.mean([row[name] for row in rows])) for name in rows[0]}
    return {"asked": asked, **means, "least": min(row["jod"] for row in rows), "off": off}


def _quality(
    periphery: Periphery, view: Camera, settings: FrameSettings, whole: SplatImage
) -> dict[str, float]:
    """Number of Gaussians, PSNR and JOD against the finest layer."""
    region = settings.foveation.region(view.width, view.height)
    drawn = periphery.draw(view, periphery.detail(view, settings), region)
    image, truth = drawn.numpy(), whole.numpy()
    quality = jod(image, truth, settings.display, settings.gaze)
    assert quality is not None, "FovVideoVDP is not installed"
    return {"nodes": drawn.nodes, "psnr": psnr(image, truth), "jod": quality}


def _compared(
    methods: dict[str, Periphery], view: Camera, settings: FrameSettings
) -> Iterator[tuple[str, str, dict[str, float]]]:
    """What as many Gaussians are as, method, and number of Gaussians, PSNR and JOD; of one view."""
    ours = methods[_OURS]
    whole = ours.whole(view, settings)
    row = partial(_quality, view=view, whole=whole)
    for share in _SHARES:
        few, name = replace(settings, gaussians=round(share * whole.nodes)), f"{share:.0%}"
        for method, periphery in methods.items():
            yield name, method, row(periphery, settings=few)
        yield name, _ALIKE, row(ours, settings=replace(few, acuity_model="none"))
    layers = {f"layer {n}": replace(settings, layers=(n, n)) for n in range(1, len(ours.forest.counts))}
    if layers:
        layers["layers by zones"] = replace(settings, acuity_model="fov-gs")
    for name, chosen in layers.items():
        of_layers = row(ours, settings=chosen)
        yield name, name, of_layers
        yield name, _OURS, row(ours, settings=replace(settings, gaussians=int(of_layers["nodes"])))


def _summary(rows: list[dict[str, float]], ours: list[dict[str, float]]) -> dict[str, Any]:
    """Means over the views, and by how many JOD continuous levels are ahead, with a 95 % interval."""
    means = {name: float(np.mean([row[name] for row in rows])) for name in rows[0]}
    ahead = [own["jod"] - row["jod"] for own, row in zip(ours, rows, strict=True)]
    return means | {"ahead": list(mean_interval(ahead, 0.95))}


def _times(periphery: Periphery, camera: Camera) -> list[dict[str, Any]]:
    """Milliseconds of some settings, camera moving."""
    region = _SPLATS.foveation.region(camera.width, camera.height)
    counts = periphery.forest.counts
    cases = {f"layer {n}": replace(_SPLATS, layers=(n, n)) for n in range(1, len(counts) + 1)}
    cases["layers, as the eye resolves"] = _SPLATS
    cases |= {f"{n:,} Gaussians": replace(_SPLATS, gaussians=n) for n in (5000, 10000, 20000, 40000)}

    def draw(settings: FrameSettings, number: int) -> SplatImage:
        view = camera.moved_right(number * _STEP)
        return periphery.draw(view, periphery.detail(view, settings, moving=True), region)

    times: dict[str, list[float]] = {name: [] for name in cases}
    for number in range(-2, _REPEATS):
        for name, settings in cases.items():
            start = time.perf_counter()
            draw(settings, number)
            dr.sync_thread()
            times[name].append((time.perf_counter() - start) * 1000)
    return [
        {"method": name, "nodes": draw(settings, 0).nodes, "ms": float(np.median(times[name][2:]))}
        for name, settings in cases.items()
    ]


if __name__ == "__main__":
    measure_forest(__doc__, measured)
