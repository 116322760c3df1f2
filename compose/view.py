"""Cameras and the angles a viewer sees them under.

Right-handed world. A camera is a 4x4 world-to-camera matrix in OpenCV axes (x right, y down,
z forward) with pinhole intrinsics in pixels. Pixel centres lie at +0.5, rows count from the top.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compose.errors import UserError

Array = NDArray[np.float64]

# Each converts camera axes to OpenCV's and back (they are their own inverse).
_MITSUBA_AXES = np.diag([-1.0, -1.0, 1.0, 1.0])  # x left, y up, z forward
_OPENGL_AXES = np.diag([1.0, -1.0, -1.0, 1.0])  # x right, y up, z backward


@dataclass(frozen=True)
class Camera:
    """A pinhole camera.

    Attributes:
        world_to_camera: (4, 4) rigid transform, OpenCV axes.
        width, height: frame size in pixels.
        fx, fy: focal lengths in pixels.
        cx, cy: principal point in pixels, (width / 2, height / 2) for a centred camera.

    Raises:
        ValueError: a size or a focal length is not positive, or a number is not finite.
    """

    world_to_camera: Array
    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float

    def __post_init__(self) -> None:
        if self.width <= 0 or self.height <= 0:
            raise ValueError(f"frame size {self.width} x {self.height} must be positive")
        numbers = [self.fx, self.fy, self.cx, self.cy, *np.ravel(self.world_to_camera)]
        if not np.all(np.isfinite(numbers)) or min(self.fx, self.fy) <= 0:
            raise ValueError("camera has a number that is not finite, or no focal length")

    @property
    def camera_to_world(self) -> Array:
        """(4, 4) inverse of world_to_camera."""
        rotation, translation = self.world_to_camera[:3, :3], self.world_to_camera[:3, 3]
        inverse = np.eye(4)
        inverse[:3, :3] = rotation.T
        inverse[:3, 3] = -rotation.T @ translation
        return inverse

    @property
    def position(self) -> Array:
        """(3,) centre of projection in world space."""
        return self.camera_to_world[:3, 3]

    @property
    def vertical_fov(self) -> float:
        """Vertical field of view in degrees."""
        return float(np.degrees(np.arctan(self.cy / self.fy) + np.arctan((self.height - self.cy) / self.fy)))

    def resized(self, width: int, height: int) -> Camera:
        """The same view on another frame: the vertical field of view is kept, a wider frame sees more."""
        scale = height / self.height
        return replace(
            self,
            width=width,
            height=height,
            fx=self.fx * scale,
            fy=self.fy * scale,
            cx=width / 2 + (self.cx - self.width / 2) * scale,
            cy=self.cy * scale,
        )

    def cropped(self, left: float, top: float, width: int, height: int) -> Camera:
        """The camera that sees a rectangle of this frame alone, `left` and `top` in pixels."""
        return replace(self, width=width, height=height, cx=self.cx - left, cy=self.cy - top)

    def project(self, points: Array) -> tuple[Array, Array]:
        """Pixel positions (N, 2) and depths along the view axis (N,) of world points (N, 3)."""
        local = points @ self.world_to_camera[:3, :3].T + self.world_to_camera[:3, 3]
        depth = local[:, 2]
        x = self.fx * local[:, 0] / depth + self.cx
        y = self.fy * local[:, 1] / depth + self.cy
        return np.stack([x, y], axis=1), depth

    @property
    def key(self) -> bytes:
        """The same for cameras that see the same, and only for those."""
        numbers = (self.width, self.height, self.fx, self.fy, self.cx, self.cy)
        return np.array(numbers, dtype=np.float64).tobytes() + self.world_to_camera.tobytes()

    def rays(self, pixels: Array) -> Array:
        """Unit directions (N, 3) in world space through pixel positions (N, 2)."""
        local = np.stack(
            [
                (pixels[:, 0] - self.cx) / self.fx,
                (pixels[:, 1] - self.cy) / self.fy,
                np.ones(len(pixels)),
            ],
            axis=1,
        )
        world = local @ self.world_to_camera[:3, :3]
        return world / np.linalg.norm(world, axis=1, keepdims=True)

    def pixel_centres(self) -> Array:
        """(height * width, 2) positions of all pixel centres, row by row from the top."""
        x, y = np.meshgrid(np.arange(self.width) + 0.5, np.arange(self.height) + 0.5)
        return np.stack([x.ravel(), y.ravel()], axis=1)


def from_camera_to_world(
    camera_to_world: Array, width: int, height: int, fx: float, fy: float, cx: float, cy: float
) -> Camera:
    """A camera from its pose: (4, 4) camera-to-world, OpenCV axes."""
    rotation, translation = camera_to_world[:3, :3], camera_to_world[:3, 3]
    inverse = np.eye(4)
    inverse[:3, :3] = rotation.T
    inverse[:3, 3] = -rotation.T @ translation
    return Camera(inverse, width, height, float(fx), float(fy), float(cx), float(cy))


def opencv_from_mitsuba(to_world: Array) -> Array:
    """Camera-to-world in OpenCV axes from Mitsuba's `to_world`; a uniform scale in it is dropped."""
    pose = to_world @ _MITSUBA_AXES
    pose = pose.copy()
    pose[:3, :3] /= np.linalg.norm(pose[:3, :3], axis=0, keepdims=True)
    return pose


