"""Stability margins of a single loop, and those that a set of loops certainly has (THEORY 7.5, [13]).

L is the loop's frequency response, broken at the plant's input, with negative feedback: S = 1/(1 + L) and
T = L/(1 + L). Frequencies are in rad/s, gains are factors, phases are in rad and delays in s. The open loop
must be stable: then the loop is stable exactly when 1 + L does not encircle 0.

``Response`` is any function from omega (k,) to L (k,). ``of_samples`` makes one of measured samples, and
``of_system`` of a system. A first grid is refined until log L and log (1 + L) change by at most STEP from
point to point. Crossings and maxima are then found on the function itself.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq, minimize_scalar

from lpvguard.engine.synthesis.errors import SynthesisError
from lpvguard.engine.synthesis.statespace import StateSpace

Response = Callable[[np.ndarray], np.ndarray]
"""omega (k,) [rad/s] to complex numbers (k,)."""
SKEWS = {"S": 1.0, "T": -1.0, "balanced": 0.0}
"""Skew sigma of each disk margin."""
NAMES = (
    *("gain_up", "gain_down", "phase", "delay", "Ms", "Mt"),
    *("disk_S", "disk_T", "disk_balanced", "disk_gain", "disk_phase"),
)
"""Names of the margins: factors, rad, s, factors, radii of disks, and what the balanced disk covers: a factor
up and down, rad."""
SHOWN = {"phase": ("°", 180 / np.pi), "delay": ("ms", 1e3), "disk_phase": ("°", 180 / np.pi)}
"""Unit in which people read a margin, and its factor from SI; the other margins have no unit."""
STEP = 0.05
"""Largest change of log L and log (1 + L) between neighbours of a refined grid."""
ROUNDS = 60
TOLERANCE = 0.02
"""Largest estimated error of L between samples, over 1 + |L|."""
FEWEST = 8
"""Samples."""
SEARCHED = 0.5
"""A local maximum on the grid is followed where its logarithm is no further than this below the largest."""
GRID = 400
"""Points of a system's first grid."""


@dataclass(frozen=True)
class LoopMargin:
    """A margin and where it is attained: ``value``, ``omega`` [rad/s]; None: nowhere, the margin is
    unlimited."""

    value: float
    omega: float | None


@dataclass(frozen=True)
class LoopMargins:
    """Margins of a loop.

    Attributes
    ----------
    unstable_poles : int, of the closed loop
    by_name : dict[str, LoopMargin], by NAMES, empty for an unstable loop
    """

    unstable_poles: int
    by_name: dict[str, LoopMargin]

    @property
    def stable(self) -> bool:
        """Whether the closed loop is stable."""
        return self.unstable_poles == 0


def shown(name: str, value: float) -> float:
    """Convert a margin to its display unit (SHOWN).

    Parameters
    ----------
    name : str, of the margin
    value : float

    Returns
    -------
    float
    """
    return value * SHOWN[name][1] if name in SHOWN else value


def disk_gain_and_phase(alpha: float, skew: float) -> tuple[float, float, float]:
    """Compute the gain and phase that a disk margin covers.

    Gain alone may lie between the factors, phase alone between minus and plus the phase.

    Parameters
    ----------
    alpha : float, disk margin
    skew : float

    Returns
    -------
    tuple of least factor, largest factor and phase [rad]

    References
    ----------
    THEORY 7.5, (T28).
    """
    if np.isinf(alpha):
        return 0.0, np.inf, np.pi
    low = (2 - alpha * (1 - skew)) / (2 + alpha * (1 + skew))
    rest = 2 - alpha * (1 + skew)
    # The phase's cosine is over / under.
    if rest == 0:
        high, over, under = np.inf, low, 1.0
    else:
        high = (2 + alpha * (1 - skew)) / rest
        over, under = 1 + low * high, low + high
    return (
        max(low, 0.0),
        high if rest > 0 else np.inf,
        float(np.arccos(over / under)) if abs(over) <= abs(under) else np.pi,
    )


