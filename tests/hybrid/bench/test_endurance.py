"""What is said of many frames."""

from __future__ import annotations

import pytest

from hybrid.bench.endurance import summary


def block(number: int, **changed: float) -> dict:
    """A block of frames that take 20 ms each, in a process that neither grows nor drifts."""
    frames = 200 * (number + 1)
    steady = {"milliseconds": 20.0, "memory": 500.0, "compiled": 0, "drift": 0.0}
    return {"frames": frames, "seconds": 0.02 * frames, **steady, **changed}


def test_a_steady_loop_neither_grows_nor_slows():
    assert summary([block(n) for n in range(100)]) == {
        "memory_growth": pytest.approx(0, abs=1e-6),
        "late_compiled": 0,
        "drift": 0.0,
        "slower": 1.0,
    }


def test_growth_kernels_and_slowing_after_the_first_minute_count():
    blocks = [block(n, memory=500 + 0.4 * n, compiled=n, milliseconds=20.0 + n, drift=n) for n in range(100)]
    found = summary(blocks)
    assert found["memory_growth"] == pytest.approx(2.0)
    # A minute is 3,000 frames, the end of block 14.
    assert found["late_compiled"] == sum(range(15, 100))
    assert found["drift"] == 99
    assert found["slower"] == pytest.approx((20 + 91) / (20 + 23))


def test_a_run_of_less_than_a_minute_is_judged_by_its_last_block():
    found = summary([block(0, compiled=40), block(1, compiled=3)])
    assert (found["late_compiled"], found["memory_growth"]) == (3, 0.0)
