"""Sobol sequences: each pair of dimensions is stratified, and pairs and positions differ."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from scipy import stats

from pathtrace.trace.sequences import FILM, LIGHT, SCATTERING, Sequences, sobol_tables

pytestmark = pytest.mark.usefixtures("backend")


def points(pair: int, count: int, one: int = 3, other: int = 5, start: int = 0) -> np.ndarray:
    number = dr.arange(mi.UInt32, count) + start
    sequences = Sequences(sobol_tables(), number, (mi.UInt32(one), mi.UInt32(other)))
    x, y = sequences.point(pair, number)
    return np.stack([x.numpy(), y.numpy()])


@pytest.mark.parametrize("pair", [FILM, LIGHT, SCATTERING])
def test_each_of_n_strata_has_one_of_n_points(pair):
    x, y = points(pair, 256)
    for values in (x, y):
        assert sorted((values * 256).astype(int)) == list(range(256))


@pytest.mark.parametrize("pair", [FILM, LIGHT, SCATTERING])
def test_scrambled_points_are_uniform(pair):
    first = np.concatenate([points(pair, 1, one, 7) for one in range(2000)], axis=1)
    for values in first:
        assert stats.kstest(values, "uniform").pvalue > 1e-3


def test_pairs_scramblings_and_restarts_differ():
    drawn = [
        points(FILM, 16),
        points(LIGHT, 16),
        points(SCATTERING, 16),
        points(FILM, 16, 4),
        points(FILM, 16, start=4096),
    ]
    for index, one in enumerate(drawn):
        for other in drawn[:index]:
            assert (one != other).all()


def test_film_and_lights_are_not_related():
    film = np.concatenate([points(FILM, 1, one, 7) for one in range(2000)], axis=1)
    light = np.concatenate([points(LIGHT, 1, one, 7) for one in range(2000)], axis=1)
    for one in film:
        for other in light:
            assert abs(stats.pearsonr(one, other).statistic) < 0.1
