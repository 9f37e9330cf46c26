"""Conduct of the closed loop in a run, measured from its signals, and its contradictions of a certificate.

Three findings falsify the certificate when the truck of the run is within the bounds:

    oscillates  the demand holds a steady line above the commanded band (``steady_line``), of at least
                LEAST_BAR
    saturates   the demand is at its limit for at least SATURATED_S in one stretch (``longest_stretch``)
    loses track the error of the yaw rate up to STEERING_RADPS is larger, rms, than the certificate allows
                with the run's command, disturbance and noise (tracking.py)

The error is relative to the reference model's answer to the command. A user's wish is tighter than the proof
and is counted too. Its limit is the share TRACKED of the wanted yaw rate and the free motion of the same
truck. Where the brakes have less than WEAK_BRAKES of the nominal gain, the share is TRACKED_WEAK. Free motion
is that without control on the same road in the same wind. The two are independent, and their powers add.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

LEAST_BAR = 0.25
"""Least amplitude of use: the bounds do not cover smaller ones, where friction dominates."""
LINE_SHARE = 0.6
"""Least share of the demand's power above the commanded band in a steady line's main lobe."""
LINE_KEPT = 0.7
"""Least share of its amplitude that a steady line keeps from one window to the next."""
WINDOW_S, HIGHEST_RADPS, BAND_GAP_RADPS = 20.0, 60.0, 1.0
"""Search for lines: its windows, its upper end, and the start of its range above the commanded band."""
LOBE = 2
"""Half the main lobe of a Hann window in samples of its spectrum."""

SATURATED_S = 1.0
BRIDGED_S = 0.1
"""Longest interruption of a stretch: noise takes a demand off its limit for an instant."""
AT_LIMIT = 0.999

STEERING_RADPS = 1.0
"""Upper end of the steering task, above which little tracking is required."""
TRACKED, TRACKED_WEAK, WEAK_BRAKES = 0.10, 0.15, 0.8


@dataclass(frozen=True)
class Line:
    """A steady line of the demand: its least amplitude [bar] over its windows, and its frequency; else 0,
    0."""

    bar: float
    radps: float


def steady_line(u: np.ndarray, Ts: float, commanded: float) -> Line:
    """Find the largest steady line of a demand above the commanded band.

    Windows of WINDOW_S begin every half window. A window holds a line if its highest peak has LINE_SHARE of
    the power up to HIGHEST_RADPS in its main lobe. The peak must not be the slope of a peak at a lower
    frequency. The line is steady if three windows in succession hold it within a tenth of its frequency and
    it keeps LINE_KEPT of its amplitude. The response of a damped loop to noise has a broader peak, and a
    step's decays.

    Parameters
    ----------
    u : ndarray (N,), bar
    Ts : float, s
    commanded : float, rad/s, highest commanded frequency; the search starts BAND_GAP_RADPS above

    Returns
    -------
    Line
    """
    length = round(WINDOW_S / Ts)
    starts = range(0, len(u) - length + 1, length // 2)
    by_window = [_line(u[start : start + length], Ts, commanded + BAND_GAP_RADPS) for start in starts]
    best = Line(0.0, 0.0)
    for lines in zip(by_window, by_window[1:], by_window[2:], strict=False):
        steady = all(
            a.bar > 0 and b.bar >= LINE_KEPT * a.bar and abs(b.radps - a.radps) <= 0.1 * a.radps
            for a, b in pairwise(lines)
        )
        least = min(lines, key=lambda line: line.bar)
        if steady and least.bar > best.bar:
            best = least
    return best


def _line(u: np.ndarray, Ts: float, above: float) -> Line:
    """Line of one window; amplitude 0 without one."""
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
    """Longest time [s] that ``at_limit`` (N,) is True; interruptions below BRIDGED_S are bridged."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], at_limit, [False]]).astype(int)))
    longest, begin, end = 0, 0, -len(at_limit)
    for a, b in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        begin = begin if (a - end) * Ts < BRIDGED_S else a
        end = b
        longest = max(longest, end - begin)
    return longest * Ts


def band_rms(
    x: np.ndarray, Ts: float, highest: float, gain: Callable[[np.ndarray], np.ndarray] = np.ones_like
) -> float:
    """Rms of ``x`` (N,) from DC to ``highest`` [rad/s], times ``gain`` (k,) at its frequencies (k,) [rad/s].

    ``Ts`` [s] is the sample period.
    """
    X = np.fft.rfft(x) / len(x)
    omega = 2 * np.pi * np.arange(len(X)) / (len(x) * Ts)
    power = np.abs(X) ** 2
    power[1:] *= 2
    if len(x) % 2 == 0:
        power[-1] /= 2
    kept = omega <= highest
    return float(np.sqrt((power[kept] * gain(omega[kept]) ** 2).sum()))


def beyond_wish(row: dict[str, Any]) -> bool:
    """Return whether a run's error exceeds a user's wish: TRACKED of the wanted yaw rate and the free motion.
    No certificate promises this."""
    share = TRACKED_WEAK if row["brake_gain"] < WEAK_BRAKES else TRACKED
    return bool(row["error_rms_radps"] > np.hypot(share * row["wanted_rms_radps"], row["free_rms_radps"]))


def ruled_out(row: dict[str, Any]) -> Iterator[str]:
    """Contradictions in a run's row to the certificate of a truck within the bounds, in words."""
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
