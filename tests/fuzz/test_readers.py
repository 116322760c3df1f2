"""Every reader, with files changed at random: it takes them, or refuses them in one line."""

from __future__ import annotations

import json

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.extremes import extreme
from tests.fuzz.mutations import mutations
from tests.fuzz.readers import READERS, good, outcome

_COUNT = 40

pytestmark = pytest.mark.usefixtures("backend")


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(
            name,
            marks=extreme(
                f"fuzzed {name}",
                given=f"{_COUNT} files with bytes, numbers, names or structure changed at random",
                expected="read, or refused in one line",
            ),
        )
        for name in READERS
    ],
)
def test_a_file_that_is_changed_at_random_is_read_or_refused(name, tmp_path, got):
    reader = READERS[name]
    content = good(reader, tmp_path / "f")
    taken = sum(outcome(reader, tmp_path / "f", changed) for changed in mutations(content, _COUNT, seed=1))
    assert taken < _COUNT
    got(f"{taken} read, {_COUNT - taken} refused")


@pytest.mark.parametrize("name", READERS)
def test_a_file_of_any_bytes_is_read_or_refused(name, tmp_path_factory):
    reader = READERS[name]
    folder = tmp_path_factory.mktemp("f")

    @settings(max_examples=25, deadline=None, database=None, derandomize=True)
    @given(st.one_of(st.binary(max_size=300), st.text(max_size=200).map(lambda text: text.encode())))
    def check(content: bytes) -> None:
        outcome(reader, folder, content)

    check()


_MIXED = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4),
    max_leaves=8,
)


@pytest.mark.parametrize("name", ["frame set", "camera", "display", "journal", "glTF"])
def test_json_with_any_value_in_the_place_of_another_is_read_or_refused(name, tmp_path_factory):

    reader = READERS[name]
    folder = tmp_path_factory.mktemp("f") / "g"
    document = json.loads(good(reader, folder))

    @settings(max_examples=40, deadline=None, database=None, derandomize=True)
    @given(st.data())
    def check(data: st.DataObject) -> None:
        changed = json.loads(json.dumps(document))
        place = changed
        while True:
            key = data.draw(st.sampled_from(sorted(place) if isinstance(place, dict) else range(len(place))))
            if not isinstance(place[key], dict | list) or not place[key] or data.draw(st.booleans()):
                break
            place = place[key]
        place[key] = data.draw(_MIXED)
        outcome(reader, folder, json.dumps(changed).encode())

    check()
