"""Excitation of the change test by a gain error in one bin alone (THEORY 7.4)."""

from __future__ import annotations

import numpy as np

from ..base.sampling import row_hash, stacked
from ..drives.frames import Estimator
from .change import BLOCK, Blocks, ChangeTest
from .visibility import SPEED_CELLS, Excitation, speed_cell


def in_bins(x: np.ndarray, omega: np.ndarray, Ts: float) -> np.ndarray:
    """Parts (K, N, m) of the signals x (N, m) around each bin.

    Neighbouring parts meet at the geometric mean of their frequencies ``omega`` (K,) [rad/s], of which the
    first is 0. The last part ends as far above its bin as it begins below, and holds no higher frequency.
    """
    edges = np.sqrt(omega[1:-1] * omega[2:])
    edges = np.concatenate([[omega[1] ** 2 / edges[0]], edges, [omega[-1] ** 2 / edges[-1]]])
    spectrum = np.fft.rfft(x, axis=0)
    at = np.searchsorted(edges, 2 * np.pi * np.fft.rfftfreq(len(x), Ts), side="right")
    return np.stack([np.fft.irfft(spectrum * (at == k)[:, None], len(x), axis=0) for k in range(len(omega))])


def narrow_excitation(
    test: ChangeTest, name: str, yhat: np.ndarray, v: np.ndarray, estimator: Estimator
) -> Excitation:
    """Excitation of the change test in a drive, by what a vehicle without response in one bin would show.

    ``yhat`` (N, n_y) is the nominal output, ``v`` (N,) the speed. The rows are one a hop, of the ratio of a
    gain error of 1. The ratio is proportional to the error (THEORY 7.4).
    """
    K, settled = estimator.n_bins, estimator.settled(v)
    rows = [{"group": np.zeros(0, int), "hash": np.zeros(0, np.uint64), "dead": np.zeros(0)}]
    for k, part in enumerate(in_bins(yhat, estimator.omega, estimator.Ts)):
        once_a_hop = slice(None, None, max(1, int(estimator.hop[k]) // BLOCK))
        for blocks in Blocks.stretches(part, yhat, settled):
            ends = blocks.ends[once_a_hop]
            ratio = (np.abs(test.estimates(blocks, once_a_hop)) / test.size).max(axis=(1, 2), initial=0.0)
            group = speed_cell(estimator.speed_range, v[ends]) * K + k
            rows.append({"group": group, "hash": row_hash(name, group % K, ends), "dead": ratio})
    every = stacked(rows)
    return Excitation.of_rows(np.zeros((SPEED_CELLS, K), int), every, every)
