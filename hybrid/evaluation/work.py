"""Progress of an evaluation over all kinds of its work."""

from __future__ import annotations

from collections.abc import Callable

from hybrid.evaluation.settings import EvaluationSettings

# Approximate milliseconds per step of each kind of work, from which the time left is estimated: per sample of
# a reference, in total, in total, per view, and per round of frames.
_COSTS = {"references": 4e-3, "tuning": 44e3, "costs": 72e3, "quality": 63e3, "times": 2.5e3}


class WorkProgress:
    """Adds up the progress of all kinds of work, weighted by what they take.

    Args:
        settings: of the evaluation.
        report: called with the kind of work, work done and work in total.
    """

    def __init__(self, settings: EvaluationSettings, report: Callable[[str, float, float], None]):
        samples = settings.width * settings.height * settings.reference_spp
        steps = {
            "references": settings.views * samples,
            "tuning": 1,
            "costs": 1,
            "quality": settings.views,
            "times": settings.repeats,
        }
        self._weight = {name: steps[name] * _COSTS[name] for name in steps}
        self._done = dict.fromkeys(steps, 0.0)
        self._report = report

    def of(self, kind: str) -> Callable[[int, int], None]:
        """The progress callback of one kind of work: called with steps done and steps in total."""

        def progress(done: int, total: int) -> None:
            self._done[kind] = self._weight[kind] * done / total
            self._report(kind, sum(self._done.values()), sum(self._weight.values()))

        return progress
