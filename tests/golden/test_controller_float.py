"""The shipped controller in float against the same in double: within 1e-4 of its range, at 5, 10 and 20 ms,
for long.

Both are given the same measurements, rounded to float, and the same coefficients, those of the double one
unrounded: the difference is all that float does to the demand, coefficients included.
"""

import ctypes
import shutil
from pathlib import Path

import numpy as np
import pytest
import scipy.linalg as sl

from lpvguard.base import native
from lpvguard.base.artefacts import write_files
from lpvguard.control.input_limit import input_limit, rule
from lpvguard.core.compiled import library_root, shipped_vehicle
from lpvguard.core.control_coefficients import build_controller, replaced_controller
from lpvguard.core.scheduled import realisation
from lpvguard.vehicle.nominal import NominalModel
from lpvguard.vehicle.project import load_project

SOURCE = Path(__file__).with_name("control_run.cpp")
ALLOWED = 1e-4
RANGE = load_project("truck").design.input_max[0]
"""Of the demand [bar]: what the actuator gives, whatever the limit at a speed."""


class Controller:
    """The compiled controller of a generated folder."""

    def __init__(self, folder: Path, *, double: bool):
        root = library_root()
        flags = (
            "-std=c++17",
            "-O2",
            "-ffp-contract=off",
            "-fno-math-errno",
            *(["-DLPVG_DOUBLE"] if double else []),
        )
        self.lib = ctypes.CDLL(
            str(
                native.compile_shared(
                    [root / "src" / "guard" / "controller.cpp", folder / "lpvguard_control.c", SOURCE],
                    name="control_run",
                    flags=flags,
                    include_dirs=[root / "include", root / "src", folder],
                )
            )
        )
        self.lib.control_run.restype = ctypes.c_int64
        sizes = np.zeros(5, np.int64)
        self.lib.control_sizes(_pointer(sizes))
        self.n, self.n_m, self.n_g, self.n_u = map(int, sizes[:4])
        self.Ts = 1e-6 * sizes[4]

    def arrays(self) -> dict[str, np.ndarray]:
        """The coefficients by the names of ``build_controller``."""
        n, n_m, n_g, n_u = self.n, self.n_m, self.n_g, self.n_u
        counts = np.cumsum([2, n_g * n_u, n_u, n, 2 * n, n_g * n_u * n * (n_m + n_u)])
        values = np.zeros(counts[-1])
        self.lib.control_coefficients(_pointer(values))
        ends, u_max, rate_max, a, _, BL = np.split(values, counts[:-1])
        BL = BL.reshape(n_g, n_u, n, n_m + n_u)
        return {
            "speeds": np.linspace(*ends, n_g),
            "a": a,
            "B": BL[..., :n_m],
            "L": BL[..., n_m:],
            "u_max": u_max.reshape(n_g, n_u),
            "rate_max": rate_max,
        }

    def start(self) -> None:
        assert self.lib.control_start() == 0

    def run(self, speed: np.ndarray, m: np.ndarray, engaged: np.ndarray) -> tuple[np.ndarray, int]:
        """Demands (N, n_u), and in how many samples a limit acted."""
        u = np.zeros((len(speed), self.n_u))
        arrays = [np.ascontiguousarray(x, t) for x, t in ((speed, float), (m, float), (engaged, np.uint8))]
        limited = self.lib.control_run(ctypes.c_int64(len(speed)), *map(_pointer, arrays), _pointer(u))
        assert limited >= 0
        return u, limited


def _pointer(array: np.ndarray) -> ctypes.c_void_p:
    return array.ctypes.data_as(ctypes.c_void_p)


def resampled(a: np.ndarray, rows: np.ndarray, Ts: float, to: float) -> tuple[np.ndarray, np.ndarray]:
    """The same continuous pairs of poles, input held, at another sample period; rows (..., n, columns) of B
    and L. The last state, the delay of one sample, stays one."""
    out_a, out = a.copy(), rows.copy()
    for j in range(0, len(a) - 1, 2):
        A, c = realisation(a[j : j + 2])
        continuous = sl.logm(A).real / Ts
        A_to = sl.expm(continuous * to)
        held = np.linalg.solve(A - np.eye(2), np.linalg.solve(continuous, A_to - np.eye(2)) @ continuous).real
        trace, determinant = np.trace(A_to) - 2, np.linalg.det(A_to - np.eye(2))
        out_a[j : j + 2] = trace, -determinant
        T = np.vstack([c, c @ (A_to - (1 + trace) * np.eye(2))])  # to the coordinates of ``realisation``
        out[..., j : j + 2, :] = T @ held @ rows[..., j : j + 2, :]
    return out_a, out


