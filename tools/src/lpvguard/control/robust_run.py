"""Test the certified gain by simulating the nominal plant, the weights, a Delta and the compiled controller.

The demand has no limits. For every Delta with ||Delta||_inf <= 1 / max(1, mu), the gain from [w; n; r_c] to z
is at most mu from rest. Both signals are normalised (before the weights). With the controller's rounding,
||z|| <= mu ||[w; n; r_c]|| + ``QUANTISATION`` ||[w; n; r_c]||. The test draws Delta and inputs at random. It
also uses the worst stable Delta that is found (engine/synthesis/worst_case.py), with the input of largest
gain.
"""

import ctypes
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..base import native
from ..base.errors import InputError
from ..core.compiled import core_objects
from ..core.scheduled import Scheduled
from ..engine.synthesis.dk import RobustPerformance, certify
from ..engine.synthesis.interconnection import GeneralisedPlant
from ..engine.synthesis.norms import hinf_norm
from ..engine.synthesis.statespace import StateSpace, append, lft, to_discrete
from ..engine.synthesis.worst_case import close_delta, worst_case
from ..identify.identification import StoredIdentification
from .controller_file import stated_scaling
from .plants import DesignProblem

QUANTISATION = 1e-4
"""Allowed effect of float32 rounding in z, relative to the norm of the input. The test measures the
effect."""
STEPS, WORST_STEPS, DECAY = 3000, 12000, 1000
"""Samples of a random run and of the worst-case run, and samples without input at the end of a run."""
POLES_RAD_S = (0.02, 60.0)
"""Range of the poles of a random Delta."""


@dataclass(frozen=True)
class RobustRun:
    """Ratios ||z|| / ||[w; n; r_c]|| at a speed.

    Attributes
    ----------
    v : float, m/s
    bound : float, mu
    draws : int, number of random runs
    sampled : float, largest ratio of the random runs
    worst : float, ratio with the worst Delta that is found
    worst_gain : float, theoretical ratio with that Delta
    rounding : float, largest ||z - z_double|| / ||input||; z_double is computed in double precision
    """

    v: float
    bound: float
    draws: int
    sampled: float
    worst: float
    worst_gain: float
    rounding: float

    @property
    def kept(self) -> bool:
        """Tell if each ratio is at most bound + QUANTISATION, and the rounding at most QUANTISATION."""
        return max(self.sampled, self.worst) <= self.bound + QUANTISATION and self.rounding <= QUANTISATION


