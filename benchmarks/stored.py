"""What formats keep: the finest layer of a forest, and frames as a data set of COLMAP, out and in again.

The layer is fitted for other viewers first, as `hybrid export` does.

python -m benchmarks.stored SCENE --forest FOREST [--json FILE]
"""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from PIL import Image as PillowImage
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

import hybrid
from benchmarks import measure_forest
from compose.camera.camera import Array, Camera, turned
from compose.camera.coordinate_systems import Place
from compose.image.colour import decibels, srgb_from_radiance
from hybrid.base.compute_device import device_arrays
from hybrid.render.forest_attachments import own_views
from pathtrace.dataset.captured_frames import read_frame
from pathtrace.dataset.colmap_layout import write_colmap
from pathtrace.dataset.frame_set import CaptureSettings
from pathtrace.dataset.posed_layouts import read_posed_folder
from pathtrace.gltf.document import read_document
from pathtrace.gltf.gaussians import read_gaussians
from splat.io.compact import compact
from splat.io.forest_file import load_forest, save_forest
from splat.io.gltf_gaussians import gaussians_from
from splat.io.other_formats import load_gaussians, save_gaussians
from splat.io.ply import UNBOUND_FOCAL
from splat.model.forest import forest_of
from splat.model.gaussians import SH_DC, Blending, Gaussians, concatenated
from splat.model.points import from_world, in_world, quaternions_xyzw, rows_of
from splat.model.trees import static_layer
from splat.training.picture_fit import fitted_for_display

# Of the layer, by the ends of the files.
FORMATS = "forest", "ply", "glb", "spz", "sog", "ksplat", "splat"
_YAWS = 0.0, 90.0, 180.0, 270.0
_SIZE = 512
# What most Gaussians have is told: those that lie close together are taken for each other.
_MOST = 95


def stored(gaussians: Gaussians, place: Place, file: Path) -> Gaussians:
    """The Gaussians written and read again, in the format that the file's name tells."""
    if file.suffix == ".forest":
        layer = static_layer(from_world(gaussians, place))
        save_forest(file, compact(forest_of([layer], UNBOUND_FOCAL, "a", "", place)))
        return in_world(load_forest(file).finest, place).all_turning()
    save_gaussians(file, gaussians)
    if file.suffix == ".glb":
        return concatenated(
            [gaussians_from(**vars(part)) for part in read_gaussians(read_document(file), [])]
        )
    return load_gaussians(file)


def errors(sent: Gaussians, back: Gaussians) -> dict[str, float]:
    """How far 95 % of the Gaussians are at most from those nearest to them that came back.

    Of positions, in standard deviations along the shortest axis; of scales as a share, of rotations of those
    that are not round in degrees, of opacities and colours in 256ths.
    """
    nearest = cKDTree(rows_of(back.means)).query(rows_of(sent.means))[1]
    back = back.select(torch.from_numpy(nearest))
    shortest = sent.log_scales.min(dim=0).values.exp().double().numpy()
    moved = np.linalg.norm(rows_of(sent.means) - rows_of(back.means), axis=1) / shortest
    ours, theirs = (np.sort(rows_of(one.log_scales), axis=1) for one in (sent, back))
    opacity = (sent.opacity_logits.sigmoid() - back.opacity_logits.sigmoid()).numpy()
    colour = SH_DC * (rows_of(sent.sh[0]) - rows_of(back.sh[0]))
    found = {"position": moved, "scale": np.exp(np.abs(ours - theirs)) - 1, "rotation": _angles(sent, back)}
    found |= {"opacity": 256 * np.abs(opacity), "colour": 256 * np.abs(colour)}
    return {name: float(np.percentile(values, _MOST)) for name, values in found.items()}


