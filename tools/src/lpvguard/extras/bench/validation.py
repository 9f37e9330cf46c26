"""Measure the validation engine with one thread: 20 experiments x 1024 bins of the paper's truck.

Three kernels run on arrays: the closed form of S1, the on-line margin, and S2 to a certified gap of 1e-4. In
the same run, a conic solver (cvxpy and Clarabel, rebuilt for each point) solves a part of the same problems.
For S2, the solver tries a grid of nu_s with one semidefinite relaxation per value. The package cvxpy is a
test dependency. Without cvxpy, the table has no ratios.

>>> data = truck_points(experiments=2, bins=4, seed=1)
>>> data["e"].shape, data["h_s"].shape
((8, 2), (8, 3, 3))
"""

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass

import numpy as np

from lpvguard.engine.validation import s1, s2
from lpvguard.extras.bench import _memory as memory
from lpvguard.extras.bench import parser, show
from lpvguard.vehicle import truck_model

TARGET_US = {"S1": 0.02, "margin": 0.1, "S2": 500.0}
"""Largest allowed time of each kernel [us per point]."""

GRID = 40
"""Number of values of nu_s that the conic version of S2 tries."""


@dataclass(frozen=True)
class KernelRow:
    """Line of the table; ``peer_us`` and ``ratio`` are None without cvxpy, ``worst_gap`` is only for S2."""

    kernel: str
    points: int
    us_per_point: float
    target_us: float
    peer_us: float | None
    ratio: float | None
    worst_gap: float | None

    @property
    def ok(self) -> bool:
        """Tell if the kernel meets its target."""
        return self.us_per_point <= self.target_us


def truck_points(
    experiments: int = 20, bins: int = 1024, seed: int = 0, ts_s: float = 0.01
) -> dict[str, np.ndarray]:
    """Draw points of class S2 with a known (delta, Delta_s, w).

    There are ``experiments`` speeds from 8 to 22 m/s. The ``bins`` go from 0.02 rad/s to 90 % of Nyquist,
    sampled at ``ts_s``. Keys are ``e (K, 2)``, ``z (K, 2)``, ``u (K,)``, ``x_nom (K, 3)``, ``h_i (K, 3)``,
    ``h_s (K, 3, 3)``, ``c (2, 3)``, ``gamma_w (K,)``, ``w_delta (K, 1)``, ``w_w (K, 2)``.
    """
    rng = np.random.default_rng(seed)

    def gauss(*shape):
        return (rng.normal(size=shape) + 1j * rng.normal(size=shape)) / np.sqrt(2.0)

    omega = np.geomspace(0.02, 0.9 * np.pi / ts_s, bins)
    per_speed_i, per_speed_s = [], []
    for v in np.linspace(8.0, 22.0, experiments):
        a, _ = truck_model.continuous(v, 4.5)
        a_d, b_d = truck_model.zoh(v, 4.5, ts_s)
        g_d = np.linalg.solve(a, a_d - np.eye(3))
        resolvent = np.linalg.inv(np.exp(1j * omega * ts_s)[:, None, None] * np.eye(3) - a_d)
        per_speed_i.append((resolvent @ b_d)[:, :, 0])
        per_speed_s.append(resolvent @ g_d)
    h_i, h_s = np.concatenate(per_speed_i), np.concatenate(per_speed_s)
    points = experiments * bins
    u = gauss(points)
    x_nom = h_i * u[:, None]
    cap = 1.0 / np.linalg.norm(h_s, 2, axis=(1, 2))
    delta = 0.3 * rng.uniform(size=points) * np.exp(2j * np.pi * rng.uniform(size=points))
    d_s = gauss(points, 3, 3)
    d_s *= (0.3 * cap * rng.uniform(size=points) / np.linalg.norm(d_s, 2, axis=(1, 2)))[:, None, None]
    x = np.linalg.solve(np.eye(3) - h_s @ d_s, (h_i * (u * (1.0 + delta))[:, None])[:, :, None])[:, :, 0]
    z = x_nom @ truck_model.C.T
    e = (x - x_nom) @ truck_model.C.T
    w = 0.2 * rng.uniform(size=points)[:, None] * np.linalg.norm(e, axis=1)[:, None] * gauss(points, 2)
    e = e + w
    b1, size = s1.solve(e, z, np.zeros(points)).b1, np.linalg.norm(e, axis=1)
    gamma = b1 + rng.uniform(0.1, 0.9, points) * (size - b1)
    return {
        "e": e,
        "z": z,
        "u": u,
        "x_nom": x_nom,
        "h_i": h_i,
        "h_s": h_s,
        "c": truck_model.C,
        "gamma_w": gamma,
        "w_delta": rng.uniform(0.05, 0.5, (points, 1)),
        "w_w": rng.uniform(0.05, 0.5, (points, 2)) * size[:, None],
    }


def _time_us(run: Callable[[], object], points: int, repeats: int) -> float:
    """Median time per point [us] over the repeats, because a median is insensitive to other processes."""
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        run()
        times.append(time.perf_counter() - start)
    return float(np.median(times)) / points * 1e6


def _peer_s1(data, k):
    import cvxpy as cp
    from cvxpy.atoms.elementwise.abs import abs as modulus
    from cvxpy.atoms.norm import norm

    delta = cp.Variable(complex=True)
    e, z = data["e"][k], data["z"][k]
    scale = np.linalg.norm(e)
    problem = cp.Problem(
        cp.Minimize(modulus(delta)), [norm(e / scale - delta * (z / scale)) <= data["gamma_w"][k] / scale]
    )
    return problem.solve(solver=cp.CLARABEL)


