"""Ctrl-C takes effect between two steps."""

from __future__ import annotations

import signal
import threading

import pytest

from hybrid.base.progress import interrupts_between_steps


def test_ctrl_c_waits_for_the_end_of_the_step():
    steps = []

    def work() -> None:
        with interrupts_between_steps() as interrupted:
            for number in range(3):
                if number == 1:
                    signal.raise_signal(signal.SIGINT)
                steps.append(number)
                interrupted()

    with pytest.raises(KeyboardInterrupt):
        work()
    assert steps == [0, 1]


def test_without_ctrl_c_nothing_happens_and_the_handler_is_restored():
    before = signal.getsignal(signal.SIGINT)
    with interrupts_between_steps() as interrupted:
        assert signal.getsignal(signal.SIGINT) is not before
        interrupted()
    assert signal.getsignal(signal.SIGINT) is before


def test_the_handler_is_restored_after_an_error():
    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(ZeroDivisionError), interrupts_between_steps():
        raise ZeroDivisionError
    assert signal.getsignal(signal.SIGINT) is before


def test_another_thread_can_work_too_although_signals_do_not_reach_it():
    steps, before = [], signal.getsignal(signal.SIGINT)

    def work() -> None:
        with interrupts_between_steps() as interrupted:
            interrupted()
            steps.append(signal.getsignal(signal.SIGINT))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert steps == [before]
