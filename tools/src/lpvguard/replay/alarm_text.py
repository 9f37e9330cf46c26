"""Describe alarms in sentences."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .replayer import Alarm


def alarm_sentence(alarm: Alarm | dict[str, Any]) -> str:
    """Describe an alarm in one line: test, place, margin and the violated bound.

    Parameters
    ----------
    alarm : Alarm, or dict as in the JSON of `replay`

    Returns
    -------
    str
    """
    a = alarm if isinstance(alarm, dict) else asdict(alarm)
    if a["test"] == "energy":
        return (
            f"energy test, v = {a['speed_mps']:.1f} m/s: ratio {a['margin']:.2f} > {a['threshold']:.2f} in "
            f"the band {a['band']} the corners, direction ({_listed(a['direction'])}); ||F e|| = "
            f"{_listed(a['E'])}, allowed ||F W_delta yhat|| {_listed(a['Z'])} + sigma {_listed(a['B_w'])} + "
            f"restart term{_attributed(a)}"
        )
    if a["test"] == "change":
        return (
            f"change test, v = {a['speed_mps']:.1f} m/s: {a['part']} of {a['output']} is {a['margin']:.2f} > "
            f"{a['threshold']:.2f} times its largest value on the bound-setting drives; estimate: gain "
            f"{1 + a['estimate']['gain']:.3g}, delay {a['estimate']['delay_s']:.3g} s, bias "
            f"{a['estimate']['bias']:.3g}{_attributed(a)}"
        )
    if a["statistic"] <= a["threshold"]:
        return (
            f"frame test, {a['bin_rad_s']:.3g} rad/s, v = {a['speed_mps']:.1f} m/s: pool of the newest "
            f"frames {a['pooled']:.2f} > {a['threshold']:.2f}, margin of the last one {a['margin']:.2f}"
            f"{_attributed(a)}"
        )
    return (
        f"frame test, {a['bin_rad_s']:.3g} rad/s, v = {a['speed_mps']:.1f} m/s: "
        f"margin {a['margin']:.2f} (statistic {a['statistic']:.2f} > {a['threshold']:.2f}); |E| = "
        f"{_norm(a['E']):.3g}, allowed W_delta {_listed(a['W_delta'])} x |Z| {_norm(a['Z']):.3g} + B_w "
        f"{_listed(a['B_w'])}{_attributed(a)}"
    )


def _attributed(a: dict[str, Any]) -> str:
    """End of the line: the set that the vehicle left, or that the disturbance exceeded its bound."""
    left = "certificate set" if a["verdict"] == "invalid" else "healthy set"
    return f"; outside the {left}" + (
        "; disturbance beyond its bound" if a["beyond"] == "disturbance" else ""
    )


def _listed(values: list[float]) -> str:
    return ", ".join(f"{x:.3g}" for x in values)


def _norm(values: list[complex]) -> float:
    return sum(abs(x) ** 2 for x in values) ** 0.5
