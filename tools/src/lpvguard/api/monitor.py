"""Run the compiled monitor sample by sample."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from ..core.compiled import REASONS, STATUSES, VERDICTS
from ..vehicle.project import Project
from .drive_replay import open_core


@dataclass(frozen=True)
class JudgedFrame:
    """A frame that the core judged.

    Attributes
    ----------
    t_end_s : float, s, time of its last sample
    omega_rad_s : float, rad/s, frequency of its bin
    speed_mps : float, m/s, mean speed
    margin : float, t*
    reason : str, why the frame did not count, "none" if it counted
    falsified : bool, the frame is outside the healthy set and raises an alarm
    refuted : bool, the frame also refutes the certificate's set
    """

    t_end_s: float
    omega_rad_s: float
    speed_mps: float
    margin: float
    reason: str
    falsified: bool
    refuted: bool


@dataclass(frozen=True)
class Said:
    """Result of the core for one sample.

    Attributes
    ----------
    verdict, status : str, names of monitor.h and status.h
    energy_ratio, change_ratio : float or None, None where the test does not judge
    frame : JudgedFrame or None, judged at this sample
    energy_alarm, change_alarm : bool, the test alarmed at this sample
    """

    verdict: str
    status: str
    energy_ratio: float | None
    frame: JudgedFrame | None
    energy_alarm: bool
    change_ratio: float | None
    change_alarm: bool


class Monitor:
    """The compiled monitor of a vehicle, as on the ECU.

    Parameters
    ----------
    vehicle : str, Path or Project, shipped vehicle's name, path of a project file, or a project
    coefficients : str or Path, optional, folder of `lpvguard export`, by default the shipped one

    Raises
    ------
    InputError
        If vehicle and coefficients do not belong together.
    """

    def __init__(self, vehicle: str | Path | Project, coefficients: str | Path | None = None):
        self._replayer = open_core(vehicle, coefficients)
        self.reset()

    def reset(self) -> None:
        """Reset the monitor to its initial state."""
        self._running = self._replayer.core.monitor()

    @property
    def sample_time_s(self) -> float:
        """Sample period [s]."""
        return self._replayer.project.Ts_s

    def push(self, t: float, v: float, u: ArrayLike, y: ArrayLike) -> Said:
        """Process one sample.

        A value that the core refuses is no error: ``status`` reports it, as on the ECU.

        Parameters
        ----------
        t : float, s
        v : float, m/s
        u : array_like (n_u,), inputs, or a number for one
        y : array_like (n_y,), outputs, or a number for one

        Returns
        -------
        Said

        Raises
        ------
        ValueError
            If the number of inputs or outputs differs.
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
                bool(frames.refuted[0]),
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
