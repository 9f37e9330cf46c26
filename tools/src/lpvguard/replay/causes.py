"""The causes of alarms as the core found them, and in words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ..vehicle.project import Project

WITH_INTERVAL = ("gain", "delay", "bias", "sign")
"""Causes whose value has an interval."""


@dataclass(frozen=True)
class Diagnosis:
    """The cause that the core found of an alarm in one output (diagnosis.h); times from the drive's start
    [s].

    ``value`` with its 95 % interval: the factor of a gain or sign, a delay [s], a bias, the mean of a frozen
    output or the noise's standard deviation [output unit]. The interval is None where there is none, and
    ``value`` too for "other". ``since_s``: the onset; ``at_least``: or sooner. ``final``: of the whole
    record; else of its first half, and what comes later replaces it. ``says``: all of it in words.
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
    """What the core says of an output, by its index. ``cause``: of core.compiled.CAUSES. ``numbers``: value,
    low and high of lpvg_found_t. Times are the drive's [s]; the advice is the project file's."""
    signal = project.outputs[output]
    shown = 3 if cause in WITH_INTERVAL else 0 if cause == "other" else 1
    value, low, high = (x if k < shown else None for k, x in enumerate(numbers))
    says = cause_sentence(signal.name, signal.unit, cause, numbers, since_s, at_least)
    says = says if final else f"so far {says}"
    advice = project.advice.of(cause, signal.name)
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
    """A cause of core.compiled.CAUSES of the output ``name``: its value, 95 % interval and onset.

    ``numbers``: value, low and high of lpvg_found_t (lib/include/lpvguard/diagnosis.h), of which those that
    the cause has are read. ``since_s`` [s]; ``at_least``: or sooner.
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
        return f"{value:+.3g} {unit} beside what the model says ({low:+.3g} to {high:+.3g})"
    if cause == "delay":
        near, far = sorted((abs(low), abs(high)))
        when = "later" if value > 0 else "sooner"
        return f"{abs(value):.2f} s {when} than the model says ({near:.2f} to {far:.2f})"
    turned = "turned round: " if cause == "sign" else ""
    return f"{turned}{value:.2f} of what the model says ({low:.2f} to {high:.2f})"
