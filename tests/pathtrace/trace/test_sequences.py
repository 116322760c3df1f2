"""Sobol sequences: each pair of dimensions is stratified, and pairs and positions differ."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from scipy import stats

from pathtrace.trace.film import FILM, LIGHT, SCATTERING, Sequences, sobol_tables

pytestmark = pytest.mark.usefixtures("backend")


def points(pair: int, count: int, one: int = 3, other: int = 5, start: int = 0) -> np.ndarray:
    """(2, count) points of one sequence, from a number on."""
    number = dr.arange(mi.UInt32, count) + start
    sequences = Sequences(sobol_tables(), number, (mi.UInt32(one), mi.UInt32(other)))
    x, y = sequences.point(pair, number)
    return np.stack([x.numpy(), y.numpy()])


def first_points(pair: int, count: int) -> np.ndarray:
    """(2, count) first points of as many sequences."""
    sequences = Sequences(sobol_tables(), mi.UInt32(0), (dr.arange(mi.UInt32, count), mi.UInt32(7)))
    x, y = sequences.point(pair, dr.zeros(mi.UInt32, count))
    return np.stack([x.numpy(), y.numpy()])


@pytest.mark.parametrize("pair", [FILM, LIGHT, SCATTERING])
def test_each_of_n_strata_has_one_of_n_points(pair):
    x, y = points(pair, 256)
    for values in (x, y):
        assert sorted((values * 256).astype(int)) == list(range(256))


@pytest.mark.parametrize("pair", [FILM, LIGHT, SCATTERING])
def test_scrambled_points_are_uniform(pair):
    first = first_points(pair, 2000)
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
    film = first_points(FILM, 2000)
    light = first_points(LIGHT, 2000)
    for one in film:
        for other in light:
            assert abs(stats.pearsonr(one, other).statistic) < 0.1
