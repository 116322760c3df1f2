"""The rows of each sweep, and what of the base has no influence on them."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from typing import Any

import pytest

from compose.base.errors import UserError
from compose.camera.camera import View
from compose.eye.acuity import ACUITY_MODELS
from compose.fovea.foveation import FoveaMode
from hybrid.evaluation.sweep_catalogue import (
    FPC_BREAK_EVEN,
    FPC_TABLE_4,
    FPC_TABLE_5,
    SWEEPS,
    Setting,
    sweep_named,
)
from hybrid.measure.frame_times import jittered_view

COUNTS = (5, 20, 80)
ALL = (*SWEEPS, "layers")


def rows_of(name: str, base: Setting) -> list[Setting]:
    views = [jittered_view(View(base.camera), number) for number in range(3)]
    return sweep_named(name, COUNTS).settings(base, views)


def size(setting: Setting) -> tuple[int, int]:
    return setting.camera.width, setting.camera.height


@pytest.mark.parametrize(("name", "table"), [("resolution", FPC_TABLE_4), ("aspect", FPC_TABLE_5)])
def test_sizes_are_those_of_fpcs_tables(base, name, table):
    rows = rows_of(name, base)
    assert [size(row) for row in rows] == list(table)
    assert [row.varied for row in rows] == [{"width": w, "height": h} for w, h in table]
    assert [row.paper["ratio"] for row in rows] == [ours / full for ours, full in table.values()]
    assert {row.frame for row in rows} == {base.frame}


def test_radii_are_swept_at_each_size_with_the_band_in_proportion(base):
    rows = rows_of("radius", base)
    expected = list(product(FPC_BREAK_EVEN, range(10, 100, 10)))
    assert [(size(row), row.varied["radius"]) for row in rows] == expected
    for row in rows:
        assert row.frame.fov_a == row.varied["radius"]
        assert row.frame.fov_b == pytest.approx(row.frame.fov_a * base.frame.fov_b / base.frame.fov_a)
        assert (row.varied["width"], row.varied["height"]) == size(row)


def test_samples_are_swept_against_full_frames_of_one_sample_as_well(base):
    rows = rows_of("spp", base)
    assert [(row.frame.spp, row.frame.fov_a) for row in rows] == list(product((1, 2, 4, 6), (10, 20, 50, 90)))
    assert {size(row) for row in rows} == {(1012, 1061)}
    for row in rows:
        assert row.over_one_spp
        assert row.varied == {"spp": row.frame.spp, "radius": row.frame.fov_a}
    # FPC has figures at radii of 10 and 90 %: 200, 100, 192 and 67 frames per second over 150.
    papers = [row.paper.get("ratio_1spp") for row in rows[:8]]
    assert papers == [200 / 150, None, None, 100 / 150, 192 / 150, None, None, 67 / 150]


def test_views_are_those_of_the_scene_at_fpcs_sizes(base):
    rows = rows_of("view", base)
    keys = [(row.varied["width"], row.varied["view"], row.varied["radius"]) for row in rows]
    assert keys == list(product((1280, 3316), (0, 1, 2), (20, 50)))
    assert len({row.camera.key for row in rows}) == 2 * 3
    assert [row.frame.fov_a for row in rows[:2]] == [20, 50]


def test_bands_have_four_widths_at_four_radii(base):
    rows = rows_of("band", base)
    expected = [(a, a * share) for a in (10, 20, 30, 40) for share in (0.25, 0.5, 0.75, 1)]
    assert [(row.frame.fov_a, row.frame.fov_b) for row in rows] == expected
    assert [(row.varied["fov_a"], row.varied["fov_b"]) for row in rows] == expected


def test_all_acuity_models_and_all_foveas_have_their_row(base):
    assert [row.frame.acuity_model for row in rows_of("acuity", base)] == list(ACUITY_MODELS)
    rows = rows_of("denoiser", base)
    assert [(row.frame.spp, row.frame.fovea) for row in rows] == list(product((1, 2, 4, 16), FoveaMode))
    assert rows[1].varied == {"fovea": "denoised", "spp": 1}


def test_targets_choose_from_radii_samples_and_foveas(base):
    rows = rows_of("trade", base)
    made = {(row.frame.fov_a, row.frame.spp, row.frame.fovea) for row in rows}
    assert made == set(product((5, 10, 20, 30), (1, 2, 4, 8), (FoveaMode.DENOISED, FoveaMode.FUSED)))
    assert len(rows) == 32
    for row in rows:
        frame = row.frame
        assert row.varied == {
            "fovea": frame.fovea.value,
            "spp": frame.spp,
            "fov_a": frame.fov_a,
            "fov_b": frame.fov_b,
        }


def test_layers_are_left_out_at_either_end(base):
    rows = rows_of("layers", base)
    assert [row.frame.layers for row in rows] == [(1, 1), (1, 2), (1, 3), (2, 3), (3, 3)]
    assert [row.varied["gaussians"] for row in rows] == [5, 20, 80, 80, 80]
    assert [row.varied["layers"] for row in rows][3] == "2 to 3"


@pytest.mark.parametrize("name", ALL)
def test_no_two_rows_of_a_sweep_are_varied_alike(base, name):
    rows = rows_of(name, base)
    assert len({str(row.varied) for row in rows}) == len(rows) > 1
    assert len({tuple(row.varied) for row in rows}) == 1


# Other values of what a command may set, and what they change of a base.
OTHERS: dict[str, dict[str, Any]] = {
    "fovea": {"fovea": FoveaMode.DENOISED},
    "fov_b": {"fov_b": 10.0},
    "fov_a": {"fov_a": 25.0},
    "spp": {"spp": 3},
    "acuity_model": {"acuity_model": "stelacsf"},
}


@pytest.mark.parametrize(("name", "quantity"), list(product(ALL, OTHERS)))
def test_a_quantity_is_ignored_where_it_changes_no_row_and_nowhere_else(base, name, quantity):
    other = replace(base, frame=replace(base.frame, **OTHERS[quantity]))
    changed = rows_of(name, base) != rows_of(name, other)
    assert changed == (quantity not in sweep_named(name, COUNTS).ignored)


@pytest.mark.parametrize("name", ALL)
def test_a_size_is_ignored_where_the_sweep_sets_it(base, name):
    other = replace(base, camera=base.camera.resized(60, 40))
    sizes, others = ([size(row) for row in rows_of(name, one)] for one in (base, other))
    assert (sizes != others) == ("size" not in sweep_named(name, COUNTS).ignored)


@pytest.mark.parametrize("name", ALL)
def test_references_are_needed_for_quality_only(name):
    sweep = sweep_named(name, COUNTS)
    assert sweep.with_quality == ("reference_spp" not in sweep.ignored)
    assert sweep.with_quality == (name in ("band", "acuity", "trade", "denoiser", "paths", "layers"))


def test_a_sweep_that_does_not_exist_is_named():
    with pytest.raises(UserError, match=r"sweep over moon: must be over resolution, aspect.* or layers"):
        sweep_named("moon", (1,))
