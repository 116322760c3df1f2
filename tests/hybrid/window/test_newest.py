"""The newest item wins, is taken once, and wakes whoever waits for it."""

from __future__ import annotations

import threading

from hybrid.window.messages import Newest


def test_the_newest_item_is_taken_once():
    slot: Newest[int] = Newest()
    assert slot.take() is None
    for item in range(5):
        slot.put(item)
    assert slot.take() == 4
    assert slot.take() is None


def test_a_look_at_the_newest_item_leaves_it_there():
    slot: Newest[int] = Newest()
    assert slot.peek() is None
    for item in range(3):
        slot.put(item)
    assert slot.peek() == 2
    assert slot.take() == 2
    assert slot.peek() is None


def test_taking_from_an_empty_slot_gives_up():
    assert Newest[int]().take(0.01) is None


def test_an_item_wakes_whoever_waits():
    slot: Newest[str] = Newest()
    taken: list[str | None] = []
    waits = threading.Thread(target=lambda: taken.append(slot.take(600)), daemon=True)
    waits.start()
    slot.put("here")
    waits.join(60)
    assert taken == ["here"]


def test_what_many_threads_put_last_is_not_lost():
    slot: Newest[int] = Newest()
    threads = [threading.Thread(target=lambda: [slot.put(n) for n in range(1000)]) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert slot.take() == 999
