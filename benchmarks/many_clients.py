"""Many clients of one server, half of them hostile: whether the others are served as before, see `remote`."""

from __future__ import annotations

import asyncio
import contextlib
import secrets
import time
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
from websockets.asyncio.client import connect
from websockets.exceptions import WebSocketException
from websockets.typing import Subprotocol

from compose.camera.camera import Camera, turned
from compose.eye.display import DISPLAYS
from compose.eye.gaze import Gaze, simulated
from hybrid.window.messages import Server
from hybrid.window.remote.disc_messages import DiscWanted
from hybrid.window.remote.protocol import (
    FOREST_WANTED,
    MASK,
    SUBPROTOCOL,
    MaskMessage,
    ViewMessage,
    Welcome,
)

SIZE, DISPLAY = (960, 540), DISPLAYS["desktop"]
# Views per second of each client; seconds between two hostile attempts of one.
_CALM, _PAUSE = 1.0, 1.0
# Seconds until clients count.
_SETTLE = 15.0


def view_at(home: Camera, distance: float, seconds: float) -> Camera:
    """A walk through a fifth of a room's depth, turning by up to 40 degrees per second."""
    camera, reach = home.resized(*SIZE), 0.18 * distance
    turn, pose = 0.7 * seconds / reach, camera.camera_to_world.copy()
    pose[:3, 3] += pose[:3, :3] @ (reach * np.array([np.sin(turn), 0, np.sin(0.7 * turn)]))
    yaw, pitch = 40 * np.sin(2 * np.pi * seconds / 6), 10 * np.sin(2 * np.pi * seconds / 4)
    pose[:3, :3] = turned(pose[:3, :3], yaw, pitch)
    return camera.at(pose)


def _connected(address: str, token: str) -> connect:
    headers = {"Authorization": f"Bearer {token}"}
    protocols = [Subprotocol(SUBPROTOCOL)]
    return connect(address, additional_headers=headers, subprotocols=protocols, compression=None, proxy=None)


class Swarm:
    """Many clients on this machine, some of them hostile, each in its own way."""

    def __init__(self, server: Server):
        self._server, self.answers, self.attempts = server, Counter[int](), Counter[str]()
        self.admitted = 0

    async def honest(self, number: int) -> None:
        """Asks for a mask now and then, and answers."""
        async with _connected(self._server.address, self._server.token) as connection:
            welcome = Welcome.of_text(str(await connection.recv()))
            trace = simulated(DISPLAY, *SIZE, 60, number)
            sequence, held, due = 0, 0, time.monotonic() + (number % 97) / 97 / _CALM
            while True:
                await asyncio.sleep(max(0.0, due - time.monotonic()))
                # What was late is not made up for.
                due = max(due + 1 / _CALM, time.monotonic())
                camera = view_at(welcome.camera, welcome.distance, time.monotonic() % 60)
                sequence += 1
                view = ViewMessage(sequence, held, camera, trace.at(time.monotonic() % 60), DISPLAY)
                await connection.send(view.packed())
                held = MaskMessage.unpacked(bytes(await connection.recv(decode=False))).number
                self.answers[number] += 1

    async def hostile(self, number: int) -> None:
        """Does the same wrong thing again and again."""
        kinds = [self._stranger, self._garbage, self._bad, self._slow, self._greedy]
        kind = kinds[number % len(kinds)]
        while True:
            self.attempts[kind.__name__.strip("_")] += 1
            with contextlib.suppress(OSError, WebSocketException, asyncio.TimeoutError):
                await kind()
            await asyncio.sleep(_PAUSE)

    async def _stranger(self) -> None:
        async with _connected(self._server.address, secrets.token_urlsafe(32)) as connection:
            await connection.recv()
            self.admitted += 1

    async def _garbage(self) -> None:
        host, port = self._server.address.removeprefix("ws://").split(":")
        reader, writer = await asyncio.open_connection(host, int(port))
        writer.write(secrets.token_bytes(2000))
        await writer.drain()
        await asyncio.wait_for(reader.read(), 30)
        writer.close()

    async def _bad(self) -> None:
        """Oversized messages, damaged ones, old ones, and ones that make no sense."""
        async with _connected(self._server.address, self._server.token) as connection:
            welcome = Welcome.of_text(str(await connection.recv()))
            camera = welcome.camera.resized(*SIZE)
            view = ViewMessage(7, 0, camera, Gaze(), DISPLAY).packed()
            nan = bytearray(view)
            nan[9:17] = b"\xff" * 8
            said: list[str | bytes] = [secrets.token_bytes(1 << 20), bytes(nan), view[:-1], "text", b""]
            for message in (view, secrets.choice([view, *said])):
                await connection.send(message)
            async for _ in connection:
                pass

    async def _slow(self) -> None:
        """Takes the forest, and masks, a few bytes at a time or not at all."""
        async with _connected(self._server.address, self._server.token) as connection:
            welcome = Welcome.of_text(str(await connection.recv()))
            camera = welcome.camera.resized(*SIZE)
            connection.transport.pause_reading()
            await connection.send(bytes([FOREST_WANTED]))
            for sequence in range(1, 600):
                moved = camera.moved_right(sequence * 1e-3)
                await connection.send(ViewMessage(sequence, 0, moved, Gaze(), DISPLAY).packed())
                await asyncio.sleep(0.2)

    async def _greedy(self) -> None:
        """Looks at ever new discs, as large and with as many samples as there are."""
        async with _connected(self._server.address, self._server.token) as connection:
            welcome = Welcome.of_text(str(await connection.recv()))
            await connection.send(DiscWanted(1e4, 1e4, 1000).packed())
            sequence = held = 0
            while True:
                sequence += 1
                view = view_at(welcome.camera, welcome.distance, sequence / 10).resized(8192, 8192)
                await connection.send(ViewMessage(sequence, held, view, Gaze(), DISPLAY).packed())
                message = bytes(await connection.recv(decode=False))
                held = MaskMessage.unpacked(message).number if message[0] == MASK else held


