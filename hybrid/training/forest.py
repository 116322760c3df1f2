"""From a frame set to a forest: training with checkpoints, and how good the result is."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from compose.base.errors import UserError
from hybrid.measure.metrics.similarity import quality
from hybrid.runtime.interrupts import interrupts_between_steps
from hybrid.training.fusion import fusion_steps, with_fusion
from pathtrace.dataset.exr import read_frame
from pathtrace.dataset.frames import FrameEntry, FrameSet
from splat.base.arrays import Arrays
from splat.io.forest_file import save_forest
from splat.io.tensors import FORMAT_VERSION, load_tensors, save_tensors
from splat.lod.pictures import ForestRenderer
from splat.model.forest import Forest, forest_of
from splat.training.initialization import TrainingView
from splat.training.layer import reduced
from splat.training.trainer import Trainer, TrainingSettings, most_layers

_CHECKPOINT_SECONDS = 30.0


def training_view(entry: FrameEntry) -> TrainingView:
    """A captured frame as the splats see it."""
    frame = read_frame(entry.file)
    # The normal is that of the mirror, not of what seems to lie behind it.
    cosine = (entry.camera.rays(entry.camera.pixel_centres()) @ entry.camera.camera_to_world[:3, 2]).reshape(
        frame.depth.shape
    )
    reflected = frame.unfolded * cosine > frame.depth * 1.001
    normal = np.where(reflected[..., None], 0, frame.normal).astype(np.float32)
    return TrainingView(entry.camera, frame.radiance, frame.unfolded, normal)


def checkpoint_path(forest: Path) -> Path:
    """Where an unfinished training of this forest lies."""
    return forest.with_name(forest.name + ".checkpoint")


def train_forest(
    arrays: Arrays,
    frames: FrameSet,
    path: Path,
    settings: TrainingSettings,
    progress: Callable[[int, int], None],
) -> tuple[Forest, float]:
    """Trains a forest, fits the fusion to it, and writes both; goes on where it was interrupted.

    Returns:
        The forest, and the seconds that training took in this process.

    Raises:
        UserError: a frame is damaged, there are none to train on, or the file cannot be written.
    """
    if not frames.training:
        raise UserError(f"{frames.folder}: holds no frames to train on")
    camera = frames.training[0].camera
    if most_layers(camera.width, camera.height) < settings.layers:
        raise UserError(
            f"{frames.folder}: frames of {camera.width} x {camera.height} pixels are too small for "
            f"{settings.layers} layers; they allow {most_layers(camera.width, camera.height)}, or capture "
            "larger ones"
        )
    start = time.perf_counter()
    views = [training_view(entry) for entry in frames.training]
    trainer = Trainer(arrays, views, settings)
    checkpoint = checkpoint_path(path)
    _restore(trainer, checkpoint, frames)
    saved = time.perf_counter()

    total = settings.iterations + fusion_steps(frames)

    def step(done: int) -> None:
        nonlocal saved
        progress(done, total)
        if time.perf_counter() - saved > _CHECKPOINT_SECONDS:
            _save(trainer, checkpoint, frames)
            saved = time.perf_counter()
        interrupted()

    with interrupts_between_steps() as interrupted:
        try:
            trainer.run(step)
        except KeyboardInterrupt:
            _save(trainer, checkpoint, frames)
            raise
    forest = forest_of(trainer.forest(), views[0].camera.fy, frames.scene_name, frames.scene_hash)
    if not forest.nodes.gaussians.is_finite():
        raise RuntimeError("training ended with numbers that are not finite")
    fit_step = lambda done, _: progress(settings.iterations + done, total)  # noqa: E731
    forest = with_fusion(arrays, frames, forest, settings.seed, fit_step)
    save_forest(path, forest)
    checkpoint.unlink(missing_ok=True)
    return forest, time.perf_counter() - start


def _save(trainer: Trainer, path: Path, frames: FrameSet) -> None:
    tensors, numbers = trainer.state()
    metadata = {
        "format_version": FORMAT_VERSION,
        "kind": "checkpoint",
        "frames": frames.digest,
        **numbers,
    }
    save_tensors(path, tensors, metadata)


def _restore(trainer: Trainer, path: Path, frames: FrameSet) -> None:
    if not path.is_file():
        return
    tensors, metadata = load_tensors(path)
    if metadata.get("kind") != "checkpoint" or metadata.get("frames") != frames.digest:
        raise UserError(f"{path}: not a checkpoint of this training; remove it to start anew")
    try:
        trainer.restore(tensors, metadata)
    except (ValueError, KeyError) as error:
        raise UserError(f"{path}: {error}; remove it to start anew") from error


def held_out_quality(arrays: Arrays, frames: FrameSet, forest: Forest) -> list[dict[str, Any]]:
    """Mean PSNR and SSIM over the held-out views of each layer alone, coarsest first.

    Layer l is compared with the frames reduced to its resolution, at that size.
    """
    renderer = ForestRenderer(arrays, forest)
    views = [training_view(entry) for entry in frames.held_out]
    rows = []
    for number, count in enumerate(forest.counts, start=1):
        factor = 2 ** (len(forest.counts) - number)
        found = []
        for view in views:
            small = reduced(view, factor)
            image = renderer.render_layer(small.camera, number).image()
            found.append(quality(image, small.radiance))
        means = (
            {name: float(np.mean([row[name] for row in found])) for name in ("psnr", "ssim")} if found else {}
        )
        rows.append({"layer": number, "nodes": count, **means})
    return rows
