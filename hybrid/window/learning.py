"""Goes on preparing a scene while it is watched: in a process of its own, at a lower priority."""

from __future__ import annotations

import json
import logging
import math
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import IO, TypeAlias

import drjit as dr
import torch

from compose.base.errors import UserError, one_line
from compose.base.files import locked
from compose.camera.camera import Camera
from hybrid.base.cache_folder import newest_forest, scene_folder
from hybrid.base.progress import Progress, bars_of
from hybrid.preparation.earlier_jobs import newest_job
from hybrid.preparation.preparation import Beginning, Staged, prepare
from hybrid.preparation.scene_plan import as_planned
from hybrid.preparation.stages import GLIMPSE, LIVE, PreparationSettings
from hybrid.window.messages import Newest
from pathtrace.region.neighbourhood import is_elsewhere
from pathtrace.scene.backend import select_backend
from pathtrace.scene.scene import Scene, files_of_scene, load_scene
from splat.io.forest_file import load_forest
from splat.model.forest import Forest

# Seconds between two lines about the progress, and between two looks at a scene's files: folders of other
# machines tell nobody of their changes.
_LINE_EVERY, _LOOK_EVERY = 1.0, 0.5
# Seconds for which a viewer stands still before it counts as staying.
_STAYS = 2.0
# Niceness of learning, over that of the window, and the most that there is: of two cores that a window wants
# whole, about a third of one is left to it.
_NICE, _MOST_NICE = 5, 19
_Stamps: TypeAlias = dict[Path, tuple[int, int]]


@dataclass(frozen=True)
class ShownScene:
    """A scene as it is loaded for the window; arguments as in `load_scene` and `select_backend`."""

    source: str
    thin_glass: bool = False
    sensor: str | None = None
    backend: str = "auto"

    def load(self) -> Scene:
        """Loads it, without a plan."""
        return load_scene(self.source, thin_glass=self.thin_glass, sensor=self.sensor)


def forest_to_show(scene: Scene) -> tuple[Path | None, bool]:
    """The best forest of a scene that there is, and whether it is still to learn.

    That is the newest one of the cache, else that of a stage of a preparation that was watched.
    """
    newest = newest_forest(scene)
    if newest is not None:
        return newest, newest.name.startswith(LIVE)
    folder = scene_folder(scene.name, scene.hash)
    for kind in (LIVE, GLIMPSE):
        stages = sorted(folder.glob(f"{kind}-*/stage-*.safetensors"), key=lambda file: file.stat().st_mtime)
        if stages:
            return stages[-1], True
    return None, True


@dataclass(frozen=True)
class Task:
    """What is to be learnt, in types that JSON has.

    Attributes:
        start: file of the forest to go on from.
        urgent: whether the window leaves half of its threads to it until there is a better forest.
        job: folder of the preparation whose frames are taken over; see `Beginning`.
        place: `Camera.key` of where it learns, in hexadecimal digits; by default, where it last did.
    """

    start: str | None = None
    urgent: bool = False
    job: str | None = None
    place: str | None = None

    @staticmethod
    def after(scene: Scene, forest: Path, place: str | None) -> Task:
        """To go on soon from a forest, and from the preparation of a scene that traced last."""
        job = newest_job(scene)
        return Task(str(forest), True, None if job is None else str(job.folder), place)


class Learner:
    """A preparation in another process; `say` gets a line about it.

    `forests` has the newest forest, of which better ones follow. Until an urgent task has come to the first
    one that no other one follows soon, it `is_awaited`.
    """

    def __init__(self, scene: ShownScene, task: Task, say: Callable[[str], object]):
        self.forests: Newest[tuple[Path, Forest]] = Newest()
        self.is_awaited = task.urgent
        self._say, self._ending = say, False
        given = json.dumps({"scene": asdict(scene), "task": asdict(task)})
        self._process = subprocess.Popen(
            [sys.executable, "-m", __name__, given],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            # Ctrl-C is for the window, which ends this.
            start_new_session=True,
        )
        threading.Thread(target=self._read, daemon=True).start()

    @property
    def is_running(self) -> bool:
        """Whether there may be better forests."""
        return self._process.poll() is None

    def stop(self) -> None:
        """Tells the process to save what it has, and to end; the next one goes on where it was."""
        self._ending = True
        assert self._process.stdin is not None
        self._process.stdin.close()

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            if self._ending:
                continue
            told = json.loads(line)
            if "forest" in told:
                path = Path(told["forest"])
                self.forests.put((path, load_forest(path)))
                self.is_awaited &= told["more"]
            self._say(told["line"])
        self.is_awaited = False
        code = self._process.wait()
        if code and not self._ending:
            self._say(f"learning has ended unexpectedly, with code {code}")


