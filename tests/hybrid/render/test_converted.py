"""Dataclass fields that accept a value in several forms."""

from __future__ import annotations

from dataclasses import FrozenInstanceError, asdict, dataclass, fields, replace

import pytest

from hybrid.render.frame_settings import Converted


@dataclass(frozen=True)
class Point:
    """Two numbers, which may be given as text."""

    x: Converted[str | float, float] = Converted(float, 1.0)
    y: Converted[str | float, float] = Converted(float, 2.0)


def test_what_is_given_is_converted():
    assert (Point("3.5").x, Point("3.5", 4).y) == (3.5, 4.0)
    assert isinstance(Point(4).x, float)
    assert Point("3.5") == Point(3.5)
    assert hash(Point("3.5")) == hash(Point(3.5))


def test_fields_that_are_not_given_have_their_defaults():
    assert (Point().x, Point().y) == (1.0, 2.0)
    assert [field.default for field in fields(Point)] == [1.0, 2.0]


def test_fields_and_instances_are_independent():
    one, other = Point("3"), Point(y="5")
    assert (one.x, one.y, other.x, other.y) == (3, 2, 1, 5)


def test_a_replaced_value_is_converted_too():
    assert replace(Point(3), x="5") == Point(5, 2)
    assert asdict(Point("3")) == {"x": 3.0, "y": 2.0}


def test_what_cannot_be_converted_is_refused():
    with pytest.raises(ValueError, match="could not convert"):
        Point("three")


def test_a_converted_field_is_as_frozen_as_others():
    point = Point()
    with pytest.raises(FrozenInstanceError):
        point.x = "3"
    assert point.x == 1
