"""Files of votes and choices: what they may look like, and what is refused in one line."""

from __future__ import annotations

import numpy as np
import pytest

from compose.base.errors import UserError
from hybrid.study import observations
from hybrid.study.observations import Choices, Ratings, load_choices, load_ratings, required, save

RATINGS = "observer,scene,condition,vote\nA,room,ours,5\nA,room,other,3\nB,room,ours,4\n"
CHOICES = "observer,scene,first,second,chosen\nA,room,ours,other,1\nB,room,other,ours,2\n"


@pytest.fixture
def written(tmp_path):
    def write(text):
        path = tmp_path / "votes.csv"
        path.write_bytes(text.encode() if isinstance(text, str) else text)
        return path

    return write


def test_ratings_are_read(written):
    found = load_ratings(written("\ufeff" + RATINGS + "\n"))
    assert found.observer.tolist() == ["A", "A", "B"]
    assert found.condition.tolist() == ["ours", "other", "ours"]
    assert found.vote.tolist() == [5, 3, 4]
    assert found.left_out == 0


def test_training_and_unanswered_rows_are_counted_and_left_out(written):
    text = (
        "observer,kind,condition,vote\nA,training,ours,1\nA,vote,ours,\nA,vote,ours,5\nA,attention,ours,9\n"
    )
    found = load_ratings(written(text))
    assert found.vote.tolist() == [5]
    assert found.scene.tolist() == [""]
    assert found.left_out == 3


def test_columns_of_published_data_are_joined(written):
    text = "who,block,speed,texture_1,rate_1,texture_2,rate_2,chosen\nO1,PC,10,Noise,1,Grass,0.5,2\n"
    columns = {
        "observer": "who",
        "scene": "block+speed",
        "first": "texture_1+rate_1",
        "second": "texture_2 + rate_2",
    }
    found = load_choices(written(text), columns)
    assert (found.group[0], found.first[0], found.second[0]) == ("PC / 10", "Noise / 1", "Grass / 0.5")
    assert not found.chosen_first[0]


def test_a_column_whose_name_has_a_plus_is_meant_as_it_stands(written):
    found = load_ratings(written("observer,a+b,vote\nA,ours,2\n"), {"condition": "a+b"})
    assert found.condition.tolist() == ["ours"]


def test_what_was_chosen_may_be_named(written):
    found = load_choices(written(CHOICES.replace("other,1", "other,ours")))
    assert found.chosen_first.tolist() == [True, False]


def test_a_folder_is_read_file_by_file(tmp_path):
    for name in "AB":
        (tmp_path / f"{name}.csv").write_text(f"observer,condition,vote\n{name},ours,3\n")
    assert load_ratings(tmp_path).observer.tolist() == ["A", "B"]


@pytest.mark.parametrize("load", [load_ratings, load_choices])
def test_what_is_saved_is_read_again(written, tmp_path, load):
    found = load(written(RATINGS if load is load_ratings else CHOICES))
    save(tmp_path / "again.csv", found)
    again = load(tmp_path / "again.csv")
    assert isinstance(again, Ratings | Choices)
    for name, values in vars(found).items():
        np.testing.assert_array_equal(getattr(again, name), values)


HOSTILE = {
    "nothing": (b"", "has no column 'observer'"),
    "no rows": ("observer,condition,vote\n", "holds no answers"),
    "only unanswered rows": ("observer,condition,vote\nA,ours,\n", "holds no answers"),
    "a picture": (b"\x89PNG\r\n\x1a\n\x00\xff\xfe", "cannot be read"),
    "a page": ("<html>\n<body>\n</html>\n", "has no column 'observer'"),
    "two columns of a name": ("observer,vote,condition,vote\nA,1,ours,2\n", "has 2 columns 'vote'"),
    "a word for a vote": ("observer,condition,vote\nA,ours,good\n", "vote 'good' must be a number from 1"),
    "not a number": ("observer,condition,vote\nA,ours,nan\n", "row 2: vote 'nan'"),
    "infinity": ("observer,condition,vote\nA,ours,inf\n", "row 2: vote 'inf'"),
    "a vote off the scale": ("observer,condition,vote\nA,ours,5\nA,ours,6\n", "row 3: vote '6'"),
    "a short row": ("observer,condition,vote\nA,ours\n", "row 2 has 2 cells; must have 3"),
    "no observer": ("observer,condition,vote\n,ours,3\n", "row 2: observer is empty"),
    "an escape sequence": ("observer,condition,vote\nA,\x1b[2J,3\n", "condition ' [2J' must be printable"),
    "a long name": (f"observer,condition,vote\nA,{'x' * 201},3\n", "of at most 200 characters"),
    "a long cell": (f"observer,condition,vote\nA,{'x' * 200_000},3\n", "cannot be read (field larger"),
    "an open quote": ('observer,condition,vote\n"A,ours,3\n' + "B,ours,3\n" * 3, "row 2 has 1 cells"),
}  # fmt: skip


@pytest.mark.parametrize("name", HOSTILE)
def test_damaged_ratings_are_refused_in_a_line(written, name):
    text, said = HOSTILE[name]
    path = written(text)
    with pytest.raises(UserError) as error:
        load_ratings(path)
    assert str(error.value).startswith(f"{path}: ")
    assert said in str(error.value)
    assert str(error.value).isprintable()


@pytest.mark.parametrize(
    ("row", "said"),
    [
        ("A,room,ours,ours,1", "row 2: compares 'ours' with itself"),
        ("A,room,ours,other,3", "row 2: chosen '3' must be 1, 2, 'ours' or 'other'"),
        ("A,room,ours,,1", "row 2: second is empty"),
    ],
)
def test_damaged_choices_are_refused_in_a_line(written, row, said):
    with pytest.raises(UserError, match=said):
        load_choices(written(f"observer,scene,first,second,chosen\n{row}\n"))


def test_no_file_an_empty_folder_and_a_huge_file_are_refused(tmp_path, written, monkeypatch):
    with pytest.raises(UserError, match=r"missing\.csv: cannot be read \(No such file"):
        load_ratings(tmp_path / "missing.csv")
    with pytest.raises(UserError, match="holds no CSV files"):
        load_ratings(tmp_path)
    monkeypatch.setattr(observations, "_MOST_BYTES", 10)
    with pytest.raises(UserError, match="at most 10 are read"):
        load_ratings(written(RATINGS))


def test_unknown_columns_are_refused(written):
    with pytest.raises(UserError, match="column 'votes': is unknown; must be one of observer, scene"):
        load_ratings(written(RATINGS), {"votes": "vote"})
    with pytest.raises(UserError, match="has no column 'clip' for 'scene'"):
        load_ratings(written(RATINGS), {"scene": "clip"})


def test_what_is_not_installed_is_said_in_a_line():
    with pytest.raises(
        UserError, match=r"power requires not_there, which .* foveated-hybrid-renderer\[study\]"
    ):
        required("not_there.power", "power")
