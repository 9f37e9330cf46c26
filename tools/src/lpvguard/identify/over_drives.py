"""Passes of an identification over its drives. Workers run them, and the results are joined as they
arrive."""

import operator
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from functools import partial, reduce
from typing import TypeVar

import numpy as np

from ..base.parallel import Map
from ..base.progress import Progress
from ..base.sampling import Rows, first_of_each, stacked
from ..core.compiled import TESTS, Core
from ..drives.tables import Experiment
from ..vehicle.project import FrameTestSettings
from .bounds import Bounds, Deciders, Part, covering, fold, front_grid, undominated
from .calibration import RATED, Calibration, Peak, RateTarget, Recordings, calibrate
from .change import ChangeTest
from .confirmation import MOST_DRIVES, Confirmation, designs_of
from .diagnosis import DiagnosisScales
from .drive_set import Chosen, DriveSet, require_calibration
from .energy import EnergyTest
from .error_domain import ErrorDomain
from .error_sums import ErrorSums, joined
from .healthy import HealthySet, healthy_set
from .isolation import Changes, Isolation, odds_of
from .joint import POOLS, joint_calibration, with_joint_thresholds
from .model_error import FEWEST_FRAMES, FOLDS, ErrorEstimate, ErrorGrid, ModelError, Sums, model_error_pass
from .passes import (
    DRAWN_SPECTRA,
    Judged,
    change_met_pass,
    change_products_pass,
    confirmation_pass,
    diagnosis_pass,
    energy_pass,
    error_sums_of,
    first_pass,
    healthy_pass,
    isolation_moments_pass,
    isolation_windows_pass,
    judge,
    narrow_pass,
    pool_needs_pass,
    pool_remainder_pass,
    remainder_pass,
    thinned,
    uncertainty_pass,
)
from .pools import PoolNeeds, Pools, PoolSizes, Remainders, chosen_share
from .resolution import Resolution
from .scratch import scratch_core
from .visibility import Excitation, visibility
from .weights import FittedWeight, Weights, coefficients_of, energy_filters, fit_uncertainty

CUTS = 5
"""Number of random first samples. Every bound-setting drive is also judged from each of them for the final
inflation."""
FAR_BELOW = 0.99
"""Ratios below this share of the bound are safely below it, because the rounding of the single-precision core
is smaller."""
JOINED_AT_ONCE = 32
"""Number of drives whose samples are joined together, because one sort is faster."""
Result = TypeVar("Result")


def _folds(chosen: Iterable[Experiment]) -> dict[Experiment, int]:
    """Fold of every drive. A fold contains complete groups.

    The drives are ordered by name, because sums of floats depend on the order.
    """
    ordered = sorted(chosen, key=lambda e: e.name)
    groups = list(dict.fromkeys(e.group_or_recording for e in ordered))
    return {e: groups.index(e.group_or_recording) % FOLDS for e in ordered}


@dataclass
class Origins:
    """Origins of bounds and thresholds.

    ``evidence`` (K,) is the largest evidence of the bound-setting drives in each bin. ``peaks`` are the peaks
    of each calibration drive and test; they are empty without a core. ``decided`` are the frames that decide
    nu and B_w.
    """

    evidence: np.ndarray = field(default_factory=lambda: np.zeros(0))
    peaks: dict[str, dict[str, Peak]] = field(default_factory=dict)
    decided: dict[str, Deciders] = field(default_factory=dict)


