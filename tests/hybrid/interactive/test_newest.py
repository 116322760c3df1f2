"""The newest thing wins, and nobody waits for nothing."""

from __future__ import annotations

import threading
import time

from hybrid.interactive.newest import Newest


def test_the_newest_wins_and_is_new_once():
    place: Newest[int] = Newest()
    assert place.take(0) == (None, False)
    for item in range(5):
        place.put(item)
    assert place.take(0) == (4, True)
    assert place.take(0) == (4, False)


def test_who_waits_is_woken():
    place: Newest[str] = Newest()
    timer = threading.Timer(0.05, place.put, ["here"])
    timer.start()
    start = time.perf_counter()
    assert place.take(10) == ("here", True)
    assert time.perf_counter() - start < 5
    timer.join()


def test_many_threads_lose_nothing_that_is_last():
    place: Newest[int] = Newest()
    threads = [threading.Thread(target=lambda: [place.put(n) for n in range(1000)]) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert place.take(0) == (999, True)