def _angles(sent: Gaussians, back: Gaussians) -> Array:
    """(N,) degrees between the shortest axes, which formats may store as another one."""
    normals = []
    for one in (sent, back):
        axes = Rotation.from_quat(quaternions_xyzw(one)).as_matrix()
        normals.append(axes[np.arange(len(one)), :, rows_of(one.log_scales).argmin(axis=1)])
    cosine = np.abs(np.einsum("ni,ni->n", *normals))
    return np.degrees(np.arccos(np.clip(cosine, 0, 1)))


def pictures(gaussians: Gaussians, place: Place, cameras: list[Camera]) -> Array:
    """(V, H, W, 3) in sRGB."""
    import splat

    shown = (splat.render(gaussians, camera, place=place).numpy() for camera in cameras)
    return np.stack([srgb_from_radiance(image).astype(np.float64) for image in shown])


def psnr(ours: Array, theirs: Array) -> float:
    """Of pictures (V, H, W, 3), in decibels."""
    return decibels(float(((ours - theirs) ** 2).mean()))


def of_colmap(scene: hybrid.Scene, folder: Path) -> dict[str, Any]:
    """Frames of a scene as a data set of COLMAP, and what came back."""
    settings = CaptureSettings(views=8, held_out=0, width=128, height=128, spp=4)
    frames = hybrid.capture(scene, folder / "frames", settings)
    images, points = write_colmap(frames, folder / "colmap")
    found = read_posed_folder(folder / "colmap")
    pairs = list(zip(found.images, frames.entries, strict=True))
    pose = max(np.abs(a.camera.world_to_camera - b.camera.world_to_camera).max() for a, b in pairs)
    numbers = lambda camera: np.array([camera.fx, camera.fy, camera.cx, camera.cy])  # noqa: E731
    lens = max(np.abs(numbers(a.camera) - numbers(b.camera)).max() for a, b in pairs)
    shown = [np.asarray(PillowImage.open(a.file), np.float64) / 255 for a, _ in pairs]
    true = [srgb_from_radiance(read_frame(b.file).radiance) for _, b in pairs]
    size = sum(file.stat().st_size for file in (folder / "colmap").rglob("*") if file.is_file())
    picture = max(float(np.abs(a - b).max()) for a, b in zip(shown, true, strict=True))
    facts = {"images": images, "points": points, "bytes": size}
    return {**facts, "pose": float(pose), "lens": float(lens), "picture_256ths": 256 * picture}


def measured(name: str, forest: Path) -> dict[str, Any]:
    """All that is told of a scene and its forest."""
    scene, loaded = hybrid.load_scene(name), load_forest(forest)
    place, focal = loaded.place, loaded.focal_of(len(loaded.layers))
    views = own_views(loaded)
    fitted, _ = fitted_for_display(device_arrays(), loaded.finest, focal, views, 0)
    ours, sent = (in_world(one, place).all_turning() for one in (loaded.finest, fitted))
    view = scene.camera.resized(_SIZE, _SIZE)
    pose = view.camera_to_world
    cameras = []
    for yaw in _YAWS:
        turn = pose.copy()
        turn[:3, :3] = turned(pose[:3, :3], yaw, 0.0)
        cameras.append(view.at(turn))
    own, true = (pictures(one, place, cameras) for one in (ours, sent))
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for kind in FORMATS:
            file = Path(folder) / f"a.{kind}"
            back = stored(sent, place, file)
            row = {"format": kind, "bytes": file.stat().st_size, "degree": back.degree, "count": len(back)}
            rows.append({**row, **errors(sent, back), "psnr": psnr(true, pictures(back, place, cameras))})
        colmap = of_colmap(scene, Path(folder))
    return {
        "gaussians": len(sent), "degree": sent.degree, "formats": rows,
        "as_trained_psnr": psnr(own, pictures(replace(ours, blending=Blending.DISPLAY), place, cameras)),
        "fitted_psnr": psnr(own, true), "colmap": colmap,
    }  # fmt: skip


if __name__ == "__main__":
    measure_forest(__doc__, measured)
