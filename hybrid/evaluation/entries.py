"""The ways to make a frame that an evaluation compares, at what each costs."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, replace

from compose.camera.camera import Camera
from compose.eye.gaze import Gaze
from compose.fovea.mode import FoveaMode
from hybrid.evaluation.budgets import NEAR, Tuning, at_equal_time, families
from hybrid.evaluation.settings import EvaluationSettings
from hybrid.frame.renderer import Renderer
from hybrid.methods.hybrid import HybridMethod
from hybrid.methods.method import Method
from hybrid.methods.splats import SplatsAlone
from hybrid.store.journal import Journal
from pathtrace.trace.tracer import Tracer

# The method whose rays and time the others get.
OURS = "hybrid, fused"
# Samples per pixel of further hybrid frames: from which on their foveas pass the splats.
OTHER_SPP = (1, 2, 4, 16)


@dataclass(frozen=True)
class Entry:
    """One way to make a frame.

    Attributes:
        name: of the method.
        budget: in what it was made equal to OURS: equal-rays, equal-time, or fixed for none.
        method: renders it.
        briefly: whether a few frames are enough to time it.
    """

    name: str
    budget: str
    method: Method
    briefly: bool = False

    @property
    def title(self) -> str:
        """The same for entries that make the same frames under the same name, and only for those."""
        return ", ".join((self.name, self.budget, json.dumps(self.method.settings, sort_keys=True)))


def hybrid_entries(renderer: Renderer, settings: EvaluationSettings) -> list[Entry]:
    """This project's frames, by how the fovea is made, and by sample count."""

    def made(mode: FoveaMode, spp: int) -> HybridMethod:
        return HybridMethod(renderer, replace(settings.frame, fovea=mode, spp=spp))

    entries = [Entry(f"hybrid, {mode.value}", "fixed", made(mode, settings.frame.spp)) for mode in FoveaMode]
    for spp in OTHER_SPP:
        if spp != settings.frame.spp:
            entries.append(Entry(f"{OURS}, {spp} spp", "fixed", made(FoveaMode.FUSED, spp), briefly=True))
    return entries


def splat_entries(splats: SplatsAlone, flat: SplatsAlone | None) -> list[Entry]:
    """Gaussians alone: those of the forest, and a model without trees if there is one."""
    entries = [Entry("splats alone", "fixed", splats)]
    return entries if flat is None else [*entries, Entry("3dgs, no forest", "fixed", flat)]


def baseline_entries(
    ours: Entry,
    tracer: Tracer,
    tuning: Tuning,
    camera: Camera,
    gaze: Gaze,
    costs: Journal,
    progress: Callable[[int, int], None],
) -> list[Entry]:
    """What traces paths, at the rays and at the time of ours.

    A peer that takes more rays even at its cheapest is there at that, as fixed: it is given more than ours.
    One that meets both budgets with the same settings stands in both rows.

    Args:
        ours: whose cost is to be met.
        tracer: of the scene.
        tuning: of the peers.
        camera, gaze: what is rendered.
        costs: keeps what met the time, so that the same is taken ever after.
        progress: called with peers done and peers in all.
    """
    rays = ours.method.rays(camera, gaze)
    known = families(tracer, tuning)
    entries = []
    for number, (name, family) in enumerate(known.items()):
        equal = family(rays)
        affordable = equal.rays(camera, gaze) <= rays * (1 + NEAR)
        budget = "equal-rays" if affordable else "fixed"
        entries.append(Entry(name, budget, equal, briefly=affordable))
        met = costs.once(name, lambda: at_equal_time(family, ours.method, camera, gaze, rays))  # noqa: B023
        if met is not None:
            entries.append(Entry(name, "equal-time", family(met)))
        progress(number + 1, len(known))
    return entries