def of_samples(omega: np.ndarray, L: np.ndarray) -> Response:
    """Interpolate a response by a cubic spline of L over log omega, constant beyond the samples.

    The error falls with the fourth power of the samples' distance. A sixteenth of the error at every second
    sample of the spline through the others therefore estimates it.

    Parameters
    ----------
    omega : ndarray (K,), rad/s, rising
    L : ndarray (K,) of complex

    Returns
    -------
    Response

    Raises
    ------
    SynthesisError
        If that error exceeds TOLERANCE (1 + |L|), or samples are not finite.
    """
    omega, L = np.asarray(omega, float), np.asarray(L, complex)
    if len(omega) < FEWEST or omega[0] <= 0 or (np.diff(omega) <= 0).any() or L.shape != omega.shape:
        raise SynthesisError(
            "loop", "omega", f"{len(omega)} frequencies", f"at least {FEWEST}, rising from above 0, L at each"
        )
    if not np.isfinite(L).all():
        raise SynthesisError("loop", "L", "a sample is not finite", "finite samples")
    x = np.log(omega)
    # The last sample belongs to both splines, so that the coarse one nowhere extrapolates.
    coarse = np.unique([*range(0, len(x), 2), len(x) - 1])
    error = np.abs(CubicSpline(x[coarse], L[coarse])(x) - L) / 16
    worst = int(np.argmax(error / (1 + np.abs(L))))
    if error[worst] > TOLERANCE * (1 + np.abs(L[worst])):
        raise SynthesisError(
            "loop",
            f"L at {omega[worst]:.4g} rad/s",
            f"known to {error[worst]:.2g} between the samples",
            f"at most {TOLERANCE:g} (1 + |L|): more samples",
        )
    spline = CubicSpline(x, L)
    return lambda at: spline(np.log(np.clip(at, omega[0], omega[-1])))


def of_system(loop: StateSpace) -> tuple[Response, np.ndarray]:
    """Return the response of a single loop and a first grid for its margins.

    Parameters
    ----------
    loop : StateSpace

    Returns
    -------
    tuple of Response and ndarray (K,), rad/s

    Raises
    ------
    SynthesisError
        If it has not one input, one output and stable poles, or is not well posed.
    """
    if loop.D.shape != (1, 1):
        raise SynthesisError("loop", "L", f"{loop.D.shape} system", "one input and one output")
    if loop.stability_margin() <= 0:
        raise SynthesisError("loop", "poles", "the open loop is not stable", "a stable plant and controller")
    back = 1 + loop.D.item()
    if back == 0:
        raise SynthesisError("loop", "D", "-1: 1 + L vanishes at infinity", "a well-posed loop")
    closed = np.linalg.eigvals(loop.A - loop.B @ loop.C / back)
    poles = np.concatenate([loop.poles(), closed]).astype(complex)
    if loop.dt:
        poles = np.log(poles[np.abs(poles) > 1e-12]) / loop.dt
    sizes = np.abs(poles)[np.abs(poles) > 0]
    low, high = (sizes.min() * 1e-3, sizes.max() * 1e3) if len(sizes) else (1e-3, 1e3)
    across, along = np.abs(poles.imag), np.abs(poles.real)
    last = np.pi / loop.dt if loop.dt else high
    grid = np.concatenate([np.geomspace(low, last, GRID), across - along, across, across + along])
    return lambda omega: loop.response(omega).ravel(), np.unique([0.0, *np.clip(grid, 0.0, last)])


def margins(response: Response, omega: np.ndarray) -> LoopMargins:
    """Compute the margins of a loop.

    The grid must begin where L is nearly real, and end where it is nearly real or stays within the unit
    circle.

    Parameters
    ----------
    response : Response
    omega : ndarray (K,), rad/s, rising first grid

    Returns
    -------
    LoopMargins

    Raises
    ------
    SynthesisError
        If the grid does not.

    References
    ----------
    THEORY 7.5, (T26), (T27).
    """
    omega, L = _refined(response, np.asarray(omega, float))
    poles = unstable_poles(L)
    if poles:
        return LoopMargins(poles, {})
    by_name = _crossings(response, omega, L)
    for name, skew in SKEWS.items():
        peak = _largest(partial(_worst_sensitivity, response, np.zeros_like, skew), omega)
        by_name |= _disk(name, peak)
    return LoopMargins(0, {name: by_name[name] for name in NAMES})


def guaranteed(centre: Response, radius: Response, omega: np.ndarray) -> LoopMargins | None:
    """Compute the least margins over all loops with |L - centre| <= radius at every frequency.

    Each least margin is attained by a loop of the set, so no larger one holds for all.

    Parameters
    ----------
    centre, radius : Response
    omega : ndarray (K,), rad/s, rising first grid, with ends as for `margins`

    Returns
    -------
    LoopMargins, or None if a loop is unstable

    References
    ----------
    THEORY 7.5, (T29).
    """
    omega, c = _refined(centre, np.asarray(omega, float))
    poles = unstable_poles(c)
    if poles or (np.abs(1 + c) <= radius(omega)).any():
        return None
    # A small disk meets -1 near the crossings of its centre only, which may lie between points.
    omega = np.unique(np.concatenate([omega, *_on_axis_and_circle(centre, omega)]))
    by_name: dict[str, LoopMargin] = {}
    for name, skew in SKEWS.items():
        peak = _largest(partial(_worst_sensitivity, centre, radius, skew), omega)
        by_name |= _disk(name, peak)
    parts = {
        "gain_up": lambda w: 1 / _gains(centre(w), radius(w))[1],
        "gain_down": lambda w: _gains(centre(w), radius(w))[0],
        "phase": lambda w: 1 / _turn(centre(w), radius(w)),
        "delay": lambda w: w / _lag(centre(w), radius(w)),
    }
    for name, size in parts.items():
        peak = _largest(size, omega)
        unlimited = peak.value <= 0
        value = peak.value if name == "gain_down" else np.inf if unlimited else 1 / peak.value
        by_name[name] = LoopMargin(value, None if unlimited else peak.omega)
    return LoopMargins(0, {name: by_name[name] for name in NAMES})


