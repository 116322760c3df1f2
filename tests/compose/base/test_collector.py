"""When the garbage collector is paused, and when it runs again."""

from __future__ import annotations

import gc
from collections.abc import Iterator

import pytest

from compose.base.collector import collector_paused


@pytest.fixture(autouse=True)
def collector() -> Iterator[None]:
    """Whatever a test does, the collector runs afterwards."""
    gc.enable()
    yield
    gc.enable()


def test_the_collector_is_paused_inside():
    with collector_paused():
        assert not gc.isenabled()
    assert gc.isenabled()


def test_it_runs_again_after_an_error():
    with pytest.raises(ValueError, match="inside"), collector_paused():
        raise ValueError("inside")
    assert gc.isenabled()


def test_it_stays_off_where_it_was_off():
    gc.disable()
    with collector_paused():
        pass
    assert not gc.isenabled()


def test_pauses_overlap_in_any_order():
    """As those of two threads do."""
    one, other = collector_paused(), collector_paused()
    one.__enter__()
    other.__enter__()
    one.__exit__(None, None, None)
    assert not gc.isenabled()
    other.__exit__(None, None, None)
    assert gc.isenabled()
