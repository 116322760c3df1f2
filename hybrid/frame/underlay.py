"""The splats under the path-traced disc."""

from __future__ import annotations

from dataclasses import dataclass

from compose.camera.camera import Camera
from compose.image.device import DeviceImage


@dataclass(frozen=True)
class Underlay:
    """The splats rendered under the disc, one of the images from which a fused fovea is made.

    Attributes:
        camera: the view.
        radiance: linear, of the whole frame; only the rectangle around the disc is used.
        enlargement: side of the pixels that the splats were trained on, in pixels of this image.

    Raises:
        ValueError: the size of the image is not that of the camera's frame.
    """

    camera: Camera
    radiance: DeviceImage
    enlargement: float

    def __post_init__(self) -> None:
        width, height = self.radiance.width, self.radiance.height
        if (width, height) != (self.camera.width, self.camera.height):
            raise ValueError(
                f"the underlay is {width} x {height}, the frame {self.camera.width} x {self.camera.height}"
            )


def underlay_of(camera: Camera, underlay: Underlay | None) -> Underlay:
    """The underlay, after checking that it shows the camera's view.

    Raises:
        ValueError: it is missing, or belongs to another camera.
    """
    if underlay is None:
        raise ValueError("a fused fovea requires the splats under the disc")
    if underlay.camera != camera:
        raise ValueError("the underlay belongs to another camera")
    return underlay
