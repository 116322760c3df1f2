"""The whole analysis: its keys, its words, and the pages and tables made of it."""

from __future__ import annotations

import csv
import json

import numpy as np
import pytest
from scipy.stats import binomtest

from compose.base.errors import UserError
from compose.base.files import json_text
from hybrid.study.analysis import AnalysisSettings, analyse, p_text, sentence
from hybrid.study.analysis_page import latex_text, write_page
from hybrid.study.observations import Choices, Ratings
from hybrid.study.simulated_observers import simulated_choices, simulated_ratings

JODS = {scene: {"truth": 10.0, "ours & co_1": 9.95, "<b>worst</b>": 7.0} for scene in ("room", "hall")}


@pytest.fixture(scope="module")
def choices():
    found = simulated_choices(JODS, 14, 4, seed=1)
    return analyse(found, AnalysisSettings(reference="truth", anchor=10, margin=0.6)), found


@pytest.fixture(scope="module")
def votes():
    found = simulated_ratings(JODS, 14, 2, seed=1)
    return analyse(found, AnalysisSettings(margin=1.0)), found


def test_choices_are_told_in_words(choices):
    lines = choices[0]["sentences"]
    assert lines[0] == "14 observers gave 336 choices."
    assert any(
        line.startswith("No difference found between") and "and equivalent within 0.6 JOD" in line
        for line in lines
    )
    assert any(
        line.startswith("truth is preferred over <b>worst</b>: ") and "p < .001" in line for line in lines
    )


def test_scales_of_choices_hold_every_pair(choices):
    found, answers = choices
    assert [scale["group"] for scale in found["scales"]] == ["", "hall", "room"]
    for scale in found["scales"]:
        assert len(scale["pairs"]) == 3
        qualities = {row["condition"]: row["jod"] for row in scale["qualities"]}
        assert qualities["truth"] == 10
        for row in scale["pairs"]:
            assert row["difference"] == pytest.approx(qualities[row["first"]] - qualities[row["second"]])
            assert row["difference"] >= 0
    row = next(
        row
        for row in found["scales"][0]["pairs"]
        if {row["first"], row["second"]} == {"truth", "<b>worst</b>"}
    )
    here = np.isin(answers.first, ["truth", "<b>worst</b>"]) & np.isin(
        answers.second, ["truth", "<b>worst</b>"]
    )
    chosen = np.where(answers.chosen_first, answers.first, answers.second)[here]
    assert (row["trials"], row["first_chosen"]) == (112, int((chosen == "truth").sum()))
    assert row["binomial_p"] == binomtest(row["first_chosen"], 112).pvalue


def test_votes_are_told_in_words(votes):
    found = votes[0]
    assert found["sentences"][0] == "14 observers gave 168 votes."
    assert found["sentences"][1].startswith("The mean opinion score of all votes is ")
    assert any(" is rated higher than <b>worst</b>: " in line for line in found["sentences"])
    assert sum(sum(row["counts"].values()) for row in found["votes"]) == 168


def test_screening_can_be_left_to_the_reader():
    answers = simulated_choices({"": {"a": 0.0, "b": 2.0, "c": 4.0}}, 12, 4, seed=5)
    turned = np.where(answers.observer == "O07", ~answers.chosen_first, answers.chosen_first)
    answers = Choices(answers.observer, answers.group, answers.first, answers.second, turned)
    strict, mild = (analyse(answers, AnalysisSettings(screen=screen)) for screen in (True, False))
    assert strict["dropped"] == ["O07"]
    assert "Left out because their choices disagree with all others': O07." in strict["sentences"]
    assert mild["dropped"] == []
    assert strict["scales"][0]["observers"] == mild["scales"][0]["observers"] - 1
    assert [row["observer"] for row in mild["screening"] if row["dropped"]] == ["O07"]
    assert "Suspected, but kept, because their choices disagree with all others': O07." in mild["sentences"]


def test_groups_of_other_conditions_are_told_one_by_one():
    answers = simulated_choices({"s": {"a": 0.0, "b": 1.0}, "t": {"a": 0.0, "c": 3.0}}, 8, 4, seed=0)
    found = analyse(answers)
    assert [scale["group"] for scale in found["scales"]] == ["s", "t"]
    assert found["sentences"][2].startswith("t: from a (-1.")
    assert found["sentences"][2].endswith("1 of 1 pairs differ.")