def unstable_poles(L: np.ndarray) -> int:
    """Unstable poles of the closed loop from L (K,) on a fine grid over all frequencies, the open loop being
    stable (Nyquist).

    The curve is closed along the real axis at both ends. SynthesisError where an end is not near it and
    outside the unit circle.
    """
    back = 1 + np.asarray(L, complex)
    for place, end in (("first", L[0]), ("last", L[-1])):
        if abs(end) >= 1 and abs(np.imag(end)) > 0.5 * abs(1 + np.real(end)):
            raise SynthesisError(
                "loop",
                f"{place} frequency",
                f"L is {end:.3g} there",
                "a frequency beyond which L is real or stays within the unit circle",
            )
    # From its end the curve turns by less than a quarter to the real axis: rounding takes that away.
    turned = np.arctan(back[0].imag / back[0].real) + np.angle(back[1:] / back[:-1]).sum()
    poles = round(-turned / np.pi)
    if poles < 0:
        raise SynthesisError("loop", "L", f"goes round -1 {-poles} times forward", "a stable open loop")
    return poles


def _worst_sensitivity(centre: Response, radius: Response, skew: float, omega: np.ndarray) -> np.ndarray:
    """Largest |S + (skew - 1)/2| over the disk of L: the disk of 1 + L is inverted to a disk."""
    back, r = 1 + centre(omega), radius(omega)
    size = np.abs(back) ** 2 - r**2
    return np.abs(back / size + (skew - 1) / 2) + r / size


def _disk(name: str, peak: LoopMargin) -> dict[str, LoopMargin]:
    """The disk margin from its peak, and Ms or Mt, or what the balanced disk covers."""
    alpha = 1 / peak.value if peak.value else np.inf
    if name != "balanced":
        return {f"M{name.lower()}": peak, f"disk_{name}": LoopMargin(alpha, peak.omega)}
    _, high, phase = disk_gain_and_phase(alpha, SKEWS[name])
    values = {"disk_balanced": alpha, "disk_gain": high, "disk_phase": phase}
    return {key: LoopMargin(value, peak.omega) for key, value in values.items()}


