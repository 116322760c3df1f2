"""Comparisons of votes against SciPy, statsmodels and the moments of Fov-GS; numbers of observers."""

from __future__ import annotations

import numpy as np
import pandas
import pytest
from scipy import stats
from statsmodels.stats.anova import AnovaRM
from statsmodels.stats.multitest import multipletests
from statsmodels.stats.power import TTestPower
from statsmodels.stats.weightstats import ttost_paired

from compose.base.errors import UserError
from hybrid.study.comparisons import (
    Means,
    compare,
    effect_name,
    greenhouse_geisser,
    mean_votes,
    observers_for_difference,
    observers_for_preference,
    omnibus,
)
from hybrid.study.observations import Ratings
from hybrid.study.scaling import preference, scale
from hybrid.study.simulated_observers import simulated_choices, simulated_ratings

CONDITIONS = ("GT", "ours", "D-GS", "MS-GS")


def _means(values):
    people = tuple(f"P{n:02}" for n in range(len(values)))
    return Means(people, CONDITIONS[: values.shape[1]], values)


@pytest.fixture(scope="module")
def fov_gs():
    """15 observers; d of .49 better, 1.44 and 1.85 worse than ours, as correlated as p = .15 needs."""
    random = np.random.default_rng(0)
    drawn = random.normal(size=(15, 4))
    people, _ = np.linalg.qr(drawn - drawn.mean(0))
    people *= np.sqrt(14)
    common, share = people[:, :1], 0.221
    others = share * common + np.sqrt(1 - share**2) * people[:, 1:]
    spread = 0.4
    gt, d_gs, ms_gs = (4.2 + spread * (d + others[:, n]) for n, d in enumerate((0.49, -1.44, -1.85)))
    return _means(np.stack([gt, 4.2 + spread * common[:, 0], d_gs, ms_gs], 1))


def test_fov_gs_is_decided_as_in_the_paper(fov_gs):
    found = compare(fov_gs)
    assert found["normal"]
    assert found["omnibus"]["test"] == "repeated-measures ANOVA"
    assert found["omnibus"]["p"] < 0.001
    rows = {(row["first"], row["second"]): row for row in found["pairs"]}
    against = [rows["GT", "ours"], rows["ours", "D-GS"], rows["ours", "MS-GS"]]
    np.testing.assert_allclose([row["d"] for row in against], [0.49, 1.44, 1.85], atol=1e-6)
    assert [row["effect"] for row in against] == ["small", "very large", "very large"]
    assert against[0]["p"] == pytest.approx(0.15, abs=0.005)
    assert all(row["p"] < 0.001 for row in against[1:])
    assert [row["different"] for row in against] == [False, True, True]
    # A missing difference is no equality.
    assert not against[0]["equivalent"]


def test_statistics_of_normal_differences_equal_the_libraries(fov_gs):
    found = compare(fov_gs, margin=0.3)
    pairs = [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]
    p_values, equivalences = [], []
    for row, (i, j) in zip(found["pairs"], pairs, strict=True):
        x, y = fov_gs.values[:, i], fov_gs.values[:, j]
        t = stats.ttest_rel(x, y)
        interval = t.confidence_interval(0.95)
        assert (row["statistic"], row["p"]) == pytest.approx((t.statistic, t.pvalue))
        assert (row["low"], row["high"]) == pytest.approx((interval.low, interval.high))
        assert row["normality_p"] == pytest.approx(stats.shapiro(x - y).pvalue)
        assert row["d_z"] == pytest.approx(t.statistic / np.sqrt(15))
        assert row["power"] == pytest.approx(TTestPower().power(row["d_z"], 15, 0.05))
        reached = TTestPower().power(row["detectable"] / (x - y).std(ddof=1), 15, 0.05)
        assert reached == pytest.approx(0.8, abs=1e-4)
        p_values.append(t.pvalue)
        equivalences.append(ttost_paired(x, y, -0.3, 0.3)[0])
    for name, values in (("p_holm", p_values), ("equivalence_p_holm", equivalences)):
        adjusted = multipletests(values, method="holm")[1]
        np.testing.assert_allclose([row[name] for row in found["pairs"]], adjusted)


