"""Causes that the core found for alarms, as numbers and as text."""

from collections.abc import Sequence
from dataclasses import dataclass

from ..vehicle.project import Project

WITH_INTERVAL = ("gain", "delay", "bias", "sign")
"""Causes whose value has an interval."""


@dataclass(frozen=True)
class Diagnosis:
    """Cause that the core found for an alarm in one output (diagnosis.h).

    Attributes
    ----------
    t_s, alarm_s : float, s from the drive's start, time of the diagnosis and of the alarm
    output, cause : str
    value : float or None
        A factor for gain and sign, s for delay, the output unit for bias, frozen mean and standard deviation
        of noise.
    low, high : float or None, ends of its 95 % interval, in the same unit
    since_s : float, s, the onset
    at_least : bool, the onset may be earlier
    final : bool, from the whole record; otherwise from its first half, until a later diagnosis replaces it
    says : str, the whole diagnosis as text
    """

    t_s: float
    alarm_s: float
    output: str
    cause: str
    value: float | None
    low: float | None
    high: float | None
    since_s: float
    at_least: bool
    final: bool
    says: str


def diagnosed(
    project: Project,
    cause: str,
    output: int,
    numbers: Sequence[float],
    *,
    found_s: float,
    alarm_s: float,
    since_s: float,
    at_least: bool,
    final: bool = True,
) -> Diagnosis:
    """Convert the core's diagnosis of an output to a Diagnosis with text.

    Parameters
    ----------
    project : Project
    cause : str, of core.compiled.CAUSES
    output : int, index of the output
    numbers : Sequence[float], value, low and high of lpvg_found_t
    found_s, alarm_s, since_s : float, s, times of the drive
    at_least : bool, the onset may be earlier
    final : bool, from the whole record, default True

    Returns
    -------
    Diagnosis, with the project file's advice
    """
    signal = project.outputs[output]
    shown = 3 if cause in WITH_INTERVAL else 0 if cause == "other" else 1
    value, low, high = (x if k < shown else None for k, x in enumerate(numbers))
    says = cause_sentence(signal.name, signal.unit, cause, numbers, since_s, at_least)
    says = says if final else f"so far {says}"
    advice = project.advice.for_cause(cause, signal.name)
    return Diagnosis(
        found_s,
        alarm_s,
        signal.name,
        cause,
        value,
        low,
        high,
        since_s,
        at_least,
        final,
        says if advice is None or cause == "other" else f"{says}; {advice}",
    )


def cause_sentence(
    name: str, unit: str, cause: str, numbers: Sequence[float], since_s: float, at_least: bool
) -> str:
    """Describe a cause in an output: value, 95 % interval and onset.

    Parameters
    ----------
    name, unit : str, of the output
    cause : str, of core.compiled.CAUSES
    numbers : Sequence[float], value, low and high of lpvg_found_t (lib/include/lpvguard/diagnosis.h)
    since_s : float, s, the onset
    at_least : bool, the onset may be earlier

    Returns
    -------
    str
    """
    if cause == "other":
        return f"{name}: no single cause explains what it does"
    since = "before" if at_least else "about"
    return f"{name} {_what(unit, cause, numbers)}, since {since} {max(since_s, 0.0):.0f} s"


def _what(unit: str, cause: str, numbers: Sequence[float]) -> str:
    value, low, high = numbers
    if cause == "frozen":
        return f"is frozen at {value:.3g} {unit}"
    if cause == "noise":
        return f"is noisy, with a standard deviation of {value:.3g} {unit}"
    if cause == "bias":
        return f"{value:+.3g} {unit} off the nominal output ({low:+.3g} to {high:+.3g})"
    if cause == "delay":
        near, far = sorted((abs(low), abs(high)))
        when = "later" if value > 0 else "earlier"
        return f"{abs(value):.2f} s {when} than the nominal output ({near:.2f} to {far:.2f})"
    turned = "inverted: " if cause == "sign" else ""
    return f"{turned}{value:.2f} of the nominal output ({low:.2f} to {high:.2f})"
