"""Draw the pictures of the report page in notebooks.

    from lpvguard import plots
    plots.weights(found)                     # of lpvguard.identify or lpvguard.load
    plots.margins(run).save("margins.csv")   # of lpvguard.replay; .svg or .csv

The same functions draw the pictures of the page.
"""

import csv
import io
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import astuple, dataclass, fields
from html import escape
from pathlib import Path

import numpy as np

from ..base import artefacts
from ..base.errors import InputError
from ..report import design_pictures
from ..report.blindness import MapCell, cells
from ..report.identification_pictures import IdentificationPictures, drive_map
from ..report.page import map_page
from ..report.pictures.detectors import time_to_find
from ..report.pictures.drawing import Picture
from ..report.pictures.over_time import Stretch, model_in_time
from ..report.sections.campaign import drawn_campaign
from ..report.sections.closed_loop import drawn_run
from .drive_replay import Replayed
from .identification import Identified

ROW_PX, AROUND_PX = 31, 250
"""Height of a row of the map, and of the map's frame [px]."""


@dataclass(frozen=True)
class BlindMap:
    """Cells of speed and frequency, lowest speed first, and their picture as an HTML page.

    Attributes
    ----------
    cells : list of list of MapCell
    page : str, HTML
    """

    cells: list[list[MapCell]]
    page: str

    def _repr_html_(self) -> str:
        height = ROW_PX * len(self.cells) + AROUND_PX
        return (
            f'<iframe title="proved, blind, violated" sandbox="allow-scripts" srcdoc="{escape(self.page)}" '
            f'style="width:100%;height:{height}px;border:0"></iframe>'
        )

    @property
    def csv(self) -> str:
        """Table with one row per cell.

        Columns: speeds [m/s], frequency [rad/s], state, counted frames, smallest visible gain errors
        (typical, at the strongest frame, at any excitation), alarms.
        """
        text = io.StringIO()
        table = csv.writer(text, lineterminator="\n")
        names = [f.name for f in fields(MapCell)]
        table.writerow(["speed_from_mps", "speed_to_mps", *names[1:], "state"])
        for cell in (cell for row in self.cells for cell in row):
            speeds, *rest = astuple(cell)
            table.writerow([*speeds, *rest, cell.state])
        return text.getvalue()

    def save(self, path: str | Path) -> None:
        """Write the map to a file; its suffix is .html, or .csv for a table of the cells.

        Parameters
        ----------
        path : str or Path

        Raises
        ------
        InputError
            If the suffix is neither of these.
        """
        suffix = Path(path).suffix.lower()
        if suffix not in (".html", ".csv"):
            raise InputError(path, "suffix", suffix or "none", ".html or .csv")
        Path(path).write_text(self.page if suffix == ".html" else self.csv, encoding="utf-8")


@contextmanager
def _opened(identified: Identified) -> Iterator[IdentificationPictures]:
    """Open an identification's folder while its pictures are drawn."""
    with identified.opened() as stored:
        yield IdentificationPictures(stored, stored.estimator)


def _id(name: str) -> str:
    """Convert a name to a valid HTML id."""
    return re.sub(r"[^\w-]", "_", name)


def disturbance(identified: Identified) -> Picture:
    """Draw Fig. 2 of the paper: the disturbance bound and its frames.

    Parameters
    ----------
    identified : Identified

    Returns
    -------
    Picture
    """
    with _opened(identified) as drawn:
        return drawn.disturbance(f"disturbance-{identified.project.name}")


def weights(identified: Identified) -> Picture:
    """Draw Fig. 3 of the paper: the weights over the bounds.

    Parameters
    ----------
    identified : Identified

    Returns
    -------
    Picture
    """
    with _opened(identified) as drawn:
        return drawn.weights(f"weights-{identified.project.name}")


def model_error(identified: Identified) -> Picture:
    """Draw the model error model together with W_delta.

    Parameters
    ----------
    identified : Identified

    Returns
    -------
    Picture
    """
    with _opened(identified) as drawn:
        return drawn.model_error(f"model-error-{identified.project.name}")


def front(identified: Identified) -> Picture:
    """Draw the Pareto fronts between disturbance and uncertainty.

    Parameters
    ----------
    identified : Identified

    Returns
    -------
    Picture

    Raises
    ------
    InputError
        If the structure is S0, which has no front.
    """
    with _opened(identified) as drawn:
        shown = drawn.front(f"front-{identified.project.name}")
    if shown is None:
        raise InputError("front", "bounds.structure", "S0", "a structure that trades uncertainty")
    return shown


