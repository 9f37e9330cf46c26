"""The compiled monitor, fed sample by sample."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from ..core.compiled import REASONS, STATUSES, VERDICTS
from ..vehicle.project import Project
from .replayed import opened


@dataclass(frozen=True)
class JudgedFrame:
    """A frame that the core looked at, with its bin's frequency [rad/s], mean speed [m/s] and t* (margin).

    ``t_end_s``: its last sample [s]. ``reason``: why it did not count (none: it did). ``falsified``: it
    falsifies the model."""

    t_end_s: float
    omega_rad_s: float
    speed_mps: float
    margin: float
    reason: str
    falsified: bool


@dataclass(frozen=True)
class Said:
    """What the core says after a sample. ``verdict`` and ``status``: names of monitor.h and status.h.
    ``energy_ratio``: None where the energy test does not judge; ``change_ratio``: None before the change test
    does. ``frame``: judged with this sample, if one was. ``energy_alarm``, ``change_alarm``: these tests
    alarmed with this sample."""

    verdict: str
    status: str
    energy_ratio: float | None
    frame: JudgedFrame | None
    energy_alarm: bool
    change_ratio: float | None
    change_alarm: bool


class Monitor:
    """The compiled monitor of a vehicle, as on the ECU.

    ``vehicle``: a shipped vehicle's name, the path of a project file, or a Project. ``coefficients``: the
    folder of `lpvguard export` (None: the shipped one). Raises InputError where both do not belong together.
    """

    def __init__(self, vehicle: str | Path | Project, coefficients: str | Path | None = None):
        self._replayer = opened(vehicle, coefficients)
        self.reset()

    def reset(self) -> None:
        """Forget every sample."""
        self._running = self._replayer.core.monitor()

    @property
    def sample_time_s(self) -> float:
        """Time from sample to sample [s]."""
        return self._replayer.project.Ts_s

    def push(self, t: float, v: float, u: ArrayLike, y: ArrayLike) -> Said:
        """Push a sample and return what the core says.

        Parameters
        ----------
        t : float
            Time [s].
        v : float
            Speed [m/s].
        u, y : array_like, shape (n_u,) and (n_y,)
            Inputs and outputs in the units of the signal table. One value may be a number.

        Returns
        -------
        Said
            Verdict and status. A value that the core refuses is no error: the status says so, as on the ECU.

        Raises
        ------
        ValueError
            The number of inputs or outputs is not the vehicle's.
        """
        core = self._replayer.core
        row = [np.atleast_1d(np.asarray(x, float)) for x in (u, y)]
        for values, n, what in zip(row, (core.n_u, core.n_y), ("inputs", "outputs"), strict=True):
            if values.shape != (n,):
                raise ValueError(f"{what} of shape {values.shape}: expected ({n},)")
        run = self._running.run(np.array([t]), np.array([v]), row[0][None], row[1][None])
        frames, frame = run.frames, None
        if len(frames.bin):
            frame = JudgedFrame(
                float(frames.t_end_s[0]),
                float(self._replayer.estimator.omega[frames.bin[0]]),
                float(frames.speed[0]),
                float(frames.margin[0]),
                REASONS[frames.reason[0]],
                bool(frames.falsified[0]),
            )
        return Said(
            VERDICTS[run.verdict[0]],
            STATUSES[run.status[0]],
            float(run.energy[0]) or None,
            frame,
            bool(len(run.energy_alarms.bin)),
            float(run.change[0]) or None,
            bool(len(run.change_alarms.bin)),
        )
