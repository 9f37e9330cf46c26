"""Read the fields of one problem (solve.py) with type checks, and write complex numbers as [re, im]."""

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lpvguard.base.errors import InputError


class Fields:
    """Typed access to one problem's fields.

    Every method raises an InputError that names the problem and the field when the field does not fit.
    """

    def __init__(self, problem: dict):
        self.problem = problem
        self.source = f"problem {problem.get('id', '(no id)')}"

    def error(self, where: str, what: str, expected: str | None = None) -> InputError:
        """Make an InputError about one field."""
        return InputError(self.source, where, what, expected)

    def has(self, name: str) -> bool:
        """Tell if the field exists and is not null."""
        return self.problem.get(name) is not None

    def raw(self, name: str) -> Any:
        """JSON value of the field; InputError if it is missing."""
        if not self.has(name):
            raise self.error(name, "missing", "a value")
        return self.problem[name]

    def _array(self, name: str, expected: str) -> np.ndarray:
        value = self.raw(name)
        try:
            a = np.asarray(value, dtype=float)
        except (TypeError, ValueError):
            raise self.error(name, "not a regular array of numbers", expected) from None
        if not np.all(np.isfinite(a)):
            raise self.error(name, "a value that is not finite", expected)
        return a

    def real(self, name: str, shape: tuple[int | None, ...] = ()) -> np.ndarray:
        """Finite real array of the shape ``shape`` (None: any length; (): a scalar)."""
        expected = f"finite real numbers of shape {_shape_text(shape)}" if shape else "one finite real number"
        a = self._array(name, expected)
        if not _fits(a.shape, shape):
            raise self.error(name, f"shape {a.shape}", expected)
        return a

    def number(self, name: str, *, positive: bool = False) -> float:
        """One finite number >= 0, or > 0 with ``positive``."""
        value = float(self.real(name))
        if value < 0.0 or (positive and value == 0.0):
            raise self.error(
                name, f"{value:g}", "a positive number" if positive else "a number that is not negative"
            )
        return value

    def weights(self, name: str, length: int, *, positive: bool = False) -> np.ndarray:
        """Finite numbers (length,) >= 0, or > 0 with ``positive``."""
        a = self.real(name, (length,))
        if np.any(a < 0.0) or (positive and np.any(a == 0.0)):
            raise self.error(
                name, f"{np.min(a):g}", "positive numbers" if positive else "numbers that are not negative"
            )
        return a

    def complex(self, name: str, shape: tuple[int | None, ...]) -> np.ndarray:
        """Finite complex array of the shape ``shape`` (None: any length) from [re, im] pairs.

        A matrix without columns may be written ``[[], []]``.
        """
        expected = f"finite [re, im] pairs of shape {_shape_text(shape)}"
        a = self._array(name, expected)
        sizes = [s for s in shape if s is not None]
        if a.size == 0 and len(sizes) == len(shape) and math.prod(sizes) == 0:
            return np.zeros(sizes, dtype=complex)
        if a.ndim != len(shape) + 1 or a.shape[-1] != 2 or not _fits(a.shape[:-1], shape):
            raise self.error(name, f"shape {a.shape}", expected)
        return a[..., 0] + 1j * a[..., 1]


def _fits(actual: tuple[int, ...], expected: tuple[int | None, ...]) -> bool:
    return len(actual) == len(expected) and all(
        w is None or a == w for a, w in zip(actual, expected, strict=True)
    )


def _shape_text(shape: tuple[int | None, ...]) -> str:
    return "(" + ", ".join("n" if s is None else str(s) for s in shape) + ")"


def pairs(a: ArrayLike) -> list:
    """Write a complex array as nested lists of [re, im].

    Parameters
    ----------
    a : array_like (..., n)

    Returns
    -------
    list
    """
    a = np.asarray(a, dtype=complex)
    return np.stack([a.real, a.imag], axis=-1).tolist()
