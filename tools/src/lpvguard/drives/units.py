"""Units of measured signals, and factors between them."""

import re

import numpy as np

# To SI: dimension, factor.
_UNITS = {
    "rad": ("angle", 1.0),
    "deg": ("angle", np.pi / 180),
    "mrad": ("angle", 1e-3),
    "gon": ("angle", np.pi / 200),
    "turn": ("angle", 2 * np.pi),
    "rad/s": ("rate", 1.0),
    "deg/s": ("rate", np.pi / 180),
    "mrad/s": ("rate", 1e-3),
    "mdeg/s": ("rate", np.pi / 180e3),
    "gon/s": ("rate", np.pi / 200),
    "deg/min": ("rate", np.pi / 180 / 60),
    "rpm": ("rate", 2 * np.pi / 60),
    "m/s": ("speed", 1.0),
    "km/h": ("speed", 1 / 3.6),
    "mph": ("speed", 0.44704),
    "kn": ("speed", 1852 / 3600),
    "ft/s": ("speed", 0.3048),
    "cm/s": ("speed", 0.01),
    "mm/s": ("speed", 0.001),
    "m/s2": ("acceleration", 1.0),
    "g": ("acceleration", 9.80665),
    "Pa": ("pressure", 1.0),
    "kPa": ("pressure", 1e3),
    "bar": ("pressure", 1e5),
    "MPa": ("pressure", 1e6),
    "psi": ("pressure", 6894.757293168),
    "m": ("length", 1.0),
    "mm": ("length", 1e-3),
    "s": ("time", 1.0),
    "ms": ("time", 1e-3),
    "N": ("force", 1.0),
    "kN": ("force", 1e3),
    "Nm": ("torque", 1.0),
    "%": ("ratio", 0.01),
    "1": ("ratio", 1.0),
}
_SPELLINGS = {
    "°": "deg",
    "grad": "deg",
    "grad/s": "deg/s",
    "degree": "deg",
    "degrees": "deg",
    "°/s": "deg/s",
    "degree/s": "deg/s",
    "degrees/s": "deg/s",
    "deg/sec": "deg/s",
    "rad/sec": "rad/s",
    "°/min": "deg/min",
    "rev/min": "rpm",
    "r/min": "rpm",
    "1/min": "rpm",
    "u/min": "rpm",
    "rev": "turn",
    "turns": "turn",
    "kph": "km/h",
    "kmh": "km/h",
    "kmph": "km/h",
    "m/s^2": "m/s2",
    "m/s²": "m/s2",
    "m/sec2": "m/s2",
    "m/s/s": "m/s2",
    "m/s**2": "m/s2",
    "n·m": "nm",
    "n*m": "nm",
}
_SCALED = re.compile(r"\s*([\d.]+(?:e[-+]?\d+)?)\s+(\S.*)", re.IGNORECASE)
"""A number and a unit, as 0.034 m/s: what a signal of 1 means."""
_BY_LOWER_CASE = {name.lower(): name for name in _UNITS}


def unit_factor(source: str, target: str) -> float | None:
    """Return the factor between two units.

    Parameters
    ----------
    source, target : str

    Returns
    -------
    float, or None if a unit is unknown or they measure different things

    Examples
    --------
    >>> round(unit_factor("deg/s", "rad/s"), 6), unit_factor("km/h", "rad"), unit_factor("0.5 rad", "rad")
    (0.017453, None, 0.5)
    """
    if scaled := _SCALED.fullmatch(source):
        factor = unit_factor(scaled[2], target)
        return factor and float(scaled[1]) * factor
    if source == target:
        return 1.0
    known = []
    for text in (source, target):
        exact = text.strip()
        plain = exact.lower().replace(" ", "")
        name = exact if exact in _UNITS else _BY_LOWER_CASE.get(_SPELLINGS.get(plain, plain), "")
        known.append(_UNITS.get(name))
    if known[0] is None or known[1] is None or known[0][0] != known[1][0]:
        return None
    return known[0][1] / known[1][1]