async def many(server: Server, process: int, clients: int, seconds: float) -> dict[str, Any]:
    """Honest clients alone for a quarter of the time, then as many hostile ones beside them."""
    swarm, memory = Swarm(server), []
    rates = []
    tasks = [asyncio.ensure_future(swarm.honest(number)) for number in range(clients // 2)]
    try:
        for share, hostile in ((0.25, 0), (0.75, clients - clients // 2)):
            tasks += [asyncio.ensure_future(swarm.hostile(number)) for number in range(hostile)]
            # All are connected, and what is made once is made.
            await asyncio.sleep(_SETTLE)
            before, begin = swarm.answers.copy(), time.monotonic()
            while time.monotonic() - begin < share * seconds:
                await asyncio.sleep(1)
                memory.append((time.monotonic(), _resident(process), bool(hostile)))
            took = time.monotonic() - begin
            each = [(swarm.answers[n] - before[n]) / took for n in range(clients // 2)]
            rates.append({"mean": float(np.mean(each)), "least": float(np.min(each))})
        lost = sum(task.done() for task in tasks[: clients // 2])
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
    at, used = np.array([(at, mib) for at, mib, hostile in memory if hostile]).T
    settled = at > at[0] + (at[-1] - at[0]) / 3
    return {
        "clients": clients,
        "seconds": seconds,
        "asked_per_s": _CALM,
        "alone_per_s": rates[0],
        "beside_hostile_per_s": rates[1],
        "honest_lost": lost,
        "attempts": dict(swarm.attempts),
        "admitted_without_token": swarm.admitted,
        "mib_alone": float(np.median([mib for _, mib, hostile in memory if not hostile])),
        "mib_most": float(used.max()),
        "mib_per_minute": 60 * float(np.polyfit(at[settled], used[settled], 1)[0]),
    }


def _resident(process: int) -> float:
    """Memory of a process in MiB."""
    lines = Path(f"/proc/{process}/status").read_text().splitlines()
    return int(next(line for line in lines if line.startswith("VmRSS")).split()[1]) / 1024
