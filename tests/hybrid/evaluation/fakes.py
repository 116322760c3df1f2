"""Methods that render nothing, and what an evaluation might have found."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from compose.camera.camera import Camera, View
from compose.eye.gaze import Gaze
from hybrid.evaluation.methods import TimedImage
from hybrid.evaluation.results import NEAR, OURS

CAMERA = Camera(np.eye(4), 8, 8, 8.0, 8.0, 4.0, 4.0)
VIEW = View(CAMERA)


@dataclass(frozen=True)
class Costly:
    """A method that takes a fixed time and some per ray; nothing is rendered or waited for."""

    rays_per_pixel: float
    fixed: float
    per_ray: float

    @property
    def settings(self) -> dict[str, Any]:
        return {"rays": self.rays_per_pixel}

    def rays(self, camera: Camera, gaze: Gaze) -> float:
        return self.rays_per_pixel

    def render(self, view: View, gaze: Gaze, seed: int) -> TimedImage:
        total = self.fixed + self.per_ray * self.rays_per_pixel
        return TimedImage(np.zeros((8, 8, 3), np.float32), {"total": total})


@dataclass(frozen=True)
class Recorder:
    """A method that remembers what it was asked for; its frames take `spp` milliseconds."""

    spp: float
    cameras: list[Camera] = field(default_factory=list)
    gazes: list[Gaze] = field(default_factory=list)
    seeds: list[int] = field(default_factory=list)

    @property
    def settings(self) -> dict[str, Any]:
        return {"spp": self.spp}

    def rays(self, camera: Camera, gaze: Gaze) -> float:
        return self.spp

    def render(self, view: View, gaze: Gaze, seed: int) -> TimedImage:
        self.cameras.append(view.camera)
        self.gazes.append(gaze)
        self.seeds.append(seed)
        image = np.full((view.camera.height, view.camera.width, 3), 0.5, np.float32)
        return TimedImage(image, {"trace": 1.0, "total": float(self.spp)})


METHODS: dict[tuple[str, str], dict[str, Any]] = {
    (OURS, "fixed"): {"rays": 0.2, "fovea": "fused", "spp": 2},
    (f"{OURS}, 16 spp", "fixed"): {"rays": 1.6, "fovea": "fused", "spp": 16},
    ("splats alone", "fixed"): {"rays": 0.0},
    ("rmfr, tuned", "equal-time"): {"rays": 0.3},
    ("full", "fixed"): {"rays": 1.0},
}
# Foveal JOD and FLIP, and SSIM of the whole frame in two views; all are 30 dB from references of 40 and more.
_VALUES = {
    (OURS, "fixed"): (9.0, 0.10, (0.90, 0.80)),
    (f"{OURS}, 16 spp", "fixed"): (9.6, 0.05, (0.95, 0.85)),
    ("splats alone", "fixed"): (9.2, 0.11, (0.88, 0.79)),
    ("rmfr, tuned", "equal-time"): (8.0, 0.20, (0.70, 0.81)),
    ("full", "fixed"): (9.9, 0.01, (0.99, 0.99)),
}
_TIMES = [10.0, 40.0, 2.0, 10.0, 30.0]
_SETTINGS = {
    "width": 32,
    "height": 16,
    "gaze_x": 0.25,
    "gaze_y": 0.5,
    "spp": 2,
    "fov_a": 20.0,
    "fov_b": 15.0,
    "views": 2,
    "seeds": 1,
    "reference_spp": 4,
    "denoised_references": True,
}


def found() -> dict[str, Any]:
    """What an evaluation of two views found, as in evaluation.json, without its machine."""
    quality = []
    for (method, budget), (jod, flip, similarities) in _VALUES.items():
        for view in range(2):
            key = {"view": view, "seed": 0, "method": method, "budget": budget}
            quality += [
                {**key, "region": "foveal", "metric": "jod", "value": jod + (0.1, -0.1)[view == 0]},
                {**key, "region": "foveal", "metric": "flip", "value": flip},
                {**key, "region": "foveal", "metric": "psnr", "value": 30.0},
                {**key, "region": "whole", "metric": "ssim", "value": similarities[view]},
                {**key, "region": "whole", "metric": "psnr", "value": 30.0},
            ]
    return {
        "scene": "corner",
        "settings": dict(_SETTINGS),
        "display": {"width": 32, "height": 16, "fov": 1.0, "luminance": 200.0},
        "views": [{"view": view, "kind": NEAR, "time": 0.0} for view in range(2)],
        "references": [
            {"view": view, "region": region, "psnr": psnr + view}
            for view in range(2)
            for region, psnr in (("whole", 40.04), ("foveal", 50.0))
        ],
        "methods": [{"method": m, "budget": b, **entry} for (m, b), entry in METHODS.items()],
        "quality": quality,
        "time": [
            {"method": m, "budget": b, "ms": {"p50": t}} for (m, b), t in zip(METHODS, _TIMES, strict=True)
        ],
    }


def with_view(found: dict[str, Any], kind: str, metrics: dict[str, float]) -> None:
    """Adds a view of a kind, with our foveal and whole quality and that of RMFR, which is a tenth less."""
    number = len(found["views"])
    found["views"].append({"view": number, "kind": kind, "time": 0.0})
    for region in ("whole", "foveal"):
        found["references"].append({"view": number, "region": region, "psnr": 50.0})
        for (method, budget), factor in (((OURS, "fixed"), 1.0), (("rmfr, tuned", "equal-time"), 0.9)):
            key = {"view": number, "seed": 0, "method": method, "budget": budget, "region": region}
            found["quality"] += [
                {**key, "metric": metric, "value": factor * value} for metric, value in metrics.items()
            ]
