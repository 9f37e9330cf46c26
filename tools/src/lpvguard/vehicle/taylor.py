"""Bounds of a function of one variable and of its first two Taylor coefficients over an interval.

The method is interval arithmetic on truncated power series. An expression with + - * / **, sqrt, abs, min and
max is evaluated with ``Taylor.variable(low, high)`` as its variable. The result encloses f, f' and f''/2 at
every point of [low, high], up to rounding.

>>> f = 1 / Taylor.variable(2.0, 4.0)
>>> [float(x) for x in f.low], [float(x) for x in f.high]
([0.25, -0.25, 0.015625], [0.5, -0.0625, 0.125])
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

COEFFICIENTS = 3


@dataclass(frozen=True)
class Taylor:
    """Enclosure low <= [f, f', f''/2] <= high, (3,) each."""

    low: np.ndarray
    high: np.ndarray

    @classmethod
    def variable(cls, low: float, high: float) -> Taylor:
        """The independent variable on [low, high]."""
        return cls(np.array([low, 1.0, 0.0]), np.array([high, 1.0, 0.0]))

    @classmethod
    def from_value(cls, value: Taylor | float) -> Taylor:
        """Return a ``value`` of this type, or a number as a constant function."""
        if isinstance(value, Taylor):
            return value
        constant = np.array([float(value), 0.0, 0.0])
        return cls(constant, constant)

    @property
    def magnitude(self) -> np.ndarray:
        """Bounds of |f|, |f'|, |f''|/2, (3,)."""
        return np.maximum(np.abs(self.low), np.abs(self.high))

    def __neg__(self) -> Taylor:
        return Taylor(-self.high, -self.low)

    def __pos__(self) -> Taylor:
        return self

    def __add__(self, other: Taylor | float) -> Taylor:
        other = Taylor.from_value(other)
        return Taylor(self.low + other.low, self.high + other.high)

    def __sub__(self, other: Taylor | float) -> Taylor:
        return self + -Taylor.from_value(other)

    def __mul__(self, other: Taylor | float) -> Taylor:
        other = Taylor.from_value(other)
        low, high = np.zeros(COEFFICIENTS), np.zeros(COEFFICIENTS)
        for k in range(COEFFICIENTS):
            for i in range(k + 1):
                ends = np.outer((self.low[i], self.high[i]), (other.low[k - i], other.high[k - i]))
                low[k], high[k] = low[k] + ends.min(), high[k] + ends.max()
        return Taylor(low, high)

    def __truediv__(self, other: Taylor | float) -> Taylor:
        other = Taylor.from_value(other)
        if other.low[0] <= 0 <= other.high[0]:
            raise ZeroDivisionError("the denominator's interval contains zero")
        # 1/g = 1/g0 - g1/g0^2 s + (g1^2/g0^3 - g2/g0^2) s^2, each quotient is enclosed separately
        inverse = _interval(1 / other.high[0], 1 / other.low[0])
        g1, g2 = (_interval(other.low[k], other.high[k]) for k in (1, 2))
        square = inverse * inverse
        parts = [inverse, -(g1 * square), g1 * g1 * square * inverse - g2 * square]
        return self * Taylor(np.array([p.low[0] for p in parts]), np.array([p.high[0] for p in parts]))

    def __pow__(self, exponent: Taylor | float) -> Taylor:
        if isinstance(exponent, Taylor) or not float(exponent).is_integer():
            raise TypeError("only whole exponents")
        out = Taylor.from_value(1.0)
        for _ in range(abs(int(exponent))):
            out = out * self
        return out if exponent >= 0 else 1 / out

    def sqrt(self) -> Taylor:
        """Square root. ZeroDivisionError unless the interval lies above zero."""
        if self.low[0] <= 0:
            raise ZeroDivisionError("the root's interval contains zero or less")
        # sqrt(g) = h + g1/(2 h) s + (g2/(2 h) - g1^2/(8 h^3)) s^2 with h = sqrt(g0)
        root = _interval(float(np.sqrt(self.low[0])), float(np.sqrt(self.high[0])))
        inverse = 1 / root
        g1, g2 = (_interval(self.low[k], self.high[k]) for k in (1, 2))
        parts = [root, 0.5 * g1 * inverse, 0.5 * g2 * inverse - 0.125 * g1 * g1 * inverse**3]
        return Taylor(np.array([p.low[0] for p in parts]), np.array([p.high[0] for p in parts]))

    def __abs__(self) -> Taylor:
        return greatest(self, -self)

    def __radd__(self, other: Taylor | float) -> Taylor:
        return self + other

    def __rsub__(self, other: Taylor | float) -> Taylor:
        return -self + other

    def __rmul__(self, other: Taylor | float) -> Taylor:
        return self * other

    def __rtruediv__(self, other: Taylor | float) -> Taylor:
        return Taylor.from_value(other) / self


def greatest(one: Taylor | float, other: Taylor | float) -> Taylor:
    """Larger of two functions. Raises TypeError if the interval may contain a kink."""
    one, other = Taylor.from_value(one), Taylor.from_value(other)
    if one.low[0] >= other.high[0]:
        return one
    if other.low[0] >= one.high[0]:
        return other
    raise TypeError("abs, min or max has a kink there")


def least(one: Taylor | float, other: Taylor | float) -> Taylor:
    """Smaller of two functions. Raises TypeError if the interval may contain a kink."""
    return -greatest(-Taylor.from_value(one), -Taylor.from_value(other))


def _interval(low: float, high: float) -> Taylor:
    return Taylor(np.array([low, 0.0, 0.0]), np.array([high, 0.0, 0.0]))
