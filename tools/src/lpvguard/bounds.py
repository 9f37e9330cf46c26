"""Stage 3, unfalsified bounds: B1, B2, gamma_w, nu and B_w per bin over frames at every start (paper, steps 2-6).

Drives are streamed: every pass reduces a drive to maxima per bin, and maxima are joined, so neither memory nor the result
depends on the number or the order of the drives. Bins: 0 is DC. Units of E, Z, B1, B2, gamma_w, B_w: the outputs' own.

Rule of step 4 (DESIGN 4.4): a ceiling nu_bar(omega) on the uncertainty is set beforehand; the disturbance bound is what
the frames need beyond it,

    gamma_w(omega_k) = max over frames of sqrt(B1^2 + |Z|^2 max(0, |delta0| - nu_bar)^2),   gamma_w(0) = B2(0)

smoothed upward by an overbounding weight; then nu = min |delta| subject to |E - delta Z| <= gamma_w (step 5).
A bin without a counted frame is NaN: "no information", never 0.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np

from .drives import Drive
from .frames import Estimator
from .nominal import NominalModel
from .validation import s1


@dataclass(frozen=True)
class FrameSet:
    """Counted frames of one drive in one bin: E, Z (F, n_y) complex, starts (F,) first samples."""

    bin: int
    E: np.ndarray
    Z: np.ndarray
    starts: np.ndarray


def nominal_error(drive: Drive, model: NominalModel) -> tuple[np.ndarray, np.ndarray]:
    """Nominal error and nominal output along a drive: e, yhat (N, n_y) each, e = y - yhat (paper, e = y_n - P23 u)."""
    yhat = model.simulate(drive.v, drive.u, drive.y[0])
    return drive.y - yhat, yhat


def counted_frames(drive: Drive, e: np.ndarray, yhat: np.ndarray, estimator: Estimator, *,
                   hop_only: bool = False) -> Iterator[FrameSet]:
    """All bins' counted frames, at every start, or only those the core sees when it starts with the drive."""
    both = np.hstack([e, yhat])
    n_y = e.shape[1]
    for k in range(estimator.n_bins):
        starts = np.flatnonzero(estimator.counted(drive.v, k))
        if hop_only:
            starts = starts[starts % (estimator.length[k] // 2) == 0]
        spectra = estimator.transform(both, k, starts)
        yield FrameSet(k, spectra[:, :n_y], spectra[:, n_y:], starts)


@dataclass
class Bounds:
    """Bounds per bin (K,), B_w (K, n_y); ``frames`` counts counted frames, ``excitation`` is max |Z|."""

    omega: np.ndarray
    frames: np.ndarray
    excitation: np.ndarray
    B1: np.ndarray
    B2: np.ndarray
    gamma_rule: np.ndarray
    gamma_w: np.ndarray = field(default_factory=lambda: np.empty(0))
    nu: np.ndarray = field(default_factory=lambda: np.empty(0))
    B_w: np.ndarray = field(default_factory=lambda: np.empty(0))


def _fold(parts: Iterable[dict[str, np.ndarray]], add: tuple[str, ...] = ()) -> dict[str, np.ndarray]:
    """Join per-drive reductions: sums for the keys in ``add``, maxima (NaN where nobody has a frame) for the others."""
    total: dict[str, np.ndarray] = {}
    for part in parts:
        for key, value in part.items():
            if key not in total:
                total[key] = value.copy()
            else:
                total[key] = total[key] + value if key in add else np.fmax(total[key], value)
    return total


def _maximum(values: np.ndarray) -> np.ndarray | float:
    return values.max(axis=0) if len(values) else np.nan


FrameSource = Callable[[], Iterable[Iterable[FrameSet]]]


def disturbance_bounds(frames_of_drives: FrameSource, estimator: Estimator, nu_ceiling: np.ndarray) -> Bounds:
    """Steps 2-4 before smoothing: one pass over all frames. ``nu_ceiling`` (K,), 0 at DC."""

    def reduce(sets: Iterable[FrameSet]) -> dict[str, np.ndarray]:
        K = estimator.n_bins
        out = {key: np.full(K, np.nan) for key in ("excitation", "B1", "B2", "gamma_rule")} | {"frames": np.zeros(K, int)}
        for s in sets:
            out["frames"][s.bin] = len(s.E)
            size = np.linalg.norm(s.E, axis=1)
            z = np.linalg.norm(s.Z, axis=1)
            b1 = s1.solve(s.E, s.Z, size).b1
            excess = np.maximum(0.0, np.abs(s1.least_squares_delta(s.E, s.Z)) - nu_ceiling[s.bin])
            rule = size if estimator.cycles[s.bin] == 0 else np.hypot(b1, z * excess)
            for key, values in (("excitation", z), ("B1", b1), ("B2", size), ("gamma_rule", rule)):
                out[key][s.bin] = _maximum(values)
        return out

    total = _fold((reduce(sets) for sets in frames_of_drives()), add=("frames",))
    return Bounds(omega=estimator.omega, **total)


def explain(s: FrameSet, estimator: Estimator, gamma_w: np.ndarray, structure: str) -> tuple[np.ndarray, np.ndarray]:
    """Step 5 on every frame: least |delta| (F,) and the disturbance w (F, n_y) that goes with it, given ``gamma_w`` (K,)."""
    if structure == "S0" or estimator.cycles[s.bin] == 0:
        return np.zeros(len(s.E)), s.E
    result = s1.solve(s.E, s.Z, gamma_w[s.bin])
    return result.nu, result.w


def uncertainty_bounds(frames_of_drives: FrameSource, estimator: Estimator, bounds: Bounds, gamma_w: np.ndarray,
                       n_y: int, *, structure: str, disturbance_set: str) -> Bounds:
    """Steps 5-6: nu and the per-output disturbance bound B_w given ``gamma_w`` (K,); fills and returns ``bounds``.

    ``covering``: B_w is scaled until sum_j |w_j / B_w,j|^2 <= 1 on every frame; ``paper``: |w_j| <= B_w,j.
    """

    def explained(s: FrameSet) -> tuple[np.ndarray, np.ndarray]:
        return explain(s, estimator, gamma_w, structure)

    def reduce(sets: Iterable[FrameSet]) -> dict[str, np.ndarray]:
        out = {"nu": np.full(estimator.n_bins, np.nan), "B_w": np.full((estimator.n_bins, n_y), np.nan)}
        for s in sets:
            nu, w = explained(s)
            out["nu"][s.bin], out["B_w"][s.bin] = _maximum(nu), _maximum(np.abs(w))
        return out

    total = _fold(reduce(sets) for sets in frames_of_drives())
    bounds.gamma_w, bounds.nu, bounds.B_w = gamma_w, total["nu"], total["B_w"]
    if disturbance_set == "covering" and n_y > 1:
        bounds.B_w = bounds.B_w * _covering_scale(frames_of_drives, estimator, bounds.B_w, explained)[:, None]
    return bounds


def _covering_scale(frames_of_drives: FrameSource, estimator: Estimator, B_w: np.ndarray, explained) -> np.ndarray:
    def reduce(sets: Iterable[FrameSet]) -> dict[str, np.ndarray]:
        scale = np.full(estimator.n_bins, np.nan)
        for s in sets:
            w = explained(s)[1]
            relative = np.divide(np.abs(w), B_w[s.bin], out=np.zeros(w.shape), where=B_w[s.bin] > 0)
            scale[s.bin] = _maximum(np.linalg.norm(relative, axis=1))
        return {"scale": scale}

    return np.fmax(1.0, _fold(reduce(sets) for sets in frames_of_drives())["scale"])


def peak_magnitudes(frames_of_drives: Iterable[Iterable[FrameSet]], estimator: Estimator,
                    n_y: int) -> tuple[np.ndarray, np.ndarray]:
    """Largest |E_j| and largest |Y_j| = |E_j + Z_j| over all frames, (K, n_y) each; NaN where no frame counts.

    |E_j| of zero-input drives bounds the sensors' noise (W_n), of all others the disturbance of class S0; |Y_j| of the yaw
    rate bounds the commands that such drives contain (W_C; paper, section V).
    """

    def reduce(sets: Iterable[FrameSet]) -> dict[str, np.ndarray]:
        out = {key: np.full((estimator.n_bins, n_y), np.nan) for key in ("E", "Y")}
        for s in sets:
            out["E"][s.bin], out["Y"][s.bin] = _maximum(np.abs(s.E)), _maximum(np.abs(s.E + s.Z))
        return out

    empty = np.full((estimator.n_bins, n_y), np.nan)
    total = _fold([{"E": empty, "Y": empty}, *(reduce(sets) for sets in frames_of_drives)])
    return total["E"], total["Y"]
