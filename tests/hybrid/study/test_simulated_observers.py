"""Simulated observers answer as often, and as the given qualities say, and take part in whole studies."""

from __future__ import annotations

import csv
import json
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from compose.base.errors import UserError
from compose.eye.display import display_named
from hybrid.base.progress import no_progress
from hybrid.render.image_files import write_srgb
from hybrid.study.analysis import AnalysisSettings, analyse
from hybrid.study.design import StudyMethod
from hybrid.study.observations import answers, conditions_of
from hybrid.study.scaling import preference
from hybrid.study.session import StudySession
from hybrid.study.simulated_observers import (
    SimulatedObserver,
    clip_qualities,
    simulated_choices,
    simulated_ratings,
)
from tests.hybrid.study.studies import CONDITIONS, design, write_clips


def test_all_pairs_are_answered_by_everybody_from_both_sides():
    found = simulated_choices({"s": {"a": 0.0, "b": 1.0, "c": 2.0}, "t": {"a": 0.0, "b": 1.0}}, 6, 4, seed=0)
    assert len(found.observer) == 6 * 4 * (3 + 1)
    assert np.unique(found.observer).tolist() == [f"O{n}" for n in range(1, 7)]
    pair = np.sort(np.stack([found.first, found.second]), 0)
    here = (found.group == "s") & (found.observer == "O3") & (pair == [["b"], ["c"]]).all(0)
    assert sorted(found.first[here].tolist()) == ["b", "b", "c", "c"]


@pytest.mark.parametrize("spread", [0.0, 1.0])
def test_choices_follow_the_qualities(spread):
    """Also of observers who differ, within 4 standard deviations of 4,000 observers."""
    found = simulated_choices({"": {"a": 0.0, "b": 1.0}}, 4000, 1, seed=1, lapse=0, spread=spread)
    share = np.mean((found.first == "b") == found.chosen_first)
    assert share == pytest.approx(preference(1), abs=4 * np.sqrt(0.1875 / 4000))


def test_lapses_are_chance():
    found = simulated_choices({"": {"a": 0.0, "b": 9.0}}, 2000, 1, seed=2, lapse=0.2)
    assert np.mean((found.first == "b") == found.chosen_first) == pytest.approx(0.9, abs=0.03)


def test_votes_follow_the_qualities():
    jods = {"s": {"same": 10.0, "worse": 7.0, "worst": 0.0}}
    found = simulated_ratings(jods, 300, 2, seed=3)
    means = [found.vote[found.condition == name].mean() for name in jods["s"]]
    assert set(found.vote) == {1, 2, 3, 4, 5}
    # The best and the worst are kept on the scale.
    assert 4.5 < means[0] < 5
    assert means[1] == pytest.approx(5 - 0.6 * 3, abs=0.1)
    assert 1 <= means[2] < 1.3


def test_the_seed_decides():
    jods = {"s": {"a": 10.0, "b": 8.0}}
    for simulated in (simulated_choices, simulated_ratings):
        one, again, other = (simulated(jods, 20, 3, seed) for seed in (1, 1, 2))
        answers = [list(vars(found).values())[-2].tolist() for found in (one, again, other)]
        assert answers[0] == answers[1] != answers[2]


DESKTOP = display_named("desktop")


def qualities(made, hybrid=9.0, splats=8.0):
    by_condition = {"reference": 10.0, "hybrid": hybrid, "splats": splats, "anchor": 3.0}
    return {clip.name: by_condition[clip.condition] for clip in made.clips}


def simulate(folder, made, jods, observers=12):
    made.save(folder)
    for number in range(1, observers + 1):
        session = StudySession(folder, made, number)
        SimulatedObserver(made, jods, number, 0).run(session)
        session.close()


@pytest.mark.parametrize("method", list(StudyMethod))
def test_what_observers_see_is_found_in_what_they_answer(tmp_path, method):
    made = design(method, scenes=3, repeats=4)
    simulate(tmp_path, made, qualities(made))
    found, failed = answers(tmp_path, {}, (1.0, 5.0), keep_all=False)
    assert failed == []
    pairs = method is StudyMethod.PAIRS
    result = analyse(found, AnalysisSettings(reference="reference" if pairs else None, anchor=10.0))
    if pairs:
        jods = {row["condition"]: row["jod"] for row in result["scales"][0]["qualities"]}
        assert jods["hybrid"] == pytest.approx(9.0, abs=0.4)
        assert jods["splats"] == pytest.approx(8.0, abs=0.5)
    else:
        best_first = [row["first"] for row in result["comparison"]["pairs"]]
        assert best_first[0] == ("hybrid" if method is StudyMethod.DSIS else "reference")
        assert result["comparison"]["pairs"][-1]["different"]


