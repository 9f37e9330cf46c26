"""A weight: a real rational transfer function, its magnitude and its state-space realisation."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import solve_continuous_lyapunov

from ...base.errors import InputError


@dataclass(frozen=True, eq=False)
class Weight:
    """Real, rational and proper transfer function W(s) = num(s)/den(s).

    Attributes
    ----------
    num : ndarray (m + 1,), m <= n, real coefficients in descending powers of s [rad/s]
    den : ndarray (n + 1,), real coefficients in the same order

    Raises
    ------
    InputError
        If a coefficient is not finite, a leading coefficient is zero, or W is improper.

    Examples
    --------
    >>> float(Weight(num=np.array([1.0, 2.0]), den=np.array([1.0, 1.0])).magnitude(0.0))
    2.0
    """

    num: np.ndarray
    den: np.ndarray

    def __post_init__(self) -> None:
        for name in ("num", "den"):
            value = np.array(getattr(self, name), dtype=float)
            if value.ndim != 1 or value.size == 0 or not np.all(np.isfinite(value)) or value[0] == 0.0:
                raise InputError(
                    "weight", name, f"{value.tolist()}", "a list of finite coefficients whose first is not 0"
                )
            value.setflags(write=False)
            object.__setattr__(self, name, value)
        if self.num.size > self.den.size:
            raise InputError(
                "weight",
                "num",
                f"degree {self.num.size - 1} over degree {self.den.size - 1}",
                "a proper transfer function",
            )

    @property
    def order(self) -> int:
        """Number of states: the degree of ``den``."""
        return self.den.size - 1

    def zeros(self) -> np.ndarray:
        """Roots of ``num`` (m,), complex, rad/s."""
        return polynomial_roots(self.num)

    def poles(self) -> np.ndarray:
        """Roots of ``den`` (n,), complex, rad/s."""
        return polynomial_roots(self.den)

    def __call__(self, s: ArrayLike) -> np.ndarray:
        """W at the complex points ``s`` (rad/s), any shape."""
        s = np.asarray(s, dtype=complex)
        return np.polyval(self.num, s) / np.polyval(self.den, s)

    def magnitude(self, omega: ArrayLike) -> np.ndarray:
        """|W(j omega)| at ``omega`` >= 0 (rad/s), any shape."""
        return np.abs(self(1j * np.asarray(omega, dtype=float)))

    def to_state_space(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Realisation A (n,n), B (n,1), C (1,n), D (1,1) of a stable W.

        It is a chain of first- and second-order sections, slow to fast. Each section is computed
        from its own poles, so poles many decades apart keep their accuracy. Powers of two scale the states
        until the diagonals of both Gramians agree within a factor of four.
        """
        sections = _sections(self.num, self.den)
        a, b, c, d = np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.array([[1.0]])
        for a2, b2, c2, d2 in sections:
            a = np.block([[a, np.zeros((len(a), len(a2)))], [b2 @ c, a2]])
            b, c, d = np.vstack([b, b2 @ d]), np.hstack([d2 @ c, c2]), d2 @ d
        reach = np.diag(solve_continuous_lyapunov(a, -b @ b.T))
        observe = np.diag(solve_continuous_lyapunov(a.T, -c.T @ c))
        known = observe > 0  # a state without effect on W keeps its scale
        scale = np.ones(len(a))
        scale[known] = np.exp2(np.round(np.log2(observe[known] / reach[known]) / 4))
        return a * scale[:, None] / scale[None, :], b * scale[:, None], c / scale[None, :], d

    def to_dict(self) -> dict:
        """``num`` and ``den`` as lists for JSON. Python prints floats so that they read back exactly."""
        return {"num": self.num.tolist(), "den": self.den.tolist()}

    @classmethod
    def from_dict(cls, data: dict) -> Weight:
        """Read a weight written by :meth:`to_dict`; raises InputError when keys or numbers are missing."""
        try:
            return cls(num=np.asarray(data["num"], dtype=float), den=np.asarray(data["den"], dtype=float))
        except (KeyError, TypeError) as problem:
            raise InputError(
                "weight", "", f"cannot be read ({problem!r})", "keys num and den, lists of numbers"
            ) from problem


def polynomial_roots(polynomial: np.ndarray) -> np.ndarray:
    """Roots (n,) of a ``polynomial`` (n + 1,) in descending powers, the first not 0.

    They are computed in a unit that puts their geometric mean near 1.
    """
    n = len(polynomial) - 1
    if n == 0 or polynomial[-1] == 0:
        return np.roots(polynomial)
    unit = 2.0 ** round(math.log2(abs(polynomial[-1] / polynomial[0])) / n)
    return unit * np.roots(polynomial * unit ** np.arange(n, -1, -1.0))


def _quadratics(roots: np.ndarray) -> list[np.ndarray]:
    """Monic real factors of degree two, slow to fast, then one of degree one if the degree is odd."""
    real = sorted((float(r.real) for r in roots if r.imag == 0), key=abs)
    factors = [np.array([1.0, -2.0 * r.real, abs(r) ** 2]) for r in roots if r.imag > 0]
    factors += [np.poly(real[i : i + 2]) for i in range(0, len(real), 2)]
    return sorted(factors, key=lambda f: (-len(f), f[-1]))


def _sections(num: np.ndarray, den: np.ndarray) -> list[tuple[np.ndarray, ...]]:
    """(A, B, C, D) of first- and second-order factors whose product is num/den.

    Pairs come first in numerator and denominator. A proper weight has at least as many pairs of poles as
    pairs of zeros, so each pair of zeros gets a pair of poles.
    """
    gain = num[0] / den[0]
    tops, bottoms = _quadratics(polynomial_roots(num)), _quadratics(polynomial_roots(den))
    sections: list[tuple[np.ndarray, ...]] = []
    for bottom in bottoms:
        size = len(bottom) - 1
        top = tops.pop(0) if tops else np.ones(1)
        top = np.concatenate([np.zeros(size + 1 - len(top)), top])
        d = top[0]
        if size == 1:
            a, b, c = [[-bottom[1]]], [[1.0]], [[top[1] - d * bottom[1]]]
        else:
            poles = polynomial_roots(bottom)
            if not poles.imag.any():
                p1, p2 = sorted(-poles.real)
                a, b = [[-p1, 0.0], [1.0, -p2]], [[1.0], [0.0]]
                first = top[1] - d * (p1 + p2)
                c = [[first, top[2] - d * p1 * p2 - first * p2]]
            else:
                w = math.sqrt(bottom[2])
                a, b = [[0.0, w], [-w, -bottom[1]]], [[0.0], [1.0]]
                c = [[(top[2] - d * bottom[2]) / w, top[1] - d * bottom[1]]]
        sections.append(tuple(np.array(m, dtype=float) for m in (a, b, c, [[d]])))
    sections.append((np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.array([[gain]])))
    return sections
