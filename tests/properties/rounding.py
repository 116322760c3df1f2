"""Measures what float32 costs: composites and gradients of random scenes against their float64 twins.

`python -m tests.properties.rounding [--scenes N] [--gradients N] [--json FILE]` prints tables.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

import splat
from splat.model.gaussians import Gaussians
from tests.properties import twin
from tests.properties.blending import blended
from tests.properties.random_scenes import RandomScene, random_scene
from tests.splat.raster import reference

# Standard deviations of the eye's coordinates, in units of a scene whose nearest Gaussians are 0.03 away.
SPREADS = (0.0, 2.0, 100.0)
# What may have moved a pixel; one that is about to jump for two reasons counts for the first of them.
CAUSES = ("rounding", "cut", "order", "stop")
_WORDS = {
    "rounding": "rounding alone",
    "cut": "an alpha within 0.1 % of the cut at 1/255",
    "order": "two depths that count as equal",
    "stop": "transmittance below 1e-4, where pixels stop",
}
# A gradient that is shorter than the longest one of its scene by this factor is none.
_VANISHING = 1e-9
_QUANTILES = {"min": 0.0, "median": 0.5, "90 %": 0.9, "99 %": 0.99, "99.9 %": 0.999, "worst": 1.0}


@dataclass
class Errors:
    """Errors of the pixels of many scenes, (P,) each, by cause.

    Attributes:
        absolute: largest difference of the three channels.
        relative: the same, each divided by its radiance where that is above 1.
        worst: seed of the scene, x, y and radiance of the pixel with the largest relative error.
    """

    absolute: dict[str, list[NDArray[np.float64]]] = field(default_factory=lambda: {c: [] for c in CAUSES})
    relative: dict[str, list[NDArray[np.float64]]] = field(default_factory=lambda: {c: [] for c in CAUSES})
    worst: dict[str, tuple[float, int, int, int, float]] = field(default_factory=dict)

    def add(self, seed: int, found: NDArray[np.float64], expected: twin.TwinImage) -> None:
        """Adds the pixels of one composite (H, W, 3)."""
        difference = np.abs(found - expected.radiance)
        absolute = difference.max(axis=2)
        relative = (difference / np.maximum(1, expected.radiance)).max(axis=2)
        free = np.ones(absolute.shape, dtype=bool)
        for cause in (*CAUSES[1:], CAUSES[0]):
            mask = free & expected.jumps[cause] if cause in expected.jumps else free
            free = free & ~mask
            self.absolute[cause].append(absolute[mask])
            self.relative[cause].append(relative[mask])
            if mask.any():
                y, x = np.unravel_index(np.where(mask, relative, -1).argmax(), mask.shape)
                here = float(relative[y, x]), seed, int(x), int(y), float(expected.radiance[y, x].max())
                self.worst[cause] = max(self.worst.get(cause, here), here)


def rendered(scene: RandomScene) -> NDArray[np.float64]:
    """(H, W, 3) the composite by the kernels."""
    periphery = splat.render(scene.gaussians, scene.camera).numpy()
    region = scene.foveation.region(scene.camera.width, scene.camera.height)
    return blended(periphery, scene.fovea, region).astype(np.float64)


def composite_errors(seeds: Iterable[int], spread: float = 2.0) -> Errors:
    """Errors of the composites of random scenes."""
    errors = Errors()
    for seed in seeds:
        scene = random_scene(seed, spread)
        errors.add(seed, rendered(scene), twin.composite(scene))
    return errors


def gradient_errors(seeds: Iterable[int], spread: float = 2.0) -> dict[str, NDArray[np.float64]]:
    """(scenes,) error of the gradient by each parameter, relative to its length, of random scenes.

    The loss is a smooth weighting of the image. Scenes in which a gradient vanishes, as that by the rotation
    of round Gaussians does, are left out.
    """
    errors: dict[str, list[float]] = {}
    for seed in seeds:
        scene = random_scene(seed, spread, most=100)
        found, expected = (_gradients(scene, dtype) for dtype in (torch.float32, torch.float64))
        least = _VANISHING * max(float(gradient.norm()) for gradient in expected.values())
        for name, gradient in expected.items():
            length = float(gradient.norm())
            if length > least:
                errors.setdefault(name, []).append(float((found[name] - gradient).norm()) / length)
    return {name: np.array(values) for name, values in errors.items()}


def _gradients(scene: RandomScene, dtype: torch.dtype) -> dict[str, torch.Tensor]:
    """float64 gradients by each parameter: of the kernels for float32, of the twin for float64."""
    leaves = {name: t.to(dtype).clone().requires_grad_() for name, t in scene.gaussians.tensors()}
    gaussians, camera = Gaussians(**leaves), scene.camera
    if dtype == torch.float32:
        image = splat.render(gaussians, camera)
    else:
        image = reference.render(gaussians, camera, twin.PIXEL_FILTER)
    x, y = torch.meshgrid(torch.arange(camera.width), torch.arange(camera.height), indexing="xy")
    weight = torch.stack([torch.sin(x / 9.0), torch.cos(y / 7.0), torch.sin((x + y) / 11.0)], dim=-1)
    (image * weight.to(dtype)).sum().backward()
    return {name: leaf.grad.double() for name, leaf in leaves.items()}


def distribution(values: NDArray[np.float64]) -> dict[str, float]:
    """Quantiles by name."""
    return {name: float(np.quantile(values, share)) for name, share in _QUANTILES.items()}


def composite_table(spread: float, errors: Errors) -> list[dict[str, object]]:
    """A row for each cause and kind of error."""
    pixels = sum(len(part) for parts in errors.absolute.values() for part in parts)
    rows: list[dict[str, object]] = []
    for cause in CAUSES:
        for kind in ("relative", "absolute"):
            values = np.concatenate(getattr(errors, kind)[cause])
            if len(values):
                share = f"{100 * len(values) / pixels:.2f} %"
                rows.append(
                    {"eye": f"{spread:g}", "pixels": _WORDS[cause], "share": share, "error": kind}
                    | distribution(values)
                )
    return rows


def markdown(rows: list[dict[str, object]]) -> str:
    """Rows of equal keys as a table."""
    cell = lambda value: f"{value:.1e}" if isinstance(value, float) else str(value)  # noqa: E731
    lines = [f"| {' | '.join(rows[0])} |", "|" + "---|" * len(rows[0])]
    return "\n".join(lines + [f"| {' | '.join(cell(value) for value in row.values())} |" for row in rows])


def main() -> None:
    """Measures and prints."""
    parser = argparse.ArgumentParser(description="float32 against float64, over random scenes")
    parser.add_argument("--scenes", type=int, default=1000, help="composites for each distance of the eye")
    parser.add_argument("--gradients", type=int, default=100, help="scenes whose gradients are compared")
    parser.add_argument("--json", type=Path, help="write the tables there as well")
    options = parser.parse_args()
    composites, worst, gradients = [], [], []
    for spread in SPREADS:
        errors = composite_errors(range(options.scenes), spread)
        composites += composite_table(spread, errors)
        for cause, (error, seed, x, y, radiance) in errors.worst.items():
            place = {"seed": seed, "pixel": f"{x}, {y}", "radiance": radiance, "error": error}
            worst.append({"eye": f"{spread:g}", "pixels": _WORDS[cause], **place})
        for name, values in gradient_errors(range(options.gradients), spread).items():
            row = {"eye": f"{spread:g}", "gradient by": name, "scenes": len(values)}
            gradients.append(row | distribution(values))
    tables = {"composite": composites, "worst": worst, "gradients": gradients}
    for name, rows in tables.items():
        print(f"\n{name}\n\n{markdown(rows)}")
    if options.json:
        options.json.write_text(json.dumps(tables, indent=1) + "\n")


if __name__ == "__main__":
    main()
