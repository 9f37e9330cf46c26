"""Faults injected into recorded drives, to see whether the monitor finds them.

Gain, sign, freeze and bias act on every output. A delay acts on the input (the recorded input lags) or on the
outputs. A fault comes at once, or its share s grows from 0 to 1 over a ramp:

    gain        y becomes (1 + s (value - 1)) y
    freeze      y becomes (1 - s) y + s y_0, with y_0 at the fault's first sample
    bias        y becomes y + s value
    delay       x(t) becomes x(t - s value), linear between samples; before the drive x keeps its first value
    dead zone   y becomes sign(y) max(|y| - s value, 0)
    saturation  y becomes y / (1 + s |y| / value)

Two faults may come together.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..base.errors import InputError
from ..vehicle.project import EvaluationSettings
from .tables import Drive

KINDS = {
    "gain": "output × {:g}",
    "freeze": "output frozen",
    "bias": "output + {:g}",
    "input_delay": "input delayed by {:g} s",
    "output_delay": "output delayed by {:g} s",
    "dead_zone": "output's dead zone {:g}",
    "saturation": "output saturates at {:g}",
}
"""Words of each kind, with its value."""


@dataclass(frozen=True)
class Fault:
    """A fault of the recorded signals.

    Attributes
    ----------
    kind : str
    value : float, factor (gain), output units (bias, dead zone, saturation) or s (delays); unused for freeze
    spread : tuple (n_y,) of float, spread of the outputs; where given, output units are ``value`` times it
    also : Fault or None, a fault that comes with it
    """

    kind: str
    value: float = 0.0
    spread: tuple[float, ...] = ()
    also: Fault | None = None

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise InputError("fault", "kind", repr(self.kind), " or ".join(KINDS))
        if self.kind.endswith("delay") and self.value < 0:
            raise InputError("fault", self.kind, f"{self.value:g} s", "a delay that is not negative")

    @property
    def label(self) -> str:
        """Name of the fault, with its size."""
        own = KINDS[self.kind].format(self.value) + (" of its spread" if self.spread else "")
        return own if self.also is None else f"{own}, {self.also.label}"


def injected_delay_s(value: float, Ts: float) -> float:
    """Round a delay to the whole samples that `inject` makes.

    Parameters
    ----------
    value, Ts : float, s

    Returns
    -------
    float, s
    """
    return round(value / Ts) * Ts


def stated(settings: EvaluationSettings, spread: np.ndarray) -> tuple[Fault, ...]:
    """Return the faults of a project file's settings, the coarse ones first.

    Parameters
    ----------
    settings : EvaluationSettings
    spread : ndarray (n_y,), spread of the outputs [output units]

    Returns
    -------
    tuple of Fault
    """
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


def no_single_cause(spread: np.ndarray) -> tuple[Fault, ...]:
    """Return faults that are two at once, or none of gain, delay and bias.

    Parameters
    ----------
    spread : ndarray (n_y,), spread of the outputs [output units]

    Returns
    -------
    tuple of Fault
    """
    own = tuple(map(float, spread))
    bias, delay = Fault("bias", 0.5, own), Fault("output_delay", 0.3)
    return (
        Fault("gain", 0.6, also=bias),
        Fault("gain", 0.6, also=delay),
        Fault("output_delay", 0.3, also=bias),
        Fault("dead_zone", 0.5, own),
        Fault("saturation", 1.0, own),
    )


def share_of(after: np.ndarray, Ts: float, ramp_s: float) -> np.ndarray:
    """Compute the share of a growing fault.

    Parameters
    ----------
    after : ndarray (N,), samples since the fault's first, negative before it
    Ts, ramp_s : float, s

    Returns
    -------
    ndarray (N,), 0 to 1
    """
    return np.where(after < 0, 0.0, np.minimum(1.0, after * Ts / ramp_s) if ramp_s else 1.0)


def inject(drive: Drive, fault: Fault, start_s: float, Ts: float, ramp_s: float = 0.0) -> Drive:
    """Inject a fault into a drive.

    Parameters
    ----------
    drive : Drive
    fault : Fault
    start_s : float, s after the drive's first sample
    Ts : float, s
    ramp_s : float, s until the fault has its full size, default 0
        A full delay is whole samples.

    Returns
    -------
    Drive
    """
    first = round(start_s / Ts)
    after = np.arange(len(drive.t)) - first
    share = share_of(after, Ts, ramp_s)
    u, y = drive.u.copy(), drive.y.copy()

    def delayed(x: np.ndarray) -> np.ndarray:
        index = np.arange(len(x))
        at = np.maximum(index - share * injected_delay_s(fault.value, Ts) / Ts, 0.0)
        return np.stack([np.interp(at, index, column) for column in x.T], axis=1)

    s, size = share[first:, None], fault.value * np.array(fault.spread or 1.0)
    if fault.kind == "gain":
        y[first:] *= 1.0 + s * (fault.value - 1.0)
    elif fault.kind == "freeze":
        y[first:] += s * (y[min(first, len(y) - 1)] - y[first:])
    elif fault.kind == "bias":
        y[first:] += s * size
    elif fault.kind == "dead_zone":
        y[first:] -= np.clip(y[first:], -s * size, s * size)
    elif fault.kind == "saturation":
        y[first:] /= 1.0 + s * np.abs(y[first:]) / size
    elif fault.kind == "input_delay":
        u = delayed(u)
    else:
        y = delayed(y)
    faulty = replace(drive, u=u, y=y)
    return faulty if fault.also is None else inject(faulty, fault.also, start_s, Ts, ramp_s)
