"""Which of two methods is ahead: intervals, verdicts, and sentences."""

from __future__ import annotations

import json
from statistics import mean, stdev
from typing import Any

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from compose.base.files import json_text
from compose.eye.display import Display
from compose.eye.gaze import Gaze
from compose.fovea.foveation import Foveation
from hybrid.evaluation.results import BEYOND, EQUAL_TIME, FIXED, NEAR, OURS, WIDE
from hybrid.evaluation.verdicts import (
    AHEAD,
    BEHIND,
    EQUAL,
    UNDECIDED,
    listed,
    mean_interval,
    sentences,
    verdict,
    verdict_rows,
)
from hybrid.measure.frame_quality import Viewer, metric_rows
from hybrid.measure.image_metrics import plain_regions, psnr
from tests import small
from tests.extremes import extreme
from tests.hybrid.evaluation import fakes
from tests.hybrid.evaluation.fakes import with_view


class TestInterval:
    @pytest.mark.parametrize(
        ("values", "level", "quantile"),
        [
            # Quantiles of Student's t, as tables have them, at n - 1 degrees of freedom.
            ([1.0, 3.0], 0.95, 12.706),
            ([1.0, 2.0, 4.0, 5.0, 8.0], 0.95, 2.776),
            ([1.0, 2.0, 4.0, 5.0, 8.0], 0.90, 2.132),
            ([2.0, 7.0, 1.0, 8.0, 2.0, 8.0, 1.0], 0.95, 2.447),
        ],
    )
    def test_few_values_have_students_t(self, values, level, quantile):
        reach = quantile * stdev(values) / len(values) ** 0.5
        expected = mean(values), mean(values) - reach, mean(values) + reach
        assert mean_interval(values, level) == pytest.approx(expected, rel=1e-3)

    @pytest.mark.parametrize("level", [0.90, 0.95])
    def test_more_values_have_the_studentized_bootstrap(self, level):
        """Against plain loops over the same resamplings."""
        values = [float(one) for one in small.rng().exponential(size=9)]
        count, average = len(values), mean(values)
        ratios = []
        for places in np.random.default_rng(0).integers(count, size=(4000, count)):
            picked = [values[place] for place in places]
            if len(set(picked)) > 1:
                ratios.append((mean(picked) - average) / (stdev(picked) / count**0.5))
        ratios.sort()

        def quantile(share: float) -> float:
            place = share * (len(ratios) - 1)
            low = int(place)
            return ratios[low] + (place - low) * (ratios[low + 1] - ratios[low])

        error, tail = stdev(values) / count**0.5, (1 - level) / 2
        expected = average, average - quantile(1 - tail) * error, average - quantile(tail) * error
        assert mean_interval(values, level) == pytest.approx(expected, rel=1e-9)

    @pytest.mark.parametrize("count", [2, 7, 8, 20])
    @pytest.mark.parametrize("value", [0.0, 0.1, -3.0])
    def test_equal_values_have_no_interval(self, count, value):
        assert mean_interval([value] * count, 0.95) == pytest.approx((value, value, value), abs=1e-12)

    def test_a_single_value_says_nothing_of_others(self):
        assert mean_interval([0.3], 0.95) == (0.3, -np.inf, np.inf)

    @extreme(
        "one view unlike all others",
        given="differences of 0.1 in eleven views and of 5 in one, which a third of all resamplings lack: "
        "those have no deviation but that of rounding",
        expected="Student's t: -0.39 to 1.41",
    )
    def test_almost_equal_values_have_students_t(self, got):
        found = mean_interval([0.1] * 11 + [5.0], 0.95)
        got(f"{found.low:.2f} to {found.high:.2f}")
        reach = 2.201 * 4.9 / 12
        assert found[1:] == pytest.approx((found.mean - reach, found.mean + reach), rel=1e-3)
        # As a part of the frame that matters in one view of many.
        assert verdict([0.0] * 19 + [0.004], "ssim")[1] == EQUAL

    @pytest.mark.parametrize(("count", "least"), [(5, 0.83), (12, 0.88)])
    def test_intervals_hold_the_mean_as_often_as_they_say(self, count, least):
        """Of 300 draws, whose share has a standard error of 1.3 %, from a skewed distribution of mean 1."""
        rng, held = small.rng(), 0
        for _ in range(300):
            found = mean_interval(list(rng.exponential(size=count)), 0.95)
            held += found.low <= 1 <= found.high
        assert least < held / 300 < 0.99


