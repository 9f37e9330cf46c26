"""Find what limits a design: the signals in the worst vectors of the scaled loop at the peak of mu."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..engine.synthesis.dk import RobustPerformance
from ..engine.synthesis.interconnection import GeneralisedPlant
from ..engine.synthesis.statespace import StateSpace, lft, prewarped

LARGE = 0.1
"""Smallest share that the sentence names."""
WHOLE = {
    "r_c": "the command (W_C)",
    "z_t": "the tracking error (W_t)",
    "xi_i": "the input uncertainty (W_delta)",
    "xi_s": "the state uncertainty (W_delta_s)",
    "z_u": "the control effort (W_u)",
}
"""Name of a signal's weight by the beginning of the signal's name, without the digits of further signals."""
OF_OUTPUT = {"w": "the disturbance (W_w)", "n": "the noise (W_n)", "xi": "the uncertainty (W_delta)"}
"""Name of a weight of one output by the prefix of the signal's name."""


@dataclass(frozen=True)
class Limiting:
    """Peak of mu at one speed: its ``frequency`` [rad/s], and the share of each signal in the peak.

    A signal is an input (``enters_by``) or an output (``leaves_by``) of the scaled loop.
    """

    frequency: float
    enters_by: dict[str, float]
    leaves_by: dict[str, float]

    @classmethod
    def at_peak(cls, plant: GeneralisedPlant, controller: StateSpace, proved: RobustPerformance) -> Limiting:
        """Compute the shares at the peak of a certified loop of ``plant`` and ``controller``."""
        frequency = proved.bracket.peak_frequency
        loop = lft(plant.system, controller)
        M = loop.response([frequency])[0]
        if plant.blocks:
            below = min(frequency, np.pi / loop.dt * (1 - 1e-9)) if loop.dt else frequency
            left, right = (
                np.abs(np.diagonal(G.response([prewarped(below, loop.dt)])[0]))
                for G in proved.scaling.systems(plant)
            )
            M = left[:, None] * M * right
        U, _, Vh = np.linalg.svd(M)
        return cls(frequency, _shares(Vh[0], loop.inputs), _shares(U[:, 0], loop.outputs))

    def sentence(self) -> str:
        """Describe the limit in words."""
        return f"mu enters by {_carriers(self.enters_by)} and leaves by {_carriers(self.leaves_by)}"


def _shares(x: np.ndarray, names: tuple[str, ...]) -> dict[str, float]:
    """|x_k|^2 by name, for a vector x of norm 1."""
    return dict(zip(names, (np.abs(x) ** 2).tolist(), strict=True))


def _carrier(signal: str) -> str:
    """Name a signal of Fig. 1 in words."""
    name = signal.replace("eta", "xi", 1) if signal.startswith("eta") else signal
    if name.rstrip("0123456789") in WHOLE:
        return WHOLE[name.rstrip("0123456789")]
    kind, _, output = name.partition("_")
    return f"{OF_OUTPUT[kind]} of {output}"


def _carriers(shares: dict[str, float]) -> str:
    named: dict[str, float] = {}
    for key, value in shares.items():
        named[_carrier(key)] = named.get(_carrier(key), 0.0) + value
    large = sorted(((s, n) for n, s in named.items() if s >= LARGE), reverse=True)
    return " and ".join(f"{name} ({share:.0%})" for share, name in large)
