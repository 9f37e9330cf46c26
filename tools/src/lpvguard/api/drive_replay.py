"""Replay a recorded drive through the compiled core and return tables."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa
from scipy.io import savemat

from ..base.errors import InputError
from ..base.optional import optional
from ..core.compiled import REASONS
from ..drives.tables import Drive
from ..replay.recordings import SUFFIX, write_series
from ..replay.replayer import Alarm, Recorded, Replay, Replayer
from ..replay.vehicle_core import replayer_for
from ..vehicle.project import Project
from .identification import project_of

if TYPE_CHECKING:
    import pandas


@dataclass(frozen=True)
class Replayed:
    """Results of the core along a drive.

    Attributes
    ----------
    summary : Replay
    arrow : pyarrow.Table
        Time series for polars (`polars.from_arrow`) and Parquet, columns of replay/series.py.
    omega : ndarray (K,), rad/s, frequencies of the bins
    drive : Drive, the judged record
    replayer : Replayer, the core that judged it
    """

    summary: Replay
    arrow: pa.Table
    omega: np.ndarray
    drive: Drive
    replayer: Replayer

    @property
    def alarms(self) -> list[Alarm]:
        """Alarms of all tests, in the order of time."""
        return self.summary.alarms

    @cached_property
    def series(self) -> pandas.DataFrame:
        """Time series with one row per sample. Needs pandas."""
        optional("pandas", "pandas")
        return self.arrow.to_pandas()

    @cached_property
    def frames(self) -> pandas.DataFrame:
        """Table of the judged frames in the order of judgement. Needs pandas.

        The times t_end_s and t_judged_s are seconds after the first sample. The margin is t*. The evidence
        is the margin of a vehicle that does not respond. The reason "none" means that the frame counted. The
        other columns are omega_rad_s, speed_mps, falsified and refuted.
        """
        f, t0 = self.summary.run.frames, self.summary.start_s
        return optional("pandas", "pandas").DataFrame(
            {
                "t_end_s": f.t_end_s - t0,
                "t_judged_s": f.t_judged_s - t0,
                "omega_rad_s": self.omega[f.bin],
                "speed_mps": f.speed,
                "margin": f.margin,
                "evidence": f.evidence,
                "reason": [REASONS[code] for code in f.reason],
                "falsified": f.falsified,
                "refuted": f.refuted,
            }
        )

    def save(self, path: str | Path) -> None:
        """Write the time series to a file; its suffix .parquet, .mcap or .mf4 sets the format.

        Parameters
        ----------
        path : str or Path

        Raises
        ------
        InputError
            If the suffix is unknown, or the package for the format is not installed.
        """
        kind = next((k for k, suffix in SUFFIX.items() if Path(path).suffix.lower() == suffix), None)
        if kind is None:
            raise InputError(
                path, "suffix", Path(path).suffix or "none", ", ".join(dict.fromkeys(SUFFIX.values()))
            )
        alarms = self.summary.to_dict()["alarms"]
        write_series(Path(path), kind, self.arrow, alarms, self.replayer.project.name)

    def save_mat(self, path: str | Path) -> None:
        """Write the time series as variables of a MATLAB file.

        Slashes and points of names become underscores, and missing values become NaN.

        Parameters
        ----------
        path : str or Path
        """
        columns = {
            name.replace("/", "_").replace(".", "_"): column.to_numpy()
            for name, column in zip(self.arrow.column_names, self.arrow.columns, strict=True)
            if name != "verdict"  # the column verdict_code has its number
        }
        savemat(path, columns)


def replay_drive(
    vehicle: str | Path | Project,
    log: str | Path,
    *,
    coefficients: str | Path | None = None,
    channel: str | None = None,
) -> Replayed:
    """Run a drive table or a raw CAN log through the compiled core, as `lpvguard replay` does.

    Parameters
    ----------
    vehicle : str, Path or Project, shipped vehicle's name, path of a project file, or a project
    log : str or Path
    coefficients : str or Path, optional, folder of `lpvguard export`, by default the shipped one
    channel : str, optional, CAN channel, for a raw log with several channels

    Returns
    -------
    Replayed

    Raises
    ------
    InputError
        If an input does not fit; the error names file, place and what was expected.
    """
    replayer = open_core(vehicle, coefficients)
    recorded = replayer.read_file(Path(log), channel)
    return replay_recorded(replayer, recorded)


def replay_recorded(replayer: Replayer, recorded: Recorded) -> Replayed:
    """Run a recorded drive through an open core.

    Parameters
    ----------
    replayer : Replayer
    recorded : Recorded

    Returns
    -------
    Replayed
    """
    summary = replayer.replay_recorded(recorded)
    return Replayed(
        summary, replayer.series(recorded, summary), replayer.estimator.omega, recorded.drive, replayer
    )


def open_core(vehicle: str | Path | Project, coefficients: str | Path | None) -> Replayer:
    """Open the compiled core of a vehicle.

    Parameters
    ----------
    vehicle : str, Path or Project
    coefficients : str, Path or None, folder of `lpvguard export`, None for the shipped one

    Returns
    -------
    Replayer

    Raises
    ------
    InputError
        If the core was made with settings that differ from the project's.
    """
    project = project_of(vehicle)
    called = vehicle if not isinstance(vehicle, Project) else f"vehicle {project.name}"
    if coefficients is not None and not Path(coefficients).is_dir():
        raise InputError(coefficients, "", "no such folder", "a folder written by `lpvguard export`")
    return replayer_for(project, None if coefficients is None else Path(coefficients), called)