class TestVerdict:
    @pytest.mark.parametrize(
        ("differences", "metric", "says"),
        [
            ([0.03, 0.02, 0.04], "ssim", AHEAD),
            ([-0.03, -0.02, -0.04], "ssim", BEHIND),
            ([0.03, 0.02, 0.04], "flip", BEHIND),
            ([-0.03, -0.02, -0.04], "flip", AHEAD),
            ([0.3, 0.2, 0.4], "jod", AHEAD),
            ([0.3, -0.2, 0.4], "jod", UNDECIDED),
            ([0.03, 0.02, 0.04], "jod", EQUAL),
            ([3.0, 2.0, 4.0], "psnr", AHEAD),
            ([-0.03, 0.02, 0.04], "psnr", EQUAL),
            # Different beyond doubt, but by less than anyone sees.
            ([0.002, 0.002, 0.002], "ssim", EQUAL),
            # As little on average, but no two views agree.
            ([0.05, -0.05, 0.002], "ssim", UNDECIDED),
            ([0.0, 0.0, 0.0], "jod", EQUAL),
            ([0.0], "jod", UNDECIDED),
        ],
    )
    def test_it_follows_from_two_intervals(self, differences, metric, says):
        assert verdict(differences, metric)[1] == says

    def test_equal_is_what_two_one_sided_tests_say(self):
        """The 90 % interval lies within the margin of 0.1, that of 95 %, which is given, does not."""
        values = [0.06, 0.03, 0.09, 0.10, 0.02]
        found, says = verdict(values, "jod")
        assert mean(values) + 2.132 * stdev(values) / 5**0.5 < 0.1 < found.high
        assert found == mean_interval(values, 0.95)
        assert says == EQUAL
        # With a wider spread, the 90 % interval does not either; zero lies inside the 95 % interval.
        assert verdict([mean(values) + 2 * (one - mean(values)) for one in values], "jod")[1] == UNDECIDED


SIZE, VIEWS = 64, 10
GAZE = Gaze(0.5, 0.5)
VIEWER = Viewer(Display(SIZE, SIZE, 4.0), GAZE)
REGIONS = plain_regions(Foveation(GAZE, 40.0, 30.0), (SIZE, SIZE), ("whole", "foveal", "peripheral"))


def measured(noise_of_references: float) -> dict[str, Any]:
    """Real metrics of small pictures: of our frames, of two methods that deceive, and of a third one.

    "close" is the reference with little noise, "twin" our method by another name, with noise of its own;
    "worse" has twice our noise.
    """
    rng = small.rng()
    methods = {"hybrid, fused": FIXED, "close": EQUAL_TIME, "twin": EQUAL_TIME, "worse": EQUAL_TIME}
    found = {**fakes.found(), "quality": [], "references": [], "time": []}
    found["methods"] = [{"method": name, "budget": budget, "rays": 0.2} for name, budget in methods.items()]
    found["views"] = [{"view": view, "kind": NEAR, "time": 0.0} for view in range(VIEWS)]
    for view in range(VIEWS):
        texture = gaussian_filter(rng.normal(size=(SIZE, SIZE, 3)), (2, 2, 0))
        truth = (0.3 + 0.5 * texture).clip(0.05, 0.8)

        def noisy(image: np.ndarray, size: float) -> np.ndarray:
            return (image * (1 + size * rng.normal(size=image.shape))).astype(np.float32)

        reference = noisy(truth, noise_of_references)
        frames = {
            "hybrid, fused": noisy(truth, 0.08),
            "close": noisy(reference, 0.02),
            "twin": noisy(truth, 0.08),
            "worse": noisy(truth, 0.16),
        }
        found["references"] += [
            {"view": view, "region": name, "psnr": psnr(reference, truth.astype(np.float32), part.mask)}
            for name, part in REGIONS.items()
        ]
        for name, frame in frames.items():
            key = {"view": view, "seed": 0, "method": name, "budget": methods[name]}
            rows = metric_rows(frame, reference, REGIONS, VIEWER, wanted=("psnr", "ssim"))
            found["quality"] += [{**key, **row} for row in rows]
    return found


