"""The methods that an evaluation compares, and the budgets they get."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

from compose.camera.view import View
from compose.eye.gaze import Gaze
from compose.fovea.mode import FoveaMode
from hybrid.evaluation.equal_time import TOLERANCE, at_equal_time
from hybrid.evaluation.families import Tuning, families
from hybrid.evaluation.keys import EQUAL_RAYS, EQUAL_TIME, FIXED, OURS, Key
from hybrid.evaluation.settings import EvaluationSettings
from hybrid.frame.renderer import Renderer
from hybrid.methods.hybrid import HybridMethod
from hybrid.methods.method import Method
from hybrid.methods.splats import SplatsAlone
from hybrid.store.journal import Journal
from pathtrace.trace.tracer import Tracer

# Samples per pixel of further fused frames, which show from which count on they surpass the splats.
OTHER_SPP = (1, 2, 4, 16)


@dataclass(frozen=True)
class Entry:
    """A method at one budget.

    Attributes:
        name: of the method.
        budget: EQUAL_RAYS, EQUAL_TIME or FIXED.
        method: renders it.
        briefly: whether a few frames are enough to time it.
    """

    name: str
    budget: str
    method: Method
    briefly: bool = False

    @property
    def key(self) -> Key:
        """Identifies its results."""
        return Key(self.name, self.budget)

    @property
    def title(self) -> str:
        """Name in the journal: equal for entries of the same name that render the same frames, only."""
        return ", ".join((self.name, self.budget, json.dumps(self.method.settings, sort_keys=True)))


def hybrid_entries(renderer: Renderer, settings: EvaluationSettings) -> list[Entry]:
    """Hybrid frames with each fovea mode, and fused ones with other sample counts."""

    def hybrid(mode: FoveaMode, spp: int) -> HybridMethod:
        return HybridMethod(renderer, replace(settings.frame, fovea=mode, spp=spp))

    entries = [Entry(f"hybrid, {mode.value}", FIXED, hybrid(mode, settings.frame.spp)) for mode in FoveaMode]
    for spp in OTHER_SPP:
        if spp != settings.frame.spp:
            entries.append(Entry(f"{OURS}, {spp} spp", FIXED, hybrid(FoveaMode.FUSED, spp), briefly=True))
    return entries


def splat_entries(splats: SplatsAlone, flat: SplatsAlone | None) -> list[Entry]:
    """Splats alone: those of the forest, and if given a model without trees."""
    entries = [Entry("splats alone", FIXED, splats)]
    return entries if flat is None else [*entries, Entry("3dgs, no forest", FIXED, flat)]


def baseline_entries(
    ours: Entry,
    tracer: Tracer,
    tuning: Tuning,
    views: Sequence[View],
    gaze: Gaze,
    costs: Journal,
    progress: Callable[[int, int], None],
) -> list[Entry]:
    """Path-traced baselines at equal rays and at equal time.

    A baseline that takes more rays even at its cheapest is included as FIXED, with more than ours. One whose
    settings meet both budgets is included twice.

    Args:
        ours: the entry whose rays and time the baselines get.
        tracer: of the scene.
        tuning: of the baselines.
        views, gaze: what is rendered; rays are those of the first view.
        costs: stores the rays of equal time, so that later evaluations compare the same frames.
        progress: called with baselines done and baselines in total.
    """
    rays = ours.method.rays(views[0].camera, gaze)
    known = families(tracer, tuning)
    entries = []
    for number, (name, family) in enumerate(known.items()):
        equal = family(rays)
        affordable = equal.rays(views[0].camera, gaze) <= rays * (1 + TOLERANCE)
        entries.append(Entry(name, EQUAL_RAYS if affordable else FIXED, equal, briefly=affordable))
        met = costs.once(name, partial(at_equal_time, family, ours.method, views, gaze, rays))
        if met is not None:
            entries.append(Entry(name, EQUAL_TIME, family(met)))
        progress(number + 1, len(known))
    return entries
