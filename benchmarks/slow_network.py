"""Two network namespaces with a slow network in between, packet by packet, as `tc netem` makes it.

Kernels of small machines lack netem; virtual network devices (TUN) they have.
"""

from __future__ import annotations

import contextlib
import ctypes
import fcntl
import multiprocessing
import os
import random
import select
import struct
import subprocess
import time
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

# Namespaces, and the addresses in them.
SPACES, ADDRESSES = ("hybrid-server", "hybrid-client"), ("10.213.0.1", "10.213.0.2")
# Of each direction: bits per second, seconds, share of packets; and packets that wait at most, as in netem.
RATE, DELAY, LOSS, _MOST_WAITING = 20e6, 0.05, 0.01, 1000
_CLONE_NEWNET, _TUNSETIFF, _TUN_WITHOUT_HEADER = 0x40000000, 0x400454CA, 0x1001
_LONGEST = 65_536


def inside(space: str) -> list[str]:
    """The words before a command that is to run in a namespace."""
    return ["ip", "netns", "exec", space]


@contextlib.contextmanager
def slow_network() -> Iterator[None]:
    """Both namespaces and the network, until the end; SystemExit without root."""
    if os.geteuid():
        raise SystemExit("requires root, for network namespaces")
    devices = []
    try:
        for space, address in zip(SPACES, ADDRESSES, strict=True):
            subprocess.run(["ip", "netns", "add", space], check=True)
            devices.append(_device(space))
            for words in (f"address add {address}/24 dev hybrid0", "link set hybrid0 up", "link set lo up"):
                subprocess.run([*inside(space), "ip", *words.split()], check=True)
        carrier = multiprocessing.get_context("fork").Process(target=_carry, args=devices, daemon=True)
        carrier.start()
        yield
        carrier.terminate()
    finally:
        for device in devices:
            os.close(device)
        for space in SPACES:
            subprocess.run(["ip", "netns", "delete", space], check=False, capture_output=True)


def _device(space: str) -> int:
    """A new device in a namespace, whose packets are read from and written to a file."""
    libc = ctypes.CDLL(None, use_errno=True)
    with Path("/proc/thread-self/ns/net").open() as own, Path(f"/run/netns/{space}").open() as other:
        if libc.setns(other.fileno(), _CLONE_NEWNET):
            raise OSError(ctypes.get_errno(), "setns")
        try:
            device = os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK)
            fcntl.ioctl(device, _TUNSETIFF, struct.pack("16sH", b"hybrid0", _TUN_WITHOUT_HEADER))
        finally:
            libc.setns(own.fileno(), _CLONE_NEWNET)
    return device


@dataclass
class _Way:
    """Packets on their way to a device."""

    target: int
    free: float = 0.0  # when all that came before has been sent
    waiting: deque[tuple[float, bytes]] = field(default_factory=deque)

    def take(self, packet: bytes, now: float, lost: bool) -> None:
        if len(self.waiting) < _MOST_WAITING:
            self.free = max(self.free, now) + 8 * len(packet) / RATE
            if not lost:
                self.waiting.append((self.free + DELAY, packet))

    def deliver(self, now: float) -> None:
        while self.waiting and self.waiting[0][0] <= now:
            with contextlib.suppress(OSError):
                os.write(self.target, self.waiting.popleft()[1])


def _carry(first: int, second: int) -> None:
    rng, ways = random.Random(0), {first: _Way(second), second: _Way(first)}
    while True:
        due = min((way.waiting[0][0] for way in ways.values() if way.waiting), default=time.monotonic() + 1)
        ready, _, _ = select.select(list(ways), [], [], max(0.0, due - time.monotonic()))
        for device in ready:
            with contextlib.suppress(BlockingIOError):
                while True:
                    packet = os.read(device, _LONGEST)
                    ways[device].take(packet, time.monotonic(), rng.random() < LOSS)
        for way in ways.values():
            way.deliver(time.monotonic())