def _refined(response: Response, omega: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The grid with points between neighbours until log L and log (1 + L) move by at most STEP; L on it."""
    L = response(omega)
    for _ in range(ROUNDS):
        with np.errstate(all="ignore"):
            moved = np.maximum(*(np.abs(np.log(x[1:] / x[:-1])) for x in (L, 1 + L)))
        # Near a zero of L its logarithm never settles: values far below 1 need no resolution.
        small = (np.abs(L[1:]) < 1e-3) & (np.abs(L[:-1]) < 1e-3)
        wide = (moved > STEP) & ~small & (np.diff(omega) > 1e-12 * omega[1:])
        if not wide.any():
            break
        low, high = omega[:-1][wide], omega[1:][wide]
        middle = np.where(low > 0, np.sqrt(low * high), high / 2)
        at = np.flatnonzero(wide) + 1
        omega, L = np.insert(omega, at, middle), np.insert(L, at, response(middle))
    if not np.isfinite(L).all() or (L == -1).any():
        raise SynthesisError("loop", "L", "not finite, or -1 at a frequency", "a loop off the critical point")
    return omega, L


def _largest(size: Response, omega: np.ndarray) -> LoopMargin:
    """The largest value of ``size`` >= 0 over the grid's range, and where."""
    with np.errstate(all="ignore"):
        values = np.nan_to_num(size(omega), nan=0.0)
    padded = np.concatenate([[-np.inf], values, [-np.inf]])
    tops = np.flatnonzero((values >= padded[:-2]) & (values >= padded[2:]))
    tops = tops[values[tops] >= values.max() * np.exp(-SEARCHED)]
    best = LoopMargin(float(values.max()), float(omega[int(np.argmax(values))]))
    for k in tops if best.value > 0 else ():
        low, high = omega[max(k - 1, 0)], omega[min(k + 1, len(omega) - 1)]
        near = minimize_scalar(
            lambda w: -np.nan_to_num(size(np.array([w])).item()),
            bounds=(low, high),
            method="bounded",
            options={"xatol": 1e-9 * high},
        )
        if -near.fun > best.value:
            best = LoopMargin(float(-near.fun), float(near.x))
    return best


def _signed(value: Callable[[np.ndarray], np.ndarray], sign: float, w: float) -> float:
    return sign * float(value(np.array([w])).item())


def _roots(value: Callable[[np.ndarray], np.ndarray], omega: np.ndarray) -> list[float]:
    """Zeros of a function within the grid. A turning point that faces 0 is followed, so that a pair of zeros
    between neighbours is not missed."""
    values = value(omega)
    facing = np.flatnonzero(
        (np.sign(values[1:-1]) * (values[1:-1] - values[:-2]) <= 0)
        & (np.sign(values[1:-1]) * (values[1:-1] - values[2:]) <= 0)
        & (np.abs(values[1:-1]) < STEP)
    )
    added = []
    for k in facing + 1:
        facing_away = partial(_signed, value, float(np.sign(values[k])))
        near = (omega[k - 1], omega[k + 1])
        added.append(minimize_scalar(facing_away, bounds=near, method="bounded").x)
    points = np.unique([*omega, *added])
    signs = np.sign(value(points))
    roots = [float(w) for w in points[signs == 0]]
    for k in np.flatnonzero(signs[1:] * signs[:-1] < 0):
        low, high = points[k], points[k + 1]
        roots.append(brentq(lambda w: value(np.array([w])).item(), low, high, xtol=1e-14 * high, rtol=1e-14))
    return roots


def _on_axis_and_circle(response: Response, omega: np.ndarray) -> tuple[list[float], list[float]]:
    """Frequencies at which L is real, and at which |L| = 1."""
    return (
        _roots(lambda w: np.sin(np.angle(response(w))), omega),
        _roots(lambda w: np.log(np.maximum(np.abs(response(w)), 1e-300)), omega),
    )


def _crossings(response: Response, omega: np.ndarray, L: np.ndarray) -> dict[str, LoopMargin]:
    """Gain, phase and delay margins from the crossings of the negative real axis and of the unit circle."""
    real, unit = _on_axis_and_circle(response, omega)
    real += [float(omega[k]) for k in (0, -1) if abs(L[k].imag) <= 1e-9 * abs(L[k])]
    up, down = LoopMargin(np.inf, None), LoopMargin(0.0, None)
    for w in real:
        at = response(np.array([w])).item().real
        if at >= 0:
            continue
        if at > -1 and -1 / at < up.value:
            up = LoopMargin(float(-1 / at), w)
        elif at < -1 and -1 / at > down.value:
            down = LoopMargin(float(-1 / at), w)
    phase, delay = LoopMargin(np.inf, None), LoopMargin(np.inf, None)
    for w in unit:
        lag = float(np.angle(response(np.array([w])).item()) + np.pi)
        if min(lag, 2 * np.pi - lag) < phase.value:
            phase = LoopMargin(min(lag, 2 * np.pi - lag), w)
        if w > 0 and lag / w < delay.value:
            delay = LoopMargin(lag / w, w)
    return {"gain_up": up, "gain_down": down, "phase": phase, "delay": delay}


def _gains(c: np.ndarray, radius: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Largest factor below 1 (0: none) and least above 1 (inf: none) that bring the disk about c to -1:
    |1 + k c| = k radius."""
    with np.errstate(all="ignore"):
        square, half = np.abs(c) ** 2 - radius**2, c.real
        root = np.sqrt(half**2 - square)
        both = np.array(
            [1 / (-half + root), 1 / (-half - root)]
        )  # of k^2 square + 2 k half + 1, no loss at 0
    below = np.where(both < 1, both, 0.0).max(axis=0, initial=0.0)
    return below, np.where(both > 1, both, np.inf).min(axis=0)


def _angles(c: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """(2, k) lags in 0..2 pi that bring the disk about c to -1; NaN: none does."""
    with np.errstate(all="ignore"):
        half = np.arccos((radius**2 - 1 - np.abs(c) ** 2) / (2 * np.abs(c)))
    return np.mod([np.angle(c) + half, np.angle(c) - half], 2 * np.pi)


def _turn(c: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """Least |phase| that brings the disk to -1 [rad]; inf: none."""
    lag = _angles(c, radius)
    return np.nan_to_num(np.minimum(lag, 2 * np.pi - lag), nan=np.inf).min(axis=0)


def _lag(c: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """Least lag that brings the disk to -1 [rad]; inf: none."""
    return np.nan_to_num(_angles(c, radius), nan=np.inf).min(axis=0)
