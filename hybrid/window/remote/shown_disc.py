"""The client's end of a streamed disc: it is warped to the newest view and blended with the splats there."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from compose.base.arrays import uploaded
from compose.camera.camera import Camera
from compose.eye.gaze import FURTHEST, Gaze
from compose.fovea.disc import Disc, blend
from compose.fovea.foveation import Foveation
from compose.fovea.samples import Samples
from compose.fovea.warping import grid, warped
from compose.image.device_image import DeviceImage
from hybrid.render.fovea import FoveaImage
from hybrid.render.frame import Frame
from hybrid.window.remote.disc_messages import StreamedDisc

if TYPE_CHECKING:
    from drjit.auto.ad import Float

# What is nearer to the camera's plane, at a distance of 1 along the line of sight, is beside or behind it.
_LEAST_DEPTH = 1e-3


def with_disc(frame: Frame, disc: StreamedDisc) -> Frame:
    """A frame of splats with a disc that was traced for another view of the same size, where it is seen now.

    The frame's image is changed in place.
    """
    camera, message = frame.camera, disc.message
    if (camera.width, camera.height) != (disc.camera.width, disc.camera.height):
        return frame
    moved = _moved(disc, camera)
    if moved is None:
        return frame
    right, down = moved
    x, y = disc.gaze.pixel(camera.width, camera.height)
    gaze = Gaze((x + right) / camera.width, (y + down) / camera.height)
    region = Foveation(gaze, message.fov_a, message.fov_b).region(camera.width, camera.height)
    if not region.count:
        return frame
    found, radiance = _placed(Disc.in_region(frame.image.arrays, region), disc, camera, moved)
    composite, behind = blend(frame.image, radiance, found)
    count = dr.full(type(found.weights), message.spp, found.count)
    samples = replace(Samples.none(found.arrays, found.pixels), radiance=radiance, count=count)
    return replace(
        frame,
        image=composite,
        settings=replace(frame.settings, gaze=gaze, fov_a=message.fov_a, fov_b=message.fov_b),
        behind=behind,
        fovea=FoveaImage(found, radiance, samples),
        region=region,
    )


def _moved(disc: StreamedDisc, camera: Camera) -> tuple[int, int] | None:
    """Pixels by which what lies at the disc's centre has moved right and down; None if it cannot be seen."""
    own, before = camera, disc.camera
    rows, columns = grid(disc.square)
    near = float(disc.nearness.reshape(rows, columns)[rows // 2, columns // 2])
    x, y = disc.gaze.pixel(before.width, before.height)
    turn = own.world_to_camera @ before.camera_to_world
    ray = np.array([(x - before.cx) / before.fx, (y - before.cy) / before.fy, 1.0])
    across, down, depth = turn[:3, :3] @ ray + turn[:3, 3] * near
    if depth < _LEAST_DEPTH:
        return None
    place = own.fx * across / depth + own.cx - x, own.fy * down / depth + own.cy - y
    most = FURTHEST * max(own.width, own.height) / 2
    return None if max(map(abs, place)) > most else (round(place[0]), round(place[1]))


def _placed(
    found: Disc, disc: StreamedDisc, camera: Camera, moved: tuple[int, int]
) -> tuple[Disc, list[Float]]:
    """A disc of the new view, without weight where nothing was traced, and its radiance."""
    arrays, side = found.arrays, disc.message.side
    plain = arrays.plain
    left, top = (first + by for first, by in zip((disc.message.left, disc.message.top), moved, strict=True))
    near, newest = uploaded(plain.Float, disc.nearness), camera.cropped(left, top, side, side)
    seen, known = (
        warped(
            DeviceImage(arrays, uploaded(plain.Float, values), side, side, side), near, disc.square, newest
        )
        for values in (disc.radiance, np.repeat(_known(side)[..., None], 3, axis=2))
    )
    row, column = arrays.rows_columns(found.pixels, found.width)
    first_row, first_column, last = arrays.scalars(plain.Int, [top, left, side - 1])
    place = (plain.Int(row) - first_row, plain.Int(column) - first_column)
    at = [plain.UInt(dr.clip(one, 0, last)) for one in place]
    radiance, weights = seen.at(*at), found.weights * known.at(*at)[0]
    dr.eval(radiance, weights)
    return replace(found, weights=weights, covers_frame=False), radiance


def _known(side: int) -> NDArray[np.float32]:
    """(side, side) 1, but for the border, as which an image continues where nothing was traced."""
    known = np.zeros((side, side), np.float32)
    known[1:-1, 1:-1] = 1
    return known