class OverDrives:
    """Passes over the drives, which ``workers`` run.

    ``left_out`` maps each drive without a counted frame to the reason. ``spectra`` and ``met`` are the
    samples so far. ``origins`` are the origins of the bounds and thresholds so far.
    """

    def __init__(self, drives: DriveSet, workers: Map, progress: Progress):
        self.drives, self.reader, self.workers, self.progress = drives, drives.reader, workers, progress
        self.left_out: dict[str, str] = {}
        self._spectra: list[Rows] = []
        self._seen = np.full((2, self.reader.project.n_y), np.nan)
        self._met: list[Excitation] = []
        self._pooled: Excitation | None = None
        self._narrow: Excitation | None = None
        self._judged_s: dict[str, float] = {}
        self._maxima: dict[str, dict[str, list[float]]] = {}
        self.origins = Origins()

    def over(
        self, what: str, task: Callable[[Experiment], Result], chosen: Iterable[Experiment]
    ) -> Iterator[Result]:
        """Yield the results of ``task`` on every chosen drive, in order."""
        chosen = list(chosen)
        for e, result in zip(chosen, self.workers(task, chosen), strict=False):
            self.progress(f"{what} of {e.name}")
            yield result

    def first_parts(self, chosen: list[Experiment], ceiling: np.ndarray, *, keep: bool) -> Iterator[Part]:
        """Yield the bounds before smoothing and the peaks of every drive, for a ``ceiling`` (K,) on nu.

        With ``keep`` a sample of the spectra and the resolution of the sensors are kept.
        """
        task = partial(first_pass, self.reader, ceiling)
        for e, (part, rows, seen) in zip(chosen, self.over("frames", task, chosen), strict=False):
            if not part["frames"].any():
                self.left_out[e.name] = self.reader.why_without_frames()
            if keep:
                self._seen = np.fmin(self._seen, seen)
                self._spectra.append(rows)
                if len(self._spectra) == JOINED_AT_ONCE:
                    self._spectra = [self.spectra]
            yield part

    @property
    def resolution(self) -> Resolution:
        """Resolution and noise of the sensors in the bound-setting drives."""
        return Resolution.for_project(self.reader.project, self._seen)

    @property
    def spectra(self) -> Rows:
        """Sample of the frames of all drives so far."""
        return thinned(stacked(self._spectra))

    def with_frames(self, drives: Chosen) -> Chosen:
        """The drives without bound-setting drives that have no counted frame.

        Raises InputError when no bound-setting drive remains, or no drive calibrates.
        """
        left = [e for e in drives.setting if e.name not in self.left_out]
        if not left:
            name, reason = next(iter(self.left_out.items()))
            raise self.drives.error(
                "split " + ", ".join(self.reader.project.data.bound_split),
                "no frame counts: no judged stretch at all",
                f"at least one drive with one, unlike {name} ({reason})",
            )
        self._require_scores(drives, judged=True)
        return replace(drives, setting=left)

    def model_error(self, drives: Chosen) -> ModelError:
        """Model error model of the bound-setting drives and of the drives that judge it.

        It contains the band of a further drive. Without a ceiling on nu this band sets its bound.
        """
        reader = self.reader
        project, grid = reader.project, ErrorGrid.from_project(reader.project, reader.estimator)
        task = partial(model_error_pass, reader, grid)

        def folds(chosen: list[Experiment]) -> list[Sums]:
            by_fold: list[Sums] = []
            fold_of = _folds(chosen)
            for k, sums in zip(fold_of.values(), self.over("model error", task, list(fold_of)), strict=True):
                if k == len(by_fold):
                    by_fold.append(sums)
                else:
                    by_fold[k] = by_fold[k].plus(sums)
            return by_fold

        setting = folds(drives.setting)
        error = ModelError.from_sums(project, grid, setting, folds(drives.others), self.workers)
        self.progress("model error band")
        domain = ErrorDomain.from_estimator(reader.estimator, project.frame_test.excited_std)
        fold_of = _folds(drives.setting)
        parts: list[list[ErrorSums]] = [[] for _ in setting]
        for k, sums in zip(
            fold_of.values(), error_sums_of(reader, domain, list(fold_of), self.workers), strict=True
        ):
            parts[k].append(sums)
        own = [ErrorEstimate.from_sums(s, grid) for s in setting]
        return error.with_bands(project, domain, [joined(p) for p in parts], own, self.workers)

    def healthy(
        self,
        error: ModelError,
        floor: np.ndarray,
        setting: list[Experiment],
        W_delta: np.ndarray,
        B_w: np.ndarray | None = None,
    ) -> HealthySet:
        """The healthy set of the frame test.

        Its B_w is at least ``floor`` (K, n_y). The set lies within ``W_delta`` (K, n_delta) of the
        certificate, and within the ``B_w`` (K, n_y) of the certificate, if given.
        """
        project, fold_of = self.reader.project, _folds(setting)
        task = partial(healthy_pass, self.reader)
        needs: list[np.ndarray] = []
        for k, own in zip(fold_of.values(), self.over("healthy set", task, list(fold_of)), strict=True):
            if k == len(needs):
                needs.append(own)
            else:
                needs[k] = np.maximum(needs[k], own)
        typical = error.typical(self.reader.estimator)
        if project.bounds.structure == "S0":
            typical, W_delta = 0 * typical, 0 * W_delta
        drawn = first_of_each(self.spectra, DRAWN_SPECTRA)
        return healthy_set(needs, drawn, floor, typical, W_delta, B_w)

    def _deciders(
        self, key: str, columns: int, setting: list[Experiment], parts: Iterable[Part]
    ) -> Iterator[Part]:
        """Yield the parts of the ``setting`` drives, and record the frames that decide the bound ``key``."""
        self.origins.decided[key] = Deciders(key, (self.reader.estimator.n_bins, columns))
        return self.origins.decided[key].watched((e.name for e in setting), parts)

    def uncertainty(
        self, first: Part, gamma_w: np.ndarray, error: ModelError, setting: list[Experiment]
    ) -> tuple[Part, list[FittedWeight]]:
        """Return step 5 at ``gamma_w`` (K,), and weights W_delta above its nu and above the model error."""
        project, estimator = self.reader.project, self.reader.estimator
        grid = front_grid(first["B1"], first["B2"], estimator, project.bounds.structure)
        parts = self.over("bounds", partial(uncertainty_pass, self.reader, gamma_w, grid), setting)
        second = fold(self._deciders("nu", project.n_delta, setting, parts))
        names = [f"W_delta of {s.name}" for s in project.outputs] if project.n_delta > 1 else ["W_delta"]
        # Class S0 has no uncertainty, so all error is disturbance.
        needed = error.bound * (project.bounds.structure != "S0")
        weight = partial(fit_uncertainty, project, estimator, error.grid.omega)
        W_delta = list(self.workers(weight, zip(second["nu"].T, needed.T, names, strict=True)))
        return second | {"grid": grid}, W_delta

    def bounds(
        self,
        first: Part,
        gamma_w: np.ndarray,
        second: Part,
        W_delta: list[FittedWeight],
        setting: list[Experiment],
    ) -> Bounds:
        """Bounds of step 6 with ``gamma_w`` (K,).

        B_w bounds the remainder of all frames, and is at least its floor. With the disturbance set
        ``covering`` B_w is scaled until sum_j |w_j / B_w,j|^2 <= 1 on every frame. With ``paper`` it only
        ensures |w_j| <= B_w,j.
        """
        project, estimator = self.reader.project, self.reader.estimator
        size = np.column_stack([w.magnitude(estimator.omega) for w in W_delta])
        joint = project.bounds.disturbance_set == "covering" and project.n_y > 1
        fronts = [np.zeros((0, project.n_y))] * estimator.n_bins

        def parts() -> Iterator[Part]:
            task = partial(remainder_pass, self.reader, size, joint)
            for part, of_drive in self.over("bounds", task, setting):
                for k, new in enumerate(of_drive):
                    fronts[k] = undominated(np.concatenate([fronts[k], new]))
                yield part

        B_w = fold(self._deciders("B_w", project.n_y, setting, parts()))["B_w"]
        if joint:
            B_w = B_w * np.fmax(1.0, covering(fronts, B_w))[:, None]
        floor = self.resolution.floor(estimator)
        return Bounds(
            omega=estimator.omega,
            **{k: first[k] for k in ("frames", "excitation", "B1", "B2", "gamma_rule")},
            gamma_w=gamma_w,
            nu=second["nu"],
            B_w=np.maximum(B_w, floor),
            B_w_floor=floor,
            resolution=self.resolution,
            front_gamma_w=second["grid"],
            front_nu=second["front"],
        )

    def calibrated(
        self, weights: Weights, bounds: Bounds, drives: Chosen
    ) -> tuple[Weights, Calibration, EnergyTest | None, ChangeTest | None, Pools | None, Confirmation | None]:
        """Weights with their final inflation, the tests with their thresholds, the bounds of pools, and the
        choice of the confirmation.

        The plain DFT has only the frame test. Raises InputError where no drive calibrates.
        """
        project, model, estimator = self.reader.project, self.reader.model, self.reader.estimator
        alpha, recordings = project.frame_test.alpha, Recordings.listed(drives.setting, drives.others)
        if estimator.window != "hann":
            inflated, _ = self._inflated(weights, None, drives)
            scores, _, _ = self._scores(weights, None, None, drives)
            self._require_scores(drives, judged=bool(scores))
            scores = {n: s / inflated.inflation for n, s in scores.items()}
            by_frames = calibrate(scores, alpha, recordings=recordings).over(self._judged_s)
            return inflated, by_frames, None, None, None, None
        first = self._with_sigma(energy_filters(project, estimator, weights), bounds.resolution, drives)
        change = self._change_test(drives)
        with scratch_core(
            project, coefficients_of(project, model, estimator, weights, 1.0, first, change)
        ) as core:
            inflated, far = self._inflated(weights, core, drives)
            inflated = replace(inflated, silent=self._silent(inflated, bounds.frames))
            test = self._energy_test(inflated, first, far, bounds.resolution, drives)
            reals = coefficients_of(project, model, estimator, inflated, 1.0, test, change).flat_reals()
            confirmation = self._confirmation(core, reals, recordings, drives)
            designed = project if confirmation is None else confirmation.of_project(project)
            if designed == project:
                by_test = self._scores(weights, core, reals, drives)
            else:
                numbers = coefficients_of(designed, model, estimator, inflated, 1.0, test, change)
                with scratch_core(designed, numbers) as chosen:
                    by_test = self._scores(weights, chosen, None, drives)
            scores, energy_scores, change_scores = by_test
            speaks = bool(scores) and len(inflated.silent) < estimator.n_bins
            self._require_scores(drives, judged=speaks or bool(energy_scores or change_scores))
            aim = partial(self._target, project.frame_test)
            pools = self._pools(bounds, recordings, drives)
            pools = pools.calibrated(scores, alpha, recordings, aim("pools"))
            test = test.calibrated(energy_scores, alpha, recordings, aim("energy"))
            narrow = partial(narrow_pass, self.reader, change)
            excitations = self.over("visibility", narrow, [*drives.setting, *drives.others])
            self._narrow = reduce(lambda one, other: Excitation.joined([one, other]), excitations)
            change = change.calibrated(change_scores, alpha, recordings, aim("change"))
            by_frames = calibrate(scores, alpha, recordings=recordings, target=aim("frame"))
            tests = self._stated(by_frames, test.calibration, change.calibration, pools.calibration)
            return (
                inflated,
                tests["frame"],
                replace(test, calibration=tests["energy"]),
                replace(change, calibration=tests["change"]),
                replace(pools, calibration=tests[POOLS]),
                confirmation,
            )

    def _stated(self, *by_test: Calibration) -> dict[str, Calibration]:
        """Calibrations of TESTS and pools with the thresholds of the project, and with judged times."""
        tests = {n: c.over(self._judged_s) for n, c in zip((*TESTS, POOLS), by_test, strict=True)}
        if not self.reader.project.frame_test.joint:
            return tests
        joint = joint_calibration(tests, self.reader.project.frame_test.alpha)
        return with_joint_thresholds(tests, joint.over(self._judged_s))

    def _confirmation(
        self, core: Core, reals: np.ndarray, recordings: Recordings, drives: Chosen
    ) -> Confirmation | None:
        """Choice of the confirmation on the calibration drives, or None without a rate."""
        settings, designs = self.reader.project.frame_test, designs_of(self.reader.project)
        if settings.alarms_per_1000_h is None:
            return None
        every = sorted(e.name for e in drives.others)
        planted = frozenset(every[:: -(-len(every) // MOST_DRIVES)])
        task = partial(confirmation_pass, self.reader, core, reals, designs, planted)
        results = self.over("confirmation", task, drives.others)
        by_drive = {e.name: c for e, c in zip(drives.others, results, strict=True)}
        return Confirmation.compared(self.reader.project, designs, by_drive, recordings)

    def _target(self, settings: FrameTestSettings, test: str) -> RateTarget | None:
        """Target rate of a test, an equal share of the rate of all tests, or None without a rate."""
        if settings.alarms_per_1000_h is None:
            return None
        share = settings.alarms_per_1000_h / len(RATED)
        return RateTarget(share, settings.alarms_confident, self._maxima.get(test, {}), self._judged_s)

    def _pools(self, bounds: Bounds, recordings: Recordings, drives: Chosen) -> Pools:
        """Bounds of the pools from all drives."""
        sizes = PoolSizes.for_project(self.reader.project, self.reader.estimator)
        task = partial(pool_needs_pass, self.reader, sizes)
        setting = PoolNeeds.joined(self.over("pools", task, drives.setting))
        W, silent, own = chosen_share(setting, bounds.B_w_floor)
        needs: dict[str, np.ndarray] = {}
        shown: dict[str, np.ndarray] = {}
        remainders: list[Remainders] = []
        blocks: dict[str, np.ndarray] = {}
        every = [*drives.setting, *drives.others]
        chosen = sorted(every, key=lambda e: e.name)  # sums of floats depend on the order
        rest = self.over("pools", partial(pool_remainder_pass, self.reader, sizes, W, own), chosen)
        for e, remainder in zip(chosen, rest, strict=True):
            name = recordings.named(e.name)
            needs[name] = np.maximum(needs.get(name, 0.0), remainder.largest)
            assert remainder.blocks is not None
            shown[name] = np.maximum(shown.get(name, 0.0), remainder.blocks.max(axis=0))
            if e.name in self._maxima.get("frame", {}):
                blocks[e.name] = remainder.blocks
            remainders.append(remainder)
            if len(remainders) == JOINED_AT_ONCE:
                remainders = [Remainders.joined(remainders)]
        floor = np.where(silent, np.inf, bounds.B_w_floor)
        order = dict.fromkeys(recordings.named(e.name) for e in every)
        needs, shown = ({name: x[name] for name in order} for x in (needs, shown))
        alpha = self.reader.project.frame_test.alpha
        pools = Pools(sizes, W, floor, own, needs, shown, calibrate({}, alpha), blocks=blocks)
        joined = Remainders.joined(remainders)
        quantile = joined.sums.quantile(alpha, len(chosen), sizes.parts * sizes.frames)
        self._pooled = joined.excitation(W, pools.bound(), quantile)
        return pools

    def _require_scores(self, drives: Chosen, *, judged: bool) -> None:
        require_calibration(self.drives, (e.name for e in drives.others), self.left_out, judged)

    def visibility(
        self, weights: Weights, calibration: Calibration, pools: Pools | None, change: ChangeTest | None
    ) -> dict:
        """Content of visibility.json: the smallest visible errors in each speed cell and bin."""
        estimator, factor = self.reader.estimator, weights.inflation
        W_delta = weights.of_frames(estimator.omega)[0] / factor
        others = []
        if pools is not None and self._pooled is not None:
            others.append((self._pooled, pools.calibration.carried))
        if change is not None and self._narrow is not None:
            others.append((self._narrow, change.calibration.carried))
        return visibility(
            estimator.omega,
            estimator.speed_range,
            self.met,
            W_delta,
            calibration.carried,
            factor,
            weights.silent,
            others,
        )

    @property
    def met(self) -> Excitation:
        """Excitation in all judged drives so far."""
        return Excitation.joined(self._met)

    def _judged(
        self,
        what: str,
        weights: Weights,
        core: Core | None,
        reals: np.ndarray | None,
        cuts: int,
        chosen: list[Experiment],
    ) -> Iterator[Judged]:
        task = partial(judge, self.reader, *weights.of_frames(self.reader.estimator.omega), core, reals, cuts)
        for j in self.over(what, task, chosen):
            self._met.append(j.met)
            if len(self._met) == JOINED_AT_ONCE:
                self._met = [self.met]
            yield j

    def _inflated(self, weights: Weights, core: Core | None, drives: Chosen) -> tuple[Weights, set[str]]:
        """Weights with the final inflation, and the drives with small energy ratios.

        The inflation is the least factor >= 1 on the weights with which no margin of a bound-setting drive
        exceeds 1. The drives are judged whole and with their first samples cut. A factor above 1 is rounded
        up by 1e-4. The returned drives are those whose energy ratio stays below FAR_BELOW in all cut runs.

        """
        worst, far = 1.0, set()
        judged = self._judged("inflation", weights, core, None, CUTS, drives.setting)
        for e, j in zip(drives.setting, judged, strict=True):
            worst = max(worst, j.worst)
            if j.energy_of_cuts < FAR_BELOW:
                far.add(e.name)
        return replace(weights, inflation=worst if worst == 1.0 else worst * (1 + 1e-4)), far

    def _silent(self, inflated: Weights, frames: np.ndarray) -> tuple[int, ...]:
        """Bins without evidence above 1 in any bound-setting drive.

        `_inflated` must have judged these drives before. In such a bin the test would not refute a vehicle
        that does not respond. nu is 0 at zero frequency, so this bin is silent only where all others are.
        Bins with fewer than FEWEST_FRAMES successive ``frames`` are silent too, because a further frame
        exceeds such a bound too often. With a healthy set this holds only for bins with frames of at most one
        drive.
        """
        estimator = self.reader.estimator
        self.origins.evidence = self.met.evidence(estimator.n_bins) / inflated.inflation
        thin = frames < FEWEST_FRAMES * estimator.length
        weak, steady = self.origins.evidence <= 1.0, estimator.omega == 0
        if inflated.healthy is None:
            weak &= ~steady | weak[~steady].all()
        else:
            # With a W_delta near 0 every error at zero frequency is evidence.
            weak[steady] = weak[~steady].all()
            thin &= inflated.healthy.folds < 2
        return tuple(int(k) for k in np.flatnonzero(weak | thin))

    def _with_sigma(self, test: EnergyTest, resolution: Resolution, drives: Chosen) -> EnergyTest:
        """Energy test with the sigma that the drives with and without input need, at least its floor."""
        task = partial(energy_pass, self.reader, test, 0)
        needs = fold(self.over("sigma", task, drives.setting + drives.noise))
        return test.with_sigma(needs, resolution.energy_floor(test.F, test.Ts, test.memories_s))

    def _energy_test(
        self, inflated: Weights, first: EnergyTest, far: set[str], resolution: Resolution, drives: Chosen
    ) -> EnergyTest:
        """Energy test of the ``inflated`` weights, with sigma for all directions and for cut drives.

        ``first`` is the test before the inflation. If the weights are the same and every direction is a
        single output, drives ``far`` below the bound need no further sigma.
        """
        test = energy_filters(self.reader.project, self.reader.estimator, inflated)
        chosen = drives.setting + drives.noise
        if inflated.inflation > 1.0:
            test = self._with_sigma(test, resolution, drives)
        else:
            test = replace(test, sigma=first.sigma, start=first.start)
            chosen = [e for e in chosen if not (test.single and e.name in far)]
        needs = fold(self.over("joint sigma", partial(energy_pass, self.reader, test, CUTS), chosen))
        return test.with_joint(needs or {"joint": np.ones(len(test.F))})

    def _change_test(self, drives: Chosen) -> ChangeTest:
        """Change test with sizes from the bound-setting drives."""
        # Order the drives by name, because sums of floats depend on the order.
        chosen = sorted(drives.setting, key=lambda e: e.name)
        sums = self.over("change", partial(change_products_pass, self.reader), chosen)
        test = ChangeTest.design(self.reader.project).with_moments(np.sum(list(sums), axis=0))
        met = self.over("change", partial(change_met_pass, self.reader, test), chosen)
        return test.with_sizes(reduce(operator.add, met))

    def diagnosis(self, change: ChangeTest | None, drives: Chosen) -> DiagnosisScales | None:
        """Scales of the diagnosis, with the units of the change test, or None without a change test."""
        if change is None:
            return None
        task = partial(diagnosis_pass, self.reader, 1 / change.unit)
        windows = list(self.over("diagnosis", task, drives.setting))
        return DiagnosisScales.from_windows(self.reader.project, change.unit, windows)

    def isolation(self, drives: Chosen) -> Isolation | None:
        """Isolation scales from all drives with input, or None without [isolation]."""
        reader, every = self.reader, [*drives.setting, *drives.others]
        if reader.project.isolation is None:
            return None
        changes = Changes(reader.project, reader.model)
        moments = list(self.over("isolation", partial(isolation_moments_pass, reader, changes), every))
        begun = Isolation.begun(changes, moments, reader.project.isolation.window_s)
        windows = list(self.over("isolation", partial(isolation_windows_pass, reader, changes, begun), every))
        return begun.finished(windows, odds_of(reader.project, begun.window_s))

    def _scores(
        self, weights: Weights, core: Core | None, reals: np.ndarray | None, drives: Chosen
    ) -> tuple[dict[str, float], dict[str, float], dict[str, float]]:
        """Scores of the calibration drives in the frame, energy and change test.

        The method also updates ``left_out`` and the judged times.
        """
        scores, energy_scores, change_scores = {}, {}, {}
        judged = self._judged("score", weights, core, reals, 0, drives.others)
        for e, j in zip(drives.others, judged, strict=False):
            self._judged_s[e.name] = j.judged_s
            self.origins.peaks[e.name] = j.peaks
            if self.reader.project.frame_test.alarms_per_1000_h is not None:
                for test, maxima in j.maxima.items():
                    self._maxima.setdefault(test, {})[e.name] = maxima
            if j.score is None:
                self.left_out[e.name] = self.reader.why_without_frames()
            else:
                scores[e.name] = j.score
            if j.energy_score is not None:
                energy_scores[e.name] = j.energy_score
            if j.change_score is not None:
                change_scores[e.name] = j.change_score
        return scores, energy_scores, change_scores
