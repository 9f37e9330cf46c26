"""Fig. 6: controllers of Table II in the time domain, with the worst Δ of size 1 and measured signals.

The signals are those of the paper (section V). r_c is the filtered yaw rate of a drive near the design speed.
w = diag(f, 1) e is the drive's nominal error. The factor f reduces the error of the yaw rate to its DC
disturbance bound. The noise is white and band-limited, with power NOISE_POWER before W_n. The controllers run
with their sample of delay on the nominal vehicle at the design speed. K_inf runs without Δ, K_i with the
worst Δ_i, and K_is with the worst Δ_i and Δ_s. The lower bound of μ gives the worst Δ, a stable all-pass
system (engine/synthesis/worst_case.py).
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import butter, filtfilt

from ..base.errors import InputError
from ..drives.tables import Drive
from ..engine.synthesis.interconnection import PlantWeights
from ..engine.synthesis.statespace import StateSpace, gain, lft, to_discrete
from ..engine.synthesis.table import Cell
from ..engine.synthesis.worst_case import WorstCase, close_delta, worst_case
from ..identify.identification import DriveSet
from .frozen import FrozenProblem

NOISE_POWER = 0.01
"""Spectral density of n. The variance of n is NOISE_POWER / Ts."""
REFERENCE_CUTOFF_RAD_S = 3.0
"""Cutoff of the zero-phase second-order filter from the measured yaw rate to r_c, near the bandwidth of
W_R."""
SHOWN_S = 30.0
SHOWN_STEP = 4
"""Time between the samples of the picture."""


@dataclass(frozen=True)
class WorstRun:
    """Run of one controller: u (N,) [bar], disturbed yaw rate r (N,) [rad/s], and rms tracking error."""

    cell: Cell
    worst: WorstCase
    u: np.ndarray
    r: np.ndarray
    tracking_rms: float
    tracking_rms_nominal: float


@dataclass(frozen=True)
class WorstRuns:
    """All runs on ``drive``; t (N,) is the time, and wanted (N,) is W_R r_c.

    ``left_out`` names the structures without an objective of μ < 1.
    """

    drive: str
    factor: float
    t: np.ndarray
    wanted: np.ndarray
    runs: list[WorstRun]
    left_out: list[str]

    def to_dict(self) -> dict:
        """Make the thinned signals of Fig. 6 and the results over the whole drive."""
        shown = slice(0, int(SHOWN_S / (self.t[1] - self.t[0])), SHOWN_STEP)
        return {
            "drive": self.drive,
            "factor": self.factor,
            "noise_power": NOISE_POWER,
            "left_out": self.left_out,
            "command_rms": float(np.sqrt(np.mean(self.wanted**2))),
            "t_s": self.t[shown],
            "wanted_radps": self.wanted[shown],
            "runs": [
                {
                    "structure": r.cell.structure,
                    "A_t": r.cell.A_t,
                    "A_u": r.cell.A_u,
                    "mu_upper": r.cell.upper,
                    "delta_norm": r.worst.size,
                    "delta_rad_s": r.worst.frequency,
                    "delta_order": r.worst.delta.order,
                    "worst_gain": r.worst.gain,
                    "nominal_gain": r.worst.nominal,
                    "tracking_rms": r.tracking_rms,
                    "tracking_rms_without_delta": r.tracking_rms_nominal,
                    "u_bar": r.u[shown],
                    "r_radps": r.r[shown],
                }
                for r in self.runs
            ],
        }


def nearest_drive(drives: DriveSet, speed: float) -> tuple[Drive, np.ndarray]:
    """Find the drive with input whose frames' mean speed is nearest to ``speed`` [m/s].

    The nominal error e (N, 2) of the drive is also returned.
    """
    project = drives.reader.project
    best = None
    for name, experiment in drives.experiments.items():
        if experiment.split in project.data.noise_split:
            continue
        drive, e, _ = drives.load(name)
        settled = drives.reader.estimator.settled(drive.v)
        if settled.any() and (best is None or abs(drive.v[settled].mean() - speed) < best[0]):
            best = abs(drive.v[settled].mean() - speed), drive, e
    if best is None:
        raise InputError(
            "Fig. 6", "drives", "no drive within the model's speed range", f"a drive near {speed:g} m/s"
        )
    return best[1:]


def worst_runs(problem: FrozenProblem, cells: list[Cell], drives: DriveSet) -> WorstRuns:
    """Run, for each structure, the first objective that is robustly met.

    Parameters
    ----------
    problem : FrozenProblem
    cells : list of Cell, of Table II
    drives : DriveSet

    Returns
    -------
    WorstRuns

    References
    ----------
    Paper, Fig. 6.
    """
    project = problem.stored.project
    drive, e = nearest_drive(drives, problem.settings.design_speed_mps)
    settled = np.flatnonzero(drives.reader.estimator.settled(drive.v))
    e, r_measured = e[settled[0] :], drive.y[settled[0] :, 0]
    reference = filtfilt(*butter(2, REFERENCE_CUTOFF_RAD_S, fs=2 * np.pi / project.Ts_s), r_measured)
    random = np.random.default_rng(project.seed)
    noise = random.standard_normal((len(e), 2)) * np.sqrt(NOISE_POWER / project.Ts_s)
    met = {c.structure: c for c in reversed(cells) if c.upper < 1}
    chosen = [met[s] for s in dict.fromkeys(c.structure for c in cells) if s in met]
    factor = min([1.0, *(_dc_bound(problem, c) / max(abs(e[:, 0].mean()), 1e-300) for c in chosen)])
    signals = np.column_stack([factor * e[:, 0], e[:, 1], noise, reference])
    W_R = to_discrete(problem.weights("K_inf", 1.0, 1.0).W_R, project.Ts_s)
    command = respond(W_R, reference[:, None])[:, 0]
    runs = [_run(problem, c, signals, command) for c in chosen]
    return WorstRuns(
        drive.name,
        float(factor),
        np.arange(len(e)) * project.Ts_s,
        command,
        runs,
        [s for s in dict.fromkeys(c.structure for c in cells) if s not in met],
    )


def _dc_bound(problem: FrozenProblem, c: Cell) -> float:
    return float(abs(problem.weights(c.structure, c.A_t, c.A_u).W_w[0].response([0.0])[0, 0, 0]))


def _run(problem: FrozenProblem, c: Cell, signals: np.ndarray, command: np.ndarray) -> WorstRun:
    weights, v = problem.weights(c.structure, c.A_t, c.A_u), problem.settings.design_speed_mps
    bins = problem.frames.estimator.omega
    # Only frequencies within the band of the data count, because Δ was never measured beyond it.
    band = np.r_[0.0, np.geomspace(0.1 * bins[1], bins[-1], 60)]
    worst = worst_case(
        problem.plant(c.structure, weights, v), c.controller, c.result.performance.scaling, band
    )
    physical = problem.plant(c.structure, _without_units(weights), v)
    loop = lft(physical.system, c.controller)
    with_delta = respond(close_delta(loop, worst.delta) if physical.blocks else loop, signals)
    n = physical.n_delta_in
    without = respond(
        loop.select(np.arange(n, loop.n_outputs), np.arange(physical.n_delta_out, loop.n_inputs)), signals
    )
    return WorstRun(
        c, worst, with_delta[:, 1], command - with_delta[:, 0], _rms(with_delta[:, 0]), _rms(without[:, 0])
    )


def _rms(x: np.ndarray) -> float:
    return float(np.sqrt(np.mean(x**2)))


def _without_units(weights: PlantWeights) -> PlantWeights:
    """Weights that leave w, r_c and z = [W_R r_c − r_m; u] in physical units."""
    one = gain([[1.0]])
    return replace(weights, W_C=one, W_t=one, W_u=(one,), W_w=(one, one))


def respond(G: StateSpace, inputs: np.ndarray) -> np.ndarray:
    """Simulate a discrete system from rest for ``inputs`` (N, m); return the outputs (N, p)."""
    forced, x = inputs @ G.B.T, np.zeros(G.order)
    states = np.empty((len(inputs), G.order))
    for k, step in enumerate(forced):
        states[k] = x
        x = G.A @ x + step
    return states @ G.C.T + inputs @ G.D.T
