"""Threads while torch works on images."""

from __future__ import annotations

from collections.abc import Iterator

import drjit as dr
import pytest
import torch

from hybrid.base.compute_device import torch_working_on

pytestmark = pytest.mark.usefixtures("backend")


@pytest.fixture(autouse=True)
def two_of_each() -> Iterator[None]:
    before = torch.get_num_threads(), dr.thread_count()
    torch.set_num_threads(2)
    dr.set_thread_count(2)
    yield
    torch.set_num_threads(before[0])
    dr.set_thread_count(before[1])


@pytest.mark.parametrize(("pixels", "threads"), [(0, (1, 2)), (145 * 145, (1, 2)), (512 * 512, (2, 1))])
def test_small_images_get_one_thread_and_large_ones_all(pixels, threads):
    with torch_working_on(pixels):
        assert (torch.get_num_threads(), dr.thread_count()) == threads
    assert (torch.get_num_threads(), dr.thread_count()) == (2, 2)


@pytest.mark.parametrize("pixels", [1, 10**6])
def test_threads_come_back_after_an_error(pixels):
    with pytest.raises(ZeroDivisionError), torch_working_on(pixels):
        _ = 1 / 0
    assert (torch.get_num_threads(), dr.thread_count()) == (2, 2)
