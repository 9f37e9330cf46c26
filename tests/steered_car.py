"""A car of 2.7 m that is steered to both sides, and its candump logs."""

from collections.abc import Callable, Iterable
from pathlib import Path

STEERING_RATIO = 15
PERIOD_S = 0.02


def write_logs(
    folder: Path,
    samples: int,
    speed_mps: Callable[[float], float],
    angle: Callable[[float], float],
    frames: Callable[[float, float, float], Iterable[str]],
    lag_s: float = PERIOD_S / 0.15,
) -> list[Path]:
    """Write two candump logs; in the second one the car is 1 m/s faster.

    ``angle`` is that of the steering wheel. ``frames`` gives ID#DATA of speed [m/s], angle, and yaw rate in
    the angle's unit a second.
    """
    logs = []
    for number in range(2):
        lines, yaw = [], 0.0
        for k in range(samples):
            t = PERIOD_S * k
            v, wheel = speed_mps(t) + number, angle(t)
            yaw += PERIOD_S / lag_s * (v * wheel / STEERING_RATIO / (2.7 + 0.002 * v * v) - yaw)
            lines += [f"({t:.6f}) can0 {frame}\n" for frame in frames(v, wheel, yaw)]
        logs.append(folder / f"d{number}.log")
        logs[-1].write_text("".join(lines))
    return logs