def said_of(found: dict[str, Any], baseline: str) -> dict[tuple[str, str], str]:
    rows = (row for row in verdict_rows(found) if row["baseline"] == baseline)
    return {(row["region"], row["metric"]): row["verdict"] for row in rows}


EVERYWHERE = [(region, metric) for region in REGIONS for metric in ("psnr", "ssim")]


@pytest.fixture(scope="module")
def good() -> dict[str, Any]:
    """References with a tenth of the noise of "close"."""
    return measured(0.002)


@pytest.fixture(scope="module")
def poor() -> dict[str, Any]:
    """References with as much noise as "close", which knows that noise, and a quarter of ours."""
    return measured(0.02)


class TestMethodsThatDeceive:
    def test_the_reference_with_a_little_noise_is_ahead_of_ours(self, good):
        assert said_of(good, "close") == dict.fromkeys(EVERYWHERE, BEHIND)

    def test_it_is_not_if_the_references_are_no_better_than_it_is(self, poor):
        """Though closer to them than ours in every view."""
        rows = [row for row in verdict_rows(poor) if row["baseline"] == "close"]
        assert len(rows) == len(EVERYWHERE)
        assert all(row["high"] < 0 and row["verdict"] == UNDECIDED for row in rows)

    def test_our_method_by_another_name_is_equal(self, good):
        assert said_of(good, "twin") == dict.fromkeys(EVERYWHERE, EQUAL)

    def test_other_methods_are_still_told_apart_by_poor_references(self, good, poor):
        """Their noise is 12 dB less than that of the better one of the two."""
        for found in (good, poor):
            assert said_of(found, "worse") == dict.fromkeys(EVERYWHERE, AHEAD)

    @pytest.mark.parametrize(("lead", "says"), [(5.9, UNDECIDED), (6.1, BEHIND)])
    def test_references_must_lead_by_6_db(self, good, lead, says):
        """The better one of the two has a mean squared error that is known from its PSNR."""
        errors = [
            10 ** (-row["value"] / 10)
            for row in good["quality"]
            if (row["method"], row["region"], row["metric"]) == ("close", "foveal", "psnr")
        ]
        truth = -10 * np.log10(mean(errors)) + lead
        references = [
            {**row, "psnr": float(truth)} if row["region"] == "foveal" else row for row in good["references"]
        ]
        found = said_of({**good, "references": references}, "close")
        assert found["foveal", "ssim"] == found["foveal", "psnr"] == says
        assert found["whole", "ssim"] == BEHIND

    def test_infinite_psnr_has_no_verdict_but_ssim_has(self, good):
        """A frame that equals its reference; JSON has null for its PSNR."""
        quality = [
            {**row, "value": np.inf if row["metric"] == "psnr" else 1.0} if row["method"] == "close" else row
            for row in good["quality"]
        ]
        found = json.loads(json_text({**good, "quality": quality}))
        assert said_of(found, "close") == dict.fromkeys(
            [one for one in EVERYWHERE if one[1] == "ssim"], UNDECIDED
        )
        # Of two such frames, neither is ahead; the references cannot lead them.
        same = [{**row, "value": None} if row["metric"] == "psnr" else row for row in good["quality"]]
        rows = [row for row in verdict_rows({**good, "quality": same}) if row["metric"] == "psnr"]
        assert {(row["difference"], row["verdict"]) for row in rows} == {(0.0, UNDECIDED)}


