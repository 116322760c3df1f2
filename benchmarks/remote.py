"""What a server's masks and discs cost and show over a slow network, and what hostile clients do to it.

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
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import hybrid  # noqa: F401  (finds LLVM before anything loads one)
from benchmarks import parser_of, report
from benchmarks.many_clients import DISPLAY, SIZE, many, view_at
from benchmarks.slow_network import ADDRESSES, DELAY, LOSS, RATE, SPACES, inside, slow_network
from compose.base.files import json_text
from compose.eye.gaze import Gaze, simulated
from compose.image.colour import Image, decibels, srgb_from_radiance
from hybrid.base.progress import no_bars, no_progress
from hybrid.preparation.preparation import with_forest
from hybrid.preparation.scene_plan import as_stored
from hybrid.render.frame_renderer import LiveRenderer
from hybrid.render.frame_settings import INTERACTIVE, FrameSettings
from hybrid.render.splat_renderer import SplatRenderer
from hybrid.window.messages import Server
from hybrid.window.remote.client import Cut, Remote, View
from hybrid.window.remote.disc_messages import DiscWanted, StreamedDisc
from hybrid.window.remote.protocol import ViewMessage
from hybrid.window.remote.shown_disc import with_disc
from pathtrace.scene.backend import select_backend
from pathtrace.scene.scene import Scene, load_scene
from splat.model.forest import Forest
from splat.model.hierarchy import HierarchyNodes
from splat.model.points import Bits

_RATE = 60.0
_PORT = 8765
# Frames whose pictures are compared.
_COMPARED = 100
# Seconds between jumps of the gaze; milliseconds after one at which the picture is judged; and how many
# samples per pixel, so many times, it is judged by.
_REST = 1.5
_LAGS = (0, 50, 100, 150, 200, 300, 1000)
_SPP, _SEEDS = 16, 12
_SETTINGS = FrameSettings(level=1.0)


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


def walk(remote: Remote, seconds: float) -> dict[str, Any]:
    """A client that asks for 60 masks per second: what came, how old it was, and how it looked."""
    home, distance = remote.welcome.camera, remote.welcome.distance
    trace = simulated(DISPLAY, *SIZE, seconds + 1, 0)
    nodes = remote.forest.hierarchy_nodes
    # The first masks are as large as the picture is detailed, and come before the walk begins.
    remote.look(view_at(home, distance, 0), trace.at(0), DISPLAY)
    while not remote.is_current:
        remote.changed.wait(1)
        remote.changed.clear()
    asked: list[tuple[float, View]] = []
    ages, cuts, late = [], {}, []
    disc_ages: dict[int, float] = {}
    assert remote.cut is not None
    count, begin, before = round(seconds * _RATE), time.monotonic(), (remote.bytes, remote.cut.number)
    disc_bytes, times = remote.disc_bytes, {0: begin}
    for frame in range(count):
        due = begin + frame / _RATE
        time.sleep(max(0.0, due - time.monotonic()))
        now = time.monotonic()
        view = view_at(home, distance, now - begin), trace.at(now - begin), DISPLAY
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
        disc = remote.disc
        if disc is not None and disc.message.sequence in times:
            disc_ages.setdefault(disc.message.sequence, now - times[disc.message.sequence])
        cuts[cut.number] = cut
        late.append((view, cut))
    took = time.monotonic() - begin
    received, number = remote.bytes - before[0], remote.cut.number - before[1]
    disc_bytes = remote.disc_bytes - disc_bytes
    of_discs = {}
    if disc_ages:
        of_discs["discs"] = {
            "mbit_per_s": disc_bytes * 8 / took / 1e6,
            "per_s": len(disc_ages) / took,
            "bytes": disc_bytes / len(disc_ages),
            "age_ms": _milliseconds(list(disc_ages.values())),
        }
    masks = [remote.tree.drawn(cut.split) for cut in cuts.values()]
    compared = [late[k] for k in np.linspace(count // 10, count - 1, _COMPARED).astype(int)]
    return {
        "frames": count,
        "seconds": took,
        "mbit_per_s": received * 8 / took / 1e6,
        "masks_per_s": number / took,
        "bytes_per_mask": received / max(1, number),
        "age_ms": _milliseconds(ages),
        **of_discs,
        "holes": sum(_holes(nodes, drawn) for drawn in masks),
        "gaussians": len(remote.forest.finest),
        "drawn": int(np.median([np.count_nonzero(drawn) for drawn in masks])),
        **_pictures(remote, compared),
    }


def _milliseconds(seconds: list[float]) -> dict[str, float]:
    return {f"p{p}": 1000 * float(np.percentile(seconds, p)) for p in (50, 95, 99)}


def jumps(remote: Remote, scene: Scene, forest: Forest) -> dict[str, Any]:
    """A viewer at rest whose gaze jumps: when the disc is there, and what the picture is like until then.

    `fovea_db` is PSNR against many samples, so many milliseconds after a jump, or rendered on this side.
    """
    view = remote.welcome.camera.resized(*SIZE)
    # Often: of one disc in four or five a packet is lost, and comes a round trip later.
    places = [Gaze(x, y) for y in (0.3, 0.7) for x in (0.2, 0.5, 0.8)] * 6
    seen: list[tuple[Gaze, list[tuple[float, Cut, StreamedDisc | None]]]] = []
    for gaze in places:
        begin, shown = time.monotonic(), []
        remote.look(view, gaze, DISPLAY)
        while (now := time.monotonic()) < begin + _REST:
            cut = remote.cut
            assert cut is not None
            shown.append((now - begin, cut, remote.disc))
            time.sleep(1 / _RATE)
        seen.append((gaze, shown))
    remote.close()
    renderer, tree = SplatRenderer(remote.forest), remote.tree
    waits: list[float] = []
    errors: dict[str, list[float]] = {}
    truths: dict[Gaze, tuple[Bits, Image, Image]] = {}
    for gaze, shown in seen[1:]:
        settings = replace(
            INTERACTIVE, camera=view, gaze=gaze, display=DISPLAY, acuity_model=remote.welcome.acuity_model
        )
        if gaze not in truths:
            truths[gaze] = _truth(LiveRenderer(scene, forest), settings)
        fovea, first, truth = truths[gaze]

        def error(image: Image, fovea: Bits = fovea, truth: Image = truth) -> float:
            return decibels(float(np.mean((srgb_from_radiance(image[fovea]) - truth) ** 2)))

        waits.append(next(at for at, _, disc in shown if disc is not None and disc.gaze == gaze))
        for lag in _LAGS:
            _, cut, disc = next(one for one in reversed(shown) if one[0] <= lag / 1000 or one is shown[0])
            renderer.hold_cut(tree.drawn(cut.split))
            late = renderer.frame(replace(settings, level=cut.level))
            image = (with_disc(late, disc) if disc else late).composite
            errors.setdefault(f"{lag}", []).append(error(image))
        errors.setdefault("rendered here", []).append(error(first))
    return {
        "jumps": len(waits),
        "ms_until_the_disc": _milliseconds(waits),
        "fovea_db": {name: float(np.median(found)) for name, found in errors.items()},
    }


def _truth(renderer: LiveRenderer, settings: FrameSettings) -> tuple[Bits, Image, Image]:
    """Where a frame is path-traced alone (H, W), its image, and those pixels (N, 3) of many samples, sRGB."""
    frame = renderer.frame(settings)
    fovea, first = frame.weight_image() >= 1, frame.composite.copy()
    for seed in range(_SEEDS):
        frame = renderer.refined(frame, _SPP, seed + 1, quick=False)
    return fovea, first, srgb_from_radiance(frame.composite[fovea])


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
        of_late, of_local = (jod(image, finest, DISPLAY, view[1]) for image in (shown, local))
        between = jod(shown, local, DISPLAY, view[1])
        if of_late is None or of_local is None or between is None:
            return {"compared": 0}
        direct.append(10 - between)
        lost.append(of_local - of_late)
    return {
        "compared": len(compared),
        "jod_from_local": {"mean": float(np.mean(direct)), "most": float(np.max(direct))},
        "jod_lost_against_finest": {"mean": float(np.mean(lost)), "most": float(np.max(lost))},
    }


def measured(options: argparse.Namespace) -> dict[str, Any]:
    """Both runs, one after the other."""
    network = {"mbit_per_s": RATE / 1e6, "ms_each_way": 1000 * DELAY, "loss": LOSS}
    found: dict[str, Any] = {"network": network}
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        (work / "token").write_text(secrets.token_urlsafe(32))
        own = [sys.executable, "-m", "benchmarks.remote", options.scene, "--forest", str(options.forest)]
        own += ["--walk", str(work), "--seconds", str(options.seconds)]
        for name, discs in (("walk", 0), ("streamed", 1)):
            more = ["--discs", str(discs)]
            with slow_network(), serving(options, work, ADDRESSES[0], inside(SPACES[0]), more):
                subprocess.run([*inside(SPACES[1]), *own, *more], check=True)
            found[name] = json.loads((work / "walk.json").read_text())
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
    parser.add_argument("--discs", type=int, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.walk:
        (options.walk / "walk.json").write_text(json_text(watched(options)))
        return
    report(measured(options), options.json)


def watched(options: argparse.Namespace) -> dict[str, Any]:
    """What a client sees, with a disc or without."""
    select_backend("llvm")
    remote = Remote(Server(f"ws://{ADDRESSES[0]}:{_PORT}", (options.walk / "token").read_text()))
    remote.wait(no_progress)
    if not options.discs:
        found = walk(remote, options.seconds)
        remote.close()
        return found
    remote.want(DiscWanted(INTERACTIVE.fov_a, INTERACTIVE.fov_b, INTERACTIVE.spp))
    found = walk(remote, options.seconds)
    loaded, forest = with_forest(as_stored(load_scene(options.scene)), options.forest, no_bars)
    return found | jumps(remote, loaded, forest)


if __name__ == "__main__":
    main()
