"""Dr.Jit's threads stand still while torch computes."""

from __future__ import annotations

import drjit as dr
import pytest

from hybrid.runtime.threads import torch_alone

pytestmark = pytest.mark.usefixtures("backend")


@pytest.fixture
def threads():
    """Two threads, whatever the machine has."""
    before = dr.thread_count()
    dr.set_thread_count(2)
    yield 2
    dr.set_thread_count(before)


def test_one_thread_is_left_and_all_come_back(threads):
    with torch_alone():
        assert dr.thread_count() == 1
    assert dr.thread_count() == threads


def test_threads_come_back_after_an_error(threads):
    with pytest.raises(ZeroDivisionError), torch_alone():
        raise ZeroDivisionError
    assert dr.thread_count() == threads