def test_same_seed_same_answers(tmp_path):
    made = design(StudyMethod.PAIRS)
    for name in ("one", "other"):
        simulate(tmp_path / name, made, qualities(made), 2)
    files = [tmp_path / name / "results" / "observer-002.csv" for name in ("one", "other")]
    assert files[0].read_bytes() == files[1].read_bytes()


def test_who_fails_to_attend_is_left_out_and_named(tmp_path):
    made = design(StudyMethod.PAIRS, attention=2)
    jods = qualities(made)
    simulate(tmp_path, made, jods, 3)
    session = StudySession(tmp_path, made, 4)
    upside_down = {name: 20 - jod for name, jod in jods.items()}
    SimulatedObserver(made, upside_down, 4, 0).run(session)
    session.close()
    found, failed = answers(tmp_path, {}, (1.0, 5.0), keep_all=False)
    assert failed == ["4"]
    assert set(found.observer) == {"1", "2", "3"}
    assert set(answers(tmp_path, {}, (1.0, 5.0), keep_all=True)[0].observer) == {"1", "2", "3", "4"}


def noisy_clips(folder, made, spread):
    """Clips of one pattern, with noise of some spread by condition."""
    random = np.random.default_rng(0)
    pattern = random.integers(60, 190, (96, 128, 3))
    for clip in made.clips:
        for frame in range(clip.frames):
            noise = random.normal(0, spread[clip.condition], pattern.shape)
            image = np.clip(pattern + noise, 0, 255).astype(np.uint8)
            write_srgb(folder / "clips" / clip.name / f"{frame:06}.png", image)


@pytest.mark.parametrize("frames", [1, 3])
def test_clips_are_judged_against_the_reference_of_their_scene(tmp_path, frames):
    pytest.importorskip("pyfvvdp", reason="JOD needs FovVideoVDP")
    made = design(scenes=1, frames=frames)
    noisy_clips(tmp_path, made, {"reference": 0.0, "hybrid": 5.0, "splats": 25.0, "anchor": 60.0})
    jods = clip_qualities(tmp_path, made, DESKTOP, no_progress)
    assert [jods[f"s0-{name}"] for name in (*CONDITIONS, "anchor")] == sorted(jods.values(), reverse=True)
    assert jods["s0-reference"] == 10
    assert jods["s0-anchor"] < 9
    # Not measured again.
    file = tmp_path / "clips" / "jod.json"
    file.write_text(json.dumps(dict.fromkeys(jods, 5.0)))
    assert set(clip_qualities(tmp_path, made, DESKTOP, no_progress).values()) == {5.0}


def test_a_clip_that_is_missing_is_one_line(tmp_path):
    pytest.importorskip("pyfvvdp", reason="JOD needs FovVideoVDP")
    with pytest.raises(UserError, match="is missing or damaged"):
        clip_qualities(tmp_path, design(), DESKTOP, no_progress)


def test_a_cross_that_moves_is_followed(tmp_path):
    pytest.importorskip("pyfvvdp", reason="JOD needs FovVideoVDP")
    made = design(scenes=1, frames=2)
    noisy_clips(tmp_path, made, {"reference": 0.0, "hybrid": 0.0, "splats": 0.0, "anchor": 0.0})
    # The second frame is disturbed on the left.
    random, file = np.random.default_rng(1), tmp_path / "clips" / "s0-hybrid" / "000001.png"
    image = np.asarray(Image.open(file)).copy()
    image[:, :24] = random.integers(0, 255, image[:, :24].shape)
    write_srgb(file, image)
    found = []
    for markers in (((0.9, 0.5), (0.05, 0.5)), ((0.05, 0.5), (0.9, 0.5))):
        clips = tuple(replace(clip, marker=markers) for clip in made.clips)
        found.append(clip_qualities(tmp_path, replace(made, clips=clips), DESKTOP, no_progress)["s0-hybrid"])
        (tmp_path / "clips" / "jod.json").unlink()
    assert found[0] < found[1]


def test_a_study_without_answers_says_so(tmp_path):
    made = design()
    made.save(tmp_path)
    with pytest.raises(UserError, match="nobody has answered yet"):
        answers(tmp_path, {}, (1.0, 5.0), keep_all=False)
    write_clips(tmp_path, made)
    with pytest.raises(UserError, match="holds no study"):
        answers(tmp_path / "clips", {}, (1.0, 5.0), keep_all=False)


def test_a_file_of_another_study_is_read_by_its_columns(tmp_path):
    file = tmp_path / "choices.csv"
    with file.open("w", newline="") as opened:
        csv.writer(opened).writerows(
            [["who", "a", "b", "won"], *([f"O{n}", "x", "y", 1 + n % 2] for n in range(4))]
        )
    columns = {"observer": "who", "first": "a", "second": "b", "chosen": "won"}
    found, _ = answers(file, columns, (1.0, 5.0), keep_all=False)
    assert conditions_of(found) == {"x", "y"}
