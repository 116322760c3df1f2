"""What a server's masks cost and show over a slow network, and what hostile clients do to it.

    python -m benchmarks.remote SCENE --forest FILE [--seconds N] [--json FILE]

Requires root, for network namespaces: 20 Mbit/s, 50 ms each way and 1 % loss lie between them.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import secrets
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from websockets.asyncio.client import connect
from websockets.exceptions import WebSocketException
from websockets.typing import Subprotocol

import hybrid  # noqa: F401  (finds LLVM before anything loads one)
from benchmarks import parser_of, report
from benchmarks.slow_network import ADDRESSES, DELAY, LOSS, RATE, SPACES, inside, slow_network
from compose.base.files import json_text
from compose.camera.camera import Camera, turned
from compose.eye.display import DISPLAYS
from compose.eye.gaze import Gaze, simulated
from compose.image.colour import Image
from hybrid.render.frame_settings import FrameSettings
from hybrid.window.messages import Server
from hybrid.window.remote.client import Cut, Remote, View
from hybrid.window.remote.protocol import FOREST_WANTED, SUBPROTOCOL, MaskMessage, ViewMessage, Welcome
from splat.model.hierarchy import HierarchyNodes
from splat.model.points import Bits

_RATE, _SIZE, _DISPLAY = 60.0, (960, 540), DISPLAYS["desktop"]
_PORT = 8765
# Frames whose pictures are compared; views per second of each of many clients; seconds between two hostile
# attempts of one.
_COMPARED, _CALM, _PAUSE = 20, 1.0, 1.0
# Seconds until many clients count.
_SETTLE = 15.0
_SETTINGS = FrameSettings(level=1.0)


def view_at(home: Camera, distance: float, seconds: float) -> Camera:
    """A walk through a fifth of a room's depth, turning by up to 40 degrees per second."""
    camera, reach = home.resized(*_SIZE), 0.18 * distance
    turn, pose = 0.7 * seconds / reach, camera.camera_to_world.copy()
    pose[:3, 3] += pose[:3, :3] @ (reach * np.array([np.sin(turn), 0, np.sin(0.7 * turn)]))
    yaw, pitch = 40 * np.sin(2 * np.pi * seconds / 6), 10 * np.sin(2 * np.pi * seconds / 4)
    pose[:3, :3] = turned(pose[:3, :3], yaw, pitch)
    return camera.at(pose)


@contextlib.contextmanager
def serving(
    options: argparse.Namespace, work: Path, host: str, before: list[str], more: list[str]
) -> Iterator[int]:
    """Runs `hybrid serve`; gives its process number."""
    words = [*before, sys.executable, "-m", "hybrid.cli.main", "serve", options.scene, "--insecure", *more]
    words += ["--forest", str(options.forest), "--host", host, "--port", str(_PORT)]
    words += ["--token-file", str(work / "token")]
    with (
        (work / "log").open("w") as log,
        subprocess.Popen(words, stdout=subprocess.PIPE, stderr=log, text=True) as process,
    ):
        try:
            assert process.stdout is not None
            if not process.stdout.readline().startswith("ws://"):
                raise SystemExit(f"the server does not start: {(work / 'log').read_text()}")
            # `ip netns exec` becomes the server.
            yield process.pid
        finally:
            process.terminate()


