"""Folders of frames in the layouts of others: a striped ball that rises before a checkered wall, ray cast."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from PIL import Image
from scipy.spatial.transform import Rotation

from compose.camera.camera import Camera, camera_from_pose, look_at
from compose.camera.coordinate_systems import opengl_from_opencv
from pathtrace.dataset.posed_images import Lens

WIDTH, HEIGHT, FOCAL = 48, 32, 45.0
RADIUS, WALL = 0.5, 1.5
# How files of the second layout are scaled and moved.
SCALE, CENTRE = 0.4, np.array([0.3, -0.2, 0.5])


def camera(number: int, width: int = WIDTH, height: int = HEIGHT) -> Camera:
    """One of the cameras around the ball, which look at it from the front."""
    angle, up = 0.5 * np.sin(1.7 * number), 0.4 * np.cos(2.3 * number)
    position = 3.0 * np.array([np.sin(angle), up, -np.cos(angle)])
    pose = look_at(position, np.zeros(3), np.array([0.0, -1.0, 0.0]))
    focal = FOCAL * width / WIDTH
    return camera_from_pose(pose, width, height, focal, focal, width / 2, height / 2)


def ball_centre(time: float) -> np.ndarray:
    """(3,) where the ball is at a time."""
    return np.array([0.0, 0.15 - 0.3 * time, 0.0])


def cast(view: Camera, time: float, rays: np.ndarray | None = None) -> tuple[np.ndarray, ...]:
    """Distance (H, W), whether it is the ball's (H, W), and colour (H, W, 3) in sRGB of what is seen."""
    rays = view.rays(view.pixel_centres()) if rays is None else rays
    start = view.position - ball_centre(time)
    b = rays @ start
    root = b**2 - (start @ start - RADIUS**2)
    ball = root > 0
    wall = (WALL - view.position[2]) / rays[:, 2]
    distance = np.where(ball, -b - np.sqrt(np.maximum(root, 0)), wall)
    point = view.position + rays * distance[:, None]
    stripes = np.sin(5 * (point - ball_centre(time))[:, 1]) > 0
    checks = (np.floor(point[:, 0]) + np.floor(point[:, 1])) % 2 > 0
    colour = np.where(stripes[:, None], [0.9, 0.3, 0.2], [0.8, 0.7, 0.1])
    colour = np.where(ball[:, None], colour, np.where(checks[:, None], [0.2, 0.4, 0.7], [0.5, 0.6, 0.6]))
    shape = view.height, view.width
    return distance.reshape(shape), ball.reshape(shape), colour.reshape(*shape, 3)


def _bytes(colour: np.ndarray) -> np.ndarray:
    return (255 * colour + 0.5).astype(np.uint8)


def write_synthetic(
    folder: Path, training: int = 6, held_out: int = 2, moving: bool = True, alpha: bool = True
) -> Path:
    """A folder in the layout of D-NeRF, or of NeRF's synthetic scenes if nothing moves: the ball alone."""
    for split, numbers in (("train", range(training)), ("test", range(training, training + held_out))):
        (folder / split).mkdir(parents=True)
        frames = []
        for place, number in enumerate(numbers):
            time = place / max(1, len(numbers) - 1) if moving else 0.0
            view = camera(number)
            _, ball, colour = cast(view, time)
            rgba = np.dstack([_bytes(colour), np.where(ball, 255, 0 if alpha else 255).astype(np.uint8)])
            Image.fromarray(rgba).save(folder / split / f"r_{place:03d}.png")
            pose = opengl_from_opencv(view.camera_to_world).tolist()
            entry = {"file_path": f"./{split}/r_{place:03d}", "transform_matrix": pose}
            frames.append(entry | ({"time": time} if moving else {}))
        angle = 2 * np.arctan(WIDTH / 2 / FOCAL)
        text = json.dumps({"camera_angle_x": angle, "frames": frames})
        (folder / f"transforms_{split}.json").write_text(text)
    return folder


