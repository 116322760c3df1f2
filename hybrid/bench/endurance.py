"""Many frames along a gaze trace, as in the window: whether memory, picture or kernels change with time."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import drjit as dr
import numpy as np

from compose.eye.gaze import Gaze
from compose.eye.gaze_trace import GazeTrace
from compose.image.colour import Image
from hybrid.frame.live import LiveRenderer
from hybrid.frame.settings import FrameSettings
from hybrid.interactive.loop import FrameLoop
from hybrid.interactive.request import Request
from hybrid.interactive.source import FrameSource
from hybrid.runtime.memory import resident_memory

# Frames of a block, whose figures make one row; between two blocks the picture is compared.
BLOCK = 200
# Frames per second at which the trace is followed, whatever a frame takes.
_RATE = 60.0


@dataclass(frozen=True)
class _Block:
    """What a block of frames took.

    Attributes:
        milliseconds: median of its frames.
        compiled: kernels that were compiled, or loaded from disk, meanwhile.
    """

    milliseconds: float
    compiled: int


def bench_endurance(
    renderer: LiveRenderer,
    settings: FrameSettings,
    trace: GazeTrace,
    frames: int,
    progress: Callable[[int, int], None],
) -> dict[str, Any]:
    """Renders frames along a gaze trace, over and over, in the window's loop.

    Between blocks, the first frame is rendered again as if nothing had been rendered before, and compared
    with what it was: a renderer without drift gives the same numbers for ever.

    Args:
        renderer: of the scene.
        settings: of the frames, with their camera.
        trace: the viewer's gaze; starts again at its end.
        frames: how many, rounded up to whole blocks.
        progress: called with frames done and frames in total.

    Returns:
        `blocks`, each with `frames` so far, `seconds` since the start, `milliseconds` per frame, `memory` of
        the process in MiB, `compiled` kernels, and `drift`, the largest difference of the picture's radiance
        from the one after the first block.
    """
    source = FrameSource(renderer)
    loop = FrameLoop(source, lambda request: [])
    blocks: list[dict[str, Any]] = []
    first: Image | None = None
    start = time.perf_counter()
    # Kernels are counted from a history that Dr.Jit keeps if it is told to.
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        for done in range(0, frames, BLOCK):
            block = _block(loop, settings, trace, done)
            source.forget()
            picture = renderer.frame(replace(settings, gaze=Gaze()), seed=0).composite
            first = picture if first is None else first
            source.forget()
            blocks.append(
                {
                    "frames": done + BLOCK,
                    "seconds": time.perf_counter() - start,
                    "milliseconds": block.milliseconds,
                    "memory": resident_memory() / 2**20,
                    "compiled": block.compiled,
                    "drift": float(np.abs(picture - first).max()),
                }
            )
            progress(done + BLOCK, -(-frames // BLOCK) * BLOCK)
    return {"scene": renderer.scene.name, "blocks": blocks, **summary(blocks)}


def _block(loop: FrameLoop, settings: FrameSettings, trace: GazeTrace, done: int) -> _Block:
    """Renders a block of frames after `done` others."""
    times = []
    for number in range(done, done + BLOCK):
        gaze = trace.at(number / _RATE % max(trace.duration, 1 / _RATE))
        began = time.perf_counter()
        loop.make(Request(replace(settings, gaze=gaze)))
        times.append(1000 * (time.perf_counter() - began))
    kernels = (kernel for kernel in dr.kernel_history() if "cache_hit" in kernel)
    compiled = sum(not kernel["cache_hit"] or kernel["cache_disk"] for kernel in kernels)
    return _Block(float(np.median(times)), compiled)


def summary(blocks: list[dict[str, Any]]) -> dict[str, float]:
    """How the blocks after the first minute compare.

    Returns:
        `memory_growth`: MiB per 1,000 frames, the slope of a line through the blocks' memory; `late_compiled`
        kernels; `drift`, the largest; `slower`, the median frame of the last fifth over that of the first.
    """
    late = [block for block in blocks if block["seconds"] > 60] or blocks[-1:]
    count = [block["frames"] / 1000 for block in late]
    memory = [block["memory"] for block in late]
    slope = float(np.polyfit(count, memory, 1)[0]) if len(late) > 1 else 0.0
    fifth = max(1, len(late) // 5)
    median = lambda some: float(np.median([block["milliseconds"] for block in some]))  # noqa: E731
    return {
        "memory_growth": slope,
        "late_compiled": sum(block["compiled"] for block in late),
        "drift": max(block["drift"] for block in blocks),
        "slower": median(late[-fifth:]) / median(late[:fifth]),
    }
