"""Effect of Delta's memory on the frame test: t* of an error that only a causal Delta causes, with w = 0.

t* of a frame assumes that Delta is one complex number. A causal Delta with impulse response delta_k is a
system with memory. Let h be the Hann window of N samples (scale 4/N), and z any nominal output. Then

    E - Delta(jw) Z = (4/N) sum_k delta_k e^-jwk sum_m (h[m+k] - h[m]) z[m] e^-jwm.

The Euclidean norm of the differences h[m+k] - h[m] is at most k (pi/N) sqrt(N/2). Let |Delta(jw)| <= W_delta,
and let the disturbance lie within B_w. Let delta be q N samples long. Then N (1 + q) samples of z affect the
frame. With their root mean square rms,

    t* <= 1 + 2 sqrt(2) pi sqrt(1 + q) (sum_k k |delta_k| / N) rms / B_w.

The bench draws random stable Delta with sup |Delta| = W_delta and a length of q frames. It draws random z
with a steep spectrum.
"""

from dataclasses import dataclass

import numpy as np

from lpvguard.engine.validation import s1

FRACTIONS = (0.02, 0.05, 0.1, 0.2, 0.5)
SAMPLES, PERIODS = 300, 3
"""Length of the monitor's frames, and number of periods of the bin's frequency in a frame."""
W_DELTA, B_W = 0.35, 0.05
"""Bound of |Delta|, and bound of the disturbance as a share of the nominal output's root mean square."""


@dataclass(frozen=True)
class MemoryRow:
    """Statistics of t* over random Delta whose length is ``fraction`` of the frame.

    ``bound_max`` is the largest proved bound. ``tightest`` is the largest (t* - 1) / (bound - 1).
    """

    fraction: float
    median: float
    p95: float
    largest: float
    share_above_1: float
    bound_max: float
    tightest: float


def draw(fraction: float, draws: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Compute t* (draws,) and its bound (draws,) for random Delta of length ``fraction`` of a frame."""
    rng = np.random.default_rng([seed, round(1e6 * fraction)])
    N, length = SAMPLES, max(round(fraction * SAMPLES), 2)
    hann = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(N) / N)
    kernel = 4 / N * hann * np.exp(-2j * np.pi * PERIODS / N * np.arange(N))
    t, bound = np.empty(draws), np.empty(draws)
    for i in range(draws):
        delta = rng.standard_normal(length)
        if i % 2:  # a pure delay
            delta = np.where(np.arange(length) == length - 1, 1.0, 0.0)
        delta *= W_DELTA / np.abs(np.fft.rfft(delta, 16 * N)).max()
        z = np.cumsum(rng.standard_normal(N + 2 * length))[length:]
        z -= z.mean()
        e = np.convolve(z, delta)[: len(z)]
        z, e = z[1:], e[1:]  # length - 1 earlier samples affect the frame
        reaching = z[-(N + length - 1) :]
        rms = np.sqrt(np.mean(reaching**2))
        E, Z = kernel @ e[-N:], kernel @ z[-N:]
        t[i] = s1.margin(np.array([[E]]), np.array([[Z]]), np.array([W_DELTA]), np.array([[B_W * rms]]))[0]
        moment = np.sum(np.arange(length) * np.abs(delta)) / N
        bound[i] = 1 + 2 * np.sqrt(2) * np.pi * np.sqrt(len(reaching) / N) * moment / B_W
    return t, bound


def rows(draws: int = 2000, seed: int = 0) -> list[MemoryRow]:
    """Compute one row for each of FRACTIONS."""
    out = []
    for q in FRACTIONS:
        t, bound = draw(q, draws, seed)
        out.append(
            MemoryRow(
                q,
                float(np.median(t)),
                float(np.percentile(t, 95)),
                float(t.max()),
                float(np.mean(t > 1)),
                float(bound.max()),
                float(np.max((t - 1) / (bound - 1))),
            )
        )
    return out


def table(rows: list[MemoryRow]) -> str:
    """Write the rows as a Markdown table."""
    lines = [
        "| memory / frame | median t* | 95 % | largest | above 1 | largest bound |",
        "|---|---|---|---|---|---|",
    ]
    return "\n".join(
        lines
        + [
            f"| {r.fraction:g} | {r.median:.2f} | {r.p95:.2f} | {r.largest:.2f} | {r.share_above_1:.1%} "
            f"| {r.bound_max:.2f} |"
            for r in rows
        ]
    )
