"""What a bound on indirect light removes is what it says."""

from __future__ import annotations

import numpy as np
import pytest

from hybrid.preparation.stage_frames import clamping_bias
from pathtrace.scene.scene import load_scene
from pathtrace.trace.film import frame_positions, interleaved
from pathtrace.trace.tracer import Tracer
from tests import small

pytestmark = pytest.mark.usefixtures("backend")


def test_no_bound_removes_nothing_and_a_small_one_all_indirect_light():
    scene = load_scene(small.corner())
    cameras = [scene.camera]

    def tracer(most: float) -> Tracer:
        return Tracer(scene, most_indirect=most)

    free = tracer(1e9)
    assert clamping_bias(tracer(1e6), free, cameras, 1) == 0
    removed = clamping_bias(tracer(1e-6), free, cameras, 1)
    some = clamping_bias(tracer(0.05), free, cameras, 1)
    assert 0 < some < removed < 1
    # Against frames of their own seeds.
    positions = frame_positions(scene.camera)
    means = [
        np.mean(interleaved(one.trace(scene.camera, positions, 256, seed).radiance))
        for seed, one in enumerate((tracer(1e-6), free))
    ]
    assert removed == pytest.approx(1 - means[0] / means[1], abs=0.03)


def test_darkness_loses_nothing():
    dark = small.corner()
    dark["lamp"]["emitter"]["radiance"]["value"] = 0.0
    scene = load_scene(dark)
    tracer = Tracer(scene, most_indirect=1.0)
    assert clamping_bias(tracer, tracer, [scene.camera], 0) == 0