def excitation(identified: Identified, *runs: Replayed) -> Picture:
    """Draw the nominal output in the counted frames together with the disturbance bound.

    Parameters
    ----------
    identified : Identified
    *runs : Replayed

    Returns
    -------
    Picture
    """
    if not runs:
        raise InputError("excitation", "runs", "none", "results of lpvguard.replay")
    frames = [run.summary.run.frames for run in runs]
    bin_of = np.concatenate([f.bin[f.counted] for f in frames])
    Z = np.concatenate([f.Z[f.counted] for f in frames])
    with _opened(identified) as drawn:
        return drawn.excitation(f"excitation-{identified.project.name}", bin_of, Z)


def blind(identified: Identified, *runs: Replayed) -> BlindMap:
    """Draw a map over speed and frequency: proved, blind, without data, or violated.

    Parameters
    ----------
    identified : Identified
    *runs : Replayed

    Returns
    -------
    BlindMap
    """
    alarms = [alarm for run in runs for alarm in run.alarms]
    with identified.opened() as stored:
        return BlindMap(cells(stored.visibility, alarms), map_page(stored, alarms))


def margins(run: Replayed) -> Picture:
    """Draw a drive's margin over time and frequency, with its speed, verdict and alarms.

    Parameters
    ----------
    run : Replayed

    Returns
    -------
    Picture
    """
    return drive_map(f"margins-{_id(run.summary.name)}", run.replayer, run.drive, run.summary)


def in_time(run: Replayed, begin_s: float = 0.0, end_s: float = np.inf) -> Picture:
    """Draw Fig. 4 of the paper: measurement and nominal model over time.

    Parameters
    ----------
    run : Replayed
    begin_s, end_s : float, s after the drive's start, by default all

    Returns
    -------
    Picture

    Raises
    ------
    InputError
        If fewer than two samples lie between the two times.
    """
    series, outputs = run.arrow, run.replayer.project.outputs
    t = series["t"].to_numpy()
    shown = (t >= begin_s) & (t <= end_s)
    if shown.sum() < 2:
        raise InputError(
            run.summary.name, f"{begin_s:g} to {end_s:g} s", "no two samples", "a longer stretch"
        )
    y, yhat = (
        np.column_stack([series[f"{kind}{s.name}"].to_numpy()[shown] for s in outputs])
        for kind in ("", "yhat/")
    )
    stretch = Stretch(run.summary.name, t[shown], run.drive.v[shown], y, yhat)
    return model_in_time(f"model-{_id(run.summary.name)}", [stretch], outputs)


def design(folder: str | Path) -> dict[str, Picture]:
    """Draw the results of `lpvguard design`.

    Parameters
    ----------
    folder : str or Path

    Returns
    -------
    dict[str, Picture], those of fig5, fig6 and tradeoff that it has
    """
    files = {
        name: (Path(folder) / name).read_text(encoding="utf-8")
        for name in ("figures.json", "tradeoff.json")
        if (Path(folder) / name).is_file()
    }
    if not files:
        raise InputError(folder, "", "no figures.json and no tradeoff.json", "a folder of `lpvguard design`")
    return design_pictures.pictures(files)


def evaluation(path: str | Path) -> Picture:
    """Draw the times to find injected faults.

    Parameters
    ----------
    path : str or Path, JSON of `lpvguard evaluate`

    Returns
    -------
    Picture
    """
    document = artefacts.read_json(Path(path))
    return time_to_find("time-to-find", document["faults"], document["injection"]["within_s"])


def campaign(path: str | Path) -> dict[str, Picture]:
    """Draw detection and time to the first alarm over severity.

    Parameters
    ----------
    path : str or Path, summary.json of `lpvguard campaign`

    Returns
    -------
    dict[str, Picture], matched and found at matched and calibrated thresholds, and time
    """
    return drawn_campaign(artefacts.read_json(Path(path)))


def simulated(folder: str | Path) -> dict[str, Picture]:
    """Draw the runs of `lpvguard sim -o`.

    Parameters
    ----------
    folder : str or Path

    Returns
    -------
    dict[str, Picture], by scenario and seed
    """
    runs = artefacts.read_json(Path(folder) / "results.json")
    names = {f"{r['scenario']}-{r['seed']}": r for r in runs}
    return {name: drawn_run(Path(folder), _id(name), r) for name, r in names.items()}
