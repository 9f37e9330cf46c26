"""Slow double-precision reference of the g80 chain, written from the definitions and from nothing in the
package.

Nominal model: closed-form solution of T dx/dt = -x + G u over each piece of held input. Frames: the defining
sums. Margin, one output: t* = |E| / (B_w + W_delta |Z|).
"""

from __future__ import annotations

import numpy as np

L, K, T1 = 2.661231232601298, 0.002678775525841357, 0.005145515095355525
DELAY, D0, R0 = 0.025, -0.0007443694838896991, 0.0009170204750782256
TS, SPEED = 0.02, (3.5, 19.0)


def nominal(v: np.ndarray, delta: np.ndarray, r_first: float) -> np.ndarray:
    """Nominal yaw rate (N,) along a drive."""
    speed = np.clip(v, *SPEED)
    G, T = speed / (L + K * speed**2), T1 * speed * L / (L + K * speed**2)
    whole = int(DELAY / TS)
    old = DELAY - whole * TS
    x, out = r_first - R0, np.empty(len(v))
    for k in range(len(v)):
        out[k] = x + R0
        for duration, index in ((old, k - whole - 1), (TS - old, k - whole)):
            decay = np.exp(-duration / T[k])
            x = decay * x + (1 - decay) * G[k] * (delta[max(index, 0)] - D0)
    return out


def frame(x: np.ndarray, start: int, length: int, cycles: int) -> complex:
    """Hann frame of x by its defining sum."""
    n = np.arange(length)
    w = 0.5 - 0.5 * np.cos(2 * np.pi * n / length)
    scale = (2.0 if cycles else 1.0) / w.sum()
    return scale * np.sum(w * x[start : start + length] * np.exp(-2j * np.pi * cycles * n / length))


def margin(E: complex, Z: complex, W_delta: float, B_w: float) -> float:
    return abs(E) / (B_w + W_delta * abs(Z))