class CompiledController:
    """Controller of a generated folder, compiled from the ECU's sources.

    Parameters
    ----------
    folder : Path, generated folder

    Raises
    ------
    InputError
        If it has no controller.
    """

    def __init__(self, folder: Path):
        try:
            objects = core_objects(Path(folder), [Path(__file__).with_name("loop.cpp")])
            library = native.compile_shared(objects, flags=(), name=f"loop_{Path(folder).name}")
        except native.NativeError as error:
            raise InputError(
                folder, "compiling the C core", str(error).strip(), "a C++17 compiler and Eigen 3.4"
            ) from None
        self._run = ctypes.CDLL(str(library)).lpvgb_closed_loop
        self._run.restype = ctypes.c_int64

    def close(
        self, plant: StateSpace, n_measurement: int, v: float, w: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Simulate a loop from rest for inputs w (N, n_w) at speed v [m/s]; return z (N, n_z) and u (N, n_u).

        ``plant`` is a discrete system from [w; u] to [z; y].
        """
        w = np.ascontiguousarray(w)
        n_z, n_u = plant.n_outputs - n_measurement, plant.n_inputs - w.shape[1]
        z, u = np.empty((len(w), n_z)), np.empty((len(w), n_u))
        sizes = np.array([plant.order, w.shape[1], n_z, len(w)], np.int64)
        arrays = [np.ascontiguousarray(a) for a in (plant.A, plant.B, plant.C, plant.D)]
        pointers = [a.ctypes.data_as(ctypes.c_void_p) for a in (sizes, *arrays)]
        limited = self._run(
            *pointers, ctypes.c_double(v), *(a.ctypes.data_as(ctypes.c_void_p) for a in (w, u, z))
        )
        if limited:
            raise ArithmeticError("the controller refused a sample or met a limit")
        return z, u


def run(
    compiled: CompiledController,
    plant: GeneralisedPlant,
    controller: StateSpace,
    v: float,
    proved: RobustPerformance,
    draws: int,
    seed: int,
) -> RobustRun:
    """Run random Delta and inputs ``draws`` times, and the worst case, at the speed ``v`` [m/s].

    ``plant`` is discrete. ``controller`` is the compiled controller in double precision. ``proved`` is the
    certificate at this speed.
    """
    random = np.random.default_rng(seed)
    size, dt, n_w = 1 / max(1.0, proved.upper), plant.system.dt, plant.performance_block.rows
    sampled, rounding = 0.0, 0.0
    for k in range(draws):
        delta = (
            append(*(sampled_block(random, b.rows, b.cols, size, dt) for b in plant.blocks))
            if plant.blocks
            else None
        )
        w = _sampled_input(random, n_w, dt)
        ratio, rounded = _ratio(compiled, plant, controller, v, delta, w, compare=k < 3)
        sampled, rounding = max(sampled, ratio), max(rounding, rounded)
    case = worst_case(plant, controller, proved.scaling)
    delta = None
    if plant.blocks:
        delta = StateSpace(
            case.delta.A, case.delta.B, size / case.size * case.delta.C, size / case.size * case.delta.D, dt
        )
    closed = lft(_perturbed(plant, delta), controller)
    gain = closed.response([case.frequency])[0]
    direction = np.linalg.svd(gain)[2][0].conj()
    t = dt * np.arange(WORST_STEPS)
    w = (np.exp(1j * case.frequency * t)[:, None] * direction).real * _window(WORST_STEPS)[:, None]
    worst, rounded = _ratio(compiled, plant, controller, v, delta, w, compare=True)
    return RobustRun(
        v, proved.upper, draws, sampled, worst, float(np.linalg.norm(gain, 2)), max(rounding, rounded)
    )


def certified_runs(
    stored: StoredIdentification, document: dict, compiled: CompiledController, draws: int
) -> list[RobustRun]:
    """Run the compiled controller with vehicles of the identified set, at some of its speeds.

    Parameters
    ----------
    stored : StoredIdentification
    document : dict, controller.json
    compiled : CompiledController
    draws : int, number of random vehicles over all speeds; the worst vehicle of each speed is added

    Returns
    -------
    list of RobustRun
    """
    schedule, problem = Scheduled.read(document), DesignProblem.from_identification(stored)
    speeds = schedule.speeds[:: max(1, (len(schedule.speeds) - 1) // 3)]
    rows = []
    for k, v in enumerate(map(float, speeds)):
        plant = problem.plant(v)
        proved = certify(plant, schedule.at(v), stated_scaling(document) if plant.blocks else None)
        share, seed = -(-draws // len(speeds)), stored.project.seed + k
        rows.append(run(compiled, plant, schedule.at(v), v, proved, share, seed))
    return rows


def _perturbed(plant: GeneralisedPlant, delta: StateSpace | None) -> StateSpace:
    return plant.system if delta is None else close_delta(plant.system, delta)


def _ratio(compiled, plant, controller, v, delta, w, compare) -> tuple[float, float]:
    """Compute ||z|| / ||w|| of the compiled loop, and with ``compare`` also ||z - z_double|| / ||w||."""
    system, size = _perturbed(plant, delta), np.linalg.norm(w)
    z, _ = compiled.close(system, plant.n_measurement, v, w)
    rounded = np.linalg.norm(z - _response(lft(system, controller), w)) / size if compare else 0.0
    return float(np.linalg.norm(z) / size), float(rounded)


def _response(G: StateSpace, w: np.ndarray) -> np.ndarray:
    x, z = np.zeros(G.order), np.empty((len(w), G.n_outputs))
    for k, now in enumerate(w):
        z[k] = G.C @ x + G.D @ now
        x = G.A @ x + G.B @ now
    return z


def sampled_block(random, rows: int, cols: int, size: float, dt: float) -> StateSpace:
    """Draw a stable system of first to fourth order with log-uniform poles, real or complex.

    Parameters
    ----------
    random : Generator, of numpy
    rows, cols : int, outputs and inputs
    size : float, largest norm
    dt : float, s

    Returns
    -------
    StateSpace
    """
    n = int(random.integers(1, 5))
    poles = np.exp(random.uniform(*np.log(POLES_RAD_S), n))
    A = -np.diag(poles) + np.triu(random.standard_normal((n, n)), 1) * poles[:, None]
    A = A - A.T * np.triu(np.ones((n, n)), 1).T if random.random() < 0.5 else A
    A = A - max(np.linalg.eigvals(A).real.max() + POLES_RAD_S[0], 0.0) * np.eye(n)
    parts = (
        random.standard_normal((n, cols)),
        random.standard_normal((rows, n)),
        random.standard_normal((rows, cols)),
    )
    G = to_discrete(StateSpace(A, *parts), dt)
    factor = size / hinf_norm(G).upper
    return StateSpace(G.A, G.B, factor * G.C, factor * G.D, dt)


def _sampled_input(random, n_w: int, dt: float) -> np.ndarray:
    """Draw white noise or a few sines in random directions, followed by zeros."""
    if random.random() < 0.5:
        w = random.standard_normal((STEPS, n_w))
    else:
        t, omega = dt * np.arange(STEPS), np.exp(random.uniform(*np.log(POLES_RAD_S), 3))
        phases = random.uniform(0, 2 * np.pi, (3, n_w))
        w = sum(
            np.cos(o * t[:, None] + p) * random.standard_normal(n_w)
            for o, p in zip(omega, phases, strict=False)
        )
    return w * _window(STEPS)[:, None]


def _window(steps: int) -> np.ndarray:
    """Half sine over the samples with input; zero over the last ``DECAY`` samples."""
    return np.concatenate([np.sin(np.pi * np.arange(steps - DECAY) / (steps - DECAY)), np.zeros(DECAY)])
