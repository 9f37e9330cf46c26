"""Limit of detection: the smallest gain error that a test with full knowledge of the vehicle sees (T55;
THEORY 7.19)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy.stats import norm

from .bounds import FrameSet


@dataclass(frozen=True)
class LimitSums:
    """Sums over drives, by speed cell, bin and output, each (C, K, n_y).

    Attributes
    ----------
    drives : ndarray, number of drives with at least two frames
    freedom : ndarray, sum over these drives of the number of frames less one
    residue : ndarray, sum of |E - d Z|^2 with the d of each drive [output units squared]
    power, power_squared : ndarray, sums of P and P^2 over drives, P = sum of |Z|^2
    along, along_squared : ndarray, sums of P Re(d) and P Re(d)^2
    """

    drives: np.ndarray
    freedom: np.ndarray
    residue: np.ndarray
    power: np.ndarray
    power_squared: np.ndarray
    along: np.ndarray
    along_squared: np.ndarray

    @classmethod
    def from_frames(
        cls, frames: Iterable[tuple[np.ndarray, FrameSet]], shape: tuple[int, int, int]
    ) -> LimitSums:
        """Sums of a drive, from its frames, one set for each bin, with the speed cell (F,) of each frame."""
        count = np.zeros(shape[:2])
        power, squares, along = np.zeros(shape), np.zeros(shape), np.zeros(shape, complex)
        for cell, s in frames:
            np.add.at(count[:, s.bin], cell, 1)
            np.add.at(power[:, s.bin], cell, np.abs(s.Z) ** 2)
            np.add.at(squares[:, s.bin], cell, np.abs(s.E) ** 2)
            np.add.at(along[:, s.bin], cell, s.Z.conj() * s.E)
        enough = (count[:, :, None] > 1) & (power > 0)
        P = np.where(enough, power, 0.0)
        d = np.divide(along, power, out=np.zeros(shape, complex), where=enough)
        residue = np.where(enough, squares - np.abs(d) ** 2 * P, 0.0)
        freedom = np.where(enough, count[:, :, None] - 1, 0.0)
        return cls(
            drives=enough + 0.0,
            freedom=freedom,
            residue=residue,
            power=P,
            power_squared=P**2,
            along=P * d.real,
            along_squared=P * d.real**2,
        )

    @classmethod
    def joined(cls, parts: Iterable[LimitSums]) -> LimitSums:
        """Sums of all drives of the parts."""
        return cls(*(np.sum(x, axis=0) for x in zip(*(vars(p).values() for p in parts), strict=True)))

    def spread(self) -> tuple[np.ndarray, np.ndarray]:
        """Disturbance S [output units squared] and variance of the gains (C, K, n_y), NaN if unknown."""
        with np.errstate(divide="ignore", invalid="ignore"):
            S = self.residue / self.freedom
            Q = 2 / S * (self.along_squared - self.along**2 / self.power)
            between = (Q - (self.drives - 1)) / (2 / S * (self.power - self.power_squared / self.power))
        known = (self.drives > 1) & (S > 0)
        return np.where(known, S, np.nan), np.where(known, np.maximum(between, 0.0), np.nan)

    def quantile(self, alpha: float, drives: int, held: np.ndarray) -> float:
        """Normal quantile of one look, such that any look of a drive alarms with probability ``alpha``.

        A look is a pool of ``held`` (K,) frames of one output, for errors of one sign.
        """
        frames = (self.freedom + self.drives).sum(axis=(0, 2))
        looks = max(1.0, 2 * float((frames / held).sum()) / drives)
        return float(norm.isf(-np.expm1(np.log1p(-alpha) / looks)))

    def gain_error(self, quantile: float, cell: np.ndarray, k: np.ndarray, size: np.ndarray) -> np.ndarray:
        """Smallest visible gain error (F,) in pools, by speed cell and bin ``k`` (F,).

        sqrt(P) of the pools is ``size`` (F, n_y). It is NaN where fewer than two drives inform about the
        disturbance.
        """
        S, between = (x[cell, k] for x in self.spread())
        with np.errstate(divide="ignore"):
            each = quantile * np.sqrt(S / (2 * size**2) + between)
        return np.fmin.reduce(each, axis=1)
