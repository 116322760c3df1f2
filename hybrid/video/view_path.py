"""A way through views: a camera that passes each of them, and the time that it shows."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from compose.camera.camera import camera_from_pose
from compose.camera.view import View


class ViewPath:
    """A way through views at equal steps, straight and evenly turning between them.

    Args:
        views: at least one; all frames have the size of the first.
    """

    def __init__(self, views: Sequence[View]):
        self._size = views[0].camera.width, views[0].camera.height
        cameras = [view.camera.resized(*self._size) for view in views]
        self._steps = np.linspace(0, 1, max(2, len(views)))
        poses = np.stack([camera.camera_to_world for camera in cameras])
        numbers = [[c.fx, c.fy, c.cx, c.cy] for c in cameras]
        times = [view.time for view in views]
        # Of a single view, both ends are the same.
        again = np.resize(np.arange(len(views)), len(self._steps))
        self._numbers = np.column_stack([poses[:, :3, 3], numbers, times])[again]
        self._turn = Slerp(self._steps, Rotation.from_matrix(poses[again, :3, :3]))

    def at(self, share: float) -> View:
        """The view at a share of the way, 0 to 1."""
        x, y, z, fx, fy, cx, cy, time = (np.interp(share, self._steps, row) for row in self._numbers.T)
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = self._turn(share).as_matrix(), (x, y, z)
        return View(camera_from_pose(pose, *self._size, fx, fy, cx, cy), float(time))