def test_the_anova_equals_that_of_statsmodels(fov_gs):
    values = fov_gs.values
    frame = pandas.DataFrame(
        [(p, c, values[p, c]) for p in range(15) for c in range(4)], columns=["person", "condition", "vote"]
    )
    table = AnovaRM(frame, "vote", "person", within=["condition"]).fit().anova_table
    found = omnibus(values, normal=True)
    assert found["statistic"] == pytest.approx(table["F Value"].iloc[0])
    assert (found["df"], found["df_error"]) == (3, 42)
    assert found["p"] == pytest.approx(
        stats.f.sf(found["statistic"], 3 * found["epsilon"], 42 * found["epsilon"])
    )


def test_epsilon_is_that_of_orthonormal_contrasts():
    values = np.random.default_rng(1).normal(size=(12, 4)) * [1, 2, 3, 4]
    contrasts = np.linalg.qr(np.vander(np.arange(4.0), 4, increasing=True))[0][:, 1:]
    roots = np.linalg.eigvalsh(np.cov((values @ contrasts).T))
    assert greenhouse_geisser(values) == pytest.approx(roots.sum() ** 2 / (3 * (roots**2).sum()))
    # Two conditions are always spherical.
    assert greenhouse_geisser(values[:, :2]) == pytest.approx(1)


def test_statistics_of_other_differences_equal_scipys():
    values = np.random.default_rng(2).choice([2.0, 4, 5], (14, 3), p=[0.1, 0.2, 0.7]) - [0, 0.25, 1]
    found = compare(_means(values), margin=0.4)
    assert not found["normal"]
    friedman = stats.friedmanchisquare(*values.T)
    assert (found["omnibus"]["statistic"], found["omnibus"]["p"]) == pytest.approx(tuple(friedman))
    for row, (i, j) in zip(found["pairs"], [(0, 1), (0, 2), (1, 2)], strict=True):
        difference = values[:, i] - values[:, j]
        expected = stats.wilcoxon(difference)
        assert (row["statistic"], row["p"]) == pytest.approx((expected.statistic, expected.pvalue))
        one_sided = (
            stats.wilcoxon(difference + 0.4, alternative="greater"),
            stats.wilcoxon(difference - 0.4, alternative="less"),
        )
        assert row["equivalence_p"] == pytest.approx(max(one.pvalue for one in one_sided))


def test_votes_all_alike_are_not_different():
    found = compare(_means(np.full((8, 3), 4.0)))
    for row in found["pairs"]:
        assert (row["p"], row["different"], row["effect"], row["d"], row["power"]) == (
            1,
            False,
            "none",
            None,
            None,
        )
        assert row["equivalent"]
    assert found["omnibus"]["p"] == 1


def test_a_constant_difference_is_one():
    found = compare(_means(np.array([[4.0, 3.0]] * 8)))
    assert found["pairs"][0]["different"]
    assert not found["pairs"][0]["equivalent"]
    assert found["omnibus"] is None


def test_effects_have_the_names_of_fov_gs():
    sizes = [2.1, -1.3, 0.9, 0.6, -0.3, 0.1, 0.005, None]
    names = ["huge", "very large", "large", "medium", "small", "very small", "none", "none"]
    assert [effect_name(size) for size in sizes] == names


def _ratings(rows):
    observer, scene, condition, vote = zip(*rows, strict=True)
    return Ratings(*(np.array(part) for part in (observer, scene, condition)), np.array(vote, float))


def test_means_are_over_repetitions_then_scenes():
    rows = [(p, s, c, 3) for p in "ABC" for s in "st" for c in "xy"]
    found = mean_votes(_ratings([*rows, ("A", "s", "x", 5), ("A", "s", "x", 4)]))
    assert found.conditions == ("x", "y")
    np.testing.assert_allclose(found.values, [[3.5, 3], [3, 3], [3, 3]])


