"""Linear systems in state space: the algebra shared by synthesis and analysis.

All matrices are real doubles. ``dt = 0`` means continuous time (G(s)). ``dt > 0`` means discrete time (G(z))
with the sampling time ``dt`` in seconds. Objects are immutable, and every function returns a new object.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
import scipy.linalg as sl

from lpvguard.engine.synthesis.errors import SynthesisError

EPS = np.finfo(float).eps
Frequency = TypeVar("Frequency", float, np.ndarray)


@dataclass(frozen=True)
class StateSpace:
    """System G = D + C (λI − A)⁻¹ B with λ = s or z.

    Attributes
    ----------
    A : ndarray (n, n)
    B : ndarray (n, m)
    C : ndarray (p, n)
    D : ndarray (p, m)
    dt : float, s, 0 for continuous time
    inputs, outputs : tuple of str, m and p names, or empty

    Raises
    ------
    SynthesisError
        If shapes disagree, an entry is not finite or dt is negative.

    Examples
    --------
    >>> lag = StateSpace([[-2.0]], [[2.0]], [[1.0]], [[0.0]])
    >>> float(abs(lag.response([0.0])[0, 0, 0]))
    1.0
    """

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    dt: float = 0.0
    inputs: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()

    def __post_init__(self):
        D = np.atleast_2d(np.asarray(self.D, dtype=float))
        p, m = D.shape
        A = np.asarray(self.A, dtype=float)
        n = A.shape[0] if A.size else 0
        shapes = {"A": (n, n), "B": (n, m), "C": (p, n), "D": (p, m)}
        for name, shape in shapes.items():
            value = np.array(getattr(self, name), dtype=float, order="C", ndmin=2)
            if value.size == 0 and 0 in shape:
                value = value.reshape(shape)
            if value.shape != shape:
                raise SynthesisError("state space", name, f"shape {value.shape}", f"shape {shape}")
            if not np.isfinite(value).all():
                raise SynthesisError("state space", name, "a NaN or infinite entry", "finite numbers")
            value.setflags(write=False)
            object.__setattr__(self, name, value)
        if not (np.isfinite(self.dt) and self.dt >= 0):
            raise SynthesisError(
                "state space", "dt", f"{self.dt}", "0 (continuous) or a sampling time in seconds"
            )
        object.__setattr__(self, "dt", float(self.dt))
        for name, count in (("inputs", m), ("outputs", p)):
            labels = tuple(getattr(self, name))
            if labels and len(labels) != count:
                raise SynthesisError("state space", name, f"{len(labels)} names", f"{count} names or none")
            object.__setattr__(self, name, labels)

    @property
    def order(self) -> int:
        """Number of states n."""
        return self.A.shape[0]

    @property
    def n_inputs(self) -> int:
        """Number of inputs m."""
        return self.D.shape[1]

    @property
    def n_outputs(self) -> int:
        """Number of outputs p."""
        return self.D.shape[0]

    def poles(self) -> np.ndarray:
        """Eigenvalues of A, (n,) complex, rad/s or in the z-plane."""
        return np.linalg.eigvals(self.A) if self.order else np.zeros(0, dtype=complex)

    def stability_margin(self) -> float:
        """Distance from instability: −max Re λ(A) in rad/s, or 1 − max |λ(A)| in discrete time.

        It is positive for a stable system, and +inf for n = 0.
        """
        poles = self.poles()
        if poles.size == 0:
            return np.inf
        return float(1.0 - np.abs(poles).max()) if self.dt else float(-poles.real.max())

    def response(self, omega) -> np.ndarray:
        """Complex response G(jω) or G(e^{jω dt}), (k, p, m), at ``omega`` (k,) in rad/s.

        ``omega`` may be infinite in continuous time.
        """
        omega = np.atleast_1d(np.asarray(omega, dtype=float))
        infinite = np.isinf(omega)
        finite = np.where(infinite, 0.0, omega)
        return self.evaluate(np.exp(1j * finite * self.dt) if self.dt else 1j * finite, skip=infinite)

    def evaluate(self, points, skip=None) -> np.ndarray:
        """G at complex ``points`` (k,), or D, the response at infinity, where ``skip`` (k,) is true."""
        points = np.atleast_1d(np.asarray(points, dtype=complex))
        out = np.broadcast_to(self.D.astype(complex), (points.size, *self.D.shape)).copy()
        todo = np.flatnonzero(~skip) if skip is not None else np.arange(points.size)
        n = self.order
        if n == 0 or todo.size == 0:
            return out
        eye = np.eye(n)
        block = max(1, int(2e6) // (n * n))
        for start in range(0, todo.size, block):
            part = todo[start : start + block]
            pencil = points[part, None, None] * eye - self.A
            rhs = np.broadcast_to(self.B.astype(complex), (part.size, *self.B.shape))
            try:
                out[part] += self.C @ np.linalg.solve(pencil, rhs)
            except np.linalg.LinAlgError:
                for k in part:
                    out[k] = self._evaluate_near_pole(points[k])
        return out

    def _evaluate_near_pole(self, point) -> np.ndarray:
        pencil = point * np.eye(self.order) - self.A
        try:
            return self.D + self.C @ np.linalg.solve(pencil, self.B)
        except np.linalg.LinAlgError:
            return np.full(self.D.shape, np.inf, dtype=complex)

    def select(self, rows, cols) -> StateSpace:
        """Subsystem from the inputs ``cols`` to the outputs ``rows`` (index arrays or slices)."""
        return StateSpace(
            self.A,
            self.B[:, cols],
            self.C[rows],
            self.D[rows][:, cols],
            self.dt,
            _picked(self.inputs, cols),
            _picked(self.outputs, rows),
        )

    def transformed(self, T) -> StateSpace:
        """The same system in the coordinates x = T x̃; ``T`` (n, n) invertible."""
        return replace(self, A=np.linalg.solve(T, self.A @ T), B=np.linalg.solve(T, self.B), C=self.C @ T)


def _picked(labels: tuple[str, ...], index) -> tuple[str, ...]:
    """Labels at ``index`` (an index array or a slice), or none where the system has no labels."""
    return tuple(np.asarray(labels, dtype=object)[index]) if labels else ()


def gain(D, dt: float = 0.0) -> StateSpace:
    """Make a system of order 0 from a matrix.

    Parameters
    ----------
    D : array_like (p, m)
    dt : float, s, default 0.0

    Returns
    -------
    StateSpace
    """
    D = np.atleast_2d(np.asarray(D, dtype=float))
    return StateSpace(np.zeros((0, 0)), np.zeros((0, D.shape[1])), np.zeros((D.shape[0], 0)), D, dt)


def series(second: StateSpace, first: StateSpace) -> StateSpace:
    """Connect two systems in series. The signal passes ``first``, then ``second``.

    Parameters
    ----------
    second, first : StateSpace

    Returns
    -------
    StateSpace
    """
    same_time(first, second)
    A = np.block([[first.A, np.zeros((first.order, second.order))], [second.B @ first.C, second.A]])
    return StateSpace(
        A,
        np.vstack([first.B, second.B @ first.D]),
        np.hstack([second.D @ first.C, second.C]),
        second.D @ first.D,
        first.dt,
        first.inputs,
        second.outputs,
    )


def append(*systems: StateSpace) -> StateSpace:
    """Append systems as diag(G1, G2, ...), without connections.

    Parameters
    ----------
    *systems : StateSpace

    Returns
    -------
    StateSpace
    """
    for one in systems[1:]:
        same_time(systems[0], one)

    def join(part: str) -> np.ndarray:
        # scipy.linalg.block_diag is ten times slower for systems with few states.
        blocks = [getattr(g, part) for g in systems]
        whole = np.zeros([sum(b.shape[axis] for b in blocks) for axis in (0, 1)])
        row = column = 0
        for b in blocks:
            whole[row : row + len(b), column : column + b.shape[1]] = b
            row, column = row + len(b), column + b.shape[1]
        return whole

    named = all(g.inputs and g.outputs for g in systems)
    return StateSpace(
        join("A"),
        join("B"),
        join("C"),
        join("D"),
        systems[0].dt,
        sum((g.inputs for g in systems), ()) if named else (),
        sum((g.outputs for g in systems), ()) if named else (),
    )


def lft(plant: StateSpace, controller: StateSpace) -> StateSpace:
    """Close u = K y around the last inputs and outputs of a plant: the lower LFT F_l(P, K).

    The state is [x; x_K].

    Parameters
    ----------
    plant, controller : StateSpace

    Returns
    -------
    StateSpace

    Raises
    ------
    SynthesisError
        If the loop is not well posed: I − D22 D_K is singular.
    """
    same_time(plant, controller)
    n_u, n_y = controller.n_outputs, controller.n_inputs
    n_w, n_z = plant.n_inputs - n_u, plant.n_outputs - n_y
    B1, B2 = plant.B[:, :n_w], plant.B[:, n_w:]
    C1, C2 = plant.C[:n_z], plant.C[n_z:]
    D11, D12, D21, D22 = (plant.D[:n_z, :n_w], plant.D[:n_z, n_w:], plant.D[n_z:, :n_w], plant.D[n_z:, n_w:])
    Ak, Bk, Ck, Dk = controller.A, controller.B, controller.C, controller.D
    loop = np.eye(n_y) - D22 @ Dk
    if n_y and 1 / np.linalg.cond(loop) < 1e-14:
        raise SynthesisError(
            "feedback loop", "I − D22 D_K", "singular", "a well-posed loop: change D22 or D_K"
        )
    # y = S (C2 x + D22 Ck x_k + D21 w),  u = Dk y + Ck x_k
    S = np.linalg.inv(loop)
    y_x, y_k, y_w = S @ C2, S @ D22 @ Ck, S @ D21
    u_x, u_k, u_w = Dk @ y_x, Ck + Dk @ y_k, Dk @ y_w
    A = np.block([[plant.A + B2 @ u_x, B2 @ u_k], [Bk @ y_x, Ak + Bk @ y_k]])
    return StateSpace(
        A,
        np.vstack([B1 + B2 @ u_w, Bk @ y_w]),
        np.hstack([C1 + D12 @ u_x, D12 @ u_k]),
        D11 + D12 @ u_w,
        plant.dt,
        plant.inputs[:n_w],
        plant.outputs[:n_z],
    )


def same_time(first: StateSpace, second: StateSpace) -> None:
    """Raise SynthesisError unless both systems have the same sampling time."""
    if first.dt != second.dt:
        raise SynthesisError(
            "interconnection", "dt", f"{first.dt} and {second.dt}", "one sampling time for both"
        )


def balancing(G: StateSpace) -> np.ndarray:
    """Powers of two t (n,) that even out the rows and columns of [A B; C 0] for x = diag(t) x̃.

    It is the method of Osborne (1960), by LAPACK's gebal. Inputs and outputs are not scaled. They enter the
    computation as one source and one sink node.
    """
    n = G.order
    graph = np.zeros((n + 2, n + 2))
    graph[:n, :n] = np.abs(G.A)
    np.fill_diagonal(graph, 0)
    graph[:n, n] = np.linalg.norm(G.B, axis=1)
    graph[n + 1, :n] = np.linalg.norm(G.C, axis=0)
    with np.errstate(
        invalid="ignore"
    ):  # scipy also converts the scales to row numbers, which fails for large ones
        return sl.matrix_balance(graph, separate=True, permute=False)[1][0][:n]


def scaled_states(G: StateSpace, t: np.ndarray) -> StateSpace:
    """G in the coordinates x = diag(t) x̃, with t (n,). It is exact when t holds powers of two."""
    return replace(G, A=G.A * t / t[:, None], B=G.B / t[:, None], C=G.C * t)


def balanced(G: StateSpace) -> StateSpace:
    """G with its states scaled by ``balancing``."""
    return scaled_states(G, balancing(G)) if G.order else G


def to_continuous(G: StateSpace, alpha: float | None = None) -> StateSpace:
    """Map a discrete system to a continuous one by z = (α + s)/(α − s), by default with α = 2/dt.

    The map keeps the H∞ norm and stability. Raises SynthesisError where −1 is an eigenvalue of A. A
    continuous system is returned unchanged.
    """
    if not G.dt:
        return G
    alpha = 2 / G.dt if alpha is None else alpha
    eye = np.eye(G.order)
    plus = eye + G.A
    if G.order and 1 / np.linalg.cond(plus) < 1e-13:
        raise SynthesisError(
            "discrete system", "A", "a pole at z = −1", "no pole at z = −1 (shift it by feedback)"
        )
    inverse = np.linalg.inv(plus)
    root = np.sqrt(2 * alpha)
    D = G.D - G.C @ inverse @ G.B
    A, B, C = alpha * inverse @ (G.A - eye), root * inverse @ G.B, root * G.C @ inverse
    # An entry that is exactly 0 (a zero at z = −1, an unreachable state) must not become a rounding error,
    # which scaling would treat as a weak coupling.
    size = np.abs(inverse)
    for exact, terms in (
        (A, alpha * size @ np.abs(G.A - eye)),
        (B, root * size @ np.abs(G.B)),
        (C, root * np.abs(G.C) @ size),
        (D, np.abs(G.D) + np.abs(G.C) @ size @ np.abs(G.B)),
    ):
        exact[np.abs(exact) <= 1e3 * EPS * terms] = 0.0
    return StateSpace(A, B, C, D, 0.0, G.inputs, G.outputs)


def to_discrete(G: StateSpace, dt: float, alpha: float | None = None) -> StateSpace:
    """Map a continuous system to a discrete one by s = α (z − 1)/(z + 1), the inverse of to_continuous.

    Parameters
    ----------
    G : StateSpace
    dt : float, s
    alpha : float, rad/s, optional, by default 2/dt (Tustin)

    Returns
    -------
    StateSpace

    Raises
    ------
    SynthesisError
        If α is an eigenvalue of A.
    """
    alpha = 2 / dt if alpha is None else alpha
    minus = alpha * np.eye(G.order) - G.A
    if G.order and 1 / np.linalg.cond(minus) < 1e-15:
        raise SynthesisError("continuous system", "A", f"a pole at {alpha:g} rad/s", "another sampling time")
    inverse = np.linalg.inv(minus)
    root = np.sqrt(2 * alpha)
    return StateSpace(
        inverse @ (alpha * np.eye(G.order) + G.A),
        root * inverse @ G.B,
        root * G.C @ inverse,
        G.D + G.C @ inverse @ G.B,
        dt,
        G.inputs,
        G.outputs,
    )


def prewarped(omega: Frequency, dt: float) -> Frequency:
    """Map frequencies of a discrete system to those of its bilinear continuous image.

    Parameters
    ----------
    omega : ndarray or float, rad/s
    dt : float, s, 0 for a continuous system

    Returns
    -------
    ndarray or float, rad/s
    """
    return 2 / dt * np.tan(0.5 * omega * dt) if dt else omega


def zero_order_hold(G: StateSpace, dt: float) -> StateSpace:
    """Sample a continuous system exactly, with inputs held over each step.

    Parameters
    ----------
    G : StateSpace
    dt : float, s

    Returns
    -------
    StateSpace
    """
    n, m = G.order, G.n_inputs
    big = np.zeros((n + m, n + m))
    big[:n, :n], big[:n, n:] = G.A * dt, G.B * dt
    big = sl.expm(big)
    return StateSpace(big[:n, :n], big[:n, n:], G.C, G.D, dt, G.inputs, G.outputs)
