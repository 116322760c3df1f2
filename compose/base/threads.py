"""Keeps threads that wait from taking the processor from those that work.

This happens when `compose` is imported: OpenMP reads its settings once, when torch loads it.
"""

from __future__ import annotations

import os

_SPINS_VARIABLE, _POLICY_VARIABLE = "GOMP_SPINCOUNT", "OMP_WAIT_POLICY"
# Turns of a loop in which torch's threads wait for work before they sleep. By GNU OpenMP's default they do so
# for milliseconds, which delays whoever has work where other processes are busy.
_SPINS = 1000


def let_waiting_threads_sleep() -> None:
    """Sets GOMP_SPINCOUNT, unless the user has set it or OMP_WAIT_POLICY, which it would overrule."""
    if _POLICY_VARIABLE not in os.environ:
        os.environ.setdefault(_SPINS_VARIABLE, str(_SPINS))
