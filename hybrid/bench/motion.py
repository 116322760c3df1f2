"""What the fovea's history is worth while the viewer walks and turns."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compose.base.errors import UserError
from compose.camera.camera import Camera
from compose.eye.gaze import Gaze
from compose.fovea.disc import Disc
from compose.fovea.mode import FoveaMode
from compose.fovea.region import Foveation
from compose.fusion.network import Fusion
from compose.image.colour import Image
from hybrid.bench.candidates import whole_underlay
from hybrid.bench.metrics import image_metrics, means
from hybrid.bench.views import unfitted_views
from hybrid.frame.disc_tracer import DiscRequest
from hybrid.frame.fovea import Fovea
from hybrid.frame.fusion import fusion_of
from hybrid.frame.irradiance import cache_for
from hybrid.frame.periphery import Periphery
from hybrid.measure.metrics.psnr import psnr
from hybrid.measure.reference import REFERENCE_SEED, reference
from hybrid.runtime.device import device_arrays
from pathtrace.dataset.frames import FrameSet
from pathtrace.scene.scene import Scene
from pathtrace.scene.surfaces import Surfaces
from pathtrace.trace.film import frame_positions
from pathtrace.trace.tracer import Tracer
from splat.model.forest import Forest

FRAMES = 16
_SCALE = 2
_FRAMES_PER_SECOND = 30.0
_TURN = 10.0  # degrees per second
_STRIDE = 0.3  # fraction of the distance to what the viewer looks at, per second
_RADIUS = 20.0  # of the disc, in percent of the height
_SINGLE_SPP = (1, 8)  # samples per pixel of the single frames that the walk is compared with


def walk(camera: Camera, distance: float) -> list[Camera]:
    """The last FRAMES cameras of a walk that ends at a camera: sideways, turning in the same direction.

    Args:
        camera: the last one.
        distance: to what the viewer looks at, in units of the scene; the speed is proportional to it.
    """
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
    scene: Scene,
    frames: FrameSet,
    forest: Forest,
    reference_spp: int,
    progress: Callable[[int, int], None],
) -> list[dict[str, Any]]:
    """One row per mode and method: the last disc of a walk at 1 spp per frame, and discs of single frames.

    The viewer keeps looking at the same point while walking past it.

    Args:
        scene, forest: what is rendered.
        frames: that the forest was trained on; the walks end at its unfitted views, at twice their
            resolution.
        reference_spp: samples per pixel of the references.
        progress: called with walks done and walks in total.

    Returns:
        Rows of means over the walks; fresh_psnr is that of the pixels without history, if there are any.
    """
    tracer, fusion = Tracer(scene), fusion_of(forest)
    cached = Tracer(scene, cache=cache_for(scene))
    periphery = Periphery(device_arrays(), forest)
    found: dict[tuple[str, str], list[dict[str, float]]] = {}
    views = unfitted_views(frames)
    for done, view in enumerate(views):
        camera = view.resized(view.width * _SCALE, view.height * _SCALE)
        region = _disc(camera, Gaze())
        truth = _reference(tracer, camera, region, reference_spp)
        for mode in FoveaMode:
            discs = _discs(cached, periphery, fusion, mode, camera, region)
            for method, disc in discs.radiance.items():
                row = _measured(region, disc, truth, discs.fresh)
                found.setdefault((mode.value, method), []).append(row)
        progress(done + 1, len(views))
    return [
        {"scene": scene.name, "mode": mode, "method": method, **means(rows)}
        for (mode, method), rows in found.items()
    ]


@dataclass(frozen=True)
class _Discs:
    """Discs of D pixels at the end of a walk.

    Attributes:
        radiance: (D, 3) by method.
        fresh: (D,) pixels without history.
    """

    radiance: dict[str, Image]
    fresh: NDArray[np.bool_]


def _disc(camera: Camera, gaze: Gaze) -> Disc:
    return Foveation(gaze, _RADIUS, _RADIUS).region(camera.width, camera.height).disc(device_arrays())


def _discs(
    tracer: Tracer,
    periphery: Periphery,
    fusion: Fusion | None,
    mode: FoveaMode,
    camera: Camera,
    disc: Disc,
) -> _Discs:
    """The last disc of a walk that ends at a camera, and discs of single frames."""
    distance = _distance(tracer, camera)
    ray = camera.rays(np.array([[camera.cx, camera.cy]]))
    watched = camera.position + distance * ray
    fovea, alone = Fovea(tracer, fusion, history=True), Fovea(tracer, fusion)
    underlay = whole_underlay(periphery, camera)

    def shown(made_by: Fovea, spp: int) -> Image:
        _, samples = made_by.trace(mode, camera, disc, spp, FRAMES)
        made = made_by.image(mode, disc, samples, underlay.radiance, underlay)
        return _values(disc, made.radiance)

    path = walk(camera, distance)
    for seed, earlier in enumerate(path[:-1]):
        pixel, _ = earlier.project(watched)
        gaze = Gaze(float(pixel[0, 0]) / camera.width, float(pixel[0, 1]) / camera.height)
        fovea.trace(mode, earlier, _disc(earlier, gaze), 1, seed)
    fresh = fovea.disc.known(DiscRequest(camera, disc, 1, FRAMES)).numpy("count") == 0
    discs = {f"{FRAMES} frames of 1 spp": shown(fovea, 1)}
    for spp in _SINGLE_SPP:
        discs[f"single frame, {spp} spp"] = shown(alone, spp)
    return _Discs(discs, fresh)


def _distance(tracer: Tracer, camera: Camera) -> float:
    """Distance of what is at the centre of the view; if that is sky, the median of what is visible."""
    found = tracer.hits(camera, frame_positions(camera)).distance
    middle = found[camera.height // 2 * camera.width + camera.width // 2]
    distance = float(middle) if np.isfinite(middle) else Surfaces(tracer.scene).median_distance(camera)
    if not np.isfinite(distance):
        raise UserError("a view sees nothing to walk past")
    return distance


def _values(disc: Disc, channels: list[Any]) -> Image:
    """(D, 3) channels of a disc, in host memory."""
    return disc.frame_image(channels).reshape(-1, 3)[np.asarray(disc.pixels)]


def _inside(disc: Disc) -> NDArray[np.uint32]:
    """(D,) indices of the pixels among those of the rectangle around them, in host memory."""
    return np.asarray(disc.inside)


def _reference(tracer: Tracer, camera: Camera, disc: Disc, spp: int) -> Image:
    """(D, 3) reference radiance of the disc, traced in a crop around it."""
    assert disc.box is not None
    (rows, columns), (height, width) = disc.box, disc.shape
    crop = camera.cropped(columns.start, rows.start, width, height)
    return reference(tracer, crop, spp, REFERENCE_SEED).radiance.reshape(-1, 3)[_inside(disc)]


def _measured(around: Disc, disc: Image, truth: Image, fresh: NDArray[np.bool_]) -> dict[str, float]:
    """Metrics over the rectangle around the disc, whose corners are equal; PSNR over the disc alone.

    Args:
        around: the disc's pixels.
        disc, truth: (D, 3) radiance.
        fresh: (D,) pixels without history.
    """
    black = np.zeros((*around.shape, 3), dtype=np.float32)

    def image(values: Image) -> Image:
        scattered = black.copy()
        scattered.reshape(-1, 3)[_inside(around)] = values
        return scattered

    right = image(truth)
    found = image_metrics(image(disc), right)
    # Pixels without error do not change the sum of squares, only their number.
    found["psnr"] += 10 * float(np.log10(len(disc) / black[..., 0].size))
    if fresh.any():
        elsewhere_right = image(np.where(fresh[:, None], disc, truth))
        share = np.count_nonzero(fresh) / black[..., 0].size
        found["fresh_psnr"] = psnr(elsewhere_right, right) + 10 * float(np.log10(share))
    return found
