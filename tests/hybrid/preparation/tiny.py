"""Preparations that take seconds."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest

from hybrid.preparation import preparation, stages
from hybrid.preparation.stages import Stage
from pathtrace.dataset.frame_set import CaptureSettings
from pathtrace.region import view_selection as selection

STAGES = (
    Stage(views=4, scale=1, spp=4, gaussians=300, steps=15),
    Stage(views=2, scale=1, spp=8, gaussians=500, steps=30),
    Stage(views=2, scale=2, spp=16, gaussians=700, steps=30),
)
JUDGED = CaptureSettings(views=1, held_out=3, width=32, height=32, spp=1, held_out_spp=4)


@contextmanager
def tiny_home(home: Path) -> Iterator[None]:
    """A cache folder in which all preparations are tiny, for fixtures that several tests share."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("HYBRID_HOME", str(home))
        make_tiny(patch.setattr)
        yield


def make_tiny(patch) -> None:
    """Makes all preparations tiny, by a function that sets an attribute, such as that of monkeypatch."""
    patch(stages, "STAGES", STAGES)
    patch(stages, "SIDE", 32)
    patch(stages, "_COARSEST", 16)
    more = replace(STAGES[-1], spp=32)
    qualities = {
        "glimpse": STAGES[:1],
        "draft": STAGES[:2],
        "standard": STAGES,
        "high": (*STAGES, more),
        "live": STAGES,
    }
    patch(stages, "QUALITIES", qualities)
    patch(preparation, "JUDGED", JUDGED)
    # Where viewers may be is small, too.
    patch(selection, "_VIEWERS", 160)
    patch(selection, "_CANDIDATES", 128)
    patch(selection, "_ROUND", 64)
