"""Stage 1: continuous LPV model of the project file, exact zero-order hold, simulation along a drive.

    x_{k+1} = Ad(v_k) x_k + B_old(v_k) u_{k-d-1} + B_new(v_k) u_{k-d},   yhat_k = C x_k + y0

``input_offset`` is subtracted from the input u. The input delay td = (d + f) Ts is split into whole samples d
and a fraction f. During the first f Ts of a sample interval the older input acts. This is exact if the input
is held between samples. Outside the speed range the model uses the nearest speed of the range, and the
monitor does not judge (THEORY 3.1).
"""

import ast
import ctypes
import operator
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property, lru_cache, reduce
from typing import Any, TypeVar

import numpy as np
from scipy.linalg import expm

from ..base import native
from ..base.errors import InputError
from .project import ModelSettings, Project
from .taylor import COEFFICIENTS, Taylor, greatest, least

Speed = TypeVar("Speed", np.ndarray, Taylor)
"""Type of the speed in an expression of a project file: speeds (m,) or an interval of speeds."""
_OPERATORS: dict[type[ast.AST], Callable[..., Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
}


def _sqrt(x: Any) -> Any:
    return x.sqrt() if isinstance(x, Taylor) else np.sqrt(x)


def _of_several(choose: Callable[..., Any], choose_bounds: Callable[..., Taylor]) -> Callable[..., Any]:
    """Apply ``choose`` to several values, or ``choose_bounds`` if one of two is an interval."""

    def function(*values: Any) -> Any:
        return reduce(
            lambda a, b: (choose_bounds if isinstance(a, Taylor) or isinstance(b, Taylor) else choose)(a, b),
            values,
        )

    return function


_FUNCTIONS: dict[str, tuple[Callable[..., Any], int, int]] = {
    "abs": (abs, 1, 1),
    "sqrt": (_sqrt, 1, 1),
    "min": (_of_several(np.minimum, least), 2, 99),
    "max": (_of_several(np.maximum, greatest), 2, 99),
}
"""Functions of an expression, each with its least and largest number of arguments."""


@lru_cache(maxsize=1024)
def _parsed(expression: str) -> ast.expr:
    """Syntax tree of an expression, cached because a fit evaluates the same expressions often."""
    return ast.parse(expression, mode="eval").body


def evaluate(expression: float | str, names: Mapping[str, Speed | float], where: str) -> Speed | float:
    """Evaluate an arithmetic expression of + - * / **, abs, min, max and sqrt.

    Parameters
    ----------
    expression : float or str
    names : Mapping, value of each name, ndarray (m,), float or interval
    where : str, place of the expression in errors

    Returns
    -------
    ndarray (m,), float or interval

    Raises
    ------
    InputError
        If the expression is malformed; the error names ``where`` and the wrong part.
    """
    if not isinstance(expression, str):
        return expression

    def walk(node: ast.expr) -> Speed | float:
        if isinstance(node, ast.Constant) and isinstance(node.value, (int, float)):
            return float(node.value)  # a large power of integers could fill the memory
        if isinstance(node, ast.Name) and node.id in names:
            return names[node.id]
        if isinstance(node, ast.BinOp) and type(node.op) in _OPERATORS:
            return _OPERATORS[type(node.op)](walk(node.left), walk(node.right))
        if isinstance(node, ast.UnaryOp) and type(node.op) in _OPERATORS:
            return _OPERATORS[type(node.op)](walk(node.operand))
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in _FUNCTIONS:
            return called(node, *_FUNCTIONS[node.func.id])
        raise InputError(
            where,
            expression,
            f"cannot use {ast.unparse(node)!r}",
            f"+ - * / ** and abs, min, max, sqrt over numbers and {', '.join(sorted(names))}",
        )

    def called(node: ast.Call, function: Callable[..., Any], fewest: int, most: int) -> Speed | float:
        if node.keywords or not fewest <= len(node.args) <= most:
            expected = "one value" if most == 1 else "two values or more"
            raise InputError(where, expression, f"cannot use {ast.unparse(node)!r}", expected)
        values = [walk(argument) for argument in node.args]
        if function is _sqrt and not isinstance(values[0], Taylor) and np.any(np.asarray(values[0]) < 0):
            raise InputError(where, expression, f"{ast.unparse(node)!r} has a negative argument", "0 or more")
        return function(*values)

    try:
        body = _parsed(expression)
    except (SyntaxError, ValueError, RecursionError, MemoryError):  # a NUL; too many nested brackets
        raise InputError(
            where,
            expression,
            "not an arithmetic expression",
            "+ - * / ** and abs, min, max, sqrt over v and parameters",
        ) from None
    try:
        return walk(body)
    except (ArithmeticError, RecursionError) as error:
        raise InputError(where, expression, f"has no value ({error})", "a finite number") from None


@dataclass(frozen=True)
class DiscreteModel:
    """Zero-order-hold matrices at m speeds: Ad (m, n, n), B_old and B_new (m, n, n_u)."""

    Ad: np.ndarray
    B_old: np.ndarray
    B_new: np.ndarray


TABLE_TOLERANCE = 1e-6
"""Largest error of a tabulated model entry, divided by its largest magnitude over the speed range."""


@dataclass(frozen=True)
class SpeedTable:
    """Table of the model entries over speed, as in the core.

    Entries are Ad, B_old, B_new row by row. The speed range is divided into cells of equal width. Each cell
    holds cubic polynomials of the position 0..1 in the cell.

    Attributes
    ----------
    speed_range : tuple[float, float], m/s
    base : ndarray (n_entries,)
    varying : ndarray (n_varying,) of int, indices of the entries that vary
    cell : ndarray (cells, n_varying, 4), coefficients of the cubics
    error : float, largest relative error against the exact zero-order hold
    """

    speed_range: tuple[float, float]
    base: np.ndarray
    varying: np.ndarray
    cell: np.ndarray
    error: float

    def at(self, v: np.ndarray) -> np.ndarray:
        """Entries (m, n_entries) at speeds v (m,), clamped to the range."""
        position = self.position(v)
        cell = np.minimum(position.astype(int), len(self.cell) - 1)
        p = (position - cell)[:, None]
        c = np.moveaxis(self.cell[cell], -1, 0)
        out = np.repeat(self.base[None], len(position), axis=0)
        out[:, self.varying] = c[0] + p * (c[1] + p * (c[2] + p * c[3]))
        return out

    def position(self, v: np.ndarray) -> np.ndarray:
        """Position (m,) of speeds v (m,), in cell widths from the low end, clamped to the range."""
        low, high = self.speed_range
        return (np.clip(v, low, high) - low) / (high - low) * len(self.cell)


def tabulate(
    entries: Callable[[np.ndarray], np.ndarray], low: float, high: float, cells: int | None = None
) -> SpeedTable:
    """Interpolate entries over speed by cubics through four Chebyshev points per cell.

    Parameters
    ----------
    entries : Callable, speeds (m,) -> (m, n)
    low, high : float, m/s
    cells : int, optional, by default as many as needed; with a given number the error is NaN

    Returns
    -------
    SpeedTable

    References
    ----------
    THEORY 3.1.
    """
    samples = entries(np.linspace(low, high, 101 if cells is None else 2 * cells + 1))
    size = np.abs(samples).max(axis=0)
    varying = np.flatnonzero(np.ptp(samples, axis=0) > TABLE_TOLERANCE * size)
    # The core's arrays must not be empty; an entry that does not vary is harmless in the table.
    varying = varying if len(varying) else np.array([0])
    nodes = 0.5 - 0.5 * np.cos(np.pi * (np.arange(4) + 0.5) / 4)
    to_cubic = np.linalg.inv(np.vander(nodes, 4, increasing=True))
    check = np.linspace(0.0, 1.0, 33)
    error = np.nan
    counts = (2, 4, 8, 16, 32, 64) if cells is None else (cells,)
    for count in counts:
        width = (high - low) / count
        left = low + width * np.arange(count)
        at_nodes = entries((left[:, None] + width * nodes).ravel())[:, varying].reshape(count, 4, -1)
        cell = np.einsum("ij,cjv->cvi", to_cubic, at_nodes)
        if cells is not None:
            break
        # A few points per cell already rule out most tables; the chosen table is checked at all points.
        for points in (check,) if count == counts[-1] else (check[::8], check):
            exact = entries((left[:, None] + width * points).ravel())[:, varying]
            table = np.einsum("cvi,pi->cpv", cell, np.vander(points, 4, increasing=True))
            off = np.abs(table - exact.reshape(table.shape))
            error = float(np.max(off / np.maximum(size[varying], np.finfo(float).tiny)))
            if error > TABLE_TOLERANCE:
                break
        if error <= TABLE_TOLERANCE:
            break
    return SpeedTable((low, high), samples[0], varying, cell, error)


def recursion(Ad: np.ndarray, forced: np.ndarray, x_first: np.ndarray) -> np.ndarray:
    """Run x_{k+1} = Ad_k x_k + forced_k.

    Parameters
    ----------
    Ad : ndarray (N, n, n)
    forced : ndarray (N, n)
    x_first : ndarray (n,)

    Returns
    -------
    ndarray (N, n), states
    """
    Ad, forced, x = (np.ascontiguousarray(a, float) for a in (Ad, forced, x_first))
    samples, n = forced.shape
    states = np.empty((samples, n))
    sizes = map(ctypes.c_ssize_t, (samples, n))
    native.kernels("recursion").lpvg_recursion(*sizes, *map(native.pointer, (Ad, forced, x, states)))
    return states


def entries_at(
    model: ModelSettings, v: Speed, where: str
) -> tuple[list[list[Speed | float]], list[list[Speed | float]]]:
    """Entries of A and B, row by row, at speed ``v``."""
    names: dict[str, Speed | float] = {"v": v, **model.parameters}
    for name, expression in model.let.items():
        names[name] = evaluate(expression, names, f"{where}, model.let.{name}")

    def matrix(key: str) -> list[list[Speed | float]]:
        return [
            [evaluate(entry, names, f"{where}, model.{key}[{i}][{j}]") for j, entry in enumerate(row)]
            for i, row in enumerate(getattr(model, key))
        ]

    return matrix("A"), matrix("B")


def state_space(model: ModelSettings, v: np.ndarray | float, where: str) -> tuple[np.ndarray, np.ndarray]:
    """Evaluate A (m, n, n) and B (m, n, n_u) of a project file's model at any speeds v (m,) [m/s].

    ``where`` is the model's name in errors.
    """
    v = np.atleast_1d(np.asarray(v, float))

    def filled(entries: list[list[np.ndarray | float]]) -> np.ndarray:
        out = np.empty((len(v), len(entries), len(entries[0])))
        for i, row in enumerate(entries):
            for j, entry in enumerate(row):
                out[:, i, j] = entry
        return out

    with np.errstate(all="ignore"):
        A, B = (filled(entries) for entries in entries_at(model, v, where))
    bad = ~(np.isfinite(A).all((1, 2)) & np.isfinite(B).all((1, 2)))
    if bad.any():
        raise InputError(where, f"v = {v[bad][0]:.6g} m/s", "the model is not finite there", "finite A and B")
    return A, B


class NominalModel:
    """Nominal LPV model of a project file: n states, n_u inputs, n_y outputs.

    Matrices have the units of the signal table; speeds [m/s] lie within ``speed_range``.

    Parameters
    ----------
    project : Project

    Raises
    ------
    InputError
        If the model is unstable or not finite somewhere in its speed range.
    """

    def __init__(self, project: Project):
        self._settings, self._where = project.model, f"vehicle {project.name}"
        self.Ts = project.Ts_s
        self.n, self.n_u, self.n_y = len(self._settings.A), project.n_u, project.n_y
        self.C = np.array(self._settings.C, float)
        self.input_offset = np.array(self._settings.input_offset or [0.0] * self.n_u)
        self.output_offset = np.array(self._settings.output_offset or [0.0] * self.n_y)
        self.speed_range = (self._settings.speed_min_mps, self._settings.speed_max_mps)
        delay = self._settings.input_delay_s / self.Ts
        # A delay that is a decimal multiple of Ts must not get a fraction of 1e-16 by rounding.
        self.delay = round(delay) if abs(delay - round(delay)) < 1e-9 else int(np.floor(delay))
        self.delay_fraction = 0.0 if abs(delay - round(delay)) < 1e-9 else delay - self.delay
        self._require_stable()

    def matrices(self, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """A (m, n, n) and B (m, n, n_u) at speeds v (m,) [m/s]."""
        return state_space(self._settings, v, self._where)

    def hold_bounds(self, low: float, high: float) -> tuple[np.ndarray, np.ndarray]:
        """Entrywise bounds of |d/dv| and |d2/dv2| of [Ad, Bd, Gd] (n, n + n_u + n) over low..high [m/s]. Ad
        and Bd are the zero-order hold of A and B; Gd is that of an input on every state. If the input delay
        is not a whole number of samples, Bd has two columns per input: for the previous and for the present
        sample. The bounds are rigorous up to rounding. The exponential's power series has positive
        coefficients. Bounds of A, B and their Taylor coefficients in v therefore give bounds of the hold.
        Raises InputError when an entry has a fractional exponent, or a kink of abs, min or max between low
        and high. Raises it also when the bounds of a denominator or of the argument of a root contain 0."""
        n, width = self.n, 2 * self.n + self.n_u
        bounds = np.zeros((COEFFICIENTS, width, width))
        try:
            entries = entries_at(self._settings, Taylor.variable(low, high), self._where)
        except (TypeError, ZeroDivisionError) as error:
            raise InputError(
                self._where,
                "model",
                f"cannot be bounded between {low:g} and {high:g} m/s: {error}",
                "entries of + - * /, whole exponents and roots in v, without a kink there",
            ) from None
        for first, matrix in zip((0, n), entries, strict=False):
            for i, row in enumerate(matrix):
                for j, entry in enumerate(row):
                    bounds[:, i, first + j] = Taylor.from_value(entry).magnitude
        bounds[0, :n, n + self.n_u :] = np.eye(n)
        series = np.block(
            [
                [bounds[k - i] if k >= i else np.zeros((width, width)) for k in range(COEFFICIENTS)]
                for i in range(COEFFICIENTS)
            ]
        )

        def held(duration: float) -> list[np.ndarray]:
            """Bounds (n, width) of the coefficients of the hold."""
            e = expm(series * duration)
            return [e[:n, k * width : (k + 1) * width] for k in range(COEFFICIENTS)]

        whole = held(self.Ts)
        if self.delay_fraction:
            late, early = (held(part * self.Ts) for part in (self.delay_fraction, 1 - self.delay_fraction))
            u = slice(n, n + self.n_u)
            whole = [
                np.hstack(
                    [
                        whole[k][:, :n],
                        sum(early[i][:, :n] @ late[k - i][:, u] for i in range(k + 1)),
                        early[k][:, u],
                        whole[k][:, n + self.n_u :],
                    ]
                )
                for k in range(COEFFICIENTS)
            ]
        return whole[1], 2 * whole[2]

    @property
    def held_states(self) -> int:
        """Number of states of the sampled vehicle: n, plus n_u if the delay has a fraction of a sample."""
        return self.n + (self.n_u if self.delay_fraction else 0)

    @cached_property
    def least_state_of_output(self) -> np.ndarray:
        """Pseudoinverse (n, n_y) of C."""
        return np.linalg.pinv(self.C)

    @cached_property
    def slowest_pole(self) -> float:
        """Smallest |Re lambda| over the speed range [rad/s]."""
        return float(-self._abscissa.max())

    @cached_property
    def _speed_samples(self) -> np.ndarray:
        return np.linspace(*self.speed_range, 257)

    @cached_property
    def _abscissa(self) -> np.ndarray:
        return np.linalg.eigvals(self.matrices(self._speed_samples)[0]).real.max(axis=1)

    def _require_stable(self) -> None:
        worst = int(np.argmax(self._abscissa))
        if self._abscissa[worst] >= 0:
            raise InputError(
                self._where,
                f"v = {self._speed_samples[worst]:.4g} m/s",
                f"the nominal model is unstable (max Re lambda = {self._abscissa[worst]:.3g} rad/s)",
                "a stable model over speed_min_mps..speed_max_mps",
            )

    @property
    def settle_samples(self) -> int:
        """Samples until the initial state has decayed to e^-5 at the slowest pole (THEORY 3.2)."""
        return int(np.ceil(5.0 / self.slowest_pole / self.Ts))

    def require_speed(self, v: float) -> None:
        """Raise InputError when v [m/s] is outside the speed range."""
        low, high = self.speed_range
        if not low <= v <= high:
            raise InputError(
                self._where, f"v = {v:g} m/s", "outside the model's speed range", f"{low:g} to {high:g} m/s"
            )

    def discretise(self, v: np.ndarray) -> DiscreteModel:
        """Exact zero-order hold at speeds v (m,), clamped to the speed range."""
        A, B = self.matrices(np.clip(v, *self.speed_range))
        m, n = len(A), self.n
        augmented = np.zeros((m, n + self.n_u, n + self.n_u))
        augmented[:, :n, :n], augmented[:, :n, n:] = A, B

        def hold(duration: float) -> tuple[np.ndarray, np.ndarray]:
            e = self.exponential(augmented * duration)
            return e[:, :n, :n], e[:, :n, n:]

        old = self.delay_fraction * self.Ts
        phi_new, gamma_new = hold(self.Ts - old)
        if not old:
            return DiscreteModel(phi_new, np.zeros_like(gamma_new), gamma_new)
        phi_old, gamma_old = hold(old)
        return DiscreteModel(phi_new @ phi_old, phi_new @ gamma_old, gamma_new)

    def frequency_response(self, omega: np.ndarray, v: float) -> np.ndarray:
        """G(e^{j omega Ts}) (K, n_y, n_u) at frozen v, delay included; omega [rad/s]."""
        self.require_speed(v)
        d = self.discretise(np.array([v]))
        z = np.exp(1j * np.asarray(omega, float) * self.Ts)[:, None, None]
        numerator = (d.B_old[0] / z + d.B_new[0]) * z**-self.delay
        return self.C @ np.linalg.solve(z * np.eye(self.n) - d.Ad[0], numerator)

    def dc_gain(self, v: np.ndarray) -> np.ndarray:
        """Steady-state gains (m, n_y, n_u) at frozen speeds v (m,) [m/s], without offsets."""
        A, B = self.matrices(v)
        return -(self.C @ np.linalg.solve(A, B))

    def acting_inputs(self, u: np.ndarray, before: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Inputs u_{k-d-1} and u_{k-d} (N, n_u) that act during step k, without offset, from u (N, n_u).

        ``before`` (delay + 1, n_u) holds the inputs before u[0]; by default they equal u[0].
        """
        u = np.asarray(u, float)
        du = u - self.input_offset
        earlier = np.repeat(u[:1], self.delay + 1, axis=0) if before is None else before
        past = np.vstack([earlier - self.input_offset, du])
        return past[: len(du)], past[1 : len(du) + 1]

    def simulate(self, v: np.ndarray, u: np.ndarray, y_first: np.ndarray) -> np.ndarray:
        """Nominal output yhat (N, n_y) for v (N,) [m/s], u (N, n_u), from the measured y_first (n_y,).

        Before the first sample the input is constant. The initial state is the smallest one that gives
        y_first. The model uses the speed table, as in the core.
        """
        return RunningModel(self, y_first).run(v, u)

    def states(self, v: np.ndarray, older: np.ndarray, newer: np.ndarray, first: np.ndarray) -> np.ndarray:
        """States (N + 1, n) along speeds v (N,) from ``first`` (n,), with the speed table.

        The inputs are the `acting_inputs`, (N, n_u) each.
        """
        table = self.table
        states = np.empty((len(v) + 1, self.n))
        states[0] = first
        sizes = (len(v), self.n, self.n_u, len(table.cell), len(table.varying))
        index = np.asarray(table.varying, np.intp)
        reals = [np.ascontiguousarray(a, float) for a in (table.cell, table.position(v), older, newer)]
        native.kernels("recursion").lpvg_scheduled(
            *map(ctypes.c_ssize_t, sizes), *map(native.pointer, (index, *reals, table.base.copy(), states))
        )
        return states

    @cached_property
    def table(self) -> SpeedTable:
        """Table of the model entries over speed, used by identification and the core."""
        return _table_of(_ByText(f"{self.Ts} {self._settings.model_dump_json()}", self))

    def discrete_entries(self, v: np.ndarray) -> np.ndarray:
        """Ad, B_old, B_new row by row at speeds v (m,): (m, n_entries)."""
        d = self.discretise(v)
        return np.concatenate([m.reshape(len(v), -1) for m in (d.Ad, d.B_old, d.B_new)], axis=1)

    @staticmethod
    def exponential(a: np.ndarray) -> np.ndarray:
        """Matrix exponentials of the matrices a (m, n, n), in the same shape."""
        return expm(a)

    def split(self, entries: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Ad (m, n, n), B_old and B_new (m, n, n_u) of the rows of ``discrete_entries``."""
        m, n, n_u = len(entries), self.n, self.n_u
        a, b = n * n, n * (n + n_u)
        return (
            entries[:, :a].reshape(m, n, n),
            entries[:, a:b].reshape(m, n, n_u),
            entries[:, b:].reshape(m, n, n_u),
        )


@dataclass(frozen=True)
class _ByText:
    """A model that is compared by its ``text``, because the text determines its table."""

    text: str
    model: NominalModel = field(compare=False)


@lru_cache(maxsize=16)
def _table_of(one: _ByText) -> SpeedTable:
    """Speed table, cached for all models of a project because its computation is slow."""
    return tabulate(one.model.discrete_entries, *one.model.speed_range)


class RunningModel:
    """Nominal model along a drive that arrives in one or several pieces.

    Parameters
    ----------
    model : NominalModel
    y_first : ndarray (n_y,), measured output; the run starts at the smallest state with this output
    """

    def __init__(self, model: NominalModel, y_first: np.ndarray):
        self._model = model
        self._x = model.least_state_of_output @ (np.asarray(y_first, float) - model.output_offset)
        self._before: np.ndarray | None = None

    def run(self, v: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Nominal output (N, n_y) of the next N samples with v (N,) [m/s] and u (N, n_u)."""
        model, u = self._model, np.asarray(u, float)
        if not len(u):
            return np.empty((0, len(model.C)))
        x = model.states(np.asarray(v, float), *model.acting_inputs(u, self._before), self._x)
        self._x = x[-1]
        earlier = np.repeat(u[:1], model.delay + 1, axis=0) if self._before is None else self._before
        self._before = np.vstack([earlier, u])[-(model.delay + 1) :]
        return x[:-1] @ model.C.T + model.output_offset
