"""Weights of an identification: rational magnitudes above the bounds (steps 6 and 7), and their numbers in
the core."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from ..base.errors import InputError
from ..base.parallel import Map
from ..core.coefficients import Coefficients, build_coefficients
from ..drives.frames import Estimator
from ..engine.overbound.certificate import Certificate, verify_overbound
from ..engine.overbound.fit import OverboundFit, fit_overbound
from ..engine.overbound.noise import subtract_noise
from ..engine.overbound.weight import Weight
from ..engine.synthesis.norms import hinf_norm
from ..engine.synthesis.statespace import StateSpace, series
from ..vehicle.nominal import NominalModel
from ..vehicle.project import Project
from .bounds import Bounds
from .calibration import ROUNDING
from .change import ChangeTest
from .energy import UNBOUNDED, EnergyTest
from .healthy import HealthySet
from .pools import Pools

DC_STAND_IN = 0.1
"""Fraction of the lowest bin's frequency at which DC's bound stands on a logarithmic axis."""
SMALLEST_NU = 1e-3
"""Floor of the uncertainty bound where the data need none: a weight must be positive."""
RISE, FALL = 3.0, 2.0
"""Steepest rise and fall of the uncertainty bound, in powers of the frequency."""
LEAST_SHARE = 0.1
"""Floor of step 7, as a part of B_w.

