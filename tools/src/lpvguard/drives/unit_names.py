"""Units that names and logs state, in the spellings of loggers: tokens of a name, brackets, German words.

A unit is what a role's signal is measured in: a speed, an angle, or an angle over time. Spellings that
loggers use in a sense of their own come first ("grad" is a degree in German, "ms" of a speed is m/s). The
package pint reads all other spellings.
"""

import re
from functools import cache
from itertools import product
from typing import Any

from .units import unit_factor

_LENGTHS = {
    "m": ("m", "meter", "meters", "metre", "metres"),
    "km": ("km", "kilometer", "kilometers", "kilometre", "kilometres"),
    "mi": ("mi", "mile", "miles", "meilen"),
    "ft": ("ft", "feet", "foot"),
    "cm": ("cm",),
    "mm": ("mm",),
}
_TIMES = {
    "s": ("s", "sec", "secon", "secs", "second", "seconds", "sek", "sekunde"),
    "h": ("h", "hr", "hour", "hours", "std", "stunde"),
}
_ANGLES = {
    "rad": ("rad", "rads", "radian", "radians", "radiant"),
    "deg": (
        "deg",
        "degs",
        "degreofarc",
        "degreeofarc",
        "degree",
        "degrees",
        "grad",
        "degré",
        "degrés",
        "degre",
        "grados",
        "gradi",
        "graus",
        "graden",
        "grader",
        "°",
        "º",
    ),
    "mrad": ("mrad", "milliradian", "milliradians"),
    "gon": ("gon", "gons", "gradian", "gradians"),
    "turn": ("turn", "turns", "rev", "revs", "umdrehungen"),
}
_OVER = ("", "p", "per", "pro")
_SPEED_WORDS = {
    "mph": "mph",
    "kph": "km/h",
    "kmph": "km/h",
    "kmh": "km/h",
    "mps": "m/s",
    "fps": "ft/s",
    "kn": "kn",
    "kt": "kn",
    "kts": "kn",
    "knot": "kn",
    "knots": "kn",
    "knoten": "kn",
}
_RATE_WORDS = {"dps": "deg/s", "radps": "rad/s", "rps": "", "degps": "deg/s", "mdps": "mdeg/s"}
_OF_SPEED = {
    ("m", "s"): "m/s",
    ("km", "h"): "km/h",
    ("mi", "h"): "mph",
    ("ft", "s"): "ft/s",
    ("cm", "s"): "cm/s",
    ("mm", "s"): "mm/s",
}
_QUALIFIERS = frozenset(
    (
        "raw",
        "roh",
        "filtered",
        "filt",
        "gefiltert",
        "corrected",
        "measured",
        "meas",
        "est",
        "estimated",
        "signed",
        "data",
        "value",
    )
)
"""Words behind a unit that say nothing of it."""
BRACKETS = re.compile(r"[\[({<]([^\])}>]*)[\])}>]")
"""In names: a text in brackets, often a unit."""
_IN = re.compile(r"[\s_,/](?:in|unit|einheit)[\s_:]+([^\s_].*)$", re.IGNORECASE)
_SEPARATOR = re.compile(
    r"[.:\\](?=\w)|/(?!(?:s|sec|second|sek|sekunde|min|minute|h|hr|std|dt|ms|g|\d+)(?![a-z]))", re.IGNORECASE
)
"""Signs between the parts of a signal's path, and no sign within a unit."""
_MEMBER = re.compile(r"(?<=\w)\.(data|value)$")
"""The one member of a message of a plain number, as of std_msgs: its topic says what it is."""
_TOKEN = re.compile(r"°|º|[A-Z]+(?![a-z])|[A-Z]?[a-zäöüß]+|\d+")
DIMENSIONS = {"speed": "m/s", "input": "rad", "output": "rad/s"}
"""By role: the SI unit of its signal."""
_NAMES = {
    "speed": ("m/s", "km/h", "mph", "kn", "ft/s", "cm/s", "mm/s"),
    "input": ("rad", "deg", "mrad", "gon", "turn"),
    "output": ("rad/s", "deg/s", "mrad/s", "mdeg/s", "gon/s", "deg/min", "rpm"),
}
"""By role: the units as ``units.py`` names them."""


@cache
def _spellings(role: str) -> dict[str, str]:
    """Spelling without separators -> unit of ``units.py``; empty where it is a unit that cannot be told."""
    if role == "input":
        return {word: unit for unit, words in _ANGLES.items() for word in words}
    if role == "output":
        spellings = dict(_RATE_WORDS)
        for (unit, words), over in product(_ANGLES.items(), _OVER):
            for word, time in product(words, _TIMES["s"] if f"{unit}/s" in _NAMES[role] else ()):
                spellings.setdefault(word + over + time, f"{unit}/s")
        return spellings
    spellings = dict(_SPEED_WORDS)
    for (length, time), unit in _OF_SPEED.items():
        for word, over, per in product(_LENGTHS[length], _OVER, _TIMES[time]):
            spellings.setdefault(word + over + per, unit)
    return spellings


def tokens(text: str) -> list[str]:
    """Split a name into words at other signs than letters and at capitals.

    Parameters
    ----------
    text : str

    Returns
    -------
    list[str], in lower case

    Examples
    --------
    >>> tokens("vehicleSpeedKph"), tokens("Gierrate [°/s]")
    (['vehicle', 'speed', 'kph'], ['gierrate', '°', 's'])
    """
    return [word.lower() for word in _TOKEN.findall(text)]


