"""Drives that are too short for a bin do not inform it, and do not stop the identification."""

import numpy as np
import pytest

from lpvguard.drives.frames import Estimator
from lpvguard.identify.bounds import FRONT_POINTS, FrameSet, reduce_remainder, reduce_uncertainty


@pytest.mark.parametrize("structure", ["S1", "S1_diagonal"])
def test_a_bin_without_a_frame_is_no_information(g80, g80_model, structure):
    estimator = Estimator.from_project(g80, g80_model)
    E = np.full((3, 1), 0.01 + 0j)
    few = FrameSet(5, E, 10 * E, np.arange(3))
    none = FrameSet(1, E[:0], E[:0], np.arange(0))
    gamma_w, grid = np.full(estimator.n_bins, 0.001), np.ones((estimator.n_bins, FRONT_POINTS))
    reduced = reduce_uncertainty([none, few], estimator, gamma_w, grid, 1, structure)
    reduced |= reduce_remainder([none, few], estimator, np.zeros((estimator.n_bins, 1)), 1, structure)[0]
    assert np.isnan(reduced["nu"][1]).all() and np.isnan(reduced["B_w"][1]).all()
    assert np.isfinite(reduced["nu"][5]).all()