Less is left only where two weights happen to be equal, each of them a fit to some tenths of a dB. A floor
above what is left covers it. A floor far below would put a notch into the bound that no weight of low order
follows.
"""
RATIO_RTOL, RATIO_ATOL_DB = 1e-8, 1e-7
"""Rounding of a proved ratio of weight over bound, and of its decibels."""
LISTED = ("W_w", "W_n", "W_w_S0", "W_C", "W_delta")
"""Weights of which weights.json holds a list."""


@dataclass(frozen=True)
class FittedWeight:
    """A weight with the samples that it was fitted above.

    Attributes
    ----------
    fit : OverboundFit
    omega : ndarray (K',), rad/s
    bound : ndarray (K',), NaN: no data
    """

    fit: OverboundFit
    omega: np.ndarray
    bound: np.ndarray

    def magnitude(self, omega: np.ndarray) -> np.ndarray:
        """|W| at omega [rad/s], in the same shape as omega."""
        return self.fit.weight.magnitude(omega)

    def to_dict(self) -> dict:
        """JSON-able: the weight, its fit, and its samples."""
        f = self.fit
        return {
            "weight": f.weight.to_dict(),
            "order": f.order,
            "worst_ratio_db": f.worst_ratio_db,
            "lp_optimum_db": min(f.lp_optimum_db, f.worst_ratio_db),
            "certificate": f.certificate,
            "floored_rad_s": list(f.floored),
            "breaks_outside_rad_s": list(f.breaks_outside),
            "omega_rad_s": self.omega,
            "bound": self.bound,
        }


@dataclass(frozen=True)
class Weights:
    """Fitted weights. ``inflation`` multiplies all bounds in every use.

    Attributes
    ----------
    W_w : list (n_y,) of FittedWeight, disturbance
    W_delta : list (n_delta,) of FittedWeight, uncertainty
    gamma_w : FittedWeight, disturbance bound of step 4
    W_n : list (n_y,) of FittedWeight, noise; empty without zero-input drives
    W_w_S0 : list (n_y,) of FittedWeight, disturbance of class S0 (K_inf), for synthesis; may be empty
    W_C : list of FittedWeight, command, for synthesis; may be empty
    floored : dict, frequencies [rad/s] by weight where B_w has nothing above the sensor's share (step 7)
    disturbance_set : str
    healthy : HealthySet or None, bounds of the frame test; None: it asks the fitted weights
    W_delta_healthy : list of FittedWeight, above its W_delta, for the energy test; may be empty
    inflation : float
    silent : tuple of int
        Bins without evidence above 1, which set no threshold and raise no alarm (THEORY 7.1).
    """

    W_w: list[FittedWeight]
    W_delta: list[FittedWeight]
    gamma_w: FittedWeight
    W_n: list[FittedWeight]
    W_w_S0: list[FittedWeight]
    W_C: list[FittedWeight]
    floored: dict[str, list[float]]
    disturbance_set: str
    healthy: HealthySet | None = None
    W_delta_healthy: list[FittedWeight] = field(default_factory=list)
    inflation: float = 1.0
    silent: tuple[int, ...] = ()

    def at(self, omega: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """W_delta (K, n_delta) and B_w (K, n_y) of the certificate at omega (K,): with inflation and the
        sensor's share."""
        B_w = np.column_stack([w.magnitude(omega) for w in self.W_w])
        if self.W_n:
            W_n = np.column_stack([w.magnitude(omega) for w in self.W_n])
            B_w = np.hypot(B_w, W_n) if self.disturbance_set == "covering" else B_w + W_n
        W_delta = np.column_stack([w.magnitude(omega) for w in self.W_delta])
        return self.inflation * W_delta, self.inflation * B_w

    def of_frames(self, omega: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """W_delta (K, n_delta) and B_w (K, n_y) of the frame test at the bins omega (K,), inflation included:
        the healthy set, or without one `at`."""
        if self.healthy is None:
            return self.at(omega)
        return self.inflation * self.healthy.W_delta, self.inflation * self.healthy.B_w

    def of_core(self, omega: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """`of_frames`, then `at`, as in the core: without a bound on the disturbance in silent bins."""
        for W_delta, B_w in (self.of_frames(omega), self.at(omega)):
            B_w = B_w.copy()
            B_w[list(self.silent)] *= UNBOUNDED
            yield W_delta, B_w

    def to_dict(self) -> dict:
        """JSON-able, for `from_dict`."""
        lists = {key: [w.to_dict() for w in getattr(self, key)] for key in LISTED}
        of_energy = [w.to_dict() for w in self.W_delta_healthy]
        return lists | {
            "gamma_w": self.gamma_w.to_dict(),
            "floored_rad_s": self.floored,
            "disturbance_set": self.disturbance_set,
            "inflation": self.inflation,
            "silent_bins": list(self.silent),
            **({} if self.healthy is None else {"healthy": self.healthy.to_dict()}),
            **({"W_delta_healthy": of_energy} if of_energy else {}),
        }

    @classmethod
    def from_dict(cls, data: dict, source: str) -> Weights:
        """Read back and prove every certificate again; InputError for a failing one."""

        def weight(entry: dict, name: str) -> FittedWeight:
            omega = np.array(entry["omega_rad_s"], float)
            bound = np.array([np.nan if b is None else b for b in entry["bound"]], float)
            loaded = Weight.from_dict(entry["weight"])
            certificate = verify_overbound(loaded, omega, bound, name=name)
            if not certificate.ok:
                raise InputError(
                    source,
                    name,
                    f"the weight falls to {certificate.min_ratio:.6f} of its bound at "
                    f"{certificate.min_ratio_at:.4g} rad/s",
                    "a weight that overbounds its data",
                )
            _require_stated(source, name, entry, certificate)
            fit = OverboundFit(
                loaded,
                entry["order"],
                entry["worst_ratio_db"],
                entry["lp_optimum_db"],
                1.0,
                certificate.to_dict(),
                {},
                tuple(entry["floored_rad_s"]),
                tuple(entry["breaks_outside_rad_s"]),
            )
            return FittedWeight(fit, omega, bound)

        if isinstance(data["W_delta"], dict) or not data["W_delta"]:
            raise InputError(
                source,
                "W_delta",
                "one weight" if data["W_delta"] else "no weight",
                "a list, one a Delta: identify the drives again",
            )
        inflation = data["inflation"]
        if (
            isinstance(inflation, bool)
            or not isinstance(inflation, int | float)
            or not 0 < inflation < np.inf
        ):
            raise InputError(source, "inflation", repr(inflation), "a positive factor")
        lists = {key: [weight(e, f"{key}[{j}]") for j, e in enumerate(data[key])] for key in LISTED}
        return cls(
            **lists,
            gamma_w=weight(data["gamma_w"], "gamma_w"),
            floored=data["floored_rad_s"],
            disturbance_set=data["disturbance_set"],
            healthy=HealthySet.from_dict(data["healthy"]) if "healthy" in data else None,
            W_delta_healthy=[
                weight(e, f"W_delta_healthy[{j}]") for j, e in enumerate(data.get("W_delta_healthy", []))
            ],
            inflation=float(inflation),
            silent=tuple(data.get("silent_bins", ())),
        )


def _require_stated(source: str, name: str, entry: dict, proved: Certificate) -> None:
    """InputError unless an entry of weights.json states of its weight what ``proved`` says of it.

    The upper limit of weight over bound may not be below the one proved, nor below the level that is stated
    as out of reach for the order.
    """
    stated, highest = entry["certificate"], 20 * np.log10(proved.max_ratio)
    checks = {
        "worst_ratio_db": entry["worst_ratio_db"] >= highest - RATIO_ATOL_DB,
        "lp_optimum_db": entry["lp_optimum_db"] <= entry["worst_ratio_db"] + RATIO_ATOL_DB,
        "certificate.min_ratio": float(stated["min_ratio"]) <= proved.min_ratio * (1 + RATIO_RTOL),
        "certificate.max_ratio": float(stated["max_ratio"]) >= proved.max_ratio * (1 - RATIO_RTOL),
        "certificate.omega_max": float(stated["omega_max"]) <= proved.omega_max,
        "certificate": stated["ok"] and stated["stable"] and stated["minimum_phase"],
    }
    for key, held in checks.items():
        if not held:
            raise InputError(
                source,
                f"{name}.{key}",
                f"is not proved: weight over bound lies in {proved.min_ratio:.9g} .. {proved.max_ratio:.9g}, "
                f"{highest:.6g} dB, up to {proved.omega_max:.4g} rad/s",
                "what `lpvguard identify` wrote",
            )


def fitting_grid(estimator: Estimator) -> np.ndarray:
    """Return the frequencies at which weights are fitted: those of the bins, with a replacement for DC.

    Parameters
    ----------
    estimator : Estimator

    Returns
    -------
    ndarray (K,), rad/s
    """
    omega = estimator.omega.copy()
    omega[0] = DC_STAND_IN * omega[1]
    return omega


def smallest_disturbance(B2: np.ndarray) -> float:
    """Return the floor of disturbance bounds, 1e-6 times the largest, because a weight must be positive.

    Parameters
    ----------
    B2 : ndarray (K,), output units, NaN: no data

    Returns
    -------
    float, output units
    """
    return 1e-6 * float(np.nanmax(B2))


def uncertainty_samples(
    estimator: Estimator, nu: np.ndarray, omega: np.ndarray, error_bound: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Samples for W_delta: frequencies (S,) [rad/s] and bound (S,), NaN at the replacement of DC.

    ``error_bound`` (G,) at ``omega`` (G,) is the bound of the model error model (THEORY 7.6). It is log-log
    between its frequencies. ``nu`` (K,) is the bound of the frames of step 5 at the bins. It is 0 at DC by
    definition. Below the lowest bin any small value will do (paper, step 6).

    Dips that a weight of low order cannot follow are filled. The bound rises at most as omega^RISE and falls
    at most as omega^-FALL. One deep dip would otherwise worsen the best worst ratio at every frequency.
    """
    bins = fitting_grid(estimator)
    samples = np.union1d(bins, omega)
    bound = np.exp(np.interp(np.log(samples), np.log(omega), np.log(np.maximum(error_bound, SMALLEST_NU))))
    at = np.searchsorted(samples, bins)
    bound[at] = np.fmax(bound[at], nu)
    apart = np.log(samples[:, None] / samples)
    filled = (bound * np.exp(-np.where(apart > 0, FALL, -RISE) * apart))[:, samples > bins[0]].max(axis=1)
    return samples, np.where(samples == bins[0], np.nan, filled)


def fit_uncertainty(
    project: Project, estimator: Estimator, omega: np.ndarray, column: tuple[np.ndarray, np.ndarray, str]
) -> FittedWeight:
    """Fit W_delta above the uncertainty bounds.

    Parameters
    ----------
    project : Project
    estimator : Estimator
    omega : ndarray (G,), rad/s
    column : tuple of nu, ndarray (K,), model error bound, ndarray (G,), and a name for errors, of one Delta

    Returns
    -------
    FittedWeight

    Raises
    ------
    InputError
        If no weight of the project's order fits.

    References
    ----------
    Paper, step 6; THEORY 7.6.
    """
    nu, error_bound, name = column
    samples, bound = uncertainty_samples(estimator, nu, omega, error_bound)
    return _fitted(project, samples, bound, name)


def with_healthy(
    project: Project, estimator: Estimator, weights: Weights, healthy: HealthySet, workers: Map = map
) -> Weights:
    """The weights with the ``healthy`` set of the frame test, and W_delta of the energy test above it."""
    omega, names = estimator.omega[1:], [f"healthy W_delta {j + 1}" for j in range(project.n_delta)]
    none = np.full((estimator.n_bins, project.n_delta), np.nan)
    columns = zip(none.T, healthy.W_delta[1:].T, names, strict=True)
    fitted = list(workers(partial(fit_uncertainty, project, estimator, omega), columns))
    return replace(weights, healthy=healthy, W_delta_healthy=fitted)


def fit_bound(
    project: Project, estimator: Estimator, bound: np.ndarray, name: str, floor: float
) -> FittedWeight:
    """Fit a weight above a bound and a floor.

    Parameters
    ----------
    project : Project
    estimator : Estimator
    bound : ndarray (K,), NaN: no data
    name : str, for errors
    floor : float, unit of the bound

    Returns
    -------
    FittedWeight

    Raises
    ------
    InputError
        If no weight of the project's order fits.
    """
    # The proof is against the bound with the floor.
    return _fitted(
        project, fitting_grid(estimator), np.where(np.isnan(bound), np.nan, np.fmax(bound, floor)), name
    )


def _fitted(project: Project, omega: np.ndarray, bound: np.ndarray, name: str) -> FittedWeight:
    fit = fit_overbound(
        omega, bound, name=name, max_order=project.weights.max_order, tol_db=project.weights.tolerance_db
    )
    return FittedWeight(fit, omega, bound)


def fit_weights(
    project: Project,
    estimator: Estimator,
    bounds: Bounds,
    gamma_w: FittedWeight,
    W_delta: list[FittedWeight],
    noise: np.ndarray,
    error: np.ndarray,
    command: np.ndarray,
    workers: Map = map,
) -> Weights:
    """Steps 6 and 7 for the fitted ``W_delta``.

    ``noise``, ``error`` (K, n_y): peaks of E without and with input; ``command`` (K,): of the controlled
    output. ``workers`` share the weights. Without zero-input drives (``noise`` all NaN) B_w is W_w. W_C is
    fitted with them, or for a design.
    """
    floor = smallest_disturbance(bounds.B2)
    names = [s.name for s in project.outputs]
    disturbance_set = project.bounds.disturbance_set
    # A covering set is an ellipsoid: n_y outputs at their peaks together need sqrt(n_y).
    cover = np.sqrt(project.n_y) if disturbance_set == "covering" else 1.0
    bounds_by_weight = [(bounds.B_w, "B_w")]
    if not np.isnan(noise).all():
        bounds_by_weight += [(noise, "W_n"), (cover * error, "B_w of S0")]
    columns = [
        (bound[:, j], f"{what} of {n}") for bound, what in bounds_by_weight for j, n in enumerate(names)
    ]
    commands = [(command, "W_C")] if len(bounds_by_weight) > 1 or project.design is not None else []
    fitted = list(workers(partial(_fitted_above, project, estimator, floor), columns + commands))
    W_C = fitted[len(columns) :]
    B_w, W_n, of_S0 = (fitted[: len(columns)][k * len(names) : (k + 1) * len(names)] for k in range(3))
    if not W_n:
        return Weights(B_w, W_delta, gamma_w, [], [], W_C, {}, disturbance_set)
    floored: dict[str, list[float]] = {}

    def without_noise(B: list[FittedWeight], what: str) -> list[FittedWeight]:
        weights, empty = disturbance_weights(project, estimator, B, W_n, floor, what, workers)
        floored.update({f"{what} of {n}": e for n, e in zip(names, empty, strict=False)})
        return weights

    W_w, W_w_S0 = without_noise(B_w, "W_w"), without_noise(of_S0, "W_w of S0")
    return Weights(W_w, W_delta, gamma_w, W_n, W_w_S0, W_C, floored, disturbance_set)


def _fitted_above(
    project: Project, estimator: Estimator, floor: float, named_bound: tuple[np.ndarray, str]
) -> FittedWeight:
    bound, name = named_bound
    return fit_bound(project, estimator, bound, name, floor)


def disturbance_weights(
    project: Project,
    estimator: Estimator,
    B_w: list[FittedWeight],
    W_n: list[FittedWeight],
    floor: float,
    what: str = "W_w",
    workers: Map = map,
) -> tuple[list[FittedWeight], list[list[float]]]:
    """Fit W_w per output, the part of B_w above the sensor's share (step 7).

    Parameters
    ----------
    project : Project
    estimator : Estimator
    B_w, W_n : list (n_y,) of FittedWeight
    floor : float, output units
    what : str, name for errors, default 'W_w'
    workers : Map

    Returns
    -------
    tuple of list of FittedWeight and list of the frequencies [rad/s] where nothing is left

    Raises
    ------
    InputError
        If no weight of the project's order fits.

    References
    ----------
    Paper, step 7.
    """
    omega, named_bounds, floored = fitting_grid(estimator), [], []
    for b, noise, output in zip(B_w, W_n, project.outputs, strict=True):
        left, empty = subtract_noise(
            b.magnitude(omega),
            noise.magnitude(omega),
            omega,
            floor=np.fmax(floor, LEAST_SHARE * b.magnitude(omega)),
            disturbance_set=project.bounds.disturbance_set,
        )
        named_bounds.append((left, f"{what} of {output.name}"))
        floored.append(empty)
    return list(workers(partial(_fitted_above, project, estimator, floor), named_bounds)), floored


def coefficients_of(
    project: Project,
    model: NominalModel,
    estimator: Estimator,
    weights: Weights,
    threshold: float,
    energy: EnergyTest,
    change: ChangeTest,
    pools: Pools | None = None,
) -> Coefficients:
    """Coefficients of the core for these weights; without ``pools`` these have no bounds."""
    frames, certificate = weights.of_core(estimator.omega)
    return build_coefficients(
        project, model, estimator, *frames, threshold, energy, change, pools, certificate
    )


def _largest_ratio(numerator: Weight, denominator: Weight) -> float:
    """Upper bound of the largest ratio of two weights over frequency."""
    inverse = Weight(denominator.den, denominator.num)
    both = [StateSpace(*w.to_state_space()) for w in (numerator, inverse)]
    return hinf_norm(series(*both)).upper


def energy_filters(project: Project, estimator: Estimator, weights: Weights) -> EnergyTest:
    """Filters of the energy test for these weights, without sigma. InputError for weights of another
    structure."""

    def designed(fitted: list[FittedWeight]) -> EnergyTest:
        bound = np.column_stack([w.bound for w in fitted])
        design = [w.fit.weight for w in fitted], fitted[0].omega, bound, weights.inflation
        return EnergyTest.design(project, estimator, *design)

    test = certificate = designed(weights.W_delta)
    if weights.W_delta_healthy:
        test = designed(weights.W_delta_healthy)
        pairs = zip(weights.W_delta, certificate.gain, weights.W_delta_healthy, test.gain, strict=True)
        largest = [a / b * _largest_ratio(wide.fit.weight, own.fit.weight) for wide, a, own, b in pairs]
        test = replace(test, refuting=max(1.0, *largest) * (1 + ROUNDING))
    none = len(weights.silent) == estimator.n_bins
    return replace(test, silent=tuple(range(len(test.F) - 1)) if none else ())
