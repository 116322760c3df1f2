"""How well nodes that move are told from those that stand still, with masks and without."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid.bench.moving import require_moving
from hybrid.measure.dynamics import nodes_that_move
from hybrid.runtime.device import device_arrays
from hybrid.training.forest import motion_of
from hybrid.training.views import labelled_views
from pathtrace.dataset.frames import FrameSet
from pathtrace.scene.scene import Scene
from splat.model.motion_model import Labels, MotionModel
from splat.training.trainer import Trainer, TrainingSettings
from splat.training.views import TrainingView

# Motions and labels that are compared: as scenes are prepared, and as learned without courses.
_KINDS = (
    (MotionModel.KNOWN, Labels.MASKS),
    (MotionModel.D_GS_OF_DYNAMIC, Labels.MASKS),
    (MotionModel.D_GS_OF_DYNAMIC, Labels.FLOW),
)


def bench_separation(
    scene: Scene,
    frames: FrameSet,
    settings: TrainingSettings,
    progress: Callable[[int, int], None],
) -> list[dict[str, Any]]:
    """One row per motion and labels: how many nodes of the finest layer are labelled as the scene moves.

    Args:
        scene: which moves.
        frames: of the scene.
        settings: of the trainings.
        progress: called with steps done and steps in total.

    Returns:
        Rows of `motion`, `labels`, `precision` and `recall` of dynamic nodes against the scene's own surfaces
        (hybrid.measure.dynamics), `nodes` that count and how many of them are `dynamic`, how many `objects`
        these belong to, and `pixel_precision` and `pixel_recall` of the labels of pixels that the training
        began with, against the exact masks.

    Raises:
        UserError: nothing moves in the scene.
    """
    moving = require_moving(scene)
    times = [entry.time for entry in frames.training]
    exact = labelled_views(frames, TrainingSettings())
    rows, total = [], settings.iterations
    for number, (motion, labels) in enumerate(_KINDS):
        wanted = replace(settings, motion=motion, labels=labels)
        views = exact if labels is Labels.MASKS else labelled_views(frames, wanted)
        known = motion_of(frames.courses) if motion is MotionModel.KNOWN else None
        trainer = Trainer(device_arrays(), views, wanted, motion=known)
        trainer.run(_from(number * total, len(_KINDS) * total, progress))
        layer = trainer.forest()[-1]
        moves, counts = nodes_that_move(scene, moving, trainer, layer, times)
        dynamic = layer.dynamic.numpy()
        rows.append(
            {
                "motion": motion.value,
                "labels": labels.value,
                **_scores("", dynamic[counts], moves[counts]),
                "nodes": int(counts.sum()),
                "dynamic": int(dynamic[counts].sum()),
                "objects": len(np.unique(layer.semantic[layer.dynamic])),
                **_scores("pixel_", _moving(views), _moving(exact)),
            }
        )
    return rows


def _from(first: int, total: int, progress: Callable[[int, int], None]) -> Callable[[int], None]:
    """Tells how much is done of several trainings."""
    return lambda done: progress(first + done, total)


def _moving(views: list[TrainingView]) -> NDArray[np.bool_]:
    """Which pixels of all views show an instance."""
    return np.concatenate([view.instance.ravel() >= 0 for view in views if view.instance is not None])


def _scores(prefix: str, found: NDArray[np.bool_], truth: NDArray[np.bool_]) -> dict[str, float | None]:
    """Precision and recall of what is found; None of nothing."""
    both = int((found & truth).sum())
    return {
        f"{prefix}{name}": both / int(of.sum()) if of.any() else None
        for name, of in (("precision", found), ("recall", truth))
    }
