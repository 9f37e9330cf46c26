"""`lpvguard report`: one self-contained HTML page with every picture and table of an identification.

Every number comes from the identification folder, or from a replay of the drives through the compiled core.
The page loads nothing from outside. It holds no clock time, so the same input gives the same bytes. It can be
read without its script.
"""

from collections.abc import Callable, Iterator
from html import escape
from importlib import resources
from pathlib import Path

from .. import __version__
from ..base import artefacts
from ..identify.identification import DriveSet, StoredIdentification
from ..replay.replayer import Alarm, Replayer
from ..vehicle.project import Project
from .blindness import cells
from .drive_summary import DriveSummary
from .identification_pictures import IdentificationPictures
from .pictures.drawing import files, kept, shared
from .sections.bounds import bound_sections
from .sections.campaign import campaign_section
from .sections.closed_loop import loop_section
from .sections.confirmation import confirmation_section
from .sections.design import design_section
from .sections.drives import drive_section, plain_section, visit, visit_plain
from .sections.evaluation import evaluation_section
from .sections.isolation import isolation_section
from .sections.model_in_time import time_section
from .sections.overview import blind_map, overview_section
from .sections.summary import summary_section
from .sections.tradeoff import tradeoff_section
from .sections.visibility import visibility_section
from .visits import Visits

LIBRARIES = ("bokeh", "bokeh-api")
"""Parts of BokehJS for the pictures, in the order of loading."""
SCRIPTS = ("page.js", "zoom.js")
"""Scripts for zooming, sorting and searching."""
PICTURES = "report"
"""Kind of output folder that holds the pictures."""
POLICY = "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; img-src data: blob:"
"""Content policy: a browser loads nothing from outside the page."""


def write_report(
    stored: StoredIdentification,
    drives: DriveSet,
    replayer: Replayer | None,
    out: Path,
    evaluation: dict | None,
    progress: Callable[[str], None],
    loops: Path | None = None,
    design: Path | None = None,
    tradeoff: Path | None = None,
    campaign: dict | None = None,
    pictures: Path | None = None,
) -> None:
    """Write the page.

    Parameters
    ----------
    stored : StoredIdentification
    drives : DriveSet, the identification's drives
    replayer : Replayer, or None for bounds of the plain DFT; the exact margin then judges the drives
    out : Path, the page
    evaluation : dict or None, JSON of `lpvguard evaluate`
    progress : Callable, reports progress
    loops : Path, optional, folder of `lpvguard sim -o`, with results.json
    design, tradeoff : Path, optional, folders of `lpvguard design`, without and with --tradeoff
    campaign : dict, optional, summary.json of `lpvguard campaign`
    pictures : Path, optional, folder for every picture as SVG and CSV

    Raises
    ------
    InputError
        If a drive cannot be read, or the page cannot be written.
    """
    with kept() as drawn:
        sections = list(
            _sections(stored, drives, replayer, evaluation, progress, loops, design, tradeoff, campaign)
        )
    page, scripts = shared(_page(stored.project, sections)), _scripts()
    artefacts.write_file(out, page.replace("</body>", f"{scripts}</body>"), "report")
    if pictures is not None:
        with artefacts.new_folder(pictures, PICTURES, stored.project.name) as folder:
            text = artefacts.manifest(PICTURES, vehicle=stored.project.name, identification=stored.manifest)
            artefacts.write_files(folder, files(drawn) | {artefacts.MANIFEST: text})


def _sections(
    stored: StoredIdentification,
    drives: DriveSet,
    replayer: Replayer | None,
    evaluation: dict | None,
    progress: Callable[[str], None],
    loops: Path | None,
    design: Path | None,
    tradeoff: Path | None,
    campaign: dict | None,
) -> Iterator[str]:
    """All sections; the arguments are the same as for ``write_report``."""
    yield from _identification_sections(stored, drives, replayer, progress, design, evaluation)
    if evaluation is not None:
        yield evaluation_section(evaluation)
    if design is not None:
        yield design_section(design)
    if tradeoff is not None:
        yield tradeoff_section(tradeoff)
    if loops is not None:
        yield loop_section(loops)
    if campaign is not None:
        yield campaign_section(campaign)


