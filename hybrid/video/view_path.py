"""A way through views: a camera that passes each of them, and the time that it shows."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from compose.camera.camera import Camera, camera_from_pose


class ViewPath:
    """A way through views at equal steps, straight and evenly turning between them.

    Args:
        views: cameras and the times that they show, at least one; all frames have the size of the first.
    """

    def __init__(self, views: Sequence[tuple[Camera, float]]):
        first = views[0][0]
        self._cameras = [camera.resized(first.width, first.height) for camera, _ in views]
        self._steps = np.linspace(0, 1, max(2, len(views)))
        poses = np.stack([camera.camera_to_world for camera in self._cameras])
        numbers = [[c.fx, c.fy, c.cx, c.cy] for c in self._cameras]
        times = [time for _, time in views]
        # Of a single view, both ends are the same.
        again = np.resize(np.arange(len(views)), len(self._steps))
        self._numbers = np.column_stack([poses[:, :3, 3], numbers, times])[again]
        self._turn = Slerp(self._steps, Rotation.from_matrix(poses[again, :3, :3]))

    def at(self, share: float) -> tuple[Camera, float]:
        """Camera and time at a share of the way, 0 to 1."""
        x, y, z, fx, fy, cx, cy, time = (np.interp(share, self._steps, row) for row in self._numbers.T)
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = self._turn(share).as_matrix(), (x, y, z)
        size = self._cameras[0].width, self._cameras[0].height
        return camera_from_pose(pose, *size, fx, fy, cx, cy), float(time)
