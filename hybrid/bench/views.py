"""Views of a frame set that nothing was fitted to, and crops of them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from compose.base.errors import UserError
from compose.camera.camera import Camera
from pathtrace.dataset.frames import FrameSet


@dataclass(frozen=True)
class Crop:
    """The centre of a view, as a camera of its own.

    Attributes:
        scale: its resolution over that of the frame set.
        camera: sees only the crop.
    """

    scale: int
    camera: Camera


def unfitted_views(frames: FrameSet) -> list[Camera]:
    """Cameras of the held-out views that neither the splats nor the fusion were fitted to.

    Raises:
        UserError: there are none.
    """
    cameras = [entry.camera for entry in frames.held_out if not entry.estimates]
    if not cameras:
        raise UserError(
            f"{frames.folder}: the fusion is fitted to all held-out views; hold out 3 or more when capturing"
        )
    return cameras


def crops(cameras: list[Camera], scales: tuple[int, ...], share: float) -> Iterator[Crop]:
    """The centre of each view at each resolution.

    Args:
        cameras: the views.
        scales: resolutions over that of the cameras.
        share: side of a crop over that of the view, in width and height; crops have even sides.
    """
    for camera in cameras:
        for scale in scales:
            large = camera.resized(camera.width * scale, camera.height * scale)
            width, height = (2 * round(share * side / 2) for side in (large.width, large.height))
            left, top = (large.width - width) / 2, (large.height - height) / 2
            yield Crop(scale, large.cropped(left, top, width, height))
