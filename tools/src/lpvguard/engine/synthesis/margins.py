"""Stability margins of a single loop, and the least margins over a set of loops (THEORY 7.5, [13]).

L is the loop's frequency response, broken at the plant's input, with negative feedback: S = 1/(1 + L) and T =
L/(1 + L). Frequencies are in rad/s, gains are factors, phases are in rad and delays in s. The open loop must
be stable. The closed loop is then stable exactly when 1 + L does not encircle 0.

A ``Response`` is a function from omega (k,) to L (k,). ``of_samples`` makes it from measured samples,
``of_system`` from a system. The first grid is refined until log L and log (1 + L) change by at most STEP
between neighbours. The search for crossings and maxima then uses the function itself.
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
"""Function from omega (k,) [rad/s] to complex numbers (k,)."""
SKEWS = {"S": 1.0, "T": -1.0, "balanced": 0.0}
"""Skew sigma of each disk margin."""
NAMES = (
    *("gain_up", "gain_down", "phase", "delay", "Ms", "Mt"),
    *("disk_S", "disk_T", "disk_balanced", "disk_gain", "disk_phase"),
)
"""Names of the margins. gain_up, gain_down, Ms, Mt and disk_gain are factors. phase and disk_phase are in
rad, delay is in s. disk_S, disk_T and disk_balanced are radii."""
SHOWN = {"phase": ("°", 180 / np.pi), "delay": ("ms", 1e3), "disk_phase": ("°", 180 / np.pi)}
"""Display unit of a margin, and its factor from SI. The other margins have no unit."""
STEP = 0.05
"""Largest change of log L and log (1 + L) between neighbours of a refined grid."""
ROUNDS = 60
TOLERANCE = 0.02
"""Largest estimated error of L between samples, relative to 1 + |L|."""
FEWEST = 8
"""Least number of samples."""
SEARCHED = 0.5
"""A local search starts from each grid maximum whose logarithm is at most this much below the largest."""
GRID = 400
"""Number of points of the first grid of a system."""


@dataclass(frozen=True)
class LoopMargin:
    """A margin ``value`` and the frequency ``omega`` [rad/s] that attains it.

    ``omega`` is None for an unlimited margin.
    """

    value: float
    omega: float | None


@dataclass(frozen=True)
class LoopMargins:
    """Margins of a loop.

    Attributes
    ----------
    unstable_poles : int, number of unstable poles of the closed loop
    by_name : dict[str, LoopMargin], a margin for each of NAMES, empty for an unstable loop
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
    name : str, name of the margin
    value : float

    Returns
    -------
    float
    """
    return value * SHOWN[name][1] if name in SHOWN else value


def disk_gain_and_phase(alpha: float, skew: float) -> tuple[float, float, float]:
    """Compute the gain and phase that a disk margin covers.

    The loop stays stable if the gain alone changes by a factor between both factors. It also stays stable if
    the phase alone changes by at most the phase.

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
    # The cosine of the phase is over / under.
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

    The error falls with the fourth power of the distance between samples. A spline through every second
    sample has an error at the other samples. A sixteenth of this error therefore estimates the error of the
    whole spline.

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
        If the error exceeds TOLERANCE (1 + |L|), or a sample is not finite.
    """
    omega, L = np.asarray(omega, float), np.asarray(L, complex)
    if len(omega) < FEWEST or omega[0] <= 0 or (np.diff(omega) <= 0).any() or L.shape != omega.shape:
        raise SynthesisError(
            "loop",
            "omega",
            f"{len(omega)} frequencies",
            f"at least {FEWEST} rising frequencies above 0, and one L for each",
        )
    if not np.isfinite(L).all():
        raise SynthesisError("loop", "L", "a sample is not finite", "finite samples")
    x = np.log(omega)
    # The coarse spline includes the last sample, so that it does not extrapolate.
    coarse = np.unique([*range(0, len(x), 2), len(x) - 1])
    error = np.abs(CubicSpline(x[coarse], L[coarse])(x) - L) / 16
    worst = int(np.argmax(error / (1 + np.abs(L))))
    if error[worst] > TOLERANCE * (1 + np.abs(L[worst])):
        raise SynthesisError(
            "loop",
            f"L at {omega[worst]:.4g} rad/s",
            f"an estimated error of {error[worst]:.2g} between the samples",
            f"an error of at most {TOLERANCE:g} (1 + |L|), by more samples",
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
        If the loop is not well posed, has an unstable pole, or has more than one input or output.
    """
    if loop.D.shape != (1, 1):
        raise SynthesisError("loop", "L", f"{loop.D.shape} system", "one input and one output")
    if loop.stability_margin() <= 0:
        raise SynthesisError("loop", "poles", "the open loop is not stable", "a stable plant and controller")
    back = 1 + loop.D.item()
    if back == 0:
        raise SynthesisError("loop", "D", "-1, so that 1 + L is 0 at infinity", "a well-posed loop")
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
        If an end of the grid does not fulfil this condition.

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

    A loop of the set attains each least margin, so no larger margin holds for all loops.

    Parameters
    ----------
    centre, radius : Response
    omega : ndarray (K,), rad/s, rising first grid, whose ends fulfil the conditions of `margins`

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
    # A small disk meets -1 only near the crossings of its centre, which may lie between points of the grid.
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
    """Number of unstable poles of the closed loop from L (K,), by Nyquist's criterion for a stable open loop.

    L lies on a fine grid over all frequencies. The curve is closed along the real axis at both ends. Raises
    SynthesisError where an end is outside the unit circle and not near the real axis.
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
    # The closing arcs turn by less than a quarter. Rounding of the sum removes them.
    turned = np.arctan(back[0].imag / back[0].real) + np.angle(back[1:] / back[:-1]).sum()
    poles = round(-turned / np.pi)
    if poles < 0:
        raise SynthesisError("loop", "L", f"goes round -1 {-poles} times forward", "a stable open loop")
    return poles


def _worst_sensitivity(centre: Response, radius: Response, skew: float, omega: np.ndarray) -> np.ndarray:
    """Largest |S + (skew - 1)/2| over the disk of L. The inverse of the disk of 1 + L is a disk."""
    back, r = 1 + centre(omega), radius(omega)
    size = np.abs(back) ** 2 - r**2
    return np.abs(back / size + (skew - 1) / 2) + r / size


def _disk(name: str, peak: LoopMargin) -> dict[str, LoopMargin]:
    """The disk margin from its peak, with Ms or Mt, or with the gain and phase of the balanced disk."""
    alpha = 1 / peak.value if peak.value else np.inf
    if name != "balanced":
        return {f"M{name.lower()}": peak, f"disk_{name}": LoopMargin(alpha, peak.omega)}
    _, high, phase = disk_gain_and_phase(alpha, SKEWS[name])
    values = {"disk_balanced": alpha, "disk_gain": high, "disk_phase": phase}
    return {key: LoopMargin(value, peak.omega) for key, value in values.items()}


def _refined(response: Response, omega: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Refine the grid until log L and log (1 + L) change by at most STEP between neighbours.

    Returns the grid, and L on it.
    """
    L = response(omega)
    for _ in range(ROUNDS):
        with np.errstate(all="ignore"):
            moved = np.maximum(*(np.abs(np.log(x[1:] / x[:-1])) for x in (L, 1 + L)))
        # Near a zero of L its logarithm has no limit. Values far below 1 need no resolution.
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
    """Largest value of ``size`` >= 0 over the range of the grid, and its frequency."""
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
    """Zeros of a function within the range of the grid.

    A local search follows each extremum towards 0, so that it does not miss a pair of zeros between
    neighbours.
    """
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
    """Factors k nearest to 1 that bring the disk about c to -1, |1 + k c| = k radius.

    They are the largest factor below 1 (0 if none) and the least factor above 1 (inf if none).
    """
    with np.errstate(all="ignore"):
        square, half = np.abs(c) ** 2 - radius**2, c.real
        root = np.sqrt(half**2 - square)
        both = np.array(
            [1 / (-half + root), 1 / (-half - root)]
        )  # roots of k^2 square + 2 k half + 1, without cancellation at 0
    below = np.where(both < 1, both, 0.0).max(axis=0, initial=0.0)
    return below, np.where(both > 1, both, np.inf).min(axis=0)


def _angles(c: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """Two lags (2, k) in 0..2 pi that bring the disk about c to -1, NaN if no lag does."""
    with np.errstate(all="ignore"):
        half = np.arccos((radius**2 - 1 - np.abs(c) ** 2) / (2 * np.abs(c)))
    return np.mod([np.angle(c) + half, np.angle(c) - half], 2 * np.pi)


def _turn(c: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """Least |phase| that brings the disk to -1 [rad], inf if none does."""
    lag = _angles(c, radius)
    return np.nan_to_num(np.minimum(lag, 2 * np.pi - lag), nan=np.inf).min(axis=0)


def _lag(c: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """Least lag that brings the disk to -1 [rad], inf if none does."""
    return np.nan_to_num(_angles(c, radius), nan=np.inf).min(axis=0)
