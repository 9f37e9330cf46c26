"""A recorded drive through the compiled core, as tables."""

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
from ..replay.opened import replayer_for
from ..replay.recordings import KINDS, write_series
from ..replay.run import Alarm, Recorded, Replay, Replayer
from ..vehicle.project import Project
from .identified import project_of

if TYPE_CHECKING:
    import pandas


@dataclass(frozen=True)
class Replayed:
    """What the core said of a drive. ``arrow``: the time series as a pyarrow table, for polars
    (`polars.from_arrow`) and Parquet; its columns stand in replay/series.py. ``drive``: what was judged, by
    the core of ``replayer``."""

    summary: Replay
    arrow: pa.Table
    omega: np.ndarray
    drive: Drive
    replayer: Replayer

    @property
    def alarms(self) -> list[Alarm]:
        """The alarms of all tests, in the order of time."""
        return self.summary.alarms

    @cached_property
    def series(self) -> pandas.DataFrame:
        """The time series, a row a sample. Needs pandas."""
        optional("pandas", "pandas")
        return self.arrow.to_pandas()

    @cached_property
    def frames(self) -> pandas.DataFrame:
        """A row a frame that the core looked at, in the order of judgement.

        The times t_end_s and t_judged_s are seconds after the first sample. The margin is t*. The evidence is
        the margin of a vehicle that does not respond. The reason "none" says that the frame counted. The
        other columns are omega_rad_s, speed_mps and falsified. Needs pandas."""
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
            }
        )

    def save(self, path: str | Path) -> None:
        """Write the time series as the suffix says: .parquet, .mcap or .mf4 (replay/recordings.py)."""
        kind = next((k for k in KINDS if Path(path).suffix.lower() == f".{k}"), None)
        if kind is None:
            raise InputError(path, "suffix", Path(path).suffix or "none", ", ".join(f".{k}" for k in KINDS))
        write_series(Path(path), kind, self.arrow, self.summary.to_dict()["alarms"])

    def save_mat(self, path: str | Path) -> None:
        """Write the time series as MATLAB variables; slashes and points of names become underscores, and NaN
        stands where nothing is."""
        columns = {
            name.replace("/", "_").replace(".", "_"): column.to_numpy()
            for name, column in zip(self.arrow.column_names, self.arrow.columns, strict=True)
            if name != "verdict"  # verdict_code says it in numbers
        }
        savemat(path, columns)


def replay(
    vehicle: str | Path | Project,
    log: str | Path,
    *,
    coefficients: str | Path | None = None,
    channel: str | None = None,
) -> Replayed:
    """Run a drive table or a raw CAN log through the compiled core, as `lpvguard replay` does.

    ``vehicle``: a shipped vehicle's name, the path of a project file, or a Project. ``coefficients``: the
    folder of `lpvguard export` (None: the shipped one). ``channel``: of a raw log with several. Raises
    InputError that names file, place and what was expected.
    """
    replayer = opened(vehicle, coefficients)
    recorded = replayer.read_file(Path(log), channel)
    return replayed(replayer, recorded)


def replayed(replayer: Replayer, recorded: Recorded) -> Replayed:
    """A recorded drive through an opened core."""
    summary = replayer.replay_recorded(recorded)
    return Replayed(
        summary, replayer.series(recorded, summary), replayer.estimator.omega, recorded.drive, replayer
    )


def opened(vehicle: str | Path | Project, coefficients: str | Path | None) -> Replayer:
    """The compiled core of a vehicle. InputError where it was made with other settings than the project's."""
    project = project_of(vehicle)
    called = vehicle if not isinstance(vehicle, Project) else f"vehicle {project.name}"
    if coefficients is not None and not Path(coefficients).is_dir():
        raise InputError(coefficients, "", "no such folder", "a folder written by `lpvguard export`")
    return replayer_for(project, None if coefficients is None else Path(coefficients), called)
