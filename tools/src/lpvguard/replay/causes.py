"""What the cause of an alarm is, in words."""

from __future__ import annotations

from collections.abc import Sequence

from ..vehicle.project import Signal

WITH_INTERVAL = ("gain", "delay", "bias", "sign")
"""Causes whose value has an interval."""


def cause_sentence(
    output: Signal, cause: str, numbers: Sequence[float], since_s: float, at_least: bool, advice: str | None
) -> str:
    """A cause of core.compiled.CAUSES that an output has: its value, 95 % interval, onset and what to check.

    ``numbers``: value and both ends of the interval of WITH_INTERVAL, the value alone of frozen and noise,
    nothing of other (lib/include/lpvguard/diagnosis.h). ``since_s`` [s]; ``at_least``: or sooner.
    """
    if cause == "other":
        return f"{output.name}: no single cause explains what it does"
    since = "before" if at_least else "about"
    said = f"{output.name} {_what(output, cause, numbers)}, since {since} {max(since_s, 0.0):.0f} s"
    return said if advice is None else f"{said}; {advice}"


def _what(output: Signal, cause: str, numbers: Sequence[float]) -> str:
    if cause == "frozen":
        return f"is frozen at {numbers[0]:.3g} {output.unit}"
    if cause == "noise":
        return f"is noisy, with a standard deviation of {numbers[0]:.3g} {output.unit}"
    value, low, high = numbers
    if cause == "bias":
        return f"{value:+.3g} {output.unit} beside what the model says ({low:+.3g} to {high:+.3g})"
    if cause == "delay":
        near, far = sorted((abs(low), abs(high)))
        when = "later" if value > 0 else "sooner"
        return f"{abs(value):.2f} s {when} than the model says ({near:.2f} to {far:.2f})"
    turned = "turned round: " if cause == "sign" else ""
    return f"{turned}{value:.2f} of what the model says ({low:.2f} to {high:.2f})"
