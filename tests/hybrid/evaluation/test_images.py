"""Images are embedded, under the labels that the page lists."""

from __future__ import annotations

import base64
import io

import numpy as np
from PIL import Image as PillowImage

from hybrid.evaluation.evaluation_page import embedded_flips, embedded_images
from hybrid.evaluation.results import OURS, Results
from tests.hybrid.evaluation import content


def shown(url: str) -> np.ndarray:
    kind, data = url.split(",")
    assert kind == "data:image/jpeg;base64"
    return np.asarray(PillowImage.open(io.BytesIO(base64.b64decode(data))))


def test_each_label_shows_its_image_of_that_view(tmp_path):
    results = Results(content.write(tmp_path))
    keys = {key: results.label(key) for key in results.keys}
    for view in range(2):
        images = embedded_images(tmp_path, view, keys)
        assert list(images) == ["reference", *keys.values()]
        for number, url in enumerate(images.values()):
            assert shown(url).shape == (16, 32, 3)
            assert abs(shown(url).mean() - (20 * number + 10 * view)) < 2
        assert "rmfr, tuned (equal-time)" in images


def test_maps_that_do_not_exist_are_left_out(tmp_path):
    results = Results(content.write(tmp_path))
    keys = {key: results.label(key) for key in results.keys}
    assert abs(shown(embedded_flips(tmp_path, 0, keys)[OURS]).mean() - 20) < 2
    for file in tmp_path.glob("1-*-flip.png"):
        file.unlink()
    assert len(embedded_flips(tmp_path, 0, keys)) == len(keys)
    assert embedded_flips(tmp_path, 1, keys) == {}
