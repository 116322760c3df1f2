"""Kills commands at random moments, lets them resume, and compares what they make with a run in peace.

Every command is a process of its own, forked from this one, which has imported everything but started
nothing: no Mitsuba variant, no thread. Half of the kills come at a random moment of the clock, half exactly
before the n-th step of the writes of files (sync, rename, sync of the folder), where a moment of the clock
would seldom fall.

    python -m tests.faults.killing FOLDER KILLS SEED JOB...

prints one JSON line of kills, resumed runs and differences.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import shutil
import signal
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from tests.faults.readable import unreadable

CAPTURE = ["--views", "5", "--held-out", "3", "--size", "32", "32", "--spp", "2", "--held-out-spp", "4"]
TRAIN = ["--iterations", "40", "--gaussians", "400", "--degree", "1", "--layers", "2"]
EVALUATE = ["--size", "64", "64", "--views", "2", "--reference-spp", "4", "--repeats", "3", "--quick"]
EVALUATE += ["--seeds", "1", "--fov-a", "40", "--fov-b", "30"]
SWEEP = ["--over", "layers", "--size", "48", "48", "--repeats", "3", "--warm-up", "1", "--reference-spp", "4"]
# What is timed differs each time.
_TIMED = ("ms", "ms_range", "full_ms", "ratio", "ratio_range", "ratio_interval", "passes", "covered")
_LONGEST_S = 600.0


@dataclass(frozen=True)
class Job:
    """A command that is killed.

    Attributes:
        arguments: of the command in a folder, given the folder of the commands before it.
        result: what must be the same, of the folder.
        longest: seconds up to which it is killed.
        begin: makes what the command finds in its folder, given that of the commands before it.
    """

    arguments: Callable[[Path, Path], list[str]]
    result: Callable[[Path], Any]
    longest: float
    begin: Callable[[Path, Path], object] = lambda at, made: None


@dataclass
class Summary:
    """What happened to one command."""

    kills: int = 0
    at_writes: int = 0
    runs: int = 0
    completed: int = 0
    failures: list[str] = field(default_factory=list)


def hashes(folder: Path) -> dict[str, str]:
    """Hash of each file in a folder by its name."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return {str(f.relative_to(folder)): hashlib.sha256(f.read_bytes()).hexdigest() for f in files}


def _evaluated(folder: Path) -> Any:
    """All that is not timed: rays at equal time are those of the run in peace, kept in the cache folder."""
    found = json.loads((folder / "r" / "evaluation.json").read_text())
    return [found[name] for name in ("views", "references", "methods", "quality", "verdicts")]


def _swept(folder: Path) -> Any:
    rows = json.loads((folder / "s.json").read_text())["rows"]
    return [{name: value for name, value in row.items() if name not in _TIMED} for row in rows]


JOBS = {
    "capture": Job(lambda at, _: ["capture", "cornell", f"{at}/frames", *CAPTURE], hashes, 3.0),
    "traced": Job(
        lambda at, _: ["capture", "cornell", f"{at}/frames", *CAPTURE, "--integrator", "path"], hashes, 2.0
    ),
    "train": Job(lambda at, made: ["train", f"{made}/capture/frames", f"{at}/f.forest", *TRAIN], hashes, 4.0),
    "evaluate": Job(
        lambda at, made: [
            *("evaluate", "cornell", "--forest", f"{made}/train/f.forest", "--report", f"{at}/r"),
            *EVALUATE,
        ],
        _evaluated,
        45.0,
    ),
    "part": Job(
        lambda at, _: [
            *("capture", "cornell", f"{at}/frames", *CAPTURE, "--integrator", "path", "--part", "1/1")
        ],
        hashes,
        2.0,
    ),
    "merge": Job(
        lambda at, _: ["merge", f"{at}/frames"],
        hashes,
        1.0,
        lambda at, made: shutil.copytree(made / "part", at),
    ),
    "sweep": Job(
        lambda at, made: [
            *("sweep", "cornell", "--forest", f"{made}/train/f.forest", "--json", f"{at}/s.json"),
            *SWEEP,
        ],
        _swept,
        6.0,
    ),
}


def _import(names: list[str]) -> None:
    """Imports what the commands need, so that each run starts at once."""
    import hybrid.cli.main
    import hybrid.render.irradiance
    import pathtrace.dataset.capture  # noqa: F401

    if set(names) - {"capture", "traced", "part", "merge"}:
        import hybrid.evaluation.evaluation
        import hybrid.evaluation.evaluation_page
        import hybrid.evaluation.quickstart
        import hybrid.evaluation.sweep_run  # noqa: F401


