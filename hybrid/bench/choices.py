"""Settings that a plan decides: all fixed, all planned, and each planned alone."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

from hybrid.plan.appearance import DEGREE, FRAME_PRECISION, HALF, SINGLE
from hybrid.plan.detail import FIXED_GAUSSIANS, GAUSSIANS
from hybrid.plan.layers import FIXED_LAYERS, LAYERS
from hybrid.plan.paths import DEPTH, ROULETTE
from hybrid.plan.plan import ScenePlan
from hybrid.plan.samples import FIXED_SAMPLES, SAMPLES
from pathtrace.scene.scene import RUSSIAN_ROULETTE_DEPTH, Scene
from pathtrace.trace.depths import UNBOUNDED
from splat.io.precision import Precision
from splat.model.gaussians import MAX_DEGREE
from splat.training.trainer import TrainingSettings

FIXED, PLANNED = "fixed", "planned"


@dataclass(frozen=True)
class Choices:
    """One choice for each item; by default, those for a scene that nobody has looked at.

    Attributes:
        path_depth, roulette_depth: of all paths.
        samples: per pixel of training frames.
        frame_precision: of training frames in memory.
        degree: of the spherical harmonics.
        harmonics: whether Gaussians whose radiance is not seen to turn keep those above the constant one.
        layers, gaussians: of the forest, and of its finest layer.
        precision: of the numbers in its file.
    """

    path_depth: int = UNBOUNDED
    roulette_depth: int = RUSSIAN_ROULETTE_DEPTH
    samples: int = FIXED_SAMPLES
    frame_precision: str = SINGLE
    degree: int = MAX_DEGREE
    harmonics: bool = True
    layers: int = FIXED_LAYERS
    gaussians: int = FIXED_GAUSSIANS
    precision: Precision = Precision.FLOAT32

    @staticmethod
    def planned(plan: ScenePlan) -> Choices:
        """Those of a plan, and what is the default for every scene."""
        return Choices(
            plan.value(DEPTH),
            plan.value(ROULETTE),
            plan.value(SAMPLES),
            plan.value(FRAME_PRECISION),
            plan.value(DEGREE),
            False,
            plan.value(LAYERS),
            plan.value(GAUSSIANS),
            Precision.COMPACT,
        )

    def rows(self) -> dict[str, Choices]:
        """All fixed, each item alone as here, and all as here; items that are as if fixed are left out."""
        fixed = Choices()
        alone = {
            field.name.replace("_", " "): replace(fixed, **{field.name: getattr(self, field.name)})
            for field in fields(self)
        }
        rows = {FIXED: fixed, **alone, PLANNED: self}
        return {name: row for name, row in rows.items() if name in (FIXED, PLANNED) or row != fixed}

    def of(self, scene: Scene) -> Scene:
        """A scene with these paths."""
        return replace(scene.at_depth(self.path_depth), roulette_depth=self.roulette_depth)

    @property
    def frames(self) -> str:
        """Name of the frames that a forest is trained on."""
        return f"frames-{self.path_depth}-{self.samples}"

    @property
    def forest(self) -> str:
        """Name of the forest, whatever the precision of its file."""
        harmonics = "all" if self.harmonics else "turning"
        parts = self.frame_precision, self.degree, harmonics, self.layers, self.gaussians
        return "-".join(map(str, (f"forest-{self.path_depth}-{self.samples}", *parts)))

    def training(self, iterations: int, seed: int) -> TrainingSettings:
        """Settings of its training."""
        return TrainingSettings(
            iterations,
            self.gaussians,
            self.layers,
            self.degree,
            seed,
            all_harmonics=self.harmonics,
            half_frames=self.frame_precision == HALF,
        )

    def value(self, name: str) -> Any:
        """The choice of an item, by the name of its row."""
        value = getattr(self, name.replace(" ", "_"))
        return value.value if isinstance(value, Precision) else value
