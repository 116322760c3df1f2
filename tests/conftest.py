"""One backend for the whole run, scenes small enough to trace in a test, and where real data lies."""

from __future__ import annotations

import gc
import os
from collections.abc import Callable, Generator, Iterator
from pathlib import Path

import pytest

if "PYTEST_XDIST_WORKER" in os.environ:
    # Each has a core of its own; torch's threads would wait for those of the others.
    os.environ.setdefault("OMP_NUM_THREADS", "1")

from compose.base.arrays import Arrays
from pathtrace.scene.backend import Backend, select_backend
from tests.available import available_backends
from tests.extremes import (  # noqa: F401  (hooks and a fixture of pytest)
    got,
    pytest_addoption,
    pytest_configure,
    pytest_runtest_makereport,
)

REAL_DATA = Path(__file__).resolve().parents[2] / "shared"


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leaves out what takes minutes, also of the table of extremes, unless `-m` asks for it."""
    if "long" in config.option.markexpr:
        return
    left_out = [item for item in items if item.get_closest_marker("long")]
    config.hook.pytest_deselected(items=left_out)
    items[:] = [item for item in items if not item.get_closest_marker("long")]


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """What is there before the first test stays: the garbage collector never looks through it."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


@pytest.fixture(scope="session", autouse=True)
def no_wait_for_the_disk() -> Iterator[None]:
    """What tests write need not survive a crash of the machine."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda descriptor: None)
        yield


@pytest.fixture(scope="session")
def backend() -> Backend:
    return select_backend()


@pytest.fixture(scope="session")
def arrays(backend):
    from hybrid.base.compute_device import device_arrays

    return device_arrays()


@pytest.fixture(scope="session", params=available_backends())
def each_arrays(request) -> Arrays:
    """The array types of each backend present, one after the other."""
    return Arrays(request.param)


@pytest.fixture
def threads() -> Iterator[Callable[[int], None]]:
    """Sets the number of Dr.Jit's threads; it is as it was afterwards."""
    import drjit as dr

    before = dr.thread_count()
    yield dr.set_thread_count
    dr.set_thread_count(before)


@pytest.fixture
def no_garbage() -> Iterator[None]:
    """Nothing is collected during a test: a recording depends on all scenes in memory."""
    gc.collect()
    gc.disable()
    yield
    gc.enable()


def real_file(relative: str) -> Path:
    """A file of the real test data beside the project; the test is skipped where it is not there."""
    path = REAL_DATA / relative
    if not path.exists():
        pytest.skip(f"{relative} does not lie beside the project")
    return path