def mitsuba_from_opencv(camera_to_world: Array) -> Array:
    """Mitsuba's `to_world` from a camera-to-world matrix in OpenCV axes."""
    return camera_to_world @ _MITSUBA_AXES


def opencv_from_opengl(transform_matrix: Array) -> Array:
    """Camera-to-world in OpenCV axes from the `transform_matrix` of transforms.json (OpenGL axes)."""
    return transform_matrix @ _OPENGL_AXES


def opengl_from_opencv(camera_to_world: Array) -> Array:
    """The `transform_matrix` of transforms.json (OpenGL axes) from an OpenCV camera-to-world matrix."""
    return camera_to_world @ _OPENGL_AXES


def look_at(position: Array, target: Array, up: Array) -> Array:
    """Camera-to-world in OpenCV axes that looks from position to target, (3,) each."""
    forward = target - position
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, up)
    right = right / np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
    pose[:3, 3] = position
    return pose


@dataclass(frozen=True)
class Gaze:
    """Where the viewer looks, in fractions of the frame's width and height; may lie outside of it.

    Raises:
        ValueError: a coordinate is not a finite number.
    """

    x: float = 0.5
    y: float = 0.5

    def __post_init__(self) -> None:
        if not np.all(np.isfinite([self.x, self.y])):
            raise ValueError(f"gaze ({self.x}, {self.y}) is not a pair of finite numbers")

    def pixel(self, width: int, height: int) -> tuple[float, float]:
        """Position in pixels."""
        return self.x * width, self.y * height


def require_within_frame(x: float, y: float) -> None:
    """Refuses a gaze, in fractions of the frame, with which nothing could be judged.

    Raises:
        UserError: it lies outside of the frame, or is not a number.
    """
    if not (0 <= x <= 1 and 0 <= y <= 1):
        raise UserError(f"--gaze {x} {y}: lies outside of the frame, 0..1 each")


def eccentricity(camera: Camera, gaze: Gaze) -> NDArray[np.float32]:
    """(H, W) angle in degrees between each pixel's ray and the gaze's ray, along the great circle."""
    angle = eccentricity_at(camera, gaze, camera.pixel_centres())
    return angle.reshape(camera.height, camera.width).astype(np.float32)


def eccentricity_at(camera: Camera, gaze: Gaze, pixels: Array) -> Array:
    """(N,) angle in degrees between the rays through pixel positions (N, 2) and the gaze's ray."""
    gaze_ray = camera.rays(np.array([gaze.pixel(camera.width, camera.height)]))[0]
    rays = camera.rays(pixels)
    # atan2 keeps its precision near zero, where arccos of a dot product loses half its digits.
    sine = np.linalg.norm(np.cross(rays, gaze_ray), axis=1)
    return np.degrees(np.arctan2(sine, rays @ gaze_ray))


