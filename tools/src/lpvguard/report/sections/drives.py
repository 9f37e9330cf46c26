"""Section "Margin over time and frequency, drive by drive", and its short form for the plain DFT."""

from html import escape

import numpy as np

from ...core.compiled import REASONS, VERDICTS
from ...drives.excitation import excited
from ...drives.tables import Drive
from ...engine.validation import s1
from ...fit.quality import of_drive
from ...identify.bounds import counted_frames
from ...identify.identification import DriveSet, StoredIdentification
from ...identify.unexplained import left_unexplained
from ...replay.replayer import Alarm, Replay, Replayer
from ..drive_summary import DriveSummary, course, nearest
from ..identification_pictures import drive_map
from ..markup import captioned, html_table, number
from ..pictures.margin_map import REASON_WORDS, map_key
from ..visits import Visits, longest_run
from .drive_index import drive_index

ALARMS_LISTED = 10


def visit(
    visits: Visits, stored: StoredIdentification, replayer: Replayer, drive: Drive, yhat: np.ndarray, key: str
) -> DriveSummary:
    """Replay a drive, store its counted frames and longest stretches in ``visits``, and return its summary.

    yhat (N, n_y) is the nominal output. ``key`` is the id of its section and name of its picture, unique on
    the page.
    """
    replay = replayer.replay(drive)
    frames = replay.run.frames
    counted = frames.counted
    visits.bin.append(frames.bin[counted])
    visits.Z.append(frames.Z[counted])
    low, high = replayer.model.speed_range
    relevant = replay.in_range & replay.excited
    usable = replay.judged & relevant
    third = (high - low) / 3
    visits.slow = visits.slow.or_longer(drive.name, longest_run(usable & (drive.v <= low + third)))
    visits.fast = visits.fast.or_longer(drive.name, longest_run(usable & (drive.v >= high - third)))
    explained = of_drive(replayer.model, drive, yhat, [])
    groups = stored.manifest["drives"]
    sets_bounds = drive.name in groups["bounds"]
    used = sets_bounds or drive.name in groups["calibration"]
    return DriveSummary(
        key,
        drive.name,
        stored.manifest["drivers"][drive.name],
        _role(stored, drive.name),
        (float(drive.present.v.min()), float(drive.present.v.max())),
        replay.duration_s,
        replay.judged_s,
        float(relevant.sum() * replay.Ts),
        float(usable.sum() * replay.Ts),
        replay.verdict_final.replace("_", " "),
        nearest(replay, replayer, drive),
        replay.alarms,
        *course(replay, replayer, drive.t[0]),
        float(np.min(explained.vaf)),
        left_unexplained(stored.project, explained, sets_bounds) if used else None,
        _drive_page(stored, replayer, drive, replay, key),
    )


def visit_plain(visits: Visits, stored: StoredIdentification, drives: DriveSet, drive: Drive) -> list[str]:
    """Judge the drive as one frame of the plain DFT, by its exact margin with the stored weights.

    Stores the frame in ``visits`` and returns the drive's row of the table.
    """
    reader, project = drives.reader, stored.project
    estimator, model = reader.estimator, reader.model
    sets = list(counted_frames(drive, *drives.load(drive.name)[1:], model, estimator))
    row = [escape(drive.name), escape(stored.manifest["drivers"][drive.name]), _role(stored, drive.name)]
    if not len(sets[0].starts):
        return [*row, "–", "–", "–", "–"]
    E, Z = (np.concatenate([getattr(s, a) for s in sets]) for a in ("E", "Z"))
    visits.bin.append(np.arange(estimator.n_bins))
    visits.Z.append(Z)
    span = slice(int(sets[0].starts[0]), int(sets[0].starts[0] + estimator.length[0]))
    low, high = model.speed_range
    third = (high - low) / 3
    speed = drive.v[span].mean()
    if excited(drive, project)[span].any():
        if speed <= low + third:
            visits.slow = visits.slow.or_longer(drive.name, span)
        elif speed >= high - third:
            visits.fast = visits.fast.or_longer(drive.name, span)
    margin = s1.margin(E, Z, *stored.fitted.of_frames(estimator.omega))
    worst = int(np.argmax(margin))
    return [
        *row,
        f"{drive.t[span.start] - drive.t[0]:.4g}",
        f"{speed:.3g}",
        number(margin[worst]),
        number(estimator.omega[worst]),
    ]


def plain_section(rows: list[list[str]]) -> str:
    """Make the section for bounds of the plain DFT, from ``rows`` of `visit_plain`."""
    table = html_table(
        [
            "drive",
            "driver",
            "part",
            "frame from, s",
            "mean speed, m/s",
            "largest margin",
            "in the bin, rad/s",
        ],
        rows,
    )
    return f"""<h2>Margin drive by drive</h2>
<p>One frame a drive, the first that keeps its speed, judged by the exact margin: above 1, no uncertainty \
and disturbance within the
weights explains it. Drives that set the bounds are at or below 1 by construction. “–”: no \
frame.</p>{table}"""


def _role(stored: StoredIdentification, name: str) -> str:
    """Role of a drive in the identification."""
    groups = stored.manifest["drives"]
    if name in groups["bounds"]:
        return "set the bounds"
    if name in groups["left_out"]:
        return f"left out: {escape(groups['left_out'][name])}"
    if name in groups["noise"]:
        return "zero input: bounds the noise"
    return f"calibrates, score {stored.calibration.scores[name]:.3f}"