def _run(arguments: list[str], home: Path, step: int | None, log: Path) -> None:
    """Runs a command in this process, a new one, and ends it; killed before the given step of its writes."""
    os.setsid()
    output = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.dup2(output, 1)
    os.dup2(output, 2)
    os.environ["HYBRID_HOME"] = str(home)
    from hybrid.preparation import forest_training as forest

    # Else a training as short as this has no checkpoint to resume from.
    forest._CHECKPOINT_SECONDS = 0.1
    if step is not None:
        _die_before(step)
    sys.argv = ["hybrid", *arguments]
    code = 1
    try:
        from hybrid.cli.main import main

        main()
        code = 0
    except SystemExit as stopped:
        code = int(stopped.code or 0)
    finally:
        sys.stdout.flush()
        os._exit(code)


def _die_before(step: int) -> None:
    """Lets this process kill itself before its n-th sync or rename."""
    done = 0

    def counted(function: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any, **options: Any) -> Any:
            nonlocal done
            done += 1
            if done >= step:
                os.kill(os.getpid(), signal.SIGKILL)
            return function(*arguments, **options)

        return call

    os.fsync, os.replace = counted(os.fsync), counted(os.replace)  # type: ignore[assignment]


def _forked(arguments: list[str], home: Path, step: int | None, after: float | None, log: Path) -> int:
    """Exit code of a command; negative if it was killed, by itself or after some seconds."""
    child = os.fork()
    if not child:
        _run(arguments, home, step, log)
    end = time.monotonic() + (after or _LONGEST_S)
    while time.monotonic() < end:
        pid, status = os.waitpid(child, os.WNOHANG)
        if pid:
            break
        time.sleep(0.01)
    else:
        os.kill(child, signal.SIGKILL)
        _, status = os.waitpid(child, 0)
    # What it started itself must end as well, as on a machine that is switched off.
    if os.WIFSIGNALED(status):
        with contextlib.suppress(ProcessLookupError):
            os.killpg(child, signal.SIGKILL)
    return os.waitstatus_to_exitcode(status)


def killed(name: str, folder: Path, kills: int, seed: int) -> Summary:
    """Runs a command in peace, then again and again with kills, and compares.

    Args:
        name: of the command.
        folder: for everything; commands before it must have been run there.
        kills: number of them.
        seed: same seed, same steps and moments.
    """
    job, summary, rng = JOBS[name], Summary(), np.random.default_rng(seed)
    home, log = folder / f"home-{name}", folder / f"{name}.log"
    peaceful = folder / name
    arguments = job.arguments(peaceful, folder)
    job.begin(peaceful, folder)
    if _forked(arguments, home, None, None, log):
        summary.failures.append(f"in peace: {log.read_text()[-300:]}")
        return summary
    expected = job.result(peaceful)
    number, at = 0, folder / f"{name}-killed"
    job.begin(at, folder)
    while summary.kills < kills and not summary.failures:
        by_step = number % 2 == 0
        step = int(rng.integers(1, 25)) if by_step else None
        after = None if by_step else float(rng.uniform(0, job.longest))
        number += 1
        summary.runs += 1
        code = _forked(job.arguments(at, folder), home, step, after, log)
        summary.failures += [f"unreadable after {number} runs: {file}" for file in unreadable(at, home)]
        if code == -signal.SIGKILL:
            summary.kills += 1
            summary.at_writes += by_step
        else:
            _finish(job, at, code, expected, summary, log)
            job.begin(at, folder)
    if not summary.failures:
        summary.runs += 1
        code = _forked(job.arguments(at, folder), home, None, None, log)
        _finish(job, at, code, expected, summary, log)
    return summary


def _finish(job: Job, at: Path, code: int, expected: Any, summary: Summary, log: Path) -> None:
    """Compares what a command made that came to its end, and removes it."""
    if code:
        summary.failures.append(f"exit code {code}: {log.read_text()[-300:]}")
        return
    if job.result(at) != expected:
        summary.failures.append(f"another result: {at}")
        return
    left = [str(path) for path in at.rglob(".*")]
    summary.failures += [f"left behind: {path}" for path in left]
    summary.completed += 1
    if not summary.failures:
        shutil.rmtree(at)


def main() -> None:
    folder, kills, seed, *names = sys.argv[1:]
    Path(folder).mkdir(parents=True, exist_ok=True)
    _import(names)
    found = {}
    for name in names:
        begin = time.monotonic()
        summary = killed(name, Path(folder), int(kills), int(seed))
        found[name] = {**summary.__dict__, "seconds": round(time.monotonic() - begin)}
        print(json.dumps({name: found[name]}), flush=True)


if __name__ == "__main__":
    main()
