"""What the fovea's history is worth while the viewer walks and turns."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from compose.blend import Image
from compose.foveation import FoveaPlan, Foveation
from compose.fusion import Fusion
from compose.samples import Samples
from compose.view import Camera, Gaze
from hybrid.bench_fovea import measured, reference, unfitted_views
from hybrid.fovea import Fovea, Underlay
from hybrid.fusing import fusion_of
from hybrid.periphery import Periphery, Viewing
from pathtrace.frames import FrameSet
from pathtrace.scene import Scene
from pathtrace.tracer import FilmPositions, Tracer
from splat.arrays import Arrays
from splat.forest import Forest

FRAMES = 16
_SCALE = 2
_FRAMES_PER_SECOND = 30.0
_TURN = 10.0  # degrees per second
_STRIDE = 0.3  # of the distance to what the viewer looks at, per second
_RADIUS = 20.0  # of the disc, in percent of the height


def walk(camera: Camera, distance: float) -> list[Camera]:
    """The last FRAMES frames of a walk that ends at the camera: sideways, turning towards the way it goes."""
    path = []
    for step in range(FRAMES - 1, -1, -1):
        seconds = step / _FRAMES_PER_SECOND
        angle = np.radians(_TURN * seconds)
        turn = np.eye(4)
        turn[0, 0] = turn[2, 2] = np.cos(angle)
        turn[0, 2], turn[2, 0] = np.sin(angle), -np.sin(angle)
        aside = np.eye(4)
        aside[0, 3] = -_STRIDE * distance * seconds
        pose = camera.camera_to_world @ aside @ turn
        path.append(replace(camera, world_to_camera=np.asarray(np.linalg.inv(pose), dtype=np.float64)))
    return path


def bench_motion(
    arrays: Arrays,
    scene: Scene,
    frames: FrameSet,
    forest: Forest,
    reference_spp: int,
    progress: Callable[[int, int], None],
) -> list[dict[str, Any]]:
    """One row per mode and method: the last disc of a walk at one sample a frame, and discs of single frames.

    The viewer keeps looking at the same thing while walking past it. `fresh` is the PSNR over the pixels
    that have no history.

    Args:
        arrays, scene, forest: what is rendered.
        frames: that the forest was trained on; its unfitted views, at twice their resolution, are where the
            walks end.
        reference_spp: samples per pixel of the references.
        progress: called with walks done and walks in all.
    """
    tracer, fusion = Tracer(scene), fusion_of(forest)
    periphery = Periphery(arrays, forest, Viewing(law="none"))
    found: dict[tuple[str, str], list[dict[str, float]]] = {}
    views = unfitted_views(frames)
    for done, view in enumerate(views):
        camera = view.resized(view.width * _SCALE, view.height * _SCALE)
        plan = _disc(camera, Gaze())
        truth = _reference(tracer, camera, plan, reference_spp)
        for mode in ("raw", "denoised", "fused"):
            discs, fresh = _discs(tracer, periphery, fusion, mode, camera, plan)
            for method, disc in discs.items():
                row = _measured(plan, disc, truth)
                if fresh.any():
                    row["fresh_psnr"] = _measured(plan, np.where(fresh[:, None], disc, truth), truth)["psnr"]
                    row["fresh_psnr"] += 10 * float(np.log10(fresh.mean()))
                found.setdefault((mode, method), []).append(row)
        progress(done + 1, len(views))
    return [
        {
            "scene": scene.name,
            "mode": mode,
            "method": method,
            **{
                name: float(np.mean([row[name] for row in rows if name in row]))
                for name in sorted({name for row in rows for name in row})
            },
        }
        for (mode, method), rows in found.items()
    ]


def _disc(camera: Camera, gaze: Gaze) -> FoveaPlan:
    return Foveation(gaze, _RADIUS, _RADIUS).plan(camera.width, camera.height)


def _discs(
    tracer: Tracer, periphery: Periphery, fusion: Fusion | None, mode: str, camera: Camera, plan: FoveaPlan
) -> tuple[dict[str, Image], NDArray[np.bool_]]:
    """The walk's last disc by each method, and which of its pixels have no history."""
    middle = mi.Float([camera.cx - 0.5]), mi.Float([camera.cy - 0.5])
    distance = float(tracer.hits(camera, FilmPositions(*middle)).distance[0])
    ray = camera.rays(np.array([[camera.cx, camera.cy]]))
    watched = camera.position + distance * ray
    fovea, alone = Fovea(tracer, mode, fusion, remembers=True), Fovea(tracer, mode, fusion)
    under = Underlay(camera, periphery.whole(camera), periphery.enlargement(camera))

    def shown(maker: Fovea, samples: Samples) -> Image:
        return maker.picture(camera, plan, samples, under.radiance, under).radiance

    path = walk(camera, distance)
    for seed, earlier in enumerate(path[:-1]):
        pixel, _ = earlier.project(watched)
        gaze = Gaze(float(pixel[0, 0]) / camera.width, float(pixel[0, 1]) / camera.height)
        fovea.trace(earlier, _disc(earlier, gaze), 1, seed)
    samples = fovea.trace(camera, plan, 1, FRAMES)
    discs = {f"{FRAMES} frames of 1 spp": shown(fovea, samples)}
    for spp in (1, 8):
        discs[f"single frame, {spp} spp"] = shown(alone, alone.trace(camera, plan, spp, FRAMES))
    return discs, samples.count <= 1


def _reference(tracer: Tracer, camera: Camera, plan: FoveaPlan, spp: int) -> Image:
    """(D, 3) of the disc, from a crop around it."""
    rows, columns = plan.box()
    crop = replace(
        camera,
        width=columns.stop - columns.start,
        height=rows.stop - rows.start,
        cx=camera.cx - columns.start,
        cy=camera.cy - rows.start,
    )
    return reference(tracer, crop, spp, 1_000_003)[0][_place(plan)]


def _measured(plan: FoveaPlan, disc: Image, truth: Image) -> dict[str, float]:
    """Metrics over the rectangle around the disc, equal in its corners; PSNR over the disc alone."""
    rows, columns = plan.box()
    pictures = []
    for values in (disc, truth):
        picture = np.zeros((rows.stop - rows.start, columns.stop - columns.start, 3), dtype=np.float32)
        picture[_place(plan)] = values
        pictures.append(picture)
    found = measured(*pictures)
    found["psnr"] += 10 * float(np.log10(len(disc) / pictures[0][..., 0].size))
    return found


def _place(plan: FoveaPlan) -> tuple[NDArray[np.uint32], NDArray[np.uint32]]:
    rows, columns = plan.box()
    return plan.pixels // plan.width - rows.start, plan.pixels % plan.width - columns.start
