"""Section [design] of a proposed project file: objectives and limits as the drives show them.

The command's size and corner are those of the driven output, the limits are those that the drives reached. A
controller then asks for nothing that was not driven.
"""

from dataclasses import dataclass

import numpy as np
from scipy.signal import welch

from ..drives.tables import Drive

REACHED = 0.999
"""Share of the samples within a limit that the drives reached."""
RATE_OVER_S = 0.1
"""Time over which the input's rate is measured [s]."""
COMMANDED = 0.8
"""Share of the output's power below the command's corner."""
ALLOWED = 0.3
"""Allowed slow tracking error, as a share of the output's rms."""
SPAN = 100.0
"""Zero over pole of W_t."""
EFFORT_RAD_S = 50.0
"""Frequency [rad/s] at which W_u is 1 for a sine at the rate limit: the default poles of W_u."""
EFFORT_RISE = 0.5 * (EFFORT_RAD_S / 0.02) ** 2
"""|W_u| at that frequency over A_u, with the default zeros and poles."""
PIECE_S = 60.0
"""Longest piece of a spectrum."""


@dataclass(frozen=True)
class Shown:
    """Sizes of command and actuator in drives.

    Attributes
    ----------
    rms : float, of the output [rad/s]
    corner : float, below which COMMANDED of its power is [rad/s]
    input_max : float, input unit
    input_rate_max : float, input unit/s
    lateral_mps2 : float, m/s^2
    speed : float, median [m/s]
    """

    rms: float
    corner: float
    input_max: float
    input_rate_max: float
    lateral_mps2: float
    speed: float


def shown(drives: list[Drive], Ts: float, speeds: tuple[float, float]) -> Shown:
    """Measure them in ``drives`` within the speed range ``speeds`` [m/s]; first input and first output."""
    inside = [(d.v >= speeds[0]) & (d.v <= speeds[1]) for d in drives]
    v, u, r = (
        np.concatenate([x[k] for x, k in zip(signals, inside, strict=True)])
        for signals in ([d.v for d in drives], [d.u[:, 0] for d in drives], [d.y[:, 0] for d in drives])
    )
    step = max(1, round(RATE_OVER_S / Ts))
    changes = [
        np.abs(d.u[step:, 0] - d.u[:-step, 0])[k[step:] & k[:-step]]
        for d, k in zip(drives, inside, strict=True)
    ]
    return Shown(
        float(r.std()),
        _corner([d.y[:, 0] for d in drives], Ts),
        float(np.quantile(np.abs(u - np.median(u)), REACHED)),
        float(np.quantile(np.concatenate(changes), REACHED)) / (step * Ts),
        float(np.quantile(np.abs(v * r), REACHED)),
        float(np.median(v)),
    )


def _corner(outputs: list[np.ndarray], Ts: float) -> float:
    """Frequency [rad/s] below which COMMANDED of the power of all ``outputs`` is."""
    piece = min(round(PIECE_S / Ts), *(len(y) for y in outputs))
    power = sum(len(y) * welch(y - y.mean(), 1 / Ts, nperseg=piece)[1] for y in outputs)
    below = np.cumsum(power) / np.sum(power)
    return 2 * np.pi * float(np.interp(COMMANDED, below, np.fft.rfftfreq(piece, Ts)))


def design_section(shown: Shown, Ts: float) -> str:
    """Section of a project file for `design`."""
    zero = min(SPAN * shown.corner, 0.5 * np.pi / Ts)
    A_u = EFFORT_RAD_S / shown.input_rate_max / EFFORT_RISE
    return f"""
# Steering by wire: a controller of the yaw rate, certified on the set that identify finds. identify takes
# the weights of command, noise, disturbance and uncertainty from the drives. The command is as the driven
# yaw rate: {shown.rms:.2g} rad/s rms, {COMMANDED:.0%} of its power below {shown.corner:.2g} rad/s.
# Another actuator is another input: a yaw moment (torque vectoring) or a pressure difference (differential
# braking), with its own limits below. Each input is weighted by its rate limit.
[design]
controlled = "yaw_rate"      # follows the command
A_t = {1 / (ALLOWED * shown.rms):.2g}      # 1 over the allowed slow error: {ALLOWED:.0%} of the rms
W_t_poles = [{shown.corner:.2g}]      # rad/s: above, the allowed error grows
W_t_zeros = [{zero:.2g}]      # rad/s: and from here on no longer
A_u = {A_u:.2g}      # W_u is 1 for a sine of {EFFORT_RAD_S:g} rad/s at the rate limit
design_speed_mps = {shown.speed:.2g}
nodes = 6
input_max = [{shown.input_max:.2g}]      # rad, what the drives reached; the actuator's, where that is less
input_rate_max_per_s = [{shown.input_rate_max:.2g}]      # rad/s, likewise
lateral_acceleration_max_mps2 = {shown.lateral_mps2:.2g}      # of a steady turn at the limit, likewise
"""