class SceneWatch:
    """Looks now and then at the files of a scene, given as in `load_scene`."""

    def __init__(self, source: str | Path):
        self._source, self._files = source, files_of_scene(source)
        self._known = self._seen = self._stamps({})
        self._next = 0.0

    def changed(self) -> bool:
        """Whether files have changed since the last time, and are no longer being written.

        What files there are is asked of the scene after a change only: its XML may have megabytes.
        """
        now = time.monotonic()
        if now < self._next:
            return False
        self._next = now + _LOOK_EVERY
        before, self._seen = self._seen, self._stamps(self._seen)
        if self._seen == self._known or self._seen != before:
            return False
        try:
            self._files = files_of_scene(self._source)
        except UserError:
            return False  # until it can be read
        self._known = self._seen = self._stamps(self._seen)
        return True

    def _stamps(self, before: _Stamps) -> _Stamps:
        """Times and sizes of the files; those of before while one of them is missing."""
        try:
            found = {file: file.stat() for file in self._files}
        except OSError:
            return before
        return {file: (stat.st_mtime_ns, stat.st_size) for file, stat in found.items()}


class Watched:
    """What becomes of a scene while it is shown: its files change, and its forest learns.

    Args:
        scene: that is shown.
        learns: whether a preparation goes on beside it.
        say: gets a line about either.
    """

    def __init__(self, scene: ShownScene, learns: bool, say: Callable[[str], object]):
        self._scene, self._learns, self._say = scene, learns, say
        self._files = SceneWatch(scene.source)
        self._learner: Learner | None = None
        self._threads = dr.thread_count()

    @property
    def learns(self) -> bool:
        """Whether it has begun to learn."""
        return self._learner is not None

    def learn(self, task: Task) -> None:
        """Begins to learn the scene as it is now, in place of what it was learning."""
        self.stop()
        if self._learns:
            self._learner = Learner(self._scene, task, self._say)
            self.share_threads()

    def learnt(self) -> tuple[Path, Forest] | None:
        """A better forest and its file, if there is one that was not taken yet."""
        return None if self._learner is None else self._learner.forests.take()

    def changed(self) -> Scene | None:
        """The scene if its files have changed; None if they have not, or cannot be read, which is said."""
        if not self._files.changed():
            return None
        try:
            return self._scene.load()
        except UserError as error:
            self._say(f"{one_line(error)}; shown as it was")
            return None

    def share_threads(self, rests: bool = False) -> None:
        """Draws with all threads, or what learning leaves while its forest is awaited or the view rests."""
        learner = self._learner
        shares = learner is not None and (rests or learner.is_awaited) and learner.is_running
        count = max(1, self._threads - _share_of(self._threads)) if shares else self._threads
        if count != dr.thread_count():
            dr.set_thread_count(count)

    def stop(self) -> None:
        """Ends learning."""
        if self._learner is not None:
            self._learner.stop()
            self._learner = None
            self.share_threads()


class Viewer:
    """Where somebody looks from, and whether that is a place to be learnt.

    `place` is the one that is being learnt, as in `Task`; None for that of the scene's own camera.
    """

    def __init__(self) -> None:
        self.place: str | None = None
        self._camera: Camera | None = None
        self._since = math.inf

    def stays(self, camera: Camera) -> bool:
        """Told the camera again and again: whether it has stood still for a while; once for each rest."""
        now = time.monotonic()
        if camera != self._camera:
            self._camera, self._since = camera, now
        if now - self._since < _STAYS:
            return False
        self._since = math.inf
        return True

    def is_away(self, scene: Scene, known: list[Camera]) -> bool:
        """Whether the camera sees something else than what is known from cameras, and has space around it."""
        assert self._camera is not None
        learning = [] if self.place is None else [Camera.of_key(bytes.fromhex(self.place))]
        return is_elsewhere(scene, self._camera, [*known, *learning])

    def settle(self) -> str:
        """Makes where the camera is the place."""
        assert self._camera is not None
        self.place = self._camera.key.hex()
        return self.place


