"""What stays invisible: the smallest gain and delay error that the frame test can see, per speed cell and bin (DESIGN 4.4).

A vehicle whose response is c times the nominal one shows the error E = -g Z in every output, |g| = |1 - c|. The margin of a
frame grows in proportion to g (scale delta and w alike), so it exceeds the threshold exactly when

    g > threshold / t*(-Z, Z),

t* being the exact margin of validation.s1; with one output this is g |Z| > threshold (B_w + W_delta |Z|). However strong
the excitation, g below threshold x W_delta stays invisible. A delay tau has g = |1 - exp(-j omega tau)| = 2 |sin(omega tau / 2)|.
Only the phase of g is free here: the vehicle's ordinary nominal error comes on top and can add to the fault or hide it.
"""

from __future__ import annotations

import numpy as np

from .validation import s1

PERCENTILE = 90
"""Excitation at which visibility is stated: reached by one in ten counted frames of the speed cell and bin."""
SPEED_CELLS = 5
STATED_GAINS = (0.6, 0.7)
STATED_DELAYS_S = (0.3, 0.15)


def visibility(omega: np.ndarray, speed_range: tuple[float, float], bin_of: np.ndarray, speed: np.ndarray, Z: np.ndarray,
               W_delta: np.ndarray, B_w: np.ndarray, threshold: float) -> dict:
    """Smallest visible errors over SPEED_CELLS equal cells of ``speed_range`` [m/s]; JSON-able, None where no frame counts.

    omega (K,) [rad/s], 0 at DC; counted frames: bin_of (F,), mean speed (F,) [m/s], Z (F, n_y) [output units]; W_delta (K,),
    B_w (K, n_y) at the bins, as the monitor has them. Lists under ``cells`` run over the bins:
    ``frames``, ``excitation`` |Z| [output units], ``gain_error`` [-], ``delay_s`` (None at DC and where no delay is large
    enough). The representative frame of a cell and bin is the one whose margin t*(-Z, Z) stands at PERCENTILE
    (nearest rank): for one output that is the percentile of |Z|, for several it needs no weighing of their units.
    """
    dead = s1.margin(-Z, Z, W_delta[bin_of], B_w[bin_of])
    edges = np.linspace(*speed_range, SPEED_CELLS + 1)
    cell_of = np.clip(np.searchsorted(edges, speed, side="right") - 1, 0, SPEED_CELLS - 1)
    cells = []
    for c in range(SPEED_CELLS):
        members = [np.flatnonzero((cell_of == c) & (bin_of == k)) for k in range(len(omega))]
        chosen = [_at_percentile(dead, m) for m in members]
        gain = [None if i is None or dead[i] == 0 else float(threshold / dead[i]) for i in chosen]
        delay = [_delay(g, w) for g, w in zip(gain, omega)]
        cells.append({
            "speed_mps": [float(edges[c]), float(edges[c + 1])], "frames": [len(m) for m in members],
            "excitation": [None if i is None else float(np.linalg.norm(Z[i])) for i in chosen],
            "gain_error": gain, "delay_s": delay,
            "smallest_gain_error": min((g for g in gain if g is not None), default=None),
            "smallest_delay_s": min((d for d in delay if d is not None), default=None),
            "stated": [{"fault": f"gain {value:g}", "visible": _seen(gain, np.full(len(omega), abs(1 - value)))}
                       for value in STATED_GAINS]
                      + [{"fault": f"delay {value:g} s", "visible": _seen(gain, _delay_error(omega, value))}
                         for value in STATED_DELAYS_S]})
    return {"threshold": float(threshold), "percentile": PERCENTILE, "omega_rad_s": omega.tolist(),
            "gain_error_floor": (threshold * W_delta).tolist(), "cells": cells}


def _at_percentile(values: np.ndarray, members: np.ndarray) -> int | None:
    """Index of the member whose value has the nearest rank to PERCENTILE; None without members."""
    if not len(members):
        return None
    rank = int(np.ceil(PERCENTILE / 100 * len(members))) - 1
    return int(members[np.argsort(values[members], kind="stable")[rank]])


def _delay_error(omega: np.ndarray | float, tau: float) -> np.ndarray:
    """|1 - exp(-j omega tau)|."""
    return 2 * np.abs(np.sin(np.asarray(omega) * tau / 2))


def _delay(gain_error: float | None, omega: float) -> float | None:
    """Smallest delay [s] whose error reaches ``gain_error``; no delay makes an error above 2, nor any at DC."""
    if gain_error is None or omega == 0 or gain_error > 2:
        return None
    return float(2 * np.arcsin(gain_error / 2) / omega)


def _seen(gain_error: list[float | None], error: np.ndarray) -> bool | None:
    """Whether an error of size ``error`` (K,) is visible in any bin; None where the cell has no frames."""
    known = [(g, e) for g, e in zip(gain_error, error) if g is not None]
    return any(e > g for g, e in known) if known else None
