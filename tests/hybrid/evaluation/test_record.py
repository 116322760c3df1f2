"""What is stored with a sweep's rows."""

from __future__ import annotations

import json
from dataclasses import asdict, replace

import pytest

from compose.camera.camera import View
from hybrid.base.identity import short_hash
from hybrid.evaluation import sweep_run as record
from hybrid.evaluation.sweep_catalogue import SWEEPS, SweepEffort, sweep_named
from hybrid.evaluation.sweep_run import identity_of, settings_of_row
from tests.hybrid.forests import white_dot

EFFORT = SweepEffort(3, 1, 4)


def identity(corner, rough, base, over: str = "band", effort: SweepEffort = EFFORT) -> str:
    sweep = sweep_named(over, rough.counts)
    found = identity_of(corner, rough, sweep, sweep.settings(base, [View(base.camera)]), effort)
    return short_hash(json.loads(json.dumps(found)))


def test_rows_depend_on_everything_that_they_are_measured_with(corner, rough, base):
    known = identity(corner, rough, base)
    assert identity(corner, rough, base) == known
    others = [
        identity(corner, white_dot((0, 0, 1)), base),
        identity(corner, rough, base, "denoiser"),
        identity(corner, rough, replace(base, camera=base.camera.resized(60, 40))),
        identity(corner, rough, replace(base, frame=replace(base.frame, spp=3))),
        identity(corner, rough, base, effort=SweepEffort(4, 1, 4)),
        identity(corner, rough, base, effort=SweepEffort(3, 2, 4)),
        identity(corner, rough, base, effort=SweepEffort(3, 1, 5)),
    ]
    assert len({known, *others}) == 1 + len(others)


def test_metrics_that_are_installed_later_are_measured_anew(corner, rough, base, monkeypatch):
    with_quality, without = (identity(corner, rough, base, over) for over in ("band", "radius"))
    monkeypatch.setattr(record, "missing", lambda: ["nothing is installed"])
    assert identity(corner, rough, base, "band") != with_quality
    assert identity(corner, rough, base, "radius") == without


@pytest.mark.parametrize("over", [*SWEEPS, "layers"])
def test_what_applied_to_all_rows_is_written_down_and_nothing_else(base, over):
    sweep = sweep_named(over, (1, 2))
    found = settings_of_row(sweep, base, EFFORT)
    assert found.pop("display") == asdict(base.frame.display)
    rows = [json.loads(json.dumps(one.frame.as_json())) for one in sweep.settings(base, [View(base.camera)])]
    for name in ("fovea", "fov_a", "fov_b", "spp", "acuity_model"):
        same = all(row[name] == rows[0][name] for row in rows)
        assert (name in found) == same, name
        assert found.get(name, rows[0][name]) == rows[0][name]
    assert ("width" in found) == ("size" not in sweep.sets)
    assert found.get("reference_spp") == (4 if sweep.with_quality else None)
    ratio = base.frame.fov_b / base.frame.fov_a
    assert found.get("fov_b_of_fov_a") == (ratio if sweep.scales_radii else None)
