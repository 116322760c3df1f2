"""Names of images: one for each view, method and budget, and fit for a web page."""

from __future__ import annotations

import re
from itertools import product

from hybrid.evaluation.results import EQUAL_RAYS, EQUAL_TIME, FIXED, OURS_KEY, Key, flip_name, image_name


def test_names_stay_as_earlier_reports_have_them():
    assert image_name(0, OURS_KEY) == "0-hybrid-fused-fixed.png"
    assert (
        image_name(3, Key("rmfr, tuned for the fovea", EQUAL_TIME))
        == "3-rmfr-tuned-for-the-fovea-equal-time.png"
    )
    assert image_name(2, None) == "2-reference.png"
    assert flip_name(1, Key("3dgs, no forest", FIXED)) == "1-3dgs-no-forest-fixed-flip.png"


def test_no_two_images_have_the_same_name():
    methods = ("full", "full, denoised", "hybrid, fused", "hybrid, fused, 16 spp", "hybrid, fused, 1 spp")
    keys = [Key(*key) for key in product(methods, (FIXED, EQUAL_RAYS, EQUAL_TIME))]
    names = [name(view, key) for view in range(2) for key in keys for name in (image_name, flip_name)]
    names += [image_name(view, None) for view in range(2)]
    assert len(set(names)) == len(names)
    assert all(re.fullmatch(r"[\w-]+\.png", name) for name in names)
