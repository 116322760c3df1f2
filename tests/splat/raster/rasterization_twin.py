"""A plain float64 twin of `splat.rasterization` in NumPy: one camera and one Gaussian at a time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]


@dataclass
class Options:
    """Arguments that are not differentiated."""

    width: int
    height: int
    eps2d: float = 0.3
    near_plane: float = 0.01
    far_plane: float = 1e10
    radius_clip: float = 0.0
    sh_degree: int | None = None
    render_mode: str = "RGB"
    rasterize_mode: str = "classic"


def rotation_matrix(quat: Float) -> Float:
    """(3, 3) of a quaternion, w first: the vector part turns by twice its cross products."""
    w, *v = quat / np.linalg.norm(quat)
    cross = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
    return np.eye(3) + 2 * w * cross + 2 * cross @ cross


def harmonics(degree: int, d: Float) -> Float:
    """((degree + 1)^2,) real spherical harmonics of a direction, with the signs of 3D Gaussian splatting."""
    x, y, z = d / np.linalg.norm(d)
    root = lambda number: np.sqrt(number / np.pi)  # noqa: E731
    basis = [
        root(1 / 4),
        -root(3 / 4) * y,
        root(3 / 4) * z,
        -root(3 / 4) * x,
        root(15 / 4) * x * y,
        -root(15 / 4) * y * z,
        root(5 / 16) * (3 * z * z - 1),
        -root(15 / 4) * x * z,
        root(15 / 16) * (x * x - y * y),
        -root(35 / 32) * y * (3 * x * x - y * y),
        root(105 / 4) * x * y * z,
        -root(21 / 32) * y * (5 * z * z - 1),
        root(7 / 16) * z * (5 * z * z - 3),
        -root(21 / 32) * x * (5 * z * z - 1),
        root(105 / 16) * z * (x * x - y * y),
        -root(35 / 32) * x * (x * x - 3 * y * y),
    ]
    return np.array(basis[: (degree + 1) ** 2])


@dataclass
class Splat:
    """A Gaussian on the film of a camera."""

    mean: Float  # (2,)
    inverse: Float  # (2, 2) of the covariance
    opacity: float
    radii: Float  # (2,)
    depth: float
    channels: Float


def project(v: dict[str, Float], n: int, c: int, o: Options) -> Splat | None:
    """Gaussian n as camera c sees it, or None if it is not drawn."""
    view, K = v["viewmats"][c], v["Ks"][c]
    x, y, z = view[:3, :3] @ v["means"][n] + view[:3, 3]
    if not o.near_plane <= z <= o.far_plane:
        return None
    (fx, cx), (fy, cy) = K[0, [0, 2]], K[1, [1, 2]]
    beyond_x, beyond_y = 0.15 * o.width / fx, 0.15 * o.height / fy
    tx = np.clip(x / z, -cx / fx - beyond_x, (o.width - cx) / fx + beyond_x)
    ty = np.clip(y / z, -cy / fy - beyond_y, (o.height - cy) / fy + beyond_y)
    J = np.array([[fx / z, 0, -fx * tx / z], [0, fy / z, -fy * ty / z]])
    M = J @ view[:3, :3] @ rotation_matrix(v["quats"][n]) @ np.diag(v["scales"][n])
    raw = M @ M.T
    covariance = raw + o.eps2d * np.eye(2)
    opacity = v["opacities"][n]
    if o.rasterize_mode == "antialiased":
        opacity = opacity * np.sqrt(np.linalg.det(raw) / np.linalg.det(covariance))
    mean = np.array([fx * x / z + cx, fy * y / z + cy])
    if opacity < 1 / 255:
        return None
    reach = min(3.33, np.sqrt(2 * np.log(255 * opacity)))
    radii = np.ceil(reach * np.sqrt(np.diag(covariance)))
    outside = (mean + radii <= 0).any() or (mean - radii >= [o.width, o.height]).any()
    if outside or (radii <= o.radius_clip).all():
        return None
    if "offsets" in v:
        mean = mean + v["offsets"][c, n]
    channels = colour(v, n, c, o) if "RGB" in o.render_mode else []
    depth = [z] if o.render_mode != "RGB" else []
    return Splat(mean, np.linalg.inv(covariance), opacity, radii, z, np.array([*channels, *depth]))


def colour(v: dict[str, Float], n: int, c: int, o: Options) -> Float:
    """(D,) of Gaussian n as camera c sees it."""
    own = v["colors"]
    of_camera = own.ndim == (3 if o.sh_degree is None else 4)
    own = own[c, n] if of_camera else own[n]
    if o.sh_degree is None:
        return own
    eye = np.linalg.inv(v["viewmats"][c])[:3, 3]
    basis = harmonics(o.sh_degree, v["means"][n] - eye)
    return np.maximum(basis @ own[: len(basis)] + 0.5, 0)


def render(v: dict[str, Float], o: Options) -> tuple[Float, Float]:
    """Images (C, H, W, X) and opacities (C, H, W, 1) of named inputs; `offsets` (C, N, 2) move means2d."""
    images, opacities = [], []
    pixels = np.stack(np.meshgrid(np.arange(o.width) + 0.5, np.arange(o.height) + 0.5), axis=-1)
    for c in range(len(v["viewmats"])):
        found = [splat for n in range(len(v["means"])) if (splat := project(v, n, c, o))]
        size = o.height, o.width
        channels = (v["colors"].shape[-1] if "RGB" in o.render_mode else 0) + (o.render_mode != "RGB")
        image, left, going = np.zeros((*size, channels)), np.ones(size), np.ones(size, dtype=bool)
        for splat in sorted(found, key=lambda splat: splat.depth):
            d = pixels - splat.mean
            power = -0.5 * np.einsum("hwi,ij,hwj->hw", d, splat.inverse, d)
            alpha = np.minimum(splat.opacity * np.exp(power), 0.999)
            going &= (alpha < 1 / 255) | (left * (1 - alpha) > 1e-4)
            weight = np.where(going & (alpha >= 1 / 255), alpha * left, 0)
            image += weight[..., None] * splat.channels
            left = left - weight
        if "backgrounds" in v and "RGB" in o.render_mode:
            behind = np.append(v["backgrounds"][c], np.zeros(channels - v["backgrounds"].shape[-1]))
            image += left[..., None] * behind
        if "ED" in o.render_mode:
            image[..., -1] /= np.maximum(1 - left, 1e-10)
        images.append(image)
        opacities.append((1 - left)[..., None])
    return np.stack(images), np.stack(opacities)


def slopes(v: dict[str, Float], name: str, o: Options, by_image: Float, by_opacity: Float) -> Float:
    """Derivatives of sum(by_image * image) + sum(by_opacity * opacity) by each number of an input.

    By differences so small that no pixel crosses the cut at 1/255.
    """
    found, step = np.zeros(v[name].shape), 1e-6
    for index in np.ndindex(found.shape):
        values = []
        for sign in (-1, 1):
            moved = v[name].copy()
            moved[index] += sign * step
            image, opacity = render(v | {name: moved}, o)
            values.append((by_image * image).sum() + (by_opacity * opacity).sum())
        found[index] = (values[1] - values[0]) / (2 * step)
    return found


def sample(count: int, cameras: int = 2, channels: tuple[int, ...] = (3,), seed: int = 0) -> dict[str, Float]:
    """Overlapping Gaussians in front of cameras that look at them from the side, in no special position."""
    rng = np.random.default_rng(seed)
    viewmats = np.tile(np.eye(4), (cameras, 1, 1))
    for c in range(cameras):
        viewmats[c, :3, :3] = rotation_matrix(np.array([1, 0.05 * c, 0.1 - 0.2 * c, 0.03]))
        viewmats[c, :3, 3] = 0.1 * c, -0.05, 3
    return {
        "means": rng.normal(scale=0.4, size=(count, 3)),
        "quats": rng.normal(size=(count, 4)) * 2,
        "scales": rng.uniform(0.05, 0.4, size=(count, 3)),
        "opacities": rng.uniform(0.2, 0.95, size=count),
        "colors": rng.uniform(0, 1, size=(count, *channels)),
        "viewmats": viewmats,
        "Ks": np.tile(np.array([[24.0, 0, 13], [0, 26, 9.5], [0, 0, 1]]), (cameras, 1, 1)),
    }