def write_nerfies(
    folder: Path,
    training: int = 6,
    held_out: int = 2,
    labels: str | None = None,
    points: bool = True,
    lens: Lens | None = None,
) -> Path:
    """A folder in the layout of Nerfies; with labels that end in .png or .png.png, that of NeRF-DS."""
    count = training + held_out
    names = [f"{number:06d}" for number in range(count)]
    held = {round((i + 1) * count / (held_out + 1)) - 1 for i in range(held_out)}
    for sub in ("rgb/1x", "rgb/2x", "camera", *(["mask/1x"] if labels else [])):
        (folder / sub).mkdir(parents=True)
    seen = []
    for number, name in enumerate(names):
        view, time = camera(number), number / max(1, count - 1)
        distance, ball, colour = cast(view, time, None if lens is None else _rays_through(view, lens))
        image = Image.fromarray(_bytes(colour))
        image.save(folder / f"rgb/1x/{name}.png")
        image.resize((WIDTH // 2, HEIGHT // 2), Image.Resampling.BOX).save(folder / f"rgb/2x/{name}.png")
        if labels:
            moves = ball if labels == ".png" else ~ball
            Image.fromarray((255 * moves).astype(np.uint8)).save(folder / f"mask/1x/{name}{labels}")
        found = {
            "orientation": view.world_to_camera[:3, :3].tolist(),
            "position": (view.position / SCALE + CENTRE).tolist(),
            "focal_length": view.fx,
            "principal_point": [view.cx, view.cy],
            "skew": 0.0 if lens is None else lens.skew,
            "pixel_aspect_ratio": 1.0,
            "radial_distortion": [0.0] * 3 if lens is None else lens.radial,
            "tangential_distortion": [0.0] * 2 if lens is None else lens.tangential,
            "image_size": [WIDTH, HEIGHT],
        }
        (folder / f"camera/{name}.json").write_text(json.dumps(found))
        rays = view.rays(view.pixel_centres())
        seen.append((view.position + rays * distance.reshape(-1, 1))[::7])
    ids = {
        "ids": names,
        "train_ids": [name for number, name in enumerate(names) if number not in held],
        "val_ids": [name for number, name in enumerate(names) if number in held],
    }
    (folder / "dataset.json").write_text(json.dumps(ids))
    times = {name: {"warp_id": n, "appearance_id": n, "camera_id": 0} for n, name in enumerate(names)}
    (folder / "metadata.json").write_text(json.dumps(times))
    scene = {"scale": SCALE, "center": CENTRE.tolist(), "near": 1.5, "far": 6.0}
    (folder / "scene.json").write_text(json.dumps(scene))
    if points:
        np.save(folder / "points.npy", np.concatenate(seen) / SCALE + CENTRE)
    return folder


def write_colmap(folder: Path, count: int = 10, place: str = "sparse/0") -> Path:
    """A data set of COLMAP whose model is text, of the ball without time; cameras of two sizes in turns."""
    (folder / place).mkdir(parents=True, exist_ok=True)
    (folder / "images").mkdir()
    cameras, images, points = ["# cameras"], ["# images"], ["# points"]
    for number in range(2):
        view = camera(0, WIDTH >> number, HEIGHT >> number)
        numbers = [view.width, view.height, view.fx, view.fy, view.cx, view.cy]
        cameras.append(f"{number + 7} PINHOLE {' '.join(map(str, numbers))}")
    for number in range(count):
        view = camera(number, WIDTH >> number % 2, HEIGHT >> number % 2)
        distance, _, colour = cast(view, 0.0)
        Image.fromarray(_bytes(colour)).save(folder / f"images/view {number:02d}.png")
        turn = Rotation.from_matrix(view.world_to_camera[:3, :3]).as_quat(scalar_first=True)
        pose = " ".join(map(repr, map(float, [*turn, *view.world_to_camera[:3, 3]])))
        # In no order; the line of what is seen may be empty.
        images[1:1] = [f"{number + 1} {pose} {number % 2 + 7} view {number:02d}.png", "1 2 -1" * (number % 2)]
        seen = view.position + view.rays(view.pixel_centres()) * distance.reshape(-1, 1)
        points += [f"{len(points)} {' '.join(map(repr, map(float, p)))} 9 9 9 0.5 1 0" for p in seen[::41]]
    for name, lines in (("cameras", cameras), ("images", images), ("points3D", points)):
        (folder / place / f"{name}.txt").write_text("\n".join([*lines, ""]))
    return folder


def _rays_through(view: Camera, lens: Lens) -> np.ndarray:
    """(N, 3) directions that a lens shows at the pixel centres: its inverse, by iteration in float64."""
    centres = view.pixel_centres()
    y = (centres[:, 1] - view.cy) / view.fy
    x = (centres[:, 0] - view.cx - lens.skew * y) / view.fx
    at_x, at_y = x.copy(), y.copy()
    for _ in range(200):
        found_x, found_y = lens.distorted(at_x, at_y)
        at_x, at_y = at_x + 0.5 * (x - found_x), at_y + 0.5 * (y - found_y)
    pixels = np.stack([at_x * view.fx + view.cx, at_y * view.fy + view.cy], axis=1)
    return view.rays(pixels)
