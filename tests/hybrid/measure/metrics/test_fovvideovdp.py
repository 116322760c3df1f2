"""FovVideoVDP: its maximum, its direction, and that it knows gaze and display."""

from __future__ import annotations

import subprocess
import sys
from importlib.util import find_spec

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from compose.eye.display import Display
from compose.eye.gaze import Gaze
from hybrid.measure.perceptual_metrics import jod
from tests import small

WIDTH, HEIGHT = 160, 96
# 40 degrees: 4 pixels per degree, so that the frame's edges lie in the periphery.
DISPLAY = Display(WIDTH, HEIGHT, 40.0)


@pytest.fixture(scope="module")
def image() -> np.ndarray:
    smooth = gaussian_filter(small.rng().normal(size=(HEIGHT, WIDTH, 3)), (6, 6, 0))
    return (0.3 + 0.1 * smooth / smooth.std()).clip(0.02, 1).astype(np.float32)


def noisy(image: np.ndarray, size: float) -> np.ndarray:
    return (image * small.rng(1).uniform(1 - size, 1 + size, image.shape)).astype(np.float32)


class TestInstalled:
    @pytest.fixture(autouse=True)
    def metric(self):
        if find_spec("pyfvvdp") is None:
            pytest.skip("FovVideoVDP is not installed")

    def test_equal_images_have_10_and_more_noise_has_less(self, image):
        scores = [jod(noisy(image, size), image, DISPLAY, Gaze()) for size in (0, 0.05, 0.2, 0.6)]
        assert scores[0] == pytest.approx(10, abs=1e-5)
        assert scores == sorted(scores, reverse=True)
        assert scores[1] - scores[3] > 0.5

    @pytest.mark.parametrize(
        ("x", "y", "part"),
        [
            (0.15, 0.5, np.s_[:, :48]),
            (0.85, 0.5, np.s_[:, -48:]),
            (0.5, 0.1, np.s_[:20]),
            (0.5, 0.9, np.s_[-20:]),
        ],
    )
    def test_a_defect_at_the_gaze_is_worse_than_one_elsewhere(self, image, x, y, part):
        defect = image.copy()
        defect[part] = noisy(image, 0.4)[part]
        gazes = Gaze(x, y), Gaze(), Gaze(1 - x, 1 - y)
        at, centre, away = (jod(defect, image, DISPLAY, gaze) for gaze in gazes)
        assert at < centre - 0.02
        assert centre < away - 0.02
        assert at < away - 0.05

    def test_fine_noise_is_less_visible_from_farther_away(self, image):
        """The same pixels span 40 and 4 degrees."""
        near, far = (jod(noisy(image, 0.4), image, Display(WIDTH, HEIGHT, fov), Gaze()) for fov in (40, 4))
        assert far > near + 0.2

    def test_noise_is_less_visible_on_a_darker_display(self, image):
        bright, dark = (
            jod(noisy(image, 0.2), image, Display(WIDTH, HEIGHT, 40.0, luminance), Gaze())
            for luminance in (200.0, 1.0)
        )
        assert dark > bright + 0.05

    def test_works_in_the_first_process_of_an_environment(self):
        """There pip is imported before anything else, by wheels that complete their installation."""
        code = """
import pip, os
import numpy as np
from compose.eye.display import Display
from compose.eye.gaze import Gaze
from hybrid.measure.perceptual_metrics import jod
image = np.full((48, 80, 3), 0.5, np.float32)
print(jod(image, image, Display(80, 48, 40.0), Gaze()), os.environ.get("SETUPTOOLS_USE_DISTUTILS"))
"""
        ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
        assert (ran.returncode, ran.stdout) == (0, "10.0 None\n"), ran.stderr
        assert "distutils" not in ran.stderr


def test_without_the_package_there_is_no_value(monkeypatch, image):
    monkeypatch.setitem(sys.modules, "pyfvvdp", None)
    assert jod(image, image, DISPLAY, Gaze()) is None
