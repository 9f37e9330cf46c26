"""Measure the behaviour of the closed loop in a run, and find its contradictions of a certificate.

Three findings falsify the certificate when the truck of the run is within the bounds:

    oscillates  the demand has a steady oscillation above the commanded band (`steady_line`), of at least
                LEAST_BAR
    saturates   the demand is at its limit for at least SATURATED_S without interruption (`longest_stretch`)
    loses track the rms error of the yaw rate up to STEERING_RADPS is larger than the certificate allows with
                the run's command, disturbance and noise (tracking.py)

The error is the difference from the reference model's response to the command. A second count uses a user's
requirement, which is stricter than the proof. Its limit is the share TRACKED of the wanted yaw rate and of
the truck's free motion. If the brakes have less than WEAK_BRAKES of the nominal gain, the share is
TRACKED_WEAK. Free motion is the motion without control on the same road and in the same wind. Wanted yaw rate
and free motion are independent, so their powers add.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

LEAST_BAR = 0.25
"""Least usual amplitude. The bounds do not cover smaller amplitudes, at which friction dominates."""
LINE_SHARE = 0.6
"""Least share of the demand's power above the commanded band that the main lobe of a steady line has."""
LINE_KEPT = 0.7
"""Least ratio of a steady line's amplitude in a window to its amplitude in the previous window."""
WINDOW_S, HIGHEST_RADPS, BAND_GAP_RADPS = 20.0, 60.0, 1.0
"""Search for lines: window length, highest frequency, and distance of the lowest one from the commanded
band."""
LOBE = 2
"""Half width of the main lobe of a Hann window, in samples of the spectrum."""

SATURATED_S = 1.0
BRIDGED_S = 0.1
"""Longest interruption that is ignored, because noise can move a demand off its limit for an instant."""
AT_LIMIT = 0.999

STEERING_RADPS = 1.0
"""Highest frequency of the steering task; above it, little tracking is required."""
TRACKED, TRACKED_WEAK, WEAK_BRAKES = 0.10, 0.15, 0.8


@dataclass(frozen=True)
class Line:
    """Steady line of the demand: least amplitude [bar] over its windows, and frequency; 0 and 0 for none."""

    bar: float
    radps: float


def steady_line(u: np.ndarray, Ts: float, commanded: float) -> Line:
    """Find the largest steady line of a demand above the commanded band.

    Windows of WINDOW_S begin every half window. A window has a line if the main lobe of its highest peak has
    LINE_SHARE of the power up to HIGHEST_RADPS. The peak must not be the slope of a peak at a lower
    frequency. A line is steady if three successive windows have it within a tenth of its frequency, and if it
    keeps LINE_KEPT of its amplitude. A damped loop's response to noise has a broader peak. Its response to a
    step decays.

    Parameters
    ----------
    u : ndarray (N,), bar
    Ts : float, s
    commanded : float, rad/s, highest commanded frequency; the search starts BAND_GAP_RADPS above it

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
    """Find the line of one window; the amplitude is 0 without a line."""
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
    """Longest time [s] in which ``at_limit`` (N,) is True; interruptions below BRIDGED_S are ignored."""
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
    """Rms of ``x`` (N,) from DC to ``highest`` [rad/s]; ``gain`` (k,) weights its k frequencies [rad/s].

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
    """Tell if a run's error exceeds the share TRACKED of the wanted yaw rate and the free motion.

    This is a user's requirement. No certificate promises it.
    """
    share = TRACKED_WEAK if row["brake_gain"] < WEAK_BRAKES else TRACKED
    return bool(row["error_rms_radps"] > np.hypot(share * row["wanted_rms_radps"], row["free_rms_radps"]))


def ruled_out(row: dict[str, Any]) -> Iterator[str]:
    """List, in words, how a run's row contradicts the certificate of a truck within the bounds."""
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
