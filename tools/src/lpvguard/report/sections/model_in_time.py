"""Section "The nominal model in time", which corresponds to Fig. 4."""

from html import escape

import numpy as np

from ...identify.identification import DriveSet, StoredIdentification
from ..markup import captioned
from ..pictures.over_time import Stretch, model_in_time
from ..visits import Visits

LONGEST_STRETCH_S = 60.0
"""Longest drawn part of a stretch [s], so that single bends of the road can be seen."""


def time_section(visits: Visits, stored: StoredIdentification, drives: DriveSet) -> str:
    """Return the longest judged, excited stretches of ``visits`` at low and at high speed."""
    stretches, words, project = [], [], stored.project
    for label, longest in (("lower", visits.slow), ("upper", visits.fast)):
        if not longest.samples:
            words.append(f"No judged, excited stretch in the {label} third of the speed range.")
            continue
        name, start = longest.drive, longest.start
        drive, e, yhat = drives.load(name)
        shown = slice(start, min(longest.stop, start + round(LONGEST_STRETCH_S / project.Ts_s)))
        v, error, y = drive.v[shown], e[shown], drive.y[shown]
        role = "set the bounds" if name in stored.manifest["drives"]["bounds"] else "did not set the bounds"
        low, high = f"{v.min():.1f}", f"{v.max():.1f}"
        title = f"{name}, {low} m/s" if low == high else f"{name}, {low} to {high} m/s"
        stretches.append(Stretch(title, drive.t[shown] - drive.t[0], v, y, yhat[shown]))
        rms = "; ".join(
            f"{escape(s.name)} error rms {np.std(error[:, j]):.2g} {escape(s.unit)} about its mean "
            f"{error[:, j].mean():.2g}, against {np.std(y[:, j]):.2g} of the measurement"
            for j, s in enumerate(project.outputs)
        )
        words.append(
            f"{label.capitalize()} third: {escape(name)} ({role}), {longest.samples * project.Ts_s:.1f} s "
            f"long, {(shown.stop - shown.start) * project.Ts_s:.1f} s shown; {rms}."
        )
    drawn = model_in_time("f4", stretches, project.outputs) if stretches else None
    return "<h2>The nominal model in time</h2>" + captioned(
        drawn,
        "<b>Counterpart of Fig. 4.</b> Measured output (solid) and nominal model along the measured speed "
        "(dashed). Below: the nominal error e = y − ŷ with a separate scale. The rule for the choice is "
        "fixed: the longest judged, in-range, excited stretch in the lower and in the upper third of the "
        "model's speed range. " + " ".join(words),
    )