def split_name(name: str) -> tuple[str, str]:
    """Split a name into its message, topic or group, and the signal's own name.

    Parameters
    ----------
    name : str

    Returns
    -------
    tuple of str, the first is empty where there is none

    Examples
    --------
    >>> split_name("/imu/rate_z"), split_name("ESP::Yaw [0.1 deg/s]"), split_name("steering_angle.data")
    (('/imu', 'rate_z'), ('ESP:', 'Yaw [0.1 deg/s]'), ('', 'steering_angle'))
    """
    name = _MEMBER.sub("", name)
    bare = BRACKETS.sub(lambda match: "\0" * len(match[0]), name)
    at = max((match.start() for match in _SEPARATOR.finditer(bare)), default=-1)
    return name[: max(at, 0)], name[at + 1 :]


def unit_of_text(text: str, role: str) -> str | None:
    """Find the unit that a whole text spells.

    Parameters
    ----------
    text : str, as km/h or Grad pro Sekunde
    role : str, speed, input or output

    Returns
    -------
    str or None, where it is none of the role

    Examples
    --------
    >>> unit_of_text("Grad/s", "output"), unit_of_text("m/s", "input"), unit_of_text("m s^-1", "speed")
    ('deg/s', None, 'm/s')
    """
    if not text.strip():
        return None
    if unit_factor(text, DIMENSIONS[role]) is not None:
        return _canonical(text, role)
    squeezed = re.sub(r"[\s/_.·*^]+", "", text.lower()).removeprefix("unit")
    squeezed = re.sub(r"(s|sec|sek|h)\^?\(?-1\)?$|(s|h)⁻¹$", r"\1\2", squeezed)
    known = _spellings(role)
    if squeezed in known:
        return known[squeezed] or None
    return _by_pint(text, role)


def _canonical(text: str, role: str) -> str:
    """A unit as ``units.py`` names it, of a text that it knows."""
    target = DIMENSIONS[role]
    factor = unit_factor(text, target)
    return next((u for u in _NAMES[role] if unit_factor(u, target) == factor), text.strip())


@cache
def _pint() -> Any:
    """pint's registry."""
    import pint  # costs 0.3 s, and is not needed for usual spellings

    return pint.UnitRegistry(cache_folder=None)


def _by_pint(text: str, role: str) -> str | None:
    """The unit of a role that is as large as pint says ``text`` is; None for any other."""
    if not re.fullmatch(r"[A-Za-z/*^().\s\d°-]{1,40}", text) or not re.search(r"[A-Za-z]", text):
        return None
    registry = _pint()
    try:
        unit = registry.parse_units(text.replace("°", "deg"))
        is_angle = any(re.search("radian|degree|arc(min|sec)", part) for part in unit._units)
        if role != "speed" and not is_angle:
            return None  # pint takes an angle for a plain number: rad/s would be Hz
        factor = float(registry.Quantity(1.0, unit).to(DIMENSIONS[role]).magnitude)
    except Exception:  # pint raises classes of its own and of Python's tokenizer
        return None
    for name in _NAMES[role]:
        ours = unit_factor(name, DIMENSIONS[role])
        if ours is not None and abs(factor / ours - 1) < 1e-6:
            return name
    return f"{factor:.9g} {DIMENSIONS[role]}"


def units_in_name(name: str, role: str) -> list[str]:
    """Find the units that a name states: in brackets, after "in", or at its end.

    Parameters
    ----------
    name : str
    role : str, speed, input or output

    Returns
    -------
    list[str], the surest first

    Examples
    --------
    >>> units_in_name("yaw_rate_radps", "output"), units_in_name("Lenkwinkel in Grad", "input")
    (['rad/s'], ['deg'])
    >>> units_in_name("speed", "speed"), units_in_name("SteeringWheelAngleDeg", "input")
    ([], ['deg'])
    """
    units: list[str] = []
    plain = BRACKETS.sub(" ", name)
    texts = [*BRACKETS.findall(name)]
    if spelled := _IN.search(plain):
        texts.append(spelled[1])
    if "/" in plain and (slashed := re.search(r"[\s_]([^\s_]+/[^\s_/]+)$", plain)):
        texts.append(slashed[1])
    for text in texts:
        unit = unit_of_text(text, role)
        if unit is not None and unit not in units:
            units.append(unit)
    if units:
        return units
    _, unit = _ending(tokens(plain), role)
    return [unit] if unit else []


def without_unit(name: str, role: str) -> str:
    """Join the words of a name without its unit by _.

    Parameters
    ----------
    name : str
    role : str, speed, input or output

    Returns
    -------
    str

    Examples
    --------
    >>> without_unit("v_mph", "speed"), without_unit("r [deg/s]", "output")
    ('v', 'r')
    """
    plain = BRACKETS.sub(" ", name)
    spelled = _IN.search(plain)
    words = tokens(plain[: spelled.start()] if spelled else plain)
    return "_".join(words[: _ending(words, role)[0]])


def _ending(words: list[str], role: str) -> tuple[int, str]:
    """Find the unit at the end of a name's words: its first word and the unit, the longest of several."""
    known, end = _spellings(role), len(words)
    while end and (words[end - 1] in _QUALIFIERS or words[end - 1].isdigit()):
        end -= 1
    for first in range(1, end):
        if unit := known.get("".join(words[first:end])):
            return first, unit
    return len(words), ""