def test_who_lacks_a_condition_is_left_out_and_named():
    rows = [(p, s, c, 3) for p in "ABCD" for s in "st" for c in "xy"]
    lacking = [row for row in rows if row[:3] != ("D", "t", "y")] + [("A", "u", "x", 1)]
    found = mean_votes(_ratings(lacking))
    assert found.left_out_observers == ("D",)
    assert found.left_out_scenes == ("u",)
    assert found.values.tolist() == [[3, 3]] * 3
    assert compare(found)["left_out_observers"] == ["D"]


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        ([(p, "s", "x", 3) for p in "ABC"], "condition 'x': is the only one"),
        ([(p, s, c, 3) for p in "ABC" for s, c in ("sx", "ty")], "no scene was shown in all conditions"),
        ([(p, "s", c, 3) for p in "AB" for c in "xy"], "2 of 2 observers voted on all conditions"),
    ],
)
def test_what_cannot_be_compared_is_refused(rows, said):
    with pytest.raises(UserError, match=said):
        mean_votes(_ratings(rows))


_SCENES = ("s", "t", "u")


def _study(seed, better=8.0, people=15):
    return mean_votes(simulated_ratings({s: {"a": better, "b": 8.0} for s in _SCENES}, people, 2, seed))


def test_known_differences_lie_in_their_intervals():
    """Of a difference in votes that 5,000 observers have; also, equivalence is not called at its margin."""
    many = _study(1000, 9.0, 5_000).values
    true = abs(np.ptp(many.mean(0)))
    inside = equivalent = 0
    for seed in range(100):
        study = _study(seed, 9.0)
        row = compare(study, margin=true)["pairs"][0]
        sign = 1 if row["first"] == "a" else -1
        inside += row["low"] <= sign * true <= row["high"]
        equivalent += row["equivalent"]
    assert 93 <= inside <= 97
    assert equivalent <= 5


def test_no_difference_is_called_one_in_at_most_5_of_100():
    assert sum(compare(_study(seed))["pairs"][0]["different"] for seed in range(100)) <= 5


@pytest.mark.parametrize(("d_z", "observers"), [(0.2, 199), (0.5, 34), (-0.5, 34), (0.8, 15), (3.0, 4)])
def test_observers_of_the_usual_effects(d_z, observers):
    """As G*Power has them for a paired t-test of two sides."""
    assert observers_for_difference(d_z) == observers


def test_more_trials_and_fewer_demands_need_fewer_observers():
    once = observers_for_preference(0.75, 1)
    assert observers_for_preference(0.75, 4) < once
    assert observers_for_preference(0.75, 1, alpha=0.1) < once
    assert observers_for_preference(0.75, 1, power=0.9) > once
    assert observers_for_preference(0.75, 4, spread=0.2) > observers_for_preference(0.75, 4)
    assert observers_for_preference(0.25, 4) == observers_for_preference(0.75, 4)


def test_so_many_observers_find_the_preference():
    """In 80 % of studies, give or take three standard deviations of 200 of them."""
    observers = observers_for_preference(preference(0.5), 5)
    found = [
        scale(simulated_choices({"": {"a": 0.5, "b": 0.0}}, observers, 5, seed, lapse=0))[0].difference(0, 1)
        for seed in range(200)
    ]
    assert np.mean([difference.p < 0.05 for difference in found]) == pytest.approx(0.8, abs=0.085)


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: observers_for_difference(0.0), "effect 0: must be a number other than 0"),
        (lambda: observers_for_difference(float("nan")), "effect nan: must be"),
        (
            lambda: observers_for_difference(0.001),
            "effect 0.001: is too small; needs more than 8,192 observers",
        ),
        (lambda: observers_for_difference(0.5, alpha=0.0), "alpha 0: must be between 0 and 1"),
        (lambda: observers_for_difference(0.5, power=1.0), "power 1: must be between 0 and 1"),
        (lambda: observers_for_preference(0.5, 3), "probability 0.5: must be between 0 and 1, and not .5"),
        (lambda: observers_for_preference(0.7, 0), "trials 0: must be at least 1"),
        (lambda: observers_for_preference(0.7, 1, spread=0.5), "spread 0.5: must be at least 0, below .5"),
    ],
)
def test_values_out_of_range_are_refused(call, said):
    with pytest.raises(UserError, match=said):
        call()