def test_rows_have_kinds_of_views_and_what_was_compared():
    found = fakes.found()
    with_view(found, WIDE, {"ssim": 0.5, "psnr": 20.0})
    rows = verdict_rows(found)
    (row,) = (r for r in rows if (r["views"], r["metric"], r["baseline"]) == (NEAR, "flip", "splats alone"))
    assert row == {
        "scene": "corner",
        "display": "32x16, 32 pixels per degree",
        "views": NEAR,
        "region": "foveal",
        "metric": "flip",
        "baseline": "splats alone",
        "budget": FIXED,
        "difference": pytest.approx(-0.01),
        "low": pytest.approx(-0.01),
        "high": pytest.approx(-0.01),
        # References of 50 and 51 dB, frames of 30.
        "lead": pytest.approx(-10 * np.log10((1e-5 + 10**-5.1) / 2) - 30),
        "verdict": AHEAD,
    }
    assert OURS not in {row["baseline"] for row in rows}
    # A single view is not enough to tell; nothing else was measured in it.
    wide = [row for row in rows if row["views"] == WIDE]
    assert {row["baseline"] for row in wide} == {"rmfr, tuned"}
    assert {row["verdict"] for row in wide} == {UNDECIDED}
    assert len(wide) == 4


def test_without_references_or_errors_nothing_is_decided():
    for region, missing in (("references", "region"), ("quality", "metric")):
        found = fakes.found()
        found[region] = [row for row in found[region] if row[missing] not in ("foveal", "psnr")]
        rows = [row for row in verdict_rows(found) if row["region"] == "foveal"]
        assert rows
        assert {row["verdict"] for row in rows} == {UNDECIDED}


START = "corner, 32x16, 32 pixels per degree, 2 views: "
FOVEA = START + "in the fovea, by "


def test_bad_news_come_first_and_only_affordable_baselines_count():
    assert sentences(fakes.found()) == [
        START + "over the whole frame, by SSIM, the hybrid frame cannot be told from splats alone (+0.015; "
        "-0.049 to +0.079) and rmfr, tuned (+0.095; -1.239 to +1.429): the views do not suffice.",
        FOVEA + "FovVideoVDP, the hybrid frame is behind splats alone (-0.20; -0.20 to -0.20).",
        FOVEA + "FovVideoVDP, the hybrid frame is ahead of rmfr, tuned (+1.00; +1.00 to +1.00).",
        FOVEA + "FLIP, the hybrid frame is ahead of splats alone (-0.010; -0.010 to -0.010) and "
        "rmfr, tuned (-0.100; -0.100 to -0.100).",
        "SSIM of the whole frame is higher than that of rectangular mapping-based foveated rendering (RMFR), "
        "tuned and at equal time, in 1 of 2 views (Foveated Path Culling: 2 of 5, untuned).",
        "By FovVideoVDP, the fused fovea is better than splats alone from 16 samples per pixel on.",
        "By FLIP, the fused fovea is better than splats alone from 2 samples per pixel on.",
    ]


def test_ablations_are_told_from_baselines():
    found = fakes.found()
    for name in ("methods", "quality", "time"):
        of_rmfr = [row for row in found[name] if row["method"] == "rmfr, tuned"]
        found[name] += [{**row, "method": "hybrid, without fusion"} for row in of_rmfr]
    assert [line for line in sentences(found) if line.startswith(FOVEA + "FLIP")] == [
        FOVEA + "FLIP, the hybrid frame is ahead of splats alone (-0.010; -0.010 to -0.010) and "
        "rmfr, tuned (-0.100; -0.100 to -0.100).",
        FOVEA + "FLIP, the hybrid frame is ahead of one without fusion (-0.100; -0.100 to -0.100).",
    ]


def test_it_is_said_why_nothing_is_decided():
    found = fakes.found()
    for row in found["references"]:
        row["psnr"] = 30.0
    lines = [line for line in sentences(found) if "the hybrid frame" in line and "in the fovea" in line]
    assert len(lines) == 2
    assert all(line.endswith(": the references are not close enough to the truth.") for line in lines)


def test_what_is_equal_is_said_before_what_is_ahead():
    found = fakes.found()
    for row in found["quality"]:
        if row["metric"] == "flip" and row["method"] == "splats alone":
            row["value"] = 0.101
    lines = [line for line in sentences(found) if "by FLIP, the hybrid frame" in line]
    assert lines == [
        FOVEA + "FLIP, the hybrid frame equals splats alone (-0.001; -0.001 to -0.001).",
        FOVEA + "FLIP, the hybrid frame is ahead of rmfr, tuned (-0.100; -0.100 to -0.100).",
    ]


