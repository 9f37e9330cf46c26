"""Faults injected into recorded drives, from a given time on, to see what the monitor finds.

Gain, sign, freeze and bias act on every output. A delay acts on the input (the recorded input lags) or on the
outputs.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..base.errors import InputError
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


def inject(drive: Drive, fault: Fault, start_s: float, Ts: float) -> Drive:
    """The drive with ``fault`` from ``start_s`` seconds after its first sample on. Delays are whole
    samples."""
    first = round(start_s / Ts)
    u, y = drive.u.copy(), drive.y.copy()

    def delayed(x: np.ndarray) -> np.ndarray:
        index = np.arange(len(x))
        shift = round(fault.value / Ts)
        return x[np.where(index >= first, np.maximum(index - shift, 0), index)]

    if fault.kind == "gain":
        y[first:] *= fault.value
    elif fault.kind == "freeze":
        y[first:] = y[min(first, len(y) - 1)]
    elif fault.kind == "bias":
        y[first:] += fault.value * np.array(fault.spread or 1.0)
    elif fault.kind == "input_delay":
        u = delayed(u)
    else:
        y = delayed(y)
    return replace(drive, u=u, y=y)
