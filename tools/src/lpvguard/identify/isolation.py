"""Isolation of the faulty part, by redundant outputs of one nominal model (THEORY 7.21).

Each part changes the errors e = y - yhat of all outputs in a characteristic way. The columns of a part are
its simulated changes. The sensor of an output has gain, delay and bias. The sensor of an input has gain,
delay and offset. The speed sensor has a factor, and so has each model parameter that tyres and load change.
In healthy drives the size of each column has the distribution N(mean, spread^2), and the residue is a vector
autoregression. The sizes of a faulty part have a much larger spread. Bayes' rule with equal odds selects the
faulty part. Where several parts remain possible, all are named.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from dataclasses import fields as dataclass_fields
from functools import cached_property, reduce
from itertools import combinations
from operator import add

import numpy as np
from scipy.special import logsumexp
from scipy.stats import t as student

from ..base.errors import InputError
from ..base.runs import runs
from ..drives.frames import Estimator
from ..drives.tables import Drive
from ..vehicle.nominal import NominalModel
from ..vehicle.project import Project

HALF_S = 0.1
"""Length of half a block [s]. Samples are averaged over blocks."""
LAGS = 3
"""Number of lags in the vector autoregression of the residue."""
DELAYS, FACTOR = (1, 2, 4), 0.02
"""Sizes of the simulated changes. Delays are in halves of a block, and other delays are interpolated. FACTOR
is a factor minus 1."""
FAULT = {"gain": 0.3, "delay": 0.2, "bias": 0.5, "offset": 0.5, "factor": 0.1, "parameter": 0.4}
"""Spread of a faulty size. It is in s for a delay, and in standard deviations of the signal for bias and
offset."""
SURE = 0.95
"""Least total probability of the named parts."""
ALIKE = 2 * float(np.log(SURE / (1 - SURE)))
"""A part is also named if its Akaike criterion exceeds that of the most likely part by less than this."""
NEEDED = 19.0
"""Twice the log likelihood ratio x with which 95 % of windows decide between two parts. It solves x - 2
sqrt(x) 1.64 = 2 log(SURE / (1 - SURE))."""
ODDS = float(np.log(1000.0))
"""A window differs if its log-odds exceed the log of the healthy windows' mean odds by this number. For a
stated rate of alarms the number may be larger (`odds_of`)."""
LONGEST_S = 36_000.0
"""Longest driving time in the table of times to isolation [s]."""
UNEXPLAINED = 0.05
"""Share of the evidence that a single part may leave unexplained, because large faults are not linear."""
VEHICLE = "vehicle"
"""Part of tyres, load and the rest of the vehicle."""
FOLDS = 5
"""Number of folds of drives. Each fold is judged by the others."""
ROUNDS = 60
"""Number of rounds of expectation and maximisation."""


@dataclass(frozen=True)
class PartColumn:
    """One possible change of a part, for example the gain of a sensor.

    Its column holds the effect of a unit size on the errors.

    Attributes
    ----------
    part : str
    kind : str, a key of FAULT
    what : str, name of the change
    unit : str, unit of a size
    place : int, index of the output, input or parameter, 0 for the speed
    fault : float, spread of a faulty size [unit]
    """

    part: str
    kind: str
    what: str
    unit: str
    place: int
    fault: float


def columns_of(project: Project, spread_u: np.ndarray, spread_y: np.ndarray) -> list[PartColumn]:
    """List the columns of all parts.

    Parameters
    ----------
    project : Project, must have ``isolation``
    spread_u : ndarray (n_u,), standard deviations of the inputs in the drives
    spread_y : ndarray (n_y,), standard deviations of the outputs in the drives

    Returns
    -------
    list of PartColumn
    """
    settings = project.isolation
    assert settings is not None
    columns = []
    for signals, spread, last in ((project.outputs, spread_y, "bias"), (project.inputs, spread_u, "offset")):
        for i, s in enumerate(signals):
            part = settings.part_of(s.name)
            columns += [
                PartColumn(part, "gain", f"{s.name} gain", "", i, FAULT["gain"]),
                *[PartColumn(part, "delay", f"{s.name} delay", "s", i, FAULT["delay"])] * len(DELAYS),
                PartColumn(part, last, f"{s.name} {last}", s.unit, i, FAULT[last] * float(spread[i])),
            ]
    columns.append(
        PartColumn(settings.part_of(project.speed.name), "factor", "speed factor", "", 0, FAULT["factor"])
    )
    names = list(project.model.parameters)
    for name in settings.vehicle:
        columns.append(
            PartColumn(VEHICLE, "parameter", f"{name} factor", "", names.index(name), FAULT["parameter"])
        )
    return columns


def odds_of(project: Project, window_s: float) -> float:
    """Log-odds that a window of ``window_s`` must exceed the mean odds by, for the project's rate of alarms.

    It is at least ODDS. By Markov's inequality, healthy windows then differ at most that often.
    """
    rate = project.frame_test.alarms_per_1000_h
    return ODDS if rate is None else max(ODDS, float(np.log(3.6e6 / (rate * window_s))))


class Changes:
    """Simulates the columns of all parts of a project along drives.

    Parameters
    ----------
    project : Project
    model : NominalModel
    """

    def __init__(self, project: Project, model: NominalModel):
        self.project, self.model, self.estimator = project, model, Estimator.from_project(project, model)
        settings, parameters = project.isolation, project.model.parameters
        assert settings is not None
        self.vehicles = {}
        for name in settings.vehicle:
            changed = parameters | {name: parameters[name] * (1 + FACTOR)}
            update = {"model": project.model.model_copy(update={"parameters": changed})}
            self.vehicles[name] = NominalModel(project.model_copy(update=update))
        self.half = max(1, round(HALF_S / project.Ts_s))
        self.step, self.ahead = 2 * self.half, max(DELAYS) * self.half

    def along(self, drive: Drive) -> tuple[np.ndarray, np.ndarray]:
        """Errors (N, n_y), and their change (N, n_y, m) by a unit size of every column.

        The core has the same columns. A delay of an input shifts the response to this input in time.
        """
        project, model, simulate = self.project, self.model, self.model.simulate
        v, u, first = drive.v, drive.u, drive.y[0]
        yhat, n = simulate(v, u, first), len(v)
        lags = [k * self.half for k in DELAYS]
        late = [(_delayed(yhat, lag) - yhat) / (lag * project.Ts_s) for lag in lags]
        responses = []
        for j in range(project.n_y):
            alone = np.zeros((2 + len(late), n, project.n_y))
            for column, x in zip(alone, [yhat, *late, np.ones_like(yhat)], strict=True):
                column[:, j] = x[:, j]
            responses += [*alone]
        unit = np.eye(project.n_u)
        to_input = [yhat - simulate(v, np.where(one, model.input_offset, u), first) for one in unit[1:]]
        to_input.insert(0, yhat - model.output_offset - sum(to_input))
        for response, one in zip(to_input, unit, strict=True):
            early = [(_delayed(response[::-1], lag)[::-1] - response) / (lag * project.Ts_s) for lag in lags]
            responses += [-response, *early, yhat - simulate(v, u + one, first)]
        by_speed = (simulate(v / (1 + FACTOR), u, first) - yhat) / FACTOR
        settings = project.isolation
        assert settings is not None
        powers = [settings.speed_power.get(s.name, 0) for s in project.outputs]
        responses.append(by_speed + yhat * powers)
        responses += [(vehicle.simulate(v, u, first) - yhat) / FACTOR for vehicle in self.vehicles.values()]
        return drive.y - yhat, np.stack(responses, axis=-1)

    def blocks(self, drive: Drive, from_s: float = 0.0, to_s: float = np.inf) -> Iterator[np.ndarray]:
        """Yield the means (B, n_y, 1 + m) of errors and changes over blocks, one array a settled stretch.

        Blocks follow each other from the first sample of the drive, and from the first sample after a gap, as
        in the core. A block counts if it lies between ``from_s`` and ``to_s`` after the first sample. It must
        also lie ``ahead`` samples from both ends, because its columns need these samples.
        """
        t, step = drive.t - drive.t[0] + self.project.Ts_s / 2, self.step
        present = np.ones(len(t), bool) if drive.missing is None else ~drive.missing
        good = self.estimator.settled(np.where(present, drive.v, -np.inf)) & (t >= from_s) & (t < to_s)
        pieces = []
        for first, last in runs(present):
            count = (last - first) // step
            good[first : first + self.ahead] = good[max(first, last - self.ahead) : last] = False
            settled = good[first : first + count * step].reshape(count, step).all(axis=1)
            pieces += [first + step * np.array(ends) for ends in runs(settled) if ends[1] - ends[0] > LAGS]
        if pieces:
            error, change = self.along(drive)
            both = np.concatenate([error[..., None], change], axis=-1)
            for a, b in pieces:
                yield both[a:b].reshape(-1, step, *both.shape[1:]).mean(axis=1)


def _delayed(x: np.ndarray, lag: int) -> np.ndarray:
    return np.concatenate([np.repeat(x[:1], min(lag, len(x)), axis=0), x[:-lag]])


@dataclass(frozen=True)
class WindowSums:
    """Sums of whitened products over a window.

    Attributes
    ----------
    G : ndarray (m, m), products of changes
    g : ndarray (m,), products of changes and errors
    count : int, number of blocks
    """

    G: np.ndarray
    g: np.ndarray
    count: int

    def __add__(self, other: WindowSums) -> WindowSums:
        return WindowSums(self.G + other.G, self.g + other.g, self.count + other.count)


def residual_structure(project: Project) -> dict[str, list[str]]:
    """List the residuals that each part changes.

    Residuals are errors of outputs, and differences of the errors of redundant outputs. Outputs are redundant
    if they have the same row of C. The sensor of an output changes every residual with this output. Inputs
    and vehicle change no difference. The speed changes the difference of outputs with unequal powers of the
    speed.

    Parameters
    ----------
    project : Project, must have ``isolation``

    Returns
    -------
    dict[str, list of str], names of the residuals that each part changes
    """
    settings = project.isolation
    assert settings is not None
    names = [s.name for s in project.outputs]
    pairs = [(a, b) for (a, x), (b, y) in combinations(zip(names, project.model.C, strict=True), 2) if x == y]
    differences = {f"{a} - {b}": (a, b) for a, b in pairs}
    powers = {n: settings.speed_power.get(n, 0) for n in names}
    carried: dict[str, set[str]] = {}
    for n in names:
        measured = {n} | {d for d, pair in differences.items() if n in pair}
        carried.setdefault(settings.part_of(n), set()).update(measured)
    for s in project.inputs:
        carried.setdefault(settings.part_of(s.name), set()).update(names)
    uneven = {d for d, (a, b) in differences.items() if powers[a] != powers[b]}
    carried.setdefault(settings.part_of(project.speed.name), set()).update(names, uneven)
    if settings.vehicle:
        carried.setdefault(VEHICLE, set()).update(names)
    order = [*names, *differences]
    return {part: [r for r in order if r in residuals] for part, residuals in carried.items()}


def is_separable(structure: dict[str, list[str]], part: str, other: str) -> bool:
    """Return whether ``part`` changes a residual that ``other`` does not change.

    Parameters
    ----------
    structure : dict[str, list of str], result of `residual_structure`
    part, other : str, names of parts

    Returns
    -------
    bool
    """
    return bool(set(structure[part]) - set(structure[other]))


def to_check(project: Project, part: str) -> str:
    """Describe what to check of a part: from the project file, or the usual text.

    Parameters
    ----------
    project : Project, with ``isolation``
    part : str

    Returns
    -------
    str
    """
    settings = project.isolation
    assert settings is not None
    if part in settings.check:
        return settings.check[part]
    if part == VEHICLE:
        return "tyres, tyre pressure and load"
    if part == settings.part_of(project.speed.name):
        return "the scale factor of the speed, and the wheel size"
    if part in {settings.part_of(s.name) for s in project.inputs}:
        return f"zero offset, ratio and delay of {part}"
    return f"mounting, wiring and calibration of {part}"


@dataclass(frozen=True)
class Moments:
    """Moments of a healthy drive.

    ``spread`` (n_u + n_y,) holds the standard deviations of its signals. ``products`` has (LAGS + 1) n_y + 1
    rows and columns. It holds the products of the residue at LAGS lags, its newest value and 1.
    """

    spread: np.ndarray
    products: np.ndarray


def moments_of(changes: Changes, drive: Drive) -> Moments:
    """Compute the moments of a drive. The residue is the part of the errors that the columns do not explain.

    Parameters
    ----------
    changes : Changes
    drive : Drive

    Returns
    -------
    Moments
    """
    n_y = changes.project.n_y
    products = np.zeros(((LAGS + 1) * n_y + 1,) * 2)
    if stretches := list(changes.blocks(drive)):
        both = np.concatenate(stretches)
        m = both.shape[2] - 1
        size = np.linalg.lstsq(both[..., 1:].reshape(-1, m), both[..., 0].ravel(), rcond=1e-8)[0]
        for x in stretches:
            left = x[..., 0] - x[..., 1:] @ size
            lags = [left[LAGS - k - 1 : len(left) - k - 1] for k in range(LAGS)]
            rows = np.hstack([*lags, left[LAGS:], np.zeros((len(left) - LAGS, 1))])
            products += rows.T @ rows
            products[-1, -1] += len(rows)
    return Moments(np.r_[drive.u.std(axis=0), drive.y.std(axis=0)], products)


def evidence_windows(changes: Changes, isolation: Isolation, drive: Drive) -> list[WindowSums]:
    """Compute the sums of each complete window of a drive.

    Parameters
    ----------
    changes : Changes
    isolation : Isolation
    drive : Drive

    Returns
    -------
    list of WindowSums
    """
    return isolation.windows(changes.blocks(drive), changes)


@dataclass(frozen=True)
class PartFinding:
    """Parts that explain a window.

    Attributes
    ----------
    parts : tuple of str, the most likely part first
        It is empty where nothing differs or no single part explains the window.
    probability : dict[str, float], by part
    differs : bool, whether the window contradicts a healthy vehicle
    what : str, name of the most significant change of the most likely part, "" without a part
    value, low, high : float or None, size of this change and its 95 % interval
    unit : str, unit of the size
    """

    parts: tuple[str, ...]
    probability: dict[str, float]
    differs: bool
    what: str = ""
    value: float | None = None
    low: float | None = None
    high: float | None = None
    unit: str = ""

    def words(self) -> str:
        """The finding in one line."""
        if not self.differs:
            return "no part differs"
        if not self.parts:
            return "no single part explains it"
        if len(self.parts) > 1:
            return f"one of {', '.join(self.parts)}"
        unit = f" {self.unit}" if self.unit else ""
        return f"{self.parts[0]}: {self.what} {self.value:+.3g}{unit} ({self.low:+.3g} to {self.high:+.3g})"


@dataclass(frozen=True)
class Isolation:
    """Scales of healthy drives, by which the parts that explain a window are found.

    Attributes
    ----------
    columns : list of PartColumn
    mean, spread : ndarray (m,), mean and standard deviation of healthy sizes
    A : ndarray (LAGS, n_y, n_y), autoregression of the residue
    S : ndarray (n_y, n_y), covariance of its innovation
    scale : float, divisor of log-likelihoods that makes healthy windows consistent
    least : float, log-odds against a healthy vehicle above which a window differs
    lack : float, largest lack of fit of a single part over healthy windows
    per_s : ndarray (m, m), sums G for one second of usual driving
    window_s : float, length of the windows [s]
    """

    columns: list[PartColumn]
    mean: np.ndarray
    spread: np.ndarray
    A: np.ndarray
    S: np.ndarray
    scale: float
    least: float
    lack: float
    per_s: np.ndarray
    window_s: float

    @classmethod
    def from_drives(cls, changes: Changes, drives: Sequence[Drive], window_s: float) -> Isolation:
        """Scales from healthy drives."""
        begun = cls.begun(changes, [moments_of(changes, d) for d in drives], window_s)
        windows = [evidence_windows(changes, begun, d) for d in drives]
        return begun.finished(windows, odds_of(changes.project, window_s))

    @classmethod
    def begun(cls, changes: Changes, moments: Sequence[Moments], window_s: float) -> Isolation:
        """Scales with columns and residue from the moments of healthy drives. `finished` adds the rest."""
        project = changes.project
        spread = np.mean([x.spread for x in moments], axis=0)
        columns = columns_of(project, spread[: project.n_u], spread[project.n_u :])
        A, S = _residue(np.sum([x.products for x in moments], axis=0), project.n_y)
        m = len(columns)
        return cls(columns, np.zeros(m), np.ones(m), A, S, 1.0, 0.0, 0.0, np.zeros((m, m)), window_s)

    def finished(self, windows: Sequence[Sequence[WindowSums]], odds: float = ODDS) -> Isolation:
        """Complete scales, with the sizes and limits of healthy drives, from the windows of each drive.

        For the limits, the sizes of all other folds judge the windows of each fold. Raises InputError without
        a complete window.
        """
        drives = [list(drive_windows) for drive_windows in windows if drive_windows]
        every = [w for drive_windows in drives for w in drive_windows]
        if not every:
            raise InputError(
                "isolation",
                "window_s",
                f"no drive has {self.window_s:g} s of settled driving without a gap",
                "longer drives or a shorter window",
            )
        per_s = np.mean([w.G for w in every], axis=0) / self.window_s
        made = replace(self._with_sizes(drives), per_s=per_s)
        folds = min(FOLDS, len(drives))
        judged = [
            (others, w)
            for k, others in enumerate(self._without(drives, folds))
            for drive_windows in drives[k::folds]
            for w in drive_windows
        ] or [(made, w) for w in every]
        return made._limited(judged, odds)

    def _without(self, drives: list[list[WindowSums]], folds: int) -> Iterator[Isolation]:
        """Yield for each fold the scales with the sizes of all other drives; nothing for a single drive."""
        for k in range(folds if folds > 1 else 0):
            yield self._with_sizes(
                [drive_windows for i, drive_windows in enumerate(drives) if i % folds != k]
            )

    def _with_sizes(self, drives: list[list[WindowSums]]) -> Isolation:
        """Scales with the sizes of a further drive, predicted by Student's t for this number of drives."""
        mean, spread = _healthy_sizes([reduce(add, drive_windows) for drive_windows in drives], self.faulty)
        wider = float(student.ppf(0.975, max(1, len(drives) - 1))) / 1.96 * np.sqrt(1 + 1 / len(drives))
        return replace(self, mean=mean, spread=wider * spread)

    def _excess(self, w: WindowSums) -> float:
        """Squared distance of a window from a healthy vehicle, relative to its expected value."""
        b = w.g - w.G @ self.mean
        expected = w.G + w.G @ np.diag(self.spread**2) @ w.G
        return float(b @ np.linalg.pinv(expected) @ b) / len(b)

    def _limited(self, judged: list[tuple[Isolation, WindowSums]], odds: float) -> Isolation:
        """Scales with the scale and limits of healthy windows, each paired with the scales that judge it.

        Markov's inequality: at most 1 in n healthy windows has odds above n times their mean, n = exp(odds).
        """
        scale = max(1.0, float(np.mean([judge._excess(w) for judge, w in judged])))
        against, lacks = [], [0.0]
        for judge, w in judged:
            scaled = replace(judge, scale=scale)
            fits = scaled.fits(w)
            against.append(max(fits.values()) - fits[""])
            lacks.append(scaled._lack(w))
        mean_odds = float(logsumexp(against) - np.log(len(against)))
        return replace(self, scale=scale, least=max(0.0, mean_odds) + odds, lack=max(lacks))

    def to_dict(self) -> dict:
        """Convert to JSON types, with the tables of `isolable` and `told_after`."""
        fields = {f.name: getattr(self, f.name) for f in dataclass_fields(self)}
        fields["columns"] = [vars(c) for c in self.columns]
        for name, table in (("isolable", self.isolable()), ("told_after_s", self.told_after())):
            fields[name] = {
                what: {k: v if np.isfinite(v) else None for k, v in row.items()}
                for what, row in table.items()
            }
        return fields

    @classmethod
    def from_dict(cls, data: dict) -> Isolation:
        """Scales from the result of `to_dict`."""
        mean, spread, A, S, per_s = (np.array(data[k], float) for k in ("mean", "spread", "A", "S", "per_s"))
        scale, least, lack, window_s = (float(data[k]) for k in ("scale", "least", "lack", "window_s"))
        columns = [PartColumn(**c) for c in data["columns"]]
        return cls(columns, mean, spread, A, S, scale, least, lack, per_s, window_s)

    @property
    def faulty(self) -> np.ndarray:
        """Standard deviations (m,) of faulty sizes."""
        return np.array([c.fault for c in self.columns])

    @cached_property
    def parts(self) -> list[str]:
        """Names of the parts in the order of the columns."""
        return list(dict.fromkeys(c.part for c in self.columns))

    def of_part(self, part: str) -> np.ndarray:
        """Mask (m,) of the columns of a part."""
        return np.array([c.part == part for c in self.columns])

    def evidence(self, stretches: Sequence[np.ndarray]) -> WindowSums:
        """Sums of whitened products over stretches of blocks (B, n_y, 1 + m)."""
        m = len(self.columns)
        total = WindowSums(np.zeros((m, m)), np.zeros(m), 0)
        root = np.linalg.cholesky(np.linalg.inv(self.S))
        for x in stretches:
            if len(x) <= LAGS:
                continue
            white = x[LAGS:].copy()
            for k, a in enumerate(self.A):
                white -= np.einsum("ij,bjm->bim", a, x[LAGS - k - 1 : len(x) - k - 1])
            white = np.einsum("ij,bjm->bim", root.T, white).reshape(-1, 1 + m)
            G = white.T @ white
            total += WindowSums(G[1:, 1:], G[1:, 0], len(x) - LAGS)
        return total

    def windows(self, stretches: Iterable[np.ndarray], changes: Changes) -> list[WindowSums]:
        """Sums of each complete window in stretches of blocks (B, n_y, 1 + m)."""
        length = max(LAGS + 2, round(self.window_s / (changes.step * changes.project.Ts_s)))
        return [
            self.evidence([x[first : first + length]])
            for x in stretches
            for first in range(0, len(x) - length + 1, length)
        ]

    def _explained(self, w: WindowSums, spread: np.ndarray) -> tuple[float, np.ndarray]:
        """Sum of squares of a window that sizes with a ``spread`` (m,) explain.

        Also returns the matrix (m, m) of its equation.
        """
        b = spread * (w.g - w.G @ self.mean)
        inner = np.eye(len(b)) + (spread[:, None] * w.G) * spread
        return float(b @ np.linalg.solve(inner, b)), inner

    def log_likelihood(self, w: WindowSums, spread: np.ndarray) -> float:
        """Log-likelihood of a window whose sizes have a ``spread`` (m,), up to a constant."""
        explained, inner = self._explained(w, spread)
        return 0.5 * (explained - np.linalg.slogdet(inner)[1]) / self.scale

    @property
    def _all_freed(self) -> np.ndarray:
        return np.hypot(self.spread, self.faulty)

    def _freed(self, *parts: str) -> np.ndarray:
        free = np.any([self.of_part(part) for part in parts], axis=0)
        return np.where(free, self._all_freed, self.spread)

    def fits(self, w: WindowSums) -> dict[str, float]:
        """Log-likelihood of a window for each faulty part, and with the key "" for the healthy vehicle."""
        return {"": self.log_likelihood(w, self.spread)} | {
            part: self.log_likelihood(w, self._freed(part)) for part in self.parts
        }

    def _lack(self, w: WindowSums) -> float:
        """Lack of fit of a single part: the misfit of the best part less that of all parts together."""
        best = max(self.parts, key=lambda part: self.log_likelihood(w, self._freed(part)))
        return self._misfit(w, self._freed(best)) - self._misfit(w, self._all_freed)

    def _criterion(self, w: WindowSums, part: str) -> float:
        """Akaike's information criterion of a faulty part, up to a constant: a column counts 2."""
        return self._misfit(w, self._freed(part)) + 2.0 * int(self.of_part(part).sum())

    def _misfit(self, w: WindowSums, spread: np.ndarray) -> float:
        return -self._explained(w, spread)[0] / self.scale

    def name(self, w: WindowSums, alarmed: bool = False) -> PartFinding:
        """Name the parts that explain a window.

        With ``alarmed`` a test has already shown a difference. Any odds against a healthy vehicle then are
        enough.
        """
        fits = self.fits(w)
        healthy = fits.pop("")
        top = max(fits.values())
        weights = {part: float(np.exp(x - top)) for part, x in fits.items()}
        whole = sum(weights.values())
        probability = {part: x / whole for part, x in weights.items()}
        if not w.count or top - healthy <= (0.0 if alarmed else self.least):
            return PartFinding((), probability, False)
        allowed = 2 * self.lack + NEEDED + 2 * UNEXPLAINED * (top - healthy)
        if self._lack(w) > allowed:
            return PartFinding((), probability, True)
        order = sorted(probability, key=lambda part: -probability[part])
        share = np.cumsum([probability[part] for part in order])
        named = int(np.searchsorted(share, SURE)) + 1
        criterion = {part: self._criterion(w, part) for part in order}
        alike = [part for part in order[named:] if criterion[part] - criterion[order[0]] < ALIKE]
        parts = (*order[:named], *alike)
        parts += tuple(part for part in self._likelier_pair(w, parts[0]) if part not in parts)
        return PartFinding(parts, probability, True, *self._size(w, parts[0]))

    def _likelier_pair(self, w: WindowSums, part: str) -> tuple[str, ...]:
        """The two other parts that together remain possible beside a fault of ``part``, or an empty tuple.

        A second fault has the same odds as the first, see ODDS. Two faults together are excluded where their
        probability is below 1 - SURE.
        """
        least = self.log_likelihood(w, self._freed(part)) + ODDS - ALIKE / 2
        pairs = {
            pair: self.log_likelihood(w, self._freed(*pair))
            for pair in combinations((p for p in self.parts if p != part), 2)
        }
        best = max(pairs, key=lambda pair: pairs[pair], default=())
        return best if best and pairs[best] > least else ()

    def _size(self, w: WindowSums, part: str) -> tuple[str, float, float, float, str]:
        """Name, value and 95 % interval of the most significant size of a part, and its unit."""
        spread = self._freed(part)
        V = np.linalg.inv(w.G / self.scale + np.diag(1 / spread**2))
        sizes = V @ (w.g - w.G @ self.mean) / self.scale
        sizes_of_part = []
        for what in dict.fromkeys(c.what for c in self.columns if c.part == part):
            chosen = np.array([c.what == what for c in self.columns], float)
            half = 1.96 * float(np.sqrt(chosen @ (V + np.diag(self.spread**2)) @ chosen))
            sizes_of_part.append((what, float(chosen @ sizes), half, self.columns[int(chosen.argmax())].unit))
        what, value, half, unit = max(sizes_of_part, key=lambda f: abs(f[1]) / f[2])
        return what, value, value - half, value + half, unit

    def isolable_rows(self, project: Project) -> Iterator[dict[str, str]]:
        """Rows of the table of isolability.

        A row has a change, then its least size that is distinguished from each part. A star marks parts that
        differ in structure. A dash means that no size can be distinguished. The last two columns are the size
        of a usual fault, and the driving time that distinguishes it from every other part.
        """
        structure, after = residual_structure(project), self.told_after()
        column_of = {c.what: c for c in self.columns}
        for what, row in self.isolable().items():
            part, unit = column_of[what].part, column_of[what].unit
            shown = {"size of": f"{what}{f' [{unit}]' if unit else ''}"}
            for other in ["", *self.parts]:
                if other == part:
                    shown[other] = ""
                    continue
                star = "*" if other and is_separable(structure, part, other) else ""
                shown[other or "healthy"] = f"{row[other]:.2g}{star}" if np.isfinite(row[other]) else "–"
            longest = max(after[what].values())
            shown["usual fault"] = f"{column_of[what].fault:.2g}"
            shown["told after, s"] = f"{longest:.2g}" if np.isfinite(longest) else "–"
            yield shown

    def isolable(self, seconds: float | None = None) -> dict[str, dict[str, float]]:
        """Least size of every column that a window of usual driving distinguishes from each other part.

        It is inf where no size can be distinguished. The key "" is the healthy vehicle.
        """
        return self._table(
            lambda k, other: self._least(k, other, self.window_s if seconds is None else seconds)
        )

    def told_after(self) -> dict[str, dict[str, float]]:
        """Time [s] of usual driving that distinguishes a usual fault of every column from each other part.

        It is inf where LONGEST_S is not enough. The keys are those of `isolable`.
        """
        return self._table(self._seconds)

    def _table(self, entry: Callable[[int, str], float]) -> dict[str, dict[str, float]]:
        """Entries by column and other part. The key "" is the healthy vehicle."""
        table: dict[str, dict[str, float]] = {}
        for k, column in enumerate(self.columns):
            others = ["", *(part for part in self.parts if part != column.part)]
            if column.what not in table:
                table[column.what] = {other: entry(k, other) for other in others}
        return table

    def _least(self, k: int, other: str, seconds: float) -> float:
        """Least size of column ``k`` that ``seconds`` of usual driving distinguish from a part."""
        G = self.per_s * seconds / self.scale
        spread = self.spread if not other else self._freed(other)
        left = float(G[k, k] - G[k] @ np.linalg.solve(np.diag(1 / spread**2) + G, G[:, k]))
        return float(np.sqrt(NEEDED / left)) if left > 1e-9 * G[k, k] else float("inf")

    def _seconds(self, k: int, other: str) -> float:
        """Time [s] of usual driving that distinguishes a usual fault of column ``k`` from a part.

        It is accurate to 5 %.
        """
        size, short, long = self.columns[k].fault, 1.0, LONGEST_S
        if self._least(k, other, long) > size:
            return float("inf")
        while long > 1.05 * short:
            middle = float(np.sqrt(short * long))
            short, long = (short, middle) if self._least(k, other, middle) <= size else (middle, long)
        return long


