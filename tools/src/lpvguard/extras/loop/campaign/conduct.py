"""What the closed loop did in a run, measured from its signals, and what of it a certificate rules out.

Three things falsify the certificate when the truck of the run is within the bounds:

    oscillates  the demand holds a steady line above the commanded band (``steady_line``), of at least
                LEAST_BAR
    saturates   the demand is at its limit for at least SATURATED_S in one stretch (``longest_stretch``)
    loses track the error of the yaw rate up to STEERING_RADPS is larger, rms, than the certificate allows
                with the run's command, disturbance and noise (tracking.py)

The error is that to the reference model's answer to the command. What a user asks for is tighter than what is
proved, and is counted beside it: the share TRACKED of the wanted yaw rate, TRACKED_WEAK where the truck's
brakes have less than WEAK_BRAKES of the nominal gain, and the free motion of the same truck, left alone on
the same road in the same wind, which is there however small the command is. The two are independent, and
their powers add.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

LEAST_BAR = 0.25
"""The least amplitude of use: the bounds say nothing of smaller ones, where friction rules."""
LINE_SHARE = 0.6
"""Of the demand's power above the commanded band that a steady line holds in its main lobe."""
LINE_KEPT = 0.7
"""Of its amplitude that a line keeps from one window to the next, or it decays."""
WINDOW_S, HIGHEST_RADPS, BAND_GAP_RADPS = 20.0, 60.0, 1.0
"""Of a search for lines: its windows, where it ends, and how far above the commanded band it begins."""
LOBE = 2
"""Half the main lobe of a Hann window in samples of its spectrum."""

SATURATED_S = 1.0
BRIDGED_S = 0.1
"""Noise takes a demand off its limit for an instant; what is shorter does not end a stretch."""
AT_LIMIT = 0.999

STEERING_RADPS = 1.0
"""Upper end of the steering task, above which little tracking is asked for."""
TRACKED, TRACKED_WEAK, WEAK_BRAKES = 0.10, 0.15, 0.8


@dataclass(frozen=True)
class Line:
    """A steady line of the demand: its least amplitude [bar] in the windows that hold it, and its frequency;
    both 0 where there is none."""

    bar: float
    radps: float


def steady_line(u: np.ndarray, Ts: float, commanded: float) -> Line:
    """The largest line of the demand ``u`` (N,) [bar] that stays, BAND_GAP_RADPS and more above the highest
    frequency ``commanded`` [rad/s]. ``Ts`` [s]: between samples.

    A window of WINDOW_S, every half window one, holds a line where its highest peak, no slope of what lies
    below, has LINE_SHARE of the power up to HIGHEST_RADPS in its main lobe. It stays where three windows in
    succession, 2 WINDOW_S in all, hold it within a tenth of its frequency and it keeps LINE_KEPT of its
    amplitude. The response of a damped loop to noise has a broader peak, and a step's decays.
    """
    length = round(WINDOW_S / Ts)
    starts = range(0, len(u) - length + 1, length // 2)
    found = [_line(u[start : start + length], Ts, commanded + BAND_GAP_RADPS) for start in starts]
    best = Line(0.0, 0.0)
    for lines in zip(found, found[1:], found[2:], strict=False):
        steady = all(
            a.bar > 0 and b.bar >= LINE_KEPT * a.bar and abs(b.radps - a.radps) <= 0.1 * a.radps
            for a, b in pairwise(lines)
        )
        least = min(lines, key=lambda line: line.bar)
        if steady and least.bar > best.bar:
            best = least
    return best


def _line(u: np.ndarray, Ts: float, above: float) -> Line:
    """The line of one window; amplitude 0 where it holds none."""
    window = np.hanning(len(u) + 1)[:-1]
    power = 2 * np.abs(np.fft.rfft(window * (u - u.mean()))) ** 2 / (len(u) * (window**2).sum())
    omega = 2 * np.pi * np.arange(len(power)) / (len(u) * Ts)
    first, end = np.searchsorted(omega, [above, HIGHEST_RADPS])
    searched = power[first:end]
    k = int(np.argmax(searched))
    lobe = float(searched[max(0, k - LOBE) : k + LOBE + 1].sum())
    if k < LOBE or lobe < LINE_SHARE * searched.sum() or lobe == 0:
        return Line(0.0, 0.0)
    return Line(float(np.sqrt(2 * lobe)), float(omega[first + k]))


def longest_stretch(at_limit: np.ndarray, Ts: float) -> float:
    """Longest time [s] that ``at_limit`` (N,) is True; what interrupts it for less than BRIDGED_S counts as
    True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], at_limit, [False]]).astype(int)))
    longest, begin, end = 0, 0, -len(at_limit)
    for a, b in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        begin = begin if (a - end) * Ts < BRIDGED_S else a
        end = b
        longest = max(longest, end - begin)
    return longest * Ts


def band_rms(
    x: np.ndarray,
    Ts: float,
    highest: float,
    gain: Callable[[np.ndarray], np.ndarray] = np.ones_like,
) -> float:
    """Rms of what ``x`` (N,) holds from DC to ``highest`` [rad/s], times ``gain`` (k,) at its frequencies
    (k,) [rad/s]; ``Ts`` [s] between its samples."""
    X = np.fft.rfft(x) / len(x)
    omega = 2 * np.pi * np.arange(len(X)) / (len(x) * Ts)
    power = np.abs(X) ** 2
    power[1:] *= 2
    if len(x) % 2 == 0:
        power[-1] /= 2
    kept = omega <= highest
    return float(np.sqrt((power[kept] * gain(omega[kept]) ** 2).sum()))


def beyond_wish(row: dict[str, Any]) -> bool:
    """Whether the row of a run has a larger error than a user asks for, TRACKED of the wanted yaw rate and
    the free motion; no certificate promises this."""
    share = TRACKED_WEAK if row["brake_gain"] < WEAK_BRAKES else TRACKED
    return bool(row["error_rms_radps"] > np.hypot(share * row["wanted_rms_radps"], row["free_rms_radps"]))


def ruled_out(row: dict[str, Any]) -> Iterator[str]:
    """What the row of a run holds that the certificate rules out for a truck within the bounds, in words."""
    if row["line_bar"] >= LEAST_BAR:
        yield f"oscillates at {row['line_radps']:.3g} rad/s with {row['line_bar']:.3g} bar"
    if row["limited_stretch_s"] >= SATURATED_S:
        yield f"saturates for {row['limited_stretch_s']:.3g} s"
    if row["error_rms_radps"] > row["allowed_rms_radps"]:
        yield (
            f"loses track by {1e3 * row['error_rms_radps']:.3g} mrad/s rms up to {STEERING_RADPS:g} rad/s, "
            f"allowed {1e3 * row['allowed_rms_radps']:.3g} with a wanted {1e3 * row['wanted_rms_radps']:.3g} "
            f"and a free {1e3 * row['free_rms_radps']:.3g}"
        )