def walk(server: Server, seconds: float) -> dict[str, Any]:
    """A client that asks for 60 masks per second: what came, how old it was, and how it looked."""
    from pathtrace.scene.backend import select_backend

    select_backend("llvm")
    remote = Remote(server)
    remote.wait(lambda done, total, label: None)
    home, distance = remote.welcome.camera, remote.welcome.distance
    trace = simulated(_DISPLAY, *_SIZE, seconds + 1, 0)
    nodes = remote.forest.hierarchy_nodes
    # The first masks are as large as the picture is detailed, and come before the walk begins.
    remote.look(view_at(home, distance, 0), trace.at(0), _DISPLAY)
    while not remote.is_current:
        remote.changed.wait(1)
    asked: list[tuple[float, View]] = []
    times, ages, cuts, late = {0: 0.0}, [], {}, []
    assert remote.cut is not None
    count, begin, before = round(seconds * _RATE), time.monotonic(), (remote.bytes, remote.cut.number)
    for frame in range(count):
        due = begin + frame / _RATE
        time.sleep(max(0.0, due - time.monotonic()))
        now = time.monotonic()
        view = view_at(home, distance, now - begin), trace.at(now - begin), _DISPLAY
        # That of a frame before may be the newest that was sent.
        sequence, newest = remote.sent
        times.update((sequence, at) for at, one in asked[-60:] if one == newest)
        remote.look(*view)
        asked.append((now, view))
        cut = remote.cut
        assert cut is not None
        # Of a view that was sent between two frames the one before counts: it is older.
        known = [n for n in list(times)[-600:] if n <= cut.sequence]
        ages.append(now - (times[known[-1]] if known else begin))
        cuts[cut.number] = cut
        late.append((view, cut))
    took = time.monotonic() - begin
    received, number = remote.bytes - before[0], remote.cut.number - before[1]
    remote.close()
    masks = [remote.tree.drawn(cut.split) for cut in cuts.values()]
    compared = [late[k] for k in np.linspace(count // 10, count - 1, _COMPARED).astype(int)]
    return {
        "frames": count,
        "seconds": took,
        "mbit_per_s": received * 8 / took / 1e6,
        "masks_per_s": number / took,
        "bytes_per_mask": received / max(1, number),
        "age_ms": {f"p{p}": 1000 * float(np.percentile(ages, p)) for p in (50, 95, 99)},
        "holes": sum(_holes(nodes, drawn) for drawn in masks),
        "gaussians": len(remote.forest.finest),
        "drawn": int(np.median([np.count_nonzero(drawn) for drawn in masks])),
        **_pictures(remote, compared),
    }


def _holes(nodes: HierarchyNodes, drawn: Bits) -> int:
    """Leaves that have none or several drawn nodes above them."""
    found, at = np.zeros(nodes.leaves, int), np.arange(nodes.leaves)
    while (at >= 0).any():
        found += np.where(at >= 0, drawn[at], 0)
        at = np.where(at >= 0, nodes.parent[at], -1)
    return int(np.count_nonzero(found != 1))


def _pictures(remote: Remote, compared: list[tuple[View, Cut]]) -> dict[str, Any]:
    """By how many JOD frames of late cuts differ from those of cuts that are found here."""
    from hybrid.measure.perceptual_metrics import jod
    from hybrid.render.splat_renderer import SplatRenderer
    from hybrid.window.remote.server import ViewCuts

    renderer, cuts = SplatRenderer(remote.forest), ViewCuts(remote.forest, _SETTINGS)

    def picture(view: View, split: Bits, level: float) -> Image:
        renderer.hold_cut(cuts.tree.drawn(split))
        camera, gaze, display = view
        settings = replace(_SETTINGS, camera=camera, gaze=gaze, display=display, level=level)
        return renderer.frame(settings).composite

    direct, lost = [], []
    for view, cut in compared:
        local = picture(view, *cuts.split(ViewMessage(1, 0, *view), None))
        shown = picture(view, cut.split, cut.level)
        finest = picture(view, np.ones_like(cut.split), 1e-3)
        of_late, of_local = (jod(image, finest, _DISPLAY, view[1]) for image in (shown, local))
        between = jod(shown, local, _DISPLAY, view[1])
        if of_late is None or of_local is None or between is None:
            return {"compared": 0}
        direct.append(10 - between)
        lost.append(of_local - of_late)
    return {
        "compared": len(compared),
        "jod_from_local": {"mean": float(np.mean(direct)), "most": float(np.max(direct))},
        "jod_lost_against_finest": {"mean": float(np.mean(lost)), "most": float(np.max(lost))},
    }


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
            trace = simulated(_DISPLAY, *_SIZE, 60, number)
            sequence, held, due = 0, 0, time.monotonic() + (number % 97) / 97 / _CALM
            while True:
                await asyncio.sleep(max(0.0, due - time.monotonic()))
                # What was late is not made up for.
                due = max(due + 1 / _CALM, time.monotonic())
                camera = view_at(welcome.camera, welcome.distance, time.monotonic() % 60)
                sequence += 1
                view = ViewMessage(sequence, held, camera, trace.at(time.monotonic() % 60), _DISPLAY)
                await connection.send(view.packed())
                held = MaskMessage.unpacked(bytes(await connection.recv(decode=False))).number
                self.answers[number] += 1

    async def hostile(self, number: int) -> None:
        """Does the same wrong thing again and again."""
        kinds = [self._stranger, self._garbage, self._bad, self._slow]
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
            camera = welcome.camera.resized(*_SIZE)
            view = ViewMessage(7, 0, camera, Gaze(), _DISPLAY).packed()
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
            camera = welcome.camera.resized(*_SIZE)
            connection.transport.pause_reading()
            await connection.send(bytes([FOREST_WANTED]))
            for sequence in range(1, 600):
                moved = camera.moved_right(sequence * 1e-3)
                await connection.send(ViewMessage(sequence, 0, moved, Gaze(), _DISPLAY).packed())
                await asyncio.sleep(0.2)


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


def measured(options: argparse.Namespace) -> dict[str, Any]:
    """Both runs, one after the other."""
    network = {"mbit_per_s": RATE / 1e6, "ms_each_way": 1000 * DELAY, "loss": LOSS}
    found: dict[str, Any] = {"network": network}
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        (work / "token").write_text(secrets.token_urlsafe(32))
        own = [sys.executable, "-m", "benchmarks.remote", options.scene, "--walk", str(work)]
        with slow_network(), serving(options, work, ADDRESSES[0], inside(SPACES[0]), []):
            subprocess.run([*inside(SPACES[1]), *own, "--seconds", str(options.seconds)], check=True)
        found["walk"] = json.loads((work / "walk.json").read_text())
        more = ["--clients", str(options.clients)]
        with serving(options, work, "127.0.0.1", [], more) as process:
            server = Server(f"ws://127.0.0.1:{_PORT}", (work / "token").read_text())
            found["many"] = asyncio.run(many(server, process, options.clients, options.hostile_seconds))
        found["many"]["log_lines"] = len((work / "log").read_text().splitlines())
    return found


def main() -> None:
    """Measures all of it."""
    parser = parser_of(__doc__)
    parser.add_argument("scene")
    parser.add_argument("--forest", type=Path, metavar="FILE")
    parser.add_argument("--seconds", type=float, default=20.0, metavar="N")
    parser.add_argument("--clients", type=int, default=200, metavar="N")
    parser.add_argument("--hostile-seconds", type=float, default=40.0, metavar="N")
    # The part that runs in the client's namespace.
    parser.add_argument("--walk", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.walk:
        server = Server(f"ws://{ADDRESSES[0]}:{_PORT}", (options.walk / "token").read_text())
        (options.walk / "walk.json").write_text(json_text(walk(server, options.seconds)))
        return
    report(measured(options), options.json)


if __name__ == "__main__":
    main()