def _residue(products: np.ndarray, n_y: int) -> tuple[np.ndarray, np.ndarray]:
    """Autoregression (LAGS, n_y, n_y) and innovation covariance (n_y, n_y) from `Moments.products`."""
    k = LAGS * n_y
    count = max(1.0, float(products[-1, -1]))
    past, cross, now = products[:k, :k], products[:k, k:-1], products[k:-1, k:-1]
    A = np.linalg.lstsq(past, cross, rcond=1e-12)[0]
    S = (now - cross.T @ A - A.T @ cross + A.T @ past @ A) / count
    return A.T.reshape(n_y, LAGS, n_y).swapaxes(0, 1), S + 1e-9 * np.eye(n_y) * max(np.trace(S), 1e-300)


def _healthy_sizes(whole: list[WindowSums], faulty: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean and spread (m,) of the sizes of healthy drives, by expectation and maximisation."""
    mean, spread = np.zeros(len(faulty)), 0.1 * faulty
    for _ in range(ROUNDS):
        rows = []
        for w in whole:
            V = np.linalg.inv(w.G + np.diag(1 / spread**2))
            rows.append((V @ (w.g + mean / spread**2), np.diag(V)))
        sizes, own = (np.array(x) for x in zip(*rows, strict=True))
        mean = sizes.mean(axis=0)
        spread = np.maximum(np.sqrt((own + (sizes - mean) ** 2).mean(axis=0)), 1e-4 * faulty)
    return mean, spread