@pytest.fixture(scope="module", params=[0.005, 0.01, 0.02], ids=lambda Ts: f"{1e3 * Ts:g}ms")
def pair(request, tmp_path_factory):
    """The truck's controller at a sample period, in float and in double."""
    shipped, Ts = shipped_vehicle("truck"), request.param
    original = Controller(shipped, double=True)
    arrays = original.arrays()
    if Ts != original.Ts:
        n_m = original.n_m
        arrays["a"], BL = resampled(
            arrays["a"], np.concatenate([arrays["B"], arrays["L"]], axis=3), original.Ts, Ts
        )
        arrays["B"], arrays["L"] = BL[..., :n_m], BL[..., n_m:]
    folder = tmp_path_factory.mktemp("control") / "truck"
    shutil.copytree(shipped, folder)
    write_files(
        folder,
        replaced_controller((folder / "lpvguard_vehicle.h").read_text(), build_controller(Ts, **arrays)),
    )
    return Controller(folder, double=False), Controller(folder, double=True)


def drive(
    rng: np.random.Generator, start_s: float, n: int, Ts: float, size: float
) -> tuple[np.ndarray, np.ndarray]:
    """Speed (n,) that leaves the range at both ends, and measurements (n, 3) of ``size`` [rad/s, rad/s, rad],
    float's."""
    t = start_s + Ts * np.arange(n)
    phase = np.array([0.0, 0.3, 1.0])
    m = size * (np.sin(np.outer(t, [0.31, 0.37, 0.43]) + phase) + 0.02 * rng.standard_normal((n, 3)))
    return (15 + 9 * np.sin(0.05 * t)).astype(np.float32), m.astype(np.float32)


@pytest.mark.requirement("REQ-CTL-1")
@pytest.mark.parametrize(("size", "limited_share"), [(0.01, 0.0), (0.3, 0.3)], ids=["free", "saturated"])
def test_float_is_within_1e4_of_the_range(pair, size, limited_share):
    single, double = pair
    n = round(600 / single.Ts)
    speed, m = drive(np.random.default_rng(1), 0.0, n, single.Ts, size)
    engaged = np.arange(n) % round(100 / single.Ts) < round(90 / single.Ts)  # released for 10 s at a time
    single.start(), double.start()
    (u, limited), (exact, _) = single.run(speed, m, engaged), double.run(speed, m, engaged)
    assert limited >= limited_share * engaged.sum() and np.abs(exact).max() > 0.1
    assert np.abs(u - exact).max() <= ALLOWED * RANGE


@pytest.mark.slow("3 s: 10 million samples")
@pytest.mark.requirement("REQ-CTL-1")
@pytest.mark.parametrize("pair", [0.01], indirect=True)
def test_float_does_not_drift_in_1e7_samples_and_forgets_a_burst(pair):
    single, double = pair
    rng, chunk = np.random.default_rng(2), 100_000
    single.start(), double.start()
    errors = []
    for k in range(100):
        speed, m = drive(rng, k * chunk * single.Ts, chunk, single.Ts, 0.02)
        if k == 50:
            m[:1000] *= 500
        engaged = np.ones(chunk, bool)
        errors.append(np.abs(single.run(speed, m, engaged)[0] - double.run(speed, m, engaged)[0]).max())
    errors = np.array(errors) / RANGE
    assert errors.max() <= ALLOWED
    assert errors[90:].max() <= 2 * errors[:10].max()


@pytest.mark.requirement("REQ-CTL-2")
@pytest.mark.parametrize("double", [False, True], ids=["float", "double"])
def test_the_demand_is_nowhere_above_the_rule_of_the_input_limit(double, tmp_path):
    """A demand that follows its limit at once, at 1000 random speeds. From 15 m/s on it falls as 1/v."""
    project = load_project("truck")
    A = [
        [entry.replace("p6", "p6*v/15") if isinstance(entry, str) else entry for entry in row]
        for row in project.model.A
    ]
    model = NominalModel(project.model_copy(update={"model": project.model.model_copy(update={"A": A})}))
    speeds = np.linspace(*model.speed_range, 8)
    settings = project.design.model_copy(update={"input_max": [2.0]})
    u_max = input_limit(model, settings, speeds)
    wanted = np.zeros((8, 1, 1, 1 + model.n_y))
    wanted[..., 0] = 1.0  # one sample late: no state but the delay
    controller = build_controller(
        model.Ts, speeds, np.array([-1.0]), wanted, np.zeros((8, 1, 1, 1)), u_max, np.array([1e6])
    )
    folder = tmp_path / "truck"
    shutil.copytree(shipped_vehicle("truck"), folder)
    write_files(folder, replaced_controller((folder / "lpvguard_vehicle.h").read_text(), controller))
    compiled = Controller(folder, double=double)
    rng = np.random.default_rng(6)
    v = rng.uniform(*model.speed_range, 1000).astype(np.float32).astype(float)
    m = np.zeros((1000, 1 + model.n_y))
    m[:, 0] = 50.0 * rng.choice([-1.0, 1.0], 1000)
    compiled.start()
    u, limited = compiled.run(v, m, np.ones(1000, bool))
    size, allowed = np.abs(u[1:, 0]), rule(model, settings, v[1:])[:, 0]
    assert limited == 999 and (np.sign(u[1:, 0]) == np.sign(m[:-1, 0])).all()
    assert (size <= allowed).all() and (size >= 0.95 * allowed).all()
    assert (allowed < 2.0).sum() > 100 and (size == 2.0).sum() > 100
