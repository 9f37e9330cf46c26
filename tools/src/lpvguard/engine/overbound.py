"""Stage 4: stable, minimum-phase weights of low order that provably lie above the identified bounds.

Reads   omega (K,) rad/s, bound (K,) in the unit of the weighted signal (NaN: bin without data)
Gives   ``Weight`` W(s) with |W(jw)| >= bound(w) for every w >= 0, and how tight it is
Source  Roedoenyi & Bokor, section III, steps 6 and 7; THEORY 5.3

**What is bounded.** Between samples the bound is linear in (ln w, ln bound), beyond the first and the last
sample it is constant. The *worst ratio* is sup |W|/bound over all w, the ends included. A strictly proper
weight cannot stay above a constant for ever: its claims, both ways, stop at the last sample.

**How it is fitted.** With x = w^2, |W|^2 = N(x)/D(x) for polynomials N, D, and "bound^2 D <= N <= t^2 bound^2
D" is linear in (N, D) for a fixed t, so the least t is found by a sequence of linear programs. Each program
minimises the violation of the upper inequality at a trial t (the differential correction of Barrodale, Powell
and Roberts, SIAM J. Numer. Anal. 9, 1972): either it returns a better weight, or the trial t is infeasible
and is a lower limit of what any weight of that order can reach. Trials sit 0.002 dB under the best weight so
far. Rows are divided by bound^2 D of the current D (not under 1e-5 of its sum |d_i| x^i) and columns by the
largest entry they then have, the max-plus scaling around that D: in this form monomials keep their accuracy
over six decades. A verdict "infeasible" counts only when the D that scaled the rows was itself within 0.5 dB
of the optimum. A program carries only the points that matter; points where its answer fails are added until
none fails on a fine grid, which also takes up every lightly damped pole and zero. The left-half-plane
spectral factors of N and D are the weight.

**Why the weight is above the bound.** Not by a grid. On one piece bound^2 = c x^q with a real q, no
polynomial; but x^q is convex in x (q <= 0 or q >= 1) or concave (0 < q < 1), so on [a, b] the chord
respectively a tangent, a straight line L, lies above it. N - r^2 L D is then a polynomial, and if all its
Bernstein coefficients on [a, b] are >= 0, so is the polynomial (it is a convex combination of them): it has
no root in [a, b] and |W| >= r bound there. Where a coefficient is negative the interval is halved; L and the
Bernstein coefficients converge quadratically, so the search ends. [0, w_1] is such a piece with q = 0 and
[w_K, inf) becomes one in 1/x. The coefficients of N and D follow from those of W in rational arithmetic; the
rounding error of the rest is subtracted (up to one rounding of the frequency). A proved ratio is 5e-10 below
the one attained, so a weight that merely touches its bound is not accepted. Stability and minimum phase are
decided by Routh's array in rational arithmetic. The same search with N and D exchanged bounds the worst ratio
from above. The fit is closed by one scalar gain, ``inflation``, which lifts the weight by what the
certificate found missing between the grid points.

**What it does not do.** The optimum of a given order may want a break beyond the first or last sample, or a
sharp resonance around a single deep bin of raw scatter; both are kept, since leaving them out costs more than
0.01 dB, and the former are named in ``breaks_outside``. Who does not want the scatter's shape hands in an
envelope.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace
from fractions import Fraction

import numpy as np
from scipy.linalg import solve_continuous_lyapunov
from scipy.optimize import linprog

from ..base.errors import InputError

_STEP_DB = 0.002  # resolution of the search for the least worst ratio
_GRID_STEP = 0.02  # widest gap of the cutting-plane grid, in ln w
_OUTSIDE = 1e3  # the grid goes on by this factor in w beyond both ends
_RESOLUTION = 1e-5  # smallest D of a row, over the D it is scaled by
_NEAR_DB = 0.5  # rows scaled by a D this near the optimum are scaled well
_TOLERANCE = {"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10}
_MAX_PROGRAMS, _MAX_CUTS, _MAX_REFITS = 60, 60, 8

_PROOF_MARGIN = 1e-9  # relative, on |W|^2: a proved ratio is this much below the one attained ...
_PATIENCE = 18  # ... and four times more with every halving beyond this many, where rounding stops the proof
_MAX_HALVINGS = 28
_MAX_TESTS = 300_000
_ROUNDING = 1e-13  # relative to sum |c_i| x^i: over the rounding of exp, log and the Bernstein coefficients
_MAX_RANGE = 1e60  # largest bound / smallest bound


@dataclass(frozen=True, eq=False)
class Weight:
    """Real rational W(s) = num(s)/den(s), proper.

    ``num`` (m+1,), ``den`` (n+1,), m <= n: real coefficients in descending powers of s, s in rad/s.

    >>> float(Weight(num=np.array([1.0, 2.0]), den=np.array([1.0, 1.0])).magnitude(0.0))
    2.0
    """

    num: np.ndarray
    den: np.ndarray

    def __post_init__(self):
        for name in ("num", "den"):
            value = np.array(getattr(self, name), dtype=float)
            if value.ndim != 1 or value.size == 0 or not np.all(np.isfinite(value)) or value[0] == 0.0:
                raise InputError(
                    "weight", name, f"{value.tolist()}", "a list of finite coefficients whose first is not 0"
                )
            value.setflags(write=False)
            object.__setattr__(self, name, value)
        if self.num.size > self.den.size:
            raise InputError(
                "weight",
                "num",
                f"degree {self.num.size - 1} over degree {self.den.size - 1}",
                "a proper transfer function",
            )

    @property
    def order(self) -> int:
        return self.den.size - 1

    def zeros(self) -> np.ndarray:
        """Roots of ``num`` (m,), complex, rad/s."""
        return _roots(self.num)

    def poles(self) -> np.ndarray:
        """Roots of ``den`` (n,), complex, rad/s."""
        return _roots(self.den)

    def __call__(self, s) -> np.ndarray:
        """W at the complex points ``s`` (rad/s), any shape."""
        s = np.asarray(s, dtype=complex)
        return np.polyval(self.num, s) / np.polyval(self.den, s)

    def magnitude(self, omega) -> np.ndarray:
        """|W(j omega)| at ``omega`` >= 0 (rad/s), any shape."""
        return np.abs(self(1j * np.asarray(omega, dtype=float)))

    def to_state_space(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """A (n,n), B (n,1), C (1,n), D (1,1) of W; W must be stable.

        A chain of first- and second-order sections, slow to fast, each written from its own poles, so that
        poles many decades apart keep their accuracy; states scaled by powers of two until the diagonals of
        both Gramians agree within a factor four.
        """
        sections = _sections(self.num, self.den)
        a, b, c, d = np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.array([[1.0]])
        for a2, b2, c2, d2 in sections:
            a = np.block([[a, np.zeros((len(a), len(a2)))], [b2 @ c, a2]])
            b, c, d = np.vstack([b, b2 @ d]), np.hstack([d2 @ c, c2]), d2 @ d
        if not len(a):
            return a, b, c, d
        reach = np.diag(solve_continuous_lyapunov(a, -b @ b.T))
        observe = np.diag(solve_continuous_lyapunov(a.T, -c.T @ c))
        known = (reach > 0) & (observe > 0)  # a state that W does not need keeps its scale
        scale = np.ones(len(a))
        scale[known] = np.exp2(np.round(np.log2(observe[known] / reach[known]) / 4))
        return a * scale[:, None] / scale[None, :], b * scale[:, None], c / scale[None, :], d

    def to_dict(self) -> dict:
        """JSON-able; Python prints floats so that they read back exactly."""
        return {"num": self.num.tolist(), "den": self.den.tolist()}

    @classmethod
    def from_dict(cls, data: dict) -> Weight:
        try:
            return cls(num=np.asarray(data["num"], dtype=float), den=np.asarray(data["den"], dtype=float))
        except (KeyError, TypeError) as problem:
            raise InputError(
                "weight", "", f"cannot be read ({problem!r})", "keys num and den, lists of numbers"
            )


@dataclass(frozen=True)
class Certificate:
    """What ``verify_overbound`` proved about a weight and a bound.

    ``min_ratio`` <= |W|/bound <= ``max_ratio`` for all 0 <= w <= ``omega_max``; ``*_at`` (rad/s) is where the
    extreme is attained within 1e-9. ``omega_max`` is inf, or the last sample when W is strictly proper.
    ``intervals``: Bernstein tests made. ``without_data``: frequencies of NaN samples, bridged by the bound.
    """

    ok: bool
    stable: bool
    minimum_phase: bool
    min_ratio: float
    min_ratio_at: float
    max_ratio: float
    max_ratio_at: float
    omega_max: float
    intervals: int
    without_data: tuple[float, ...]

    def to_dict(self) -> dict:
        """JSON-able; an infinite frequency becomes the string "inf"."""
        plain = asdict(self) | {"without_data": list(self.without_data)}
        return {k: "inf" if v == math.inf else v for k, v in plain.items()}


@dataclass(frozen=True)
class OverboundFit:
    """A fitted weight and how good it is.

    ``worst_ratio_db``: proved upper limit of sup |W|/bound, 20 log10. ``lp_optimum_db``: proved infeasible
    for this order (up to the LP solver's 1e-9), so the fit is within ``worst_ratio_db - lp_optimum_db`` of
    the best there is. ``ratios_db``: worst ratio reached per order tried. ``inflation``: the final scalar
    gain, already in ``weight``. ``certificate``: ``Certificate.to_dict()``. ``floored``: frequencies (rad/s)
    where the floor replaced a smaller bound. ``breaks_outside``: |pole| and |zero| (rad/s) beyond the first
    or last sample, which the optimum asked for.
    """

    weight: Weight
    order: int
    worst_ratio_db: float
    lp_optimum_db: float
    inflation: float
    certificate: dict
    ratios_db: dict[int, float]
    floored: tuple[float, ...]
    breaks_outside: tuple[float, ...]


def fit_overbound(
    omega, bound, *, max_order=4, order=None, floor=None, tol_db=0.3, proper="biproper", name=""
) -> OverboundFit:
    """Lowest-order stable minimum-phase weight above ``bound`` with the least worst ratio.

    omega     (K,) rad/s, > 0, strictly increasing
    bound     (K,) >= 0; NaN: no data there (the neighbours are joined); values under ``floor`` are raised to
              it max_order highest order considered; the order taken is the smallest n such that no order n +
              k up to max_order lowers the worst ratio by more than k ``tol_db``
    order     this order instead; a lower one is returned when the extra states gain nothing (0.002 dB)
    floor     > 0, needed where the bound is 0
    proper    "biproper" (D(inf) > 0, which H-infinity rank conditions need) or "strict" (rolls off, from 10
              omega[-1] on at the latest; claims end at omega[-1])
    name      of the bound, for messages

    Raises ``InputError`` naming the index or the frequency.

    >>> fit = fit_overbound([0.1, 1.0, 10.0], [2.0, 2.0, 2.0])
    >>> fit.order, round(float(fit.weight.magnitude(1.0)), 6)
    (0, 2.0)
    """
    source = name or "weight fit"
    lowest = _lowest_order(source, max_order, order, tol_db, proper)
    samples = _Samples.read(source, omega, bound, floor)
    problem = _Problem(samples, strict=proper == "strict")
    best: dict[int, _Candidate] = {}
    for n in range(lowest, (max_order if order is None else order) + 1):
        best[n] = _optimum(problem, n, best.get(n - 1))
        if order is None and best[n].ratio_db <= tol_db:
            break  # no higher order can gain more than tol_db
    chosen = _choose(best, tol_db) if order is None else order
    for n in range(chosen, lowest - 1, -1):
        if best[n].order == n and (closed := _close(problem, best[n], best.get(n - 1))) is not None:
            break
    else:
        raise InputError(
            source, f"order {chosen}", "no weight could be certified", "a smoother bound or another order"
        )
    weight, inflation, certificate, lower_db = closed
    worst_db = _db(certificate.max_ratio)
    return OverboundFit(
        weight=weight,
        order=weight.order,
        worst_ratio_db=worst_db,
        lp_optimum_db=lower_db,
        inflation=inflation,
        certificate=certificate.to_dict() | {"without_data": list(samples.without_data)},
        ratios_db={m: candidate.ratio_db for m, candidate in best.items()} | {n: worst_db},
        floored=samples.floored,
        breaks_outside=_outside(weight, samples),
    )


def _outside(weight: Weight, samples: _Samples) -> tuple[float, ...]:
    breaks = np.sort(np.abs(np.concatenate([weight.zeros(), weight.poles()])))
    return tuple(breaks[(breaks < samples.omega[0]) | (breaks > samples.omega[-1])].tolist())


def verify_overbound(weight: Weight, omega, bound, *, floor=None, name="") -> Certificate:
    """Prove or refute |W| >= bound from the coefficients of W alone; nothing of the fit is reused.

    ``omega`` (K,) rad/s, ``bound`` (K,) and ``floor`` as in ``fit_overbound``. ``ok`` is true when W is
    stable, minimum-phase and ``min_ratio`` >= 1. The method is the module's third paragraph.
    """
    samples = _Samples.read(name or "weight check", omega, bound, floor)
    strict = weight.num.size < weight.den.size
    stable, minimum_phase = _is_hurwitz(weight.den), _is_hurwitz(weight.num)
    top, bottom = _squared(weight.num / samples.level, samples.unit), _squared(weight.den, samples.unit)
    low, low_at, tests = _least_ratio(top, bottom, samples, strict)
    high, high_at, more = _least_ratio(bottom, top, samples.reciprocal(), strict)
    return Certificate(
        ok=bool(stable and minimum_phase and low >= 1.0),
        stable=stable,
        minimum_phase=minimum_phase,
        min_ratio=low,
        min_ratio_at=low_at,
        max_ratio=1.0 / high if high > 0.0 else math.inf,
        max_ratio_at=high_at,
        omega_max=float(samples.omega[-1]) if strict else math.inf,
        intervals=tests + more,
        without_data=samples.without_data,
    )


def subtract_noise(B_w, W_n, omega, *, disturbance_set, floor) -> tuple[np.ndarray, list[float]]:
    """Step 7: the disturbance's magnitude without the sensor's share.

    B_w, W_n  Weight, or magnitudes (K,) at ``omega`` (K,) rad/s (NaN: no data, stays NaN)
    disturbance_set  "paper": |B_w| - |W_n|; "covering": sqrt(|B_w|^2 - |W_n|^2)
    floor     > 0, scalar or (K,): the least value returned

    Returns the values (K,) and the frequencies (rad/s) at which the difference was not positive, so that the
    floor is all there is.

    >>> values, lost = subtract_noise([5.0, 1.0], [3.0, 2.0], [1.0, 10.0], disturbance_set="covering",
    floor=0.1) >>> values.tolist(), lost ([4.0, 0.1], [10.0])
    """
    omega = np.asarray(omega, dtype=float)
    total, noise = (_magnitudes(what, value, omega) for what, value in (("B_w", B_w), ("W_n", W_n)))
    floor = np.broadcast_to(np.asarray(floor, dtype=float), omega.shape)
    if not np.all(np.isfinite(floor) & (floor > 0)):
        raise InputError(
            "noise subtraction",
            "floor",
            f"{floor[~(floor > 0) | ~np.isfinite(floor)][0]}",
            "a finite number > 0",
        )
    if disturbance_set == "paper":
        left = total - noise
    elif disturbance_set == "covering":
        left = np.copysign(np.sqrt(np.abs(total - noise) * (total + noise)), total - noise)
    else:
        raise InputError(
            "noise subtraction", "disturbance_set", f"{disturbance_set!r}", "'paper' or 'covering'"
        )
    return np.maximum(left, floor), omega[left <= 0].tolist()


def _magnitudes(what: str, value, omega: np.ndarray) -> np.ndarray:
    if isinstance(value, Weight):
        return value.magnitude(omega)
    value = np.asarray(value, dtype=float)
    if value.shape != omega.shape:
        raise InputError(
            "noise subtraction", what, f"shape {value.shape}", f"the shape of omega, {omega.shape}"
        )
    wrong = np.flatnonzero((value < 0) | np.isinf(value))
    if wrong.size:
        raise InputError(
            "noise subtraction",
            f"{what} at {omega[wrong[0]]:g} rad/s",
            f"{value[wrong[0]]}",
            "a finite magnitude >= 0 or NaN",
        )
    return value


# ---------------------------------------------------------------- input


def _lowest_order(source, max_order, order, tol_db, proper) -> int:
    """The lowest order to try; refuses options that mean nothing."""
    if proper not in ("biproper", "strict"):
        raise InputError(source, "proper", f"{proper!r}", "'biproper' or 'strict'")
    lowest = 1 if proper == "strict" else 0
    for what, value in (("max_order", max_order), ("order", order)):
        if value is not None and not (isinstance(value, int) and lowest <= value <= 8):
            raise InputError(source, what, f"{value!r}", f"an integer from {lowest} to 8")
    if not (math.isfinite(tol_db) and tol_db >= 0):
        raise InputError(source, "tol_db", f"{tol_db!r}", "a finite number of dB >= 0")
    return lowest


@dataclass(frozen=True)
class _Samples:
    """A checked bound. ``omega`` (K,) and ``bound`` (K,), the latter over ``level``, without the NaN samples.

    ``unit`` and ``level`` are powers of two near the middle of omega and bound: y = (w/unit)^2 and its powers
    and the squares of the bound stay in range, and the change of units is exact.
    """

    omega: np.ndarray
    bound: np.ndarray
    unit: float
    level: float
    without_data: tuple[float, ...]
    floored: tuple[float, ...]

    @classmethod
    def read(cls, source, omega, bound, floor) -> _Samples:
        omega, bound = np.asarray(omega, dtype=float), np.asarray(bound, dtype=float)
        if omega.ndim != 1 or bound.shape != omega.shape or omega.size == 0:
            raise InputError(
                source,
                "",
                f"omega has shape {omega.shape} and bound {bound.shape}",
                "two lists of the same length >= 1",
            )
        for wrong, expected in (
            (~np.isfinite(omega) | (omega <= 0), "a finite frequency > 0 rad/s"),
            (np.append(False, np.diff(omega) <= 0), "strictly increasing frequencies"),
        ):
            if wrong.any():
                at = int(np.argmax(wrong))
                raise InputError(source, f"omega[{at}]", f"{omega[at]!r}", expected)
        known = ~np.isnan(bound)
        if not known.any():
            raise InputError(source, "bound", "every value is NaN", "data in at least one bin")
        wrong = known & ((bound < 0) | np.isinf(bound))
        if wrong.any():
            at = int(np.argmax(wrong))
            raise InputError(
                source, f"bound[{at}] at {omega[at]:g} rad/s", f"{bound[at]}", "a finite value >= 0, or NaN"
            )
        if floor is not None and not (np.isfinite(floor) and floor > 0):
            raise InputError(source, "floor", f"{floor!r}", "a finite number > 0")
        raised = known & (bound < (floor or 0.0))
        w, b = omega[known], np.where(raised, floor or 0.0, bound)[known]
        if (b == 0).any():
            raise InputError(
                source,
                f"bound at {w[np.argmin(b)]:g} rad/s",
                "is 0, and no weight is nought on an interval",
                "a floor > 0",
            )
        if b.max() / b.min() > _MAX_RANGE:
            raise InputError(
                source,
                f"bound at {w[np.argmin(b)]:g} rad/s",
                f"is {b.min()} below a largest value of {b.max()}",
                f"a range of at most {_MAX_RANGE:g}",
            )
        unit, level = (2.0 ** round(0.5 * (math.log2(v.min()) + math.log2(v.max()))) for v in (w, b))
        return cls(w, b / level, unit, level, tuple(omega[~known].tolist()), tuple(omega[raised].tolist()))

    def reciprocal(self) -> _Samples:
        return replace(self, bound=1.0 / self.bound)

    @property
    def y(self) -> np.ndarray:
        return (self.omega / self.unit) ** 2


# ---------------------------------------------------------------- proof


def _is_hurwitz(coefficients: np.ndarray) -> bool:
    """All roots in the open left half-plane: Routh's array in rational arithmetic, no rounding."""
    c = [Fraction(float(v)) for v in coefficients]
    if c[0] < 0:
        c = [-v for v in c]
    upper, lower = c[0::2], c[1::2]
    while lower:
        if lower[0] <= 0 or upper[0] <= 0:
            return False
        padded = lower + [Fraction(0)] * (len(upper) - len(lower))
        quotient = upper[0] / lower[0]
        upper, lower = lower, [u - quotient * p for u, p in zip(upper[1:], padded[1:], strict=False)]
    return upper[0] > 0


def _squared(coefficients: np.ndarray, unit: float) -> np.ndarray:
    """|p(j w)|^2 as a polynomial in y = (w/unit)^2, ascending, each coefficient rounded once."""
    scale = Fraction(unit)
    c = [Fraction(float(v)) * scale**i for i, v in enumerate(coefficients[::-1])]
    square = [Fraction(0)] * len(c)
    for i, ci in enumerate(c):
        for k, ck in enumerate(c):
            if (i + k) % 2 == 0:  # p(s) p(-s) at s = jw: odd powers cancel, s^2 = -w^2
                square[(i + k) // 2] += ci * ck * (-1) ** ((i - k) // 2)
    return np.array([float(v) for v in square])


def _bernstein(
    polynomial: np.ndarray, lo: np.ndarray, hi: np.ndarray, degree: int
) -> tuple[np.ndarray, np.ndarray]:
    """Bernstein coefficients (M, degree+1) on [lo, hi] (M,) and the same of sum |c_i| y^i.

    By the blossom: coefficient k of y^i is the mean of all products of i out of (degree-k) lo's and k hi's;
    for 0 <= lo <= hi nothing cancels within a monomial.
    """
    out = np.zeros((2, lo.size, degree + 1))
    powers = [(lo**j, hi**j) for j in range(len(polynomial))]
    for i, c in enumerate(polynomial):
        for k in range(degree + 1):
            mean = sum(
                math.comb(k, j)
                * math.comb(degree - k, i - j)
                / math.comb(degree, i)
                * powers[j][1]
                * powers[i - j][0]
                for j in range(max(0, i + k - degree), min(i, k) + 1)
            )
            out[0, :, k] += c * mean
            out[1, :, k] += abs(c) * mean
    return out[0], out[1]


def _least_ratio(
    top: np.ndarray, bottom: np.ndarray, samples: _Samples, strict: bool
) -> tuple[float, float, int]:
    """Proved lower limit of inf sqrt(top/bottom)/bound, where it is attained within 1e-9 (rad/s), tests made.

    ``top``, ``bottom``: polynomials in y, ascending, same unit as ``samples``; bottom >= 0. Returns 0 at the
    frequency where no positive ratio could be proved. ``strict``: leave out what lies beyond the last sample.
    """
    size = max(len(top), len(bottom))
    top, bottom = (np.pad(p, (0, size - len(p))) for p in (top, bottom))
    y, log_b2 = samples.y, 2.0 * np.log(samples.bound)
    slopes = np.diff(log_b2) / np.log(
        y[1:] / y[:-1]
    )  # the very logarithm of ``_bound_squared``, however close the samples
    inside = (
        np.append(0.0, y[:-1]),
        y,
        np.append(y[0], y[:-1]),
        np.append(log_b2[0], log_b2[:-1]),
        np.append(0.0, slopes),
    )
    families = [(top, bottom, inside, lambda v: samples.unit * math.sqrt(v))]
    if not strict:  # [y_K, inf) in 1/y: the reversed polynomials on [0, 1/y_K]
        beyond = (np.zeros(1), 1.0 / y[-1:], 1.0 / y[-1:], log_b2[-1:], np.zeros(1))
        families.append(
            (top[::-1], bottom[::-1], beyond, lambda v: samples.unit / math.sqrt(v) if v else math.inf)
        )
    least, at, tests, margin = math.inf, math.nan, 0, _PROOF_MARGIN
    for p, q, pieces, frequency in families:
        points, shapes = np.concatenate(pieces[:2]), tuple(np.tile(v, 2) for v in pieces[2:])
        for halvings in range(_MAX_HALVINGS):
            margin = max(margin, _PROOF_MARGIN * 4.0 ** (halvings - _PATIENCE))
            value, point = _attained(p, q, points, shapes)
            if value < least:
                least, at = value, frequency(point)
            if not least > 0.0:
                return 0.0, at, tests
            tests += len(pieces[0])
            open_ = ~_nonnegative(p, q, least * (1.0 - margin), *pieces)
            lo, hi, *shapes = (v[open_] for v in pieces)
            if not lo.size:
                break
            if tests > _MAX_TESTS:
                return 0.0, frequency(hi[0]), tests
            points = np.where(lo > 0, np.sqrt(lo * hi), 0.25 * hi)
            pieces = (
                np.concatenate([lo, points]),
                np.concatenate([points, hi]),
                *(np.tile(v, 2) for v in shapes),
            )
        else:
            return 0.0, frequency(hi[0]), tests
    return math.sqrt(least * (1.0 - margin)), at, tests


def _bound_squared(points, y0, log0, slope) -> np.ndarray:
    """c y^q of one piece; its value at y0 is exp(log0). q = 0 pieces may contain y = 0."""
    with np.errstate(divide="ignore", invalid="ignore"):
        exponent = np.where(slope == 0, 0.0, slope * np.log(points / y0))
    return np.exp(log0 + exponent)


def _attained(p, q, points, shapes) -> tuple[float, float]:
    """Least p/(bound^2 q) over ``points``, less its rounding error, and the point; q = 0 counts as
    infinite."""
    powers = points[:, None] ** np.arange(len(p))
    bottom = (powers @ q) * _bound_squared(points, *shapes)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where(bottom > 0, (powers @ p - _ROUNDING * (powers @ np.abs(p))) / bottom, math.inf)
    k = int(np.argmin(ratio))
    return float(ratio[k]), float(points[k])


def _nonnegative(p, q, factor, lo, hi, y0, log0, slope) -> np.ndarray:
    """True (M,) where p >= factor bound^2 q is proved on [lo, hi]."""
    at_lo, at_hi = (_bound_squared(v, y0, log0, slope) for v in (lo, hi))
    with np.errstate(divide="ignore", invalid="ignore"):
        middle = np.where(lo > 0, np.sqrt(lo * hi), 0.5 * hi)
        tangent = _bound_squared(middle, y0, log0, slope) * (
            1.0 + slope * (np.array([lo, hi]) / middle - 1.0)
        )
    concave = (slope > 0) & (slope < 1)
    line_lo, line_hi = (
        factor * np.where(concave, tangent[0], at_lo),
        factor * np.where(concave, tangent[1], at_hi),
    )
    n = len(p) - 1
    p_c, p_abs = _bernstein(p, lo, hi, n)
    q_c, q_abs = _bernstein(q, lo, hi, n)
    proved = np.ones(lo.size, dtype=bool)
    for k in range(n + 2):  # coefficient k of p and of (line q), both raised to degree n + 1
        value = np.zeros(lo.size)
        for weight, index, line in ((n + 1 - k, k, line_lo), (k, k - 1, line_hi)):
            if weight:
                value += weight * (
                    p_c[:, index]
                    - line * q_c[:, index]
                    - _ROUNDING * (p_abs[:, index] + line * q_abs[:, index])
                )
        proved &= value >= 0
    return proved


# ---------------------------------------------------------------- optimum


@dataclass(frozen=True)
class _Candidate:
    """N, D ascending in y with min N/(bound^2 D) = 1 on the grid, where it reaches ``ratio_db``.

    ``lower_db``: infeasible for this order on the rows ``active`` (y values) alone.
    """

    order: int
    top: np.ndarray
    bottom: np.ndarray
    ratio_db: float
    lower_db: float
    active: np.ndarray


class _Problem:
    """The cutting-plane grid: all samples, points between them, both ends and what lies beyond.

    ``y`` (G,) ascending from 0 to inf, ``b2`` (G,) bound squared, ``below`` (G,) where the weight must be
    above the bound. Grows by ``insert`` where a resonance hides between points.
    """

    def __init__(self, samples: _Samples, strict: bool):
        self.samples, self.strict = samples, strict
        self._log_w, self._log_b = np.log(samples.omega / samples.unit), np.log(samples.bound)
        first, last = self.band = (self._log_w[0], self._log_w[-1])
        self.end = math.exp(2.0 * last)
        tail = np.geomspace(
            _GRID_STEP, math.log(_OUTSIDE), 30
        )  # dense next to the corner of the bound at either end
        fill = [
            np.linspace(a, b, int((b - a) / _GRID_STEP) + 2)[:-1]
            for a, b in zip(self._log_w[:-1], self._log_w[1:], strict=False)
        ]
        self._place(np.concatenate([[-math.inf], first - tail[::-1], *fill, [last], last + tail, [math.inf]]))

    def _place(self, grid: np.ndarray):
        self.y = np.exp(2.0 * grid)
        self.b2 = np.exp(2.0 * np.interp(grid, self._log_w, self._log_b))
        if (
            self.strict
        ):  # a ceiling that falls from a decade beyond the band, else the roll-off would start anywhere
            self.b2[:-1] *= np.minimum(1.0, 100.0 * self.end / np.maximum(self.y[:-1], self.end))
        self.below = grid <= self.band[1] if self.strict else np.ones(grid.size, dtype=bool)
        self._grid = grid

    def insert(self, y: np.ndarray):
        with np.errstate(divide="ignore"):
            self._place(np.union1d(self._grid, 0.5 * np.log(y)))

    def start(self) -> np.ndarray:
        """y of the first linear program's rows: both ends, and highest and lowest bound in each of 24
        stretches."""
        cells = np.array_split(np.arange(self.y.size), 24)
        return np.unique(self.y[[0, -1] + [c[f(self.b2[c])] for c in cells for f in (np.argmin, np.argmax)]])

    def powers(self, degree: int) -> np.ndarray:
        """y^i, (G, degree+1); the row of y = inf is that of the leading coefficient."""
        rows = self.y[:-1, None] ** np.arange(degree + 1)
        return np.vstack([rows, np.eye(degree + 1)[-1:]])

    def ratio2(self, top: np.ndarray, bottom: np.ndarray) -> np.ndarray:
        """N/(bound^2 D) on the grid, nan where D <= 0."""
        powers = self.powers(len(bottom) - 1)
        low, high = powers @ bottom, powers @ np.pad(top, (0, len(bottom) - len(top)))
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(low > 0, high / (self.b2 * low), math.nan)

    def spread_db(self, ratio2: np.ndarray, rows=slice(None)) -> float:
        """Worst ratio over best of the ratios at ``rows``; inf when no gain makes that a weight above the
        bound."""
        if np.isnan(ratio2).any() or not (least := ratio2[self.below[rows]].min()) > 0:
            return math.inf
        return 10.0 * math.log10(ratio2.max() / least)


def _db(ratio: float) -> float:
    return 20.0 * math.log10(ratio) if ratio < math.inf else math.inf


def _optimum(
    problem: _Problem, order: int, lower_order: _Candidate | None, last: _Candidate | None = None
) -> _Candidate:
    """Least worst ratio of one order; the lower order's candidate when it is not beaten by ``_STEP_DB``.

    ``last``: what was found before the grid grew.
    """
    best = lower_order
    if order == 0:
        ratio_db = 10.0 * math.log10(problem.b2.max() / problem.b2.min())
        return _Candidate(0, np.array([problem.b2.max()]), np.ones(1), ratio_db, ratio_db, problem.y)
    if best is not None and best.ratio_db <= _STEP_DB:
        return best
    if last is None:
        active, lower_db, excess = problem.start(), 0.0, 10.0
        bottom = np.ones(1) if best is None else best.bottom
        while len(bottom) <= order:  # one more break in the middle of the band
            bottom = np.convolve(bottom, [1.0, math.exp(-sum(problem.band))])
    else:
        active, lower_db, excess, bottom = last.active, last.lower_db, 0.0, last.bottom
        active = np.union1d(active, _failures(problem, problem.ratio2(last.top, last.bottom), lower_db))
    if best is None:  # strictly proper, first order: any roll-off to start from
        ratio2 = problem.ratio2(np.ones(1), bottom)
        best = _Candidate(
            order,
            1.0 / ratio2[problem.below].min(keepdims=True),
            bottom,
            problem.spread_db(ratio2),
            0.0,
            active,
        )
    for _ in range(_MAX_CUTS):
        tol = max(_STEP_DB, 0.1 * excess)
        found, lower_db = _exchange(problem, active, order, bottom, lower_db, best.ratio_db, tol)
        if found is None:  # nothing better than ``best`` by tol
            if tol == _STEP_DB:
                break
            excess = 0.0
            continue
        top, bottom = found
        _resolve(problem, top, bottom)
        ratio2 = problem.ratio2(top, bottom)
        worst = problem.spread_db(ratio2)
        if worst < best.ratio_db:
            best = _Candidate(order, top / ratio2[problem.below].min(), bottom, worst, lower_db, active)
        excess = min(excess, worst - lower_db) if math.isfinite(worst) else excess
        fresh = np.setdiff1d(_failures(problem, ratio2, lower_db), active)
        if best.ratio_db <= lower_db + 2 * _STEP_DB or (not fresh.size and tol == _STEP_DB):
            break
        if not fresh.size:
            excess = 0.0
        active = np.union1d(active, fresh)
    return best if best.order < order else replace(best, lower_db=lower_db, active=active)


def _resolve(problem: _Problem, top: np.ndarray, bottom: np.ndarray):
    """Put the places of lightly damped poles and zeros on the grid when the ratio fails there."""
    for polynomial in (top, bottom):
        roots = _roots(np.trim_zeros(polynomial, "b")[::-1])
        near = np.unique(np.abs(roots[roots.real > 0]))
        if near.size:
            problem.insert(np.concatenate([near, np.sqrt(near[1:] * near[:-1])]))


def _exchange(problem, active, order, bottom, lower_db, upper_db, tol_db):
    """Bracket the optimum over the rows ``active`` (y values) to ``tol_db``: ((N, D) or None, level proved
    infeasible).

    ``upper_db`` is known to be reached; None when that cannot be bettered by ``tol_db``.
    """
    rows = np.searchsorted(problem.y, active)
    powers = problem.powers(order)
    found, level = None, min(lower_db + tol_db, 0.5 * (lower_db + upper_db))
    scaled_by, judged_by = (
        upper_db,
        math.inf,
    )  # what ``bottom`` reaches, now and at the last verdict "infeasible"
    for _ in range(_MAX_PROGRAMS):
        if upper_db - lower_db <= tol_db:
            if judged_by <= lower_db + max(tol_db, _NEAR_DB):
                break
            level = (
                lower_db  # rows scaled by a D far from the optimum may have led to that verdict: ask again
            )
        gap = upper_db - lower_db
        answer = _program(problem, powers[rows], rows, bottom, level)
        if answer is None:  # no verdict
            level = 0.5 * (level + upper_db)
            continue
        ratio2 = problem.ratio2(*answer)[rows]
        reached = problem.spread_db(ratio2, rows)
        if reached > level + 1e-6:
            lower_db, judged_by = level, scaled_by
        elif level <= lower_db:
            lower_db = 0.0
        if reached < upper_db:
            upper_db = scaled_by = reached
            bottom = answer[1]
            found = answer[0] / ratio2[problem.below[rows]].min(), bottom
        slow = upper_db - lower_db > 0.5 * gap
        level = 0.5 * (lower_db + upper_db) if slow else max(upper_db - 0.9 * tol_db, lower_db + 0.1 * tol_db)
    return found, lower_db


def _program(problem, powers, rows, bottom, level_db):
    """(N, D) of the linear program at the trial worst ratio ``level_db``, None when the solver gives up.

    Unknowns N' = N/t, D and tau; each row over the D of ``bottom``, and that not under 1e-5 of its sum |d_i|
    y^i, so that the solver's tolerance is relative even in a sharp resonance:
    bound^2 D <= t N',  N'/t - bound^2 D <= tau bound^2 D_old,  D >= 1e-5 D_old,  mean of D = 1,  least tau.
    Where a strictly proper weight may leave the bound, N only stays positive.
    """
    t = 10.0 ** (level_db / 20.0)
    size = powers @ np.abs(bottom)
    d_rows = powers / size[:, None]
    mean = d_rows.mean(axis=0)
    d_rows /= np.maximum(powers @ bottom / size, _RESOLUTION)[:, None]
    n_rows = d_rows[:, :-1] if problem.strict else d_rows
    n_rows = n_rows / problem.b2[rows, None]
    n_scale, d_scale = n_rows.max(axis=0), d_rows.max(axis=0)
    n_rows, d_rows, mean = n_rows / n_scale, d_rows / d_scale, mean / d_scale
    below, tau = problem.below[rows], np.ones((len(rows), 1))
    a_ub = np.vstack(
        [
            np.hstack([-t * n_rows, d_rows * below[:, None], 0 * tau]),
            np.hstack([n_rows / t, -d_rows, -tau]),
            np.hstack([0 * n_rows, -d_rows, 0 * tau]),
        ]
    )
    roll_off = np.where(below, 0.0, -_RESOLUTION * problem.end / np.maximum(problem.y[rows], problem.end))
    b_ub = np.concatenate([roll_off, np.zeros(len(rows)), np.full(len(rows), -_RESOLUTION)])
    cost = np.zeros(a_ub.shape[1])
    cost[-1] = 1.0
    a_eq = np.concatenate([np.zeros(n_rows.shape[1]), mean, [0.0]])[None, :]
    answer = linprog(
        cost,
        A_ub=a_ub,
        b_ub=b_ub,
        A_eq=a_eq,
        b_eq=[1.0],
        bounds=(None, None),
        method="highs-ds",
        options=_TOLERANCE,
    )
    if answer.status != 0:
        return None
    top, bottom = answer.x[: n_rows.shape[1]] / n_scale, answer.x[n_rows.shape[1] : -1] / d_scale
    return top / np.abs(bottom).max(), bottom / np.abs(bottom).max()


def _failures(problem: _Problem, ratio2: np.ndarray, level_db: float) -> np.ndarray:
    """y to add: the worst local extremes of the ratio outside [1, level], and one per stretch where D <=
    0."""
    bad = ~((ratio2 > 0) | (problem.strict & np.isinf(problem.y)))
    log_r = 10.0 * np.log10(np.where(ratio2 > 0, ratio2, 1.0))
    miss = np.maximum(log_r - level_db, np.where(problem.below, -log_r, 0.0))
    ends = np.pad(miss, 1, mode="edge")
    peak = np.flatnonzero((miss > 0.25 * _STEP_DB) & (miss >= ends[:-2]) & (miss >= ends[2:]))
    peak = peak[np.argsort(-miss[peak], kind="stable")[:30]]
    runs = np.flatnonzero(np.diff(np.concatenate([[0], bad.astype(int), [0]])))
    return np.unique(problem.y[np.concatenate([peak, (runs[0::2] + runs[1::2] - 1) // 2])])


def _choose(best: dict[int, _Candidate], tol_db: float) -> int:
    """Smallest order n such that no order n + k gains more than k tol_db."""
    return next(
        n
        for n, c in best.items()
        if all(c.ratio_db - other.ratio_db <= tol_db * (m - n) for m, other in best.items() if m > n)
    )


# ---------------------------------------------------------------- spectral factors


def _close(problem: _Problem, candidate: _Candidate, lower_order: _Candidate | None):
    """Weight, inflation, certificate and lower limit [dB] of a candidate; None when no stable spectral factor
    is found that beats the lower order.

    Where the certificate finds the ratio outside what the grid showed, that frequency joins the grid and the
    order is fitted again.
    """
    closed = None
    for _ in range(_MAX_REFITS):
        lifted = _lift(problem, candidate)
        certificate = lifted[2]
        if certificate.ok and (closed is None or certificate.max_ratio < closed[2].max_ratio):
            closed = *lifted, candidate.lower_db
        if closed is not None and _db(closed[2].max_ratio) <= candidate.lower_db + 4 * _STEP_DB:
            break
        problem.insert(
            (np.array([certificate.min_ratio_at, certificate.max_ratio_at]) / problem.samples.unit) ** 2
        )
        candidate = _optimum(problem, candidate.order, lower_order, candidate)
        if lower_order is not None and candidate.order == lower_order.order:
            break
    worse = (
        closed is not None
        and lower_order is not None
        and _db(closed[2].max_ratio) > lower_order.ratio_db + _STEP_DB
    )
    return None if worse else closed


def _lift(problem: _Problem, candidate: _Candidate) -> tuple[Weight, float, Certificate]:
    """Spectral factors of a candidate, the gain that puts them above the bound, and the certificate of
    both."""
    samples = problem.samples
    factors = [_spectral_factor(np.trim_zeros(p, "b")) for p in (candidate.top, candidate.bottom)]
    num, den = (p / samples.unit ** np.arange(len(p) - 1, -1, -1.0) for p in factors)
    raw, inflation = Weight(samples.level * num / den[0], den / den[0]), 1.0
    for _ in range(3):
        weight = Weight(raw.num * inflation, raw.den)
        certificate = verify_overbound(weight, samples.omega, samples.bound * samples.level)
        if certificate.ok or certificate.min_ratio == 0.0:
            break
        inflation *= (1.0 + 1e-12) / certificate.min_ratio
    return weight, inflation, certificate


def _roots(polynomial: np.ndarray) -> np.ndarray:
    """Roots of a polynomial in descending powers, in a unit that puts their geometric mean at 1."""
    n = len(polynomial) - 1
    if n == 0 or polynomial[-1] == 0:
        return np.roots(polynomial)
    unit = 2.0 ** round(math.log2(abs(polynomial[-1] / polynomial[0])) / n)
    return unit * np.roots(polynomial * unit ** np.arange(n, -1, -1.0))


def _spectral_factor(square: np.ndarray) -> np.ndarray:
    """p with |p(jw)|^2 = square(w^2) and roots in the open left half-plane, where there is one; descending
    powers of s."""
    roots = _roots(square[::-1])
    s = -np.sqrt(-roots.astype(complex))
    return math.sqrt(abs(square[-1])) * np.atleast_1d(np.real(np.poly(s)))


def _quadratics(roots: np.ndarray) -> list[np.ndarray]:
    """Monic real factors of degree two, and one of degree one when the count is odd, slow to fast."""
    real = sorted((float(r.real) for r in roots if r.imag == 0), key=abs)
    factors = [np.array([1.0, -2.0 * r.real, abs(r) ** 2]) for r in roots if r.imag > 0]
    if len(real) % 2:
        factors.append(np.array([1.0, -real.pop()]))
    factors += [np.poly(real[i : i + 2]) for i in range(0, len(real), 2)]
    return sorted(factors, key=lambda f: (-len(f), abs(f[-1]) ** (1.0 / (len(f) - 1))))


def _sections(num: np.ndarray, den: np.ndarray):
    """(A, B, C, D) of first- and second-order factors whose product is num/den."""
    gain = num[0] / den[0]
    tops, bottoms = _quadratics(_roots(num)), _quadratics(_roots(den))
    sections = []
    for bottom in bottoms:
        size = len(bottom) - 1
        fit = next((k for k, t in enumerate(tops) if len(t) - 1 == size), None)
        fit = fit if fit is not None else next((k for k, t in enumerate(tops) if len(t) - 1 < size), None)
        top = tops.pop(fit) if fit is not None else np.ones(1)
        top = np.pad(top, (size + 1 - len(top), 0))
        d = top[0]
        if size == 1:
            a, b, c = [[-bottom[1]]], [[1.0]], [[top[1] - d * bottom[1]]]
        else:
            poles = _roots(bottom)
            if poles[0].imag == 0:
                p1, p2 = sorted(-poles.real)
                a, b = [[-p1, 0.0], [1.0, -p2]], [[1.0], [0.0]]
                first = top[1] - d * (p1 + p2)
                c = [[first, top[2] - d * p1 * p2 - first * p2]]
            else:
                w = math.sqrt(bottom[2])
                a, b = [[0.0, w], [-w, -bottom[1]]], [[0.0], [1.0]]
                c = [[(top[2] - d * bottom[2]) / w, top[1] - d * bottom[1]]]
        sections.append(tuple(np.array(m, dtype=float) for m in (a, b, c, [[d]])))
    sections.append((np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.array([[gain]])))
    return sections