@dataclass(frozen=True)
class Display:
    """The flat display that the viewer looks at, straight in front of its centre.

    A frame is shown pixel by pixel around the display's centre; one larger than the display would go on
    beyond its edges.

    Attributes:
        width, height: pixels.
        fov: width of the display in degrees, as the viewer sees it.
        luminance: of white, in cd/m2.

    Raises:
        UserError: a number is not finite or not positive, or the field of view is 180 degrees or more.
    """

    width: int
    height: int
    fov: float
    luminance: float = 200.0

    def __post_init__(self) -> None:
        for name in ("width", "height", "fov", "luminance"):
            value = getattr(self, name)
            if not isinstance(value, int | float) or not np.isfinite(value) or value <= 0:
                raise UserError(f"display: {name} is {value}; must be a positive number")
        if self.fov >= 180:
            raise UserError(f"display: fov is {self.fov}; a flat display spans less than 180 degrees")

    @property
    def focal(self) -> float:
        """Distance of the eye in pixels."""
        return float(self.width / 2 / np.tan(np.radians(self.fov) / 2))

    @property
    def pixels_per_degree(self) -> float:
        """At the centre, where there are fewest."""
        return float(np.radians(1) * self.focal)

    def viewer(self, width: int, height: int) -> Camera:
        """The eye as a camera: what angles the pixels of a frame of this size are seen under."""
        return Camera(np.eye(4), width, height, self.focal, self.focal, width / 2, height / 2)


# A 24-inch monitor at half a metre; the headset of Fov-GS's study, one eye.
DISPLAYS = {"desktop": Display(1920, 1080, 55.0), "hmd": Display(1440, 1700, 97.0, 100.0)}


def display_named(source: str) -> Display:
    """A display by name, or from a JSON file with width, height, fov and, if it is known, luminance.

    Raises:
        UserError: the file is missing, or no such display.
    """
    if source in DISPLAYS:
        return DISPLAYS[source]
    names = ", ".join(DISPLAYS)
    try:
        entry = json.loads(Path(source).read_text())
        if not isinstance(entry, dict):
            raise TypeError("not an object")
        known = {field.name for field in fields(Display)}
        unknown = sorted(set(entry) - known)
        if unknown:
            raise UserError(f"--display {source}: does not know {unknown[0]}")
        return Display(**entry)
    except OSError as error:
        raise UserError(f"--display {source}: must be {names} or a JSON file ({error.strerror})") from error
    except (ValueError, TypeError) as error:
        raise UserError(
            f"--display {source}: must be JSON with width, height and fov (degrees across), from which the "
            f"pixels per degree follow ({error})"
        ) from error
    except UserError as error:
        raise UserError(f"--display {source}: {str(error).removeprefix(f'--display {source}: ')}") from error


def camera_to_json(camera: Camera) -> dict[str, Any]:
    """Intrinsics and pose with the names of transforms.json."""
    return {
        "w": camera.width,
        "h": camera.height,
        "fl_x": camera.fx,
        "fl_y": camera.fy,
        "cx": camera.cx,
        "cy": camera.cy,
        "transform_matrix": opengl_from_opencv(camera.camera_to_world).tolist(),
    }


def camera_from_json(entry: dict[str, Any]) -> Camera:
    """Inverse of camera_to_json.

    Raises:
        KeyError: a name is missing.
        TypeError, ValueError: what it holds is not of its kind; a size must be a whole number of pixels.
    """
    pose = opencv_from_opengl(np.asarray(entry["transform_matrix"], dtype=np.float64))
    width, height = (_whole_pixels(entry, name) for name in ("w", "h"))
    return from_camera_to_world(pose, width, height, entry["fl_x"], entry["fl_y"], entry["cx"], entry["cy"])


def _whole_pixels(entry: dict[str, Any], name: str) -> int:
    value = entry[name]
    # Other programs write 640.0; true is a number only to Python.
    if isinstance(value, float) and value.is_integer():
        return int(value)
    if isinstance(value, bool) or not isinstance(value, int):
        raise ValueError(f"{name} is {value!r}; must be a whole number of pixels")
    return value
