"""The two eyes of a viewer."""

from __future__ import annotations

from compose.camera.camera import Camera

EYES = ("left", "right")


def eyes(camera: Camera, distance: float) -> tuple[Camera, Camera]:
    """The left and the right eye of a viewer between whose eyes a camera is; both look the same way.

    Args:
        camera: midway between the eyes.
        distance: between them, in the camera's coordinates.
    """
    return camera.moved_right(-distance / 2), camera.moved_right(distance / 2)