def test_what_was_not_compared_is_said():
    rows = [(p, s, c, 3.0) for p in "ABCD" for s in "st" for c in "xy" if (p, s, c) != ("D", "t", "y")]
    observer, scene, condition, vote = (np.array(part) for part in zip(*rows, strict=True))
    found = analyse(Ratings(observer, scene, condition, vote, left_out=2))
    assert found["sentences"][0] == (
        "4 observers gave 15 votes; 2 rows without an answer, or of training, were left out."
    )
    assert "Not compared, for lack of votes on some condition: D." in found["sentences"]
    one = condition == "x"
    found = analyse(Ratings(observer[one], scene[one], condition[one], vote[one]))
    assert found["comparison"] is None
    assert found["sentences"][-1].startswith("Conditions were not compared: condition 'x': is the only one")


def test_an_unknown_reference_is_refused():
    found = simulated_ratings({"s": {"a": 9.0, "b": 8.0}}, 4)
    with pytest.raises(UserError, match="votes: no reference 'c'; their conditions are: a, b"):
        analyse(found, AnalysisSettings(reference="c"))


def test_a_missing_difference_is_never_equality():
    row = {"first": "X", "second": "Y", "difference": 0.1, "low": -0.3, "high": 0.5, "p_holm": 0.4}
    said = sentence(row | {"different": False, "equivalent": False}, "is preferred over", "JOD", "95 %", 0.25)
    assert said == (
        "No difference found between X and Y, but one of up to 0.50 JOD is not ruled out "
        "(95 % interval -0.30 to 0.50)."
    )
    row |= {"low": 0.02, "high": 0.18, "p_holm": 0.01, "different": True, "equivalent": True}
    said = sentence(row, "is preferred over", "JOD", "95 %", 0.25)
    assert said == (
        "X is preferred over Y: 0.10 JOD, 95 % interval 0.02 to 0.18, p = .010, "
        "but equivalent within 0.25 JOD."
    )
    assert (p_text(0.0004), p_text(1.0)) == ("p < .001", "p = 1.000")


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"level": 1.0}, "level 1: must be from .5 to below 1"),
        ({"margin": 0.0}, "margin 0: must be a positive number"),
        ({"anchor": float("nan")}, "anchor nan: must be a number"),
        ({"prior": "flat"}, "prior 'flat': must be jeffreys or none"),
    ],
)
def test_settings_out_of_range_are_refused(values, said):
    with pytest.raises(UserError, match=said):
        AnalysisSettings(**values)


@pytest.mark.parametrize("kind", ["choices", "votes"])
def test_page_and_tables_are_written(kind, request, tmp_path):
    found = request.getfixturevalue(kind)[0]
    write_page(tmp_path, found)
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "analysis.json",
        "index.html",
        "table.csv",
        "table.tex",
    ]
    page = (tmp_path / "index.html").read_text(encoding="utf-8")
    assert "<b>worst" not in page
    assert "&lt;b&gt;worst" in page
    assert page.count("<svg") >= 2
    # Nothing is fetched.
    assert "http" not in page.replace("http://www.w3.org", "").replace("http://purl.org", "").replace(
        "https://matplotlib.org", ""
    ).replace("http://creativecommons.org", "")
    assert json.loads((tmp_path / "analysis.json").read_text()) == json.loads(json_text(found))
    with (tmp_path / "table.csv").open(newline="") as file:
        cells = [cell for row in csv.reader(file) for cell in row]
    assert "ours & co_1" in cells
    latex = (tmp_path / "table.tex").read_text()
    assert r"ours \& co\_1" in latex
    assert latex.count(r"\begin{tabular}") == latex.count(r"\end{tabular}") >= 2
    for block in latex.split(r"\begin{tabular}")[1:]:
        rows = [line for line in block.splitlines() if line.endswith(r"\\")]
        assert len({line.replace(r"\&", "").count("&") for line in rows}) == 1


def test_latex_is_escaped():
    assert latex_text(r"a_b & 50 % \x {y} ~z^2 <#$") == (
        r"a\_b \& 50 \% \textbackslash{}x \{y\} \textasciitilde{}z\textasciicircum{}2 \textless{}\#\$"
    )