def _identification_sections(
    stored: StoredIdentification,
    drives: DriveSet,
    replayer: Replayer | None,
    progress: Callable[[str], None],
    design: Path | None,
    evaluation: dict | None,
) -> Iterator[str]:
    """Sections that every page has. The drives are read first, because some sections show their content."""
    visits = Visits()
    summaries: list[DriveSummary] = []
    rows: list[list[str]] = []
    for name in drives.experiments:
        progress(name)
        drive, _, yhat = drives.load(name)
        if replayer is not None:
            summaries.append(visit(visits, stored, replayer, drive, yhat, f"d{len(summaries)}"))
        else:
            rows.append(visit_plain(visits, stored, drives, drive))
    progress("pictures")
    drawn = IdentificationPictures(stored, drives.reader.estimator)
    yield overview_section(stored, summaries, replayer is not None, design, evaluation)
    yield summary_section(stored, replayer, drives)
    yield from bound_sections(drawn)
    yield time_section(visits, stored, drives)
    yield visibility_section(visits, drawn)
    if stored.confirmation is not None:
        yield confirmation_section(stored.confirmation)
    if stored.isolation is not None:
        yield isolation_section(stored.isolation, stored.project)
    yield drive_section(summaries, replayer.threshold) if replayer is not None else plain_section(rows)


def map_page(stored: StoredIdentification, alarms: list[Alarm]) -> str:
    """Write the first screen's picture as a page.

    Parameters
    ----------
    stored : StoredIdentification
    alarms : list of Alarm, of all drives

    Returns
    -------
    str, HTML
    """
    shown = blind_map(stored, cells(stored.visibility, alarms), alarms)
    return f"""<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><meta http-equiv="Content-Security-Policy" content="{POLICY}">
<title>{escape(stored.project.name)}</title><style>{_own("page.css")}</style></head><body>{shown}
<script>{_own("page.js")}</script></body></html>
"""


def _own(name: str) -> str:
    """Text of a file in this package."""
    return resources.files(__package__).joinpath(name).read_text(encoding="utf-8")


def _scripts() -> str:
    """BokehJS as text, which zoom.js runs at the first zoom, then the scripts of this package."""
    folder = resources.files("bokeh").joinpath("server", "static", "js")
    libraries = [folder.joinpath(f"{name}.min.js").read_text(encoding="utf-8") for name in LIBRARIES]
    own = [_own(name) for name in SCRIPTS]
    return "".join(
        f'<script type="text/plain" data-library>{text}</script>\n' for text in libraries
    ) + "".join(f"<script>{text}</script>\n" for text in own)


def _page(project: Project, sections: list[str]) -> str:
    """The whole page; the titles of the sections (h2) become the line of links."""
    titles = [s[s.index("<h2>") + 4 : s.index("</h2>")] for s in sections]
    nav = " ".join(f'<a href="#s{i}">{title}</a>' for i, title in enumerate(titles, start=1))
    body = "".join(f'<section id="s{i}">{s}</section>\n' for i, s in enumerate(sections, start=1))
    return f"""<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><meta name="generator" content="{artefacts.mark("report")}">\
<meta name="viewport" content="width=device-width,initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="{POLICY}">
<title>lpvguard report: {escape(project.name)}</title><style>{_own("page.css")}</style></head><body>
<h1>{escape(project.title)}</h1>
<nav>{nav}</nav>
{body}<p class="lead">Words and equation numbers are those of Rödönyi and Bokor, <i>Uncertainty \
identification for a nominal LPV vehicle model based on experimental data</i>. Made by lpvguard \
{escape(__version__)}; the same drives give the same page.</p>
</body></html>
"""