def _facts(replay: Replay) -> str:
    """Three small tables of a drive: totals, time per verdict, frames per reason."""
    report, frames = replay.to_dict(), len(replay.run.frames.bin)
    share = (
        report["judged_in_range_excited_s"] / report["in_range_excited_s"]
        if report["in_range_excited_s"]
        else None
    )
    totals = {
        "duration, s": f"{replay.duration_s:.1f}",
        "judged, s": f"{replay.judged_s:.1f}",
        "of in-range, excited time": "–" if share is None else f"{share:.1%}",
        "largest margin": number(replay.max_margin),
        "alarms": str(len(replay.alarms)),
        "final verdict": escape(replay.verdict_final.replace("_", " ")),
    }
    verdicts = {f"{v.replace('_', ' ')}, s": f"{report['verdict_s'][v]:.1f}" for v in VERDICTS}
    reasons = {"frames": str(frames)} | {
        REASON_WORDS[r]: f"{report['frames'][r]} ({100 * report['frames'][r] / max(1, frames):.1f} %)"
        for r in REASONS
    }
    return "".join(html_table(table, [table.values()], "tight") for table in (totals, verdicts, reasons))


def _alarm_table(alarms: list[Alarm]) -> str:
    """Table of the first alarms of a drive with their evidence, and the number of further ones."""
    if not alarms:
        return ""
    head = [
        "alarm at, s",
        "test",
        "bin, rad/s",
        "speed, m/s",
        "margin",
        "statistic",
        "threshold",
        "|E|",
        "|Z|",
        "W<sub>Δ</sub>",
        "B<sub>w</sub>",
        "evidence",
    ]
    listed = alarms[:ALARMS_LISTED]
    rows = [
        [
            f"{a.t_s:.2f}",
            ", ".join(filter(None, [a.test, a.band, a.output, a.part])),
            number(a.bin_rad_s),
            f"{a.speed_mps:.1f}",
            number(a.margin),
            number(a.statistic),
            number(a.threshold),
            number(np.linalg.norm(a.E)) if a.E else "–",
            number(np.linalg.norm(a.Z)) if a.Z else "–",
            "–" if a.W_delta is None else ", ".join(number(w) for w in a.W_delta),
            ", ".join(number(b) for b in a.B_w) or "–",
            number(a.evidence),
        ]
        for a in listed
    ]
    left = len(alarms) - len(listed)
    more = f'<p class="note">{left} more alarms; lpvguard replay --json lists all.</p>' if left else ""
    return html_table(head, rows) + more


def _causes(replay: Replay) -> str:
    """Causes that the core found for a drive's alarms."""
    rows = [[f"{d.t_s:.2f}", f"{d.alarm_s:.2f}", escape(d.says)] for d in replay.diagnoses]
    rows += [
        [f"{p.until_s:.2f}", "–" if p.alarm_s is None else f"{p.alarm_s:.2f}", escape(p.says)]
        for p in replay.parts or ()
    ]
    return html_table(["found at, s", "alarm at, s", "cause or part"], rows, "words") if rows else ""


def _drive_page(
    stored: StoredIdentification, replayer: Replayer, drive: Drive, replay: Replay, key: str
) -> str:
    """Map of the drive's margins, its facts and its alarms."""
    drawn = drive_map(key, replayer, drive, replay)
    driver = escape(stored.manifest["drivers"][drive.name])
    role = _role(stored, drive.name)
    return f"""<div class="drive" id="{key}"><h3>{escape(drive.name)} <span class="note">({driver} driver; \
{role})</span> <a class="back" href="#drive-index">all drives</a></h3>
{captioned(drawn, "")}<div class="facts">{_facts(replay)}</div>{_alarm_table(replay.alarms)}\
{_causes(replay)}</div>"""


def drive_section(summaries: list[DriveSummary], threshold: float) -> str:
    """Return the index of drives, the key of the maps, then each drive that ``visit`` returned."""
    key = captioned(
        map_key("key"),
        "<b>How to read the maps.</b> Time runs to the right. There is one line per bin, with DC at the "
        "bottom. Each cell is one frame judged by the compiled core, drawn over its central half. The colour "
        f"is its margin t* over the threshold {threshold:.4g}. The fitted bounds just explain a frame with "
        f"t* = 1, at 1/{threshold:.4g} = {1 / threshold:.2g}. Dotted cells counted, but had little "
        "excitation: even a vehicle that does not respond would have passed. They are no evidence for the "
        "model. Patterned cells were not judged; the key states the reason. Blank: no frame. Triangles at "
        "the end of a frame: alarms of the frame test, pointing to the cell of the frame. Triangles at the "
        "top: alarms of the energy test. Diamonds at the top: alarms of the change test. Below: speed (model "
        "range dashed) and the monitor's verdict. In the alarm tables |E| and |Z| are Euclidean norms in "
        "output units. For the energy test, |E| is the norm of F e, |Z| that of F W<sub>Δ</sub> ŷ with "
        "forgetting, and B<sub>w</sub> is σ; the term of a restart is not shown. The change test has no "
        "norms. Evidence is the margin of a vehicle that does not respond. Judged seconds lie in a counted "
        "frame of any bin, with or without evidence. The verdict “valid” needs evidence within the longest "
        "frame, so a drive can be judged all the time with the verdict “not judged”.",
    )
    sections = "".join(d.section for d in summaries)
    return f"<h2>Margin over time and frequency, drive by drive</h2>{drive_index(summaries)}{key}{sections}"
