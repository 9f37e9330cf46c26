"""Faults injected into recorded drives, from a given time on, to see what the monitor finds.

Gain, sign, freeze and bias act on every output. A delay acts on the input (the recorded input lags) or on the
outputs. A fault comes at once, or its share s grows from 0 to 1 over a ramp:

    gain    y becomes (1 + s (value - 1)) y
    freeze  y becomes (1 - s) y + s y_0, with y_0 at the fault's first sample
    bias    y becomes y + s value
    delay   x(t) becomes x(t - s value), linear between samples; before the drive x stands at its first
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..base.errors import InputError
from ..vehicle.project import EvaluationSettings
from .tables import Drive

KINDS = ("gain", "freeze", "bias", "input_delay", "output_delay")


@dataclass(frozen=True)
class Fault:
    """``value``: factor (gain), output units (bias), seconds (delays); unused for freeze. ``spread`` (n_y):
    of the outputs; a bias is then ``value`` of it."""

    kind: str
    value: float = 0.0
    spread: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise InputError("fault", "kind", repr(self.kind), " or ".join(KINDS))
        if self.kind.endswith("delay") and self.value < 0:
            raise InputError("fault", self.kind, f"{self.value:g} s", "a delay that is not negative")

    @property
    def label(self) -> str:
        """The fault in words, with its size."""
        texts = {
            "gain": "output × {:g}",
            "freeze": "output frozen",
            "bias": "output + {:g}" + (" of its spread" if self.spread else ""),
            "input_delay": "input delayed by {:g} s",
            "output_delay": "output delayed by {:g} s",
        }
        return texts[self.kind].format(self.value)


def stated(settings: EvaluationSettings, spread: np.ndarray) -> tuple[Fault, ...]:
    """The faults of a project file's settings, the coarse ones first; ``spread`` (n_y,): of the outputs."""
    gains, delays = settings.gains, settings.delays_s
    bias = (
        Fault("bias", settings.bias_of_spread, tuple(map(float, spread)))
        if settings.bias is None
        else Fault("bias", settings.bias)
    )
    faults = [*(Fault("gain", g) for g in gains[:2]), Fault("freeze")]
    faults += [Fault(kind, delays[0]) for kind in ("input_delay", "output_delay")]
    faults += [*(Fault("gain", g) for g in gains[2:]), bias]
    faults += [Fault(kind, d) for d in delays[1:] for kind in ("input_delay", "output_delay")]
    return tuple(faults)


def inject(drive: Drive, fault: Fault, start_s: float, Ts: float, ramp_s: float = 0.0) -> Drive:
    """The drive with ``fault`` from ``start_s`` seconds after its first sample on.

    It has its full size ``ramp_s`` [s] later. ``Ts`` [s]: between samples. A full delay is whole samples.
    """
    first = round(start_s / Ts)
    after = np.arange(len(drive.t)) - first
    share = np.where(after < 0, 0.0, np.minimum(1.0, after * Ts / ramp_s) if ramp_s else 1.0)
    u, y = drive.u.copy(), drive.y.copy()

    def delayed(x: np.ndarray) -> np.ndarray:
        index = np.arange(len(x))
        at = np.maximum(index - share * round(fault.value / Ts), 0.0)
        return np.stack([np.interp(at, index, column) for column in x.T], axis=1)

    s = share[first:, None]
    if fault.kind == "gain":
        y[first:] *= 1.0 + s * (fault.value - 1.0)
    elif fault.kind == "freeze":
        y[first:] += s * (y[min(first, len(y) - 1)] - y[first:])
    elif fault.kind == "bias":
        y[first:] += s * fault.value * np.array(fault.spread or 1.0)
    elif fault.kind == "input_delay":
        u = delayed(u)
    else:
        y = delayed(y)
    return replace(drive, u=u, y=y)