def _peer_margin(data, k):
    import cvxpy as cp
    from cvxpy.atoms.elementwise.abs import abs as modulus

    delta, t = cp.Variable(complex=True), cp.Variable()
    e, z, w_w = data["e"][k], data["z"][k], data["w_w"][k]
    limits = [modulus(delta) <= t * data["w_delta"][k, 0]]
    limits += [modulus(e[j] / w_w[j] - delta * (z[j] / w_w[j])) <= t for j in range(2)]
    return cp.Problem(cp.Minimize(t), limits).solve(solver=cp.CLARABEL)


def _peer_s2(data, k):
    """Find the least J over a grid of nu_s with one Shor relaxation each (exact for two constraints)."""
    import cvxpy as cp
    from cvxpy.atoms.affine.real import real
    from cvxpy.atoms.affine.trace import trace

    u, gain = abs(data["u"][k]), np.column_stack([data["h_i"][k], data["h_s"][k]])
    m = data["c"] @ gain
    scale = np.linalg.norm(data["e"][k]) / np.linalg.norm(m, axis=0)
    row_t = np.eye(5)[4]
    w_map = (np.column_stack([-m * scale, data["e"][k]])) / data["gamma_w"][k]
    eta = np.column_stack([gain * scale, data["x_nom"][k]])
    xi_i, xi_s = np.zeros((1, 5)), np.zeros((3, 5))
    xi_i[0, 0] = scale[0] / u
    xi_s[:, 1:4] = np.diag(scale[1:])
    gram = [a.conj().T @ a for a in (xi_i, w_map, xi_s, eta)]
    cap = 1.0 / np.linalg.norm(data["h_s"][k], 2)
    best = np.inf
    for nu in np.geomspace(1e-3 * cap, 0.98 * cap, GRID):
        x = cp.Variable((5, 5), hermitian=True)
        traces = [
            real(trace(g @ x)) for g in (gram[0], gram[1], (gram[2] - nu**2 * gram[3]) / np.trace(gram[2]))
        ]
        limits = [x >> 0, real(row_t @ x @ row_t) == 1, traces[1] <= 1, traces[2] <= 0]
        value = cp.Problem(cp.Minimize(traces[0]), limits).solve(solver=cp.CLARABEL)
        best = min(best, value + nu**2)
    return best


_PEERS = {"S1": (_peer_s1, 20), "margin": (_peer_margin, 20), "S2": (_peer_s2, 2)}


def _peer_us(kernel: str, data: dict) -> float | None:
    try:
        import cvxpy  # noqa: F401
    except ImportError:
        return None
    solve, count = _PEERS[kernel]
    solve(data, 0)
    picks = np.linspace(1, len(data["e"]) - 1, count).astype(int)
    start = time.perf_counter()
    for k in picks:
        solve(data, k)
    return (time.perf_counter() - start) / count * 1e6


def run(experiments: int = 20, bins: int = 1024, seed: int = 0, peers: bool = True) -> list[KernelRow]:
    """Measure all kernels and return one row per kernel; S2 also runs on every point."""
    data = truck_points(experiments, bins, seed)
    points = experiments * bins
    worst = {}

    def run_s2():
        keys = ("e", "u", "x_nom", "h_i", "h_s", "c", "gamma_w")
        r = s2.solve(*(data[k] for k in keys))
        worst["S2"] = float(np.max((r.upper - r.lower) / np.maximum(r.upper, 1e-300)))

    jobs = {
        "S1": (lambda: s1.solve(data["e"], data["z"], data["gamma_w"]), 50),
        "margin": (lambda: s1.margin(data["e"], data["z"], data["w_delta"], data["w_w"]), 50),
        "S2": (run_s2, 1),
    }
    rows = []
    for kernel, (job, repeats) in jobs.items():
        if repeats > 1:
            job()
        us = _time_us(job, points, repeats)
        peer = _peer_us(kernel, data) if peers else None
        rows.append(
            KernelRow(
                kernel, points, us, TARGET_US[kernel], peer, peer / us if peer else None, worst.get(kernel)
            )
        )
    return rows


def table(rows: list[KernelRow]) -> str:
    """Write the rows as text, one line each."""
    lines = [f"{'kernel':8} {'points':>7} {'us/point':>10} {'target':>8} {'conic us':>10} {'ratio':>9}  gap"]
    for r in rows:
        peer, ratio = (f"{r.peer_us:10.0f}", f"{r.ratio:9.0f}") if r.peer_us else (f"{'-':>10}", f"{'-':>9}")
        gap = f"{r.worst_gap:.1e}" if r.worst_gap is not None else "exact"
        lines.append(
            f"{r.kernel:8} {r.points:7d} {r.us_per_point:10.4f} {r.target_us:8g} {peer} {ratio}  {gap}"
        )
    return "\n".join(lines)


def as_dicts(rows: list[KernelRow]) -> list[dict]:
    """Rows for ``--json``."""
    return [asdict(r) | {"ok": r.ok} for r in rows]


def main(argv: list[str]) -> None:
    """Run `lpvguard bench validation`."""
    arguments = parser("validation", __doc__)
    arguments.add_argument("--experiments", type=int, default=20)
    arguments.add_argument("--bins", type=int, default=1024)
    arguments.add_argument("--no-peers", action="store_true", help="without the conic solver")
    arguments.add_argument(
        "--memory", action="store_true", help="instead: t* of error by Delta alone, over its memory"
    )
    options = arguments.parse_args(argv)
    if options.memory:
        memory_rows = memory.rows()
        return show(memory.table(memory_rows), [asdict(r) for r in memory_rows], options.json_out)
    rows = run(options.experiments, options.bins, peers=not options.no_peers)
    show(table(rows), as_dicts(rows), options.json_out)