@pytest.mark.parametrize(
    ("kind", "words"),
    [(BEYOND, " from beyond the prepared region"), (WIDE, " wider than any training view")],
)
def test_views_apart_have_sentences_of_their_own(kind, words):
    """Over the whole frame alone; a single view has no interval."""
    found = fakes.found()
    with_view(found, kind, {"ssim": 0.5, "flip": 0.1, "psnr": 20.0})
    assert [line for line in sentences(found) if words in line] == [
        f"corner, 32x16, 32 pixels per degree, 1 view{words}: over the whole frame, by SSIM, the hybrid "
        "frame cannot be told from rmfr, tuned (+0.050): the views do not suffice."
    ]


def test_what_was_not_measured_is_not_said():
    found = fakes.found()
    found["quality"] = [row for row in found["quality"] if row["metric"] != "jod"]
    assert not any("FovVideoVDP" in line for line in sentences(found))
    found["quality"] = [row for row in found["quality"] if row["method"] != "rmfr, tuned"]
    assert not any("rmfr" in line or "RMFR" in line for line in sentences(found))


@extreme(
    "an equal-time peer that drifted",
    given="a baseline at equal time that takes 20 % longer after the run",
    expected="marked as 20 % slower, never called equal",
)
def test_a_baseline_that_missed_equal_time_is_marked(got):
    found = fakes.found()
    for row in found["time"]:
        if row["method"] == "rmfr, tuned":
            row["over_ours"] = 1.2
    lines = sentences(found)
    marked = "rmfr, tuned (+1.00; +1.00 to +1.00; 20 % slower than the hybrid frame)"
    assert any(marked in line for line in lines)
    rmfr = next(line for line in lines if "RMFR" in line)
    assert "tuned and 20 % slower than the hybrid frame, in 1 of 2 views" in rmfr
    assert not any("equal time" in line for line in lines)
    got(marked)


def test_one_sample_may_be_enough():
    found = fakes.found()
    for row in found["methods"]:
        if row.get("spp") == 2:
            row["spp"] = 1
    lines = sentences(found)
    assert "By FLIP, the fused fovea is better than splats alone even at 1 sample per pixel." in lines
    assert (
        "By FovVideoVDP, the fused fovea is better than splats alone from 16 samples per pixel on." in lines
    )


def test_more_samples_that_are_worse_again_have_not_passed():
    found = fakes.found()
    found["methods"].append(
        {"method": f"{OURS}, 64 spp", "budget": "fixed", "rays": 9.0, "fovea": "fused", "spp": 64}
    )
    key = {"view": 0, "seed": 0, "method": f"{OURS}, 64 spp", "budget": "fixed", "region": "foveal"}
    found["quality"].append({**key, "metric": "flip", "value": 0.12})
    said = (
        "By FLIP, the fused fovea is better than splats alone at none of the sample counts that were tried "
        "(2, 16 and 64 per pixel)."
    )
    assert said in sentences(found)


def test_without_the_optional_metrics_the_fovea_is_compared_by_others():
    found = fakes.found()
    found["quality"] = [
        {**row, "metric": "ssim", "value": 1 - row["value"]} if row["metric"] == "flip" else row
        for row in found["quality"]
        if row["metric"] != "jod"
    ]
    lines = sentences(found)
    assert any(line.startswith(FOVEA + "SSIM, the hybrid frame is ahead of splats alone") for line in lines)
    # 30 dB all.
    assert any(line.startswith(FOVEA + "PSNR, the hybrid frame equals splats alone (+0.0;") for line in lines)


def test_splats_that_take_longer_are_not_compared_with():
    found = fakes.found()
    for row in found["time"]:
        if row["method"] == "splats alone":
            row["ms"]["p50"] = 10.6
    assert not any("the hybrid frame" in line and "splats alone" in line for line in sentences(found))


def test_names_are_listed_as_in_a_sentence():
    assert [listed(["a", "b", "c"][:count]) for count in range(4)] == ["", "a", "a and b", "a, b and c"]
