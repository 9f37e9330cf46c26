"""Weights of an identification, which lie above the bounds (steps 6 and 7), and their coefficients in the
core."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

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
"""On the logarithmic axis the bound of DC is placed at this fraction of the frequency of the lowest bin."""
SMALLEST_NU = 1e-3
"""Floor of the uncertainty bound where the data need none, because a weight must be positive."""
RISE, FALL = 3.0, 2.0
"""Steepest rise and fall of the uncertainty bound, in powers of the frequency."""
LEAST_SHARE = 0.1
"""Floor of the result of step 7, as a share of B_w.

A smaller difference is only accidental, because both weights are fits with errors of some tenths of a dB. The
floor lies above this difference and therefore covers it. A much lower floor would make a notch in the bound
that no weight of low order can follow.
"""
RATIO_RTOL, RATIO_ATOL_DB = 1e-8, 1e-7
"""Rounding error of a proved ratio of weight to bound: relative, and in dB."""
LISTED = ("W_w", "W_n", "W_w_S0", "W_C", "W_delta")
"""Weights that are lists in weights.json."""


@dataclass(frozen=True)
class FittedWeight:
    """A weight with the samples of its bound.

    Attributes
    ----------
    fit : OverboundFit
    omega : ndarray (K',), rad/s
    bound : ndarray (K',), NaN without data
    """

    fit: OverboundFit
    omega: np.ndarray
    bound: np.ndarray

    def magnitude(self, omega: np.ndarray) -> np.ndarray:
        """|W| at omega [rad/s], in the same shape as omega."""
        return self.fit.weight.magnitude(omega)

    def to_dict(self) -> dict:
        """Convert to JSON types: the weight, its fit, and its samples."""
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
    W_n : list (n_y,) of FittedWeight, noise; empty without drives without input
    W_w_S0 : list (n_y,) of FittedWeight, disturbance of class S0 (K_inf), for synthesis; may be empty
    W_C : list of FittedWeight, command, for synthesis; may be empty
    floored : dict, by weight, frequencies [rad/s] where the sensor explains all of B_w (step 7)
    disturbance_set : str
    healthy : HealthySet or None, bounds of the frame test, which uses the fitted weights without it
    W_delta_healthy : list of FittedWeight, above W_delta of ``healthy``, for the energy test; may be empty
    inflation : float
    silent : tuple of int
        Bins without evidence above 1. They do not affect the threshold and raise no alarm (THEORY 7.1).
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
        """W_delta (K, n_delta) and B_w (K, n_y) of the certificate at omega (K,).

        They include the inflation and the share of the sensor.
        """
        B_w = np.column_stack([w.magnitude(omega) for w in self.W_w])
        if self.W_n:
            W_n = np.column_stack([w.magnitude(omega) for w in self.W_n])
            B_w = np.hypot(B_w, W_n) if self.disturbance_set == "covering" else B_w + W_n
        W_delta = np.column_stack([w.magnitude(omega) for w in self.W_delta])
        return self.inflation * W_delta, self.inflation * B_w

    def of_frames(self, omega: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """W_delta (K, n_delta) and B_w (K, n_y) of the frame test at the bins omega (K,).

        They are those of the healthy set, or else of `at`, and include the inflation.
        """
        if self.healthy is None:
            return self.at(omega)
        return self.inflation * self.healthy.W_delta, self.inflation * self.healthy.B_w

    def of_core(self, omega: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Yield the results of `of_frames` and of `at` for the core.

        In silent bins the disturbance is unlimited.
        """
        for W_delta, B_w in (self.of_frames(omega), self.at(omega)):
            B_w = B_w.copy()
            B_w[list(self.silent)] *= UNBOUNDED
            yield W_delta, B_w

    def to_dict(self) -> dict:
        """Convert to JSON types, for `from_dict`."""
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
        """Weights from the result of `to_dict`, with a new proof of every certificate.

        Raises InputError if one fails.
        """

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
                "a list with one weight for each Delta, from a new identification",
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


def use_of_weights(stored: Mapping[str, Any]) -> str:
    """Say how far the weights lie above their bounds, and who uses which.

    Parameters
    ----------
    stored : Mapping, as `Weights.to_dict` makes it

    Returns
    -------
    str
    """
    worst = max(w["worst_ratio_db"] for key in ("W_delta", "W_w") for w in stored[key])
    monitor = "the tabulated bounds of the healthy set" if "healthy" in stored else "the weights"
    return (
        f"the frame test uses {monitor}; certificate and synthesis use the weights, at most {worst:.2f} dB "
        "above their bounds"
    )


def _require_stated(source: str, name: str, entry: dict, proved: Certificate) -> None:
    """Raise InputError unless an entry of weights.json agrees with the certificate ``proved``.

    The stated upper limit of weight / bound must be at least the proved one. It must also be at least the
    stated optimum of the order.
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
                f"is not proved: weight / bound lies in {proved.min_ratio:.9g} .. {proved.max_ratio:.9g}, "
                f"{highest:.6g} dB, up to {proved.omega_max:.4g} rad/s",
                "the value that `lpvguard identify` wrote",
            )


def fitting_grid(estimator: Estimator) -> np.ndarray:
    """Return the frequencies of the fits: those of the bins, with a low frequency in place of DC.

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
    B2 : ndarray (K,), output units, NaN without data

    Returns
    -------
    float, output units
    """
    return 1e-6 * float(np.nanmax(B2))


def uncertainty_samples(
    estimator: Estimator, nu: np.ndarray, omega: np.ndarray, error_bound: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Samples for W_delta: frequencies (S,) [rad/s] and bound (S,), NaN at the frequency in place of DC.

    ``error_bound`` (G,) at ``omega`` (G,) is the bound of the model error model (THEORY 7.6). Between its
    frequencies it is interpolated log-log. ``nu`` (K,) is the bound of the frames of step 5 at the bins, 0 at
    DC by definition. Below the lowest bin any small value is possible (paper, step 6).

    Dips that a weight of low order cannot follow are filled. The bound rises at most as omega^RISE and falls
    at most as omega^-FALL. Otherwise one deep dip would increase the least worst ratio of the whole fit.
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
    column : tuple, for one Delta
        It holds nu, ndarray (K,), the model error bound, ndarray (G,), and a name for errors.

    Returns
    -------
    FittedWeight

    Raises
    ------
    InputError
        If no weight of the allowed orders can be certified.

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
    """The weights with the ``healthy`` set of the frame test.

    W_delta of the energy test lies above this set.
    """
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
    bound : ndarray (K,), NaN without data
    name : str, name for errors
    floor : float, unit of the bound

    Returns
    -------
    FittedWeight

    Raises
    ------
    InputError
        If no weight of the project's order fits.
    """
    # The proof uses the bound with the floor.
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
    """Fit the weights of steps 6 and 7 for the fitted ``W_delta``.

    ``noise`` and ``error`` (K, n_y) are the peaks of E without and with input. ``command`` (K,) is the peak
    of the controlled output. ``workers`` fit the weights in parallel. Without drives without input (``noise``
    is NaN) W_w is B_w. W_C is fitted only with such drives, or for a design.
    """
    floor = smallest_disturbance(bounds.B2)
    names = [s.name for s in project.outputs]
    disturbance_set = project.bounds.disturbance_set
    # A covering set is an ellipsoid. If all n_y outputs are at their peaks together, it needs the factor
    # sqrt(n_y).
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
    """Fit W_w of each output, the part of B_w that the noise of the sensor does not explain (step 7).

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
    tuple of two lists
        The FittedWeights, and the frequencies [rad/s] where the sensor explains all of B_w.

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
    """Coefficients of the core for these weights. Without ``pools`` the pools have no bounds."""
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
    """Energy test for these weights, without sigma. Raises InputError for weights of another structure."""

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