def _learn(shown: ShownScene, task: Task, tell: Callable[..., None]) -> None:
    bars = bars_of(_telling(tell))
    scene = as_planned(shown.load(), bars)
    newest = newest_forest(scene)
    if newest is not None and not newest.name.startswith(LIVE):
        return tell("prepared earlier", newest)

    def told(staged: Staged, more: bool = False) -> None:
        took = f"stage {staged.number} of {staged.stages}, {staged.seconds:.0f} s"
        tell(f"learnt: {staged.psnr:.1f} dB in training frames after {took}", staged.forest, more)

    settings = PreparationSettings(quality=LIVE, held_out=0)
    folders = {scene_folder(scene.name, scene.hash)} | ({Path(task.job).parent} if task.job else set())
    with ExitStack() as stack:
        # Another window may still be learning it, or the process before this one may not have ended yet.
        for folder in sorted(folders):
            stack.enter_context(locked(folder / "learning"))
        beginning = _beginning(scene, task)
        if any(job.parent != scene_folder(scene.name, scene.hash) for job in beginning.jobs):
            # Something of what has changed is shown soon, before the frames of before are looked through.
            first, alone = replace(settings, quality=GLIMPSE), replace(beginning, jobs=())
            glimpse = prepare(scene, first, bars, beginning=alone, told=partial(told, more=True))
            folder = Path(glimpse.facts["forest"]).parent
            beginning = replace(beginning, forest=glimpse.forest, jobs=(*beginning.jobs, folder))
        prepared = prepare(scene, settings, bars, beginning=beginning, told=told)
    tell("all stages are learnt", Path(prepared.facts["forest"]))


def _beginning(scene: Scene, task: Task) -> Beginning:
    forest = None if task.start is None else load_forest(Path(task.start))
    jobs = () if task.job is None else (Path(task.job),)
    if task.place is not None:
        return Beginning(forest, jobs, Camera.of_key(bytes.fromhex(task.place)))
    last = newest_job(scene)
    return Beginning(forest, jobs, None if last is None else last.place)


def _share_of(threads: int) -> int:
    """How many of a processor's threads learn, beside others that draw.

    On two cores, a second one saves a fifth of the time alone, and beside a window costs as much.
    """
    return max(1, threads // 2)


def _give_way() -> None:
    """Lets this process have less time than the one that started it.

    Linux may schedule each session as a group ("autogroups" in sched(7)): priorities of processes are
    compared in their group alone, and groups share equally unless they have priorities, too.
    """
    os.nice(_NICE)
    with suppress(OSError):
        group = Path("/proc/self/autogroup")
        nice = _nice_of_group(group.read_text(), Path(f"/proc/{os.getppid()}/autogroup").read_text())
        if nice is not None:
            group.write_text(str(nice))


def _nice_of_group(own: str, above: str) -> int | None:
    """Priority of the group `own` of a process started from `above`, as /proc says them; None to keep it.

    Either is empty if its process is in no group, as what a container's first process starts.
    """
    name, _, nice = above.split() or ("", "", "0")
    return None if own.split()[:1] in ([], [name]) else min(int(nice) + _NICE, _MOST_NICE)


def _telling(tell: Callable[..., None]) -> Progress:
    told = time.monotonic()

    def report(done: int, total: int, label: str) -> None:
        nonlocal told
        if time.monotonic() - told > _LINE_EVERY:
            told = time.monotonic()
            tell(f"learning: {label.split(' (')[0]} {done / max(total, 1):.0%}")

    return report


def _interrupt_with(stream: IO[str]) -> None:
    """Interrupts this process as Ctrl-C does once the other end of a stream is closed."""
    stream.read()
    os.kill(os.getpid(), signal.SIGINT)


def _main() -> None:
    """Of the process; its lines are JSON: `line`, for people; `forest`, a file; whether `more` come soon."""
    logging.basicConfig(level=logging.ERROR)
    # What libraries print must not mix with the lines.
    out = os.dup(sys.stdout.fileno())
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    given = json.loads(sys.argv[1])
    shown, task = ShownScene(**given["scene"]), Task(**given["task"])
    _give_way()

    def tell(line: str, forest: Path | None = None, more: bool = False) -> None:
        told = {"line": line} | ({} if forest is None else {"forest": str(forest), "more": more})
        # A window that has ended is about to end this, too.
        with suppress(BrokenPipeError):
            os.write(out, (json.dumps(told) + "\n").encode())

    with suppress(KeyboardInterrupt):
        try:
            # Interrupted while it is loaded, a library fails.
            select_backend(shown.backend)
            threads = _share_of(dr.thread_count())
            dr.set_thread_count(threads)
            torch.set_num_threads(threads)
            # Where a window was started in the background, Ctrl-C is ignored, and by what it starts.
            signal.signal(signal.SIGINT, signal.default_int_handler)
            threading.Thread(target=_interrupt_with, args=(sys.stdin,), daemon=True).start()
            _learn(shown, task, tell)
        except UserError as error:
            tell(f"learning has ended: {one_line(error)}")
        # Told to end while it ends, libraries would print errors.
        signal.signal(signal.SIGINT, signal.SIG_IGN)


if __name__ == "__main__":
    _main()
