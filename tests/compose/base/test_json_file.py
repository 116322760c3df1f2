"""JSON of others: no number, no nesting and no size does harm."""

from __future__ import annotations

import math

import pytest

from compose.base.files import parse_json, read_json
from tests.extremes import extreme


def test_what_json_has_is_read(tmp_path):
    (tmp_path / "a").write_text('{"a": [1, -2.5, true, null, "ü"]}', encoding="utf-8")
    assert read_json(tmp_path / "a") == {"a": [1, -2.5, True, None, "ü"]}
    assert parse_json("NaN", finite=False) != parse_json("NaN", finite=False)
    assert math.isinf(parse_json("[-Infinity]", finite=False)[0])


@pytest.mark.parametrize(
    ("text", "said"),
    [
        pytest.param(
            "[" * 100_000,
            "nested too deeply",
            marks=extreme("deep JSON", given="100,000 lists in one another", expected="refused"),
        ),
        pytest.param(
            '{"a":' * 100_000 + "1" + "}" * 100_000,
            "nested too deeply",
            id="objects",
            marks=extreme("deep JSON objects", given="100,000 objects in one another", expected="refused"),
        ),
        pytest.param(
            "1e999",
            "1e999 is too large a number",
            marks=extreme("JSON number beyond doubles", given="1e999", expected="refused by name"),
        ),
        pytest.param(
            "9" * 1_000_000,
            "is too large a number",
            id="digits",
            marks=extreme("JSON number of a million digits", given="10^1000000 - 1", expected="refused"),
        ),
        ("-9223372036854775808", "is too large"),
        ("NaN", "NaN is not a number"),
        ("[Infinity]", "Infinity is not a number"),
        ("{", "Expecting"),
    ],
)
def test_what_it_has_not_is_refused(text, said, request):
    with pytest.raises(ValueError, match=said) as caught:
        parse_json(text)
    assert "\n" not in str(caught.value)
    if request.node.get_closest_marker("extremes"):
        request.getfixturevalue("got")(str(caught.value))


def test_files_that_are_too_large_or_no_text_are_refused(tmp_path):
    (tmp_path / "a").write_bytes(b"\xff\xfe[1]")
    with pytest.raises(ValueError, match="can't decode"):
        read_json(tmp_path / "a")
    with pytest.raises(ValueError, match="5 bytes; at most 4"):
        read_json(tmp_path / "a", 4)


def test_a_byte_order_mark_does_no_harm(tmp_path):
    (tmp_path / "a").write_text('{"a": "ü"}', encoding="utf-8-sig")
    assert read_json(tmp_path / "a") == {"a": "ü"}
