"""Section "Excitation and what stays invisible": |Z| per bin and the smallest visible errors."""

from html import escape

import numpy as np

from ...drives.frames import Estimator
from ...identify.visibility import STATED_GAINS
from ..identification_pictures import IdentificationPictures
from ..markup import captioned, html_rows, html_table, number, unit_of_norm, yes_or_no
from ..visits import Visits


def visibility_section(visits: Visits, drawn: IdentificationPictures) -> str:
    """Return the section on the excitation in the counted frames of ``visits``, with visibility.json."""
    stored, estimator = drawn.stored, drawn.estimator
    speeds = "" if stored.pools is None else f"<p>{escape(stored.pools.speeds_text())}.</p>"
    return f"""<h2>Excitation and what stays invisible</h2>{_excitation(visits, drawn)}
{_smallest_visible(stored.visibility, estimator, unit_of_norm(stored.project.outputs))}{speeds}"""


def _excitation(visits: Visits, drawn: IdentificationPictures) -> str:
    """Picture of |Z| per bin over the counted frames."""
    unit = unit_of_norm(drawn.stored.project.outputs)
    bin_of, Z = np.concatenate(visits.bin), np.concatenate(visits.Z)
    half = " (half overlapping, so they are not independent)"
    overlap = half if drawn.estimator.window == "hann" else ""
    return captioned(
        drawn.excitation("f5", bin_of, Z),
        f"<b>Excitation.</b> Largest and median |Z|, the nominal output in a frame, over the {len(bin_of)} "
        "counted frames of all drives, and the disturbance bound. If the median lies below the bound, most "
        f"frames say little about the model. Lower panel: counted frames per bin{overlap}. Left end: DC. "
        f"Unit of |Z|: {escape(unit)}.",
    )


def _cell_names(cells: list[dict]) -> list[str]:
    """Speed range of every cell [m/s], as text without line breaks."""
    return [f"{c['speed_mps'][0]:.3g}–\N{WORD JOINER}{c['speed_mps'][1]:.3g}" for c in cells]


def _overall(seen: dict) -> str:
    """Table per speed: smallest visible errors over all bins, and whether the stated faults are visible."""
    typical, strongest = seen["at_percentile"], seen["at_strongest"]
    names = _cell_names(typical)
    return html_rows(
        {
            "speed, m/s": n,
            "counted frames": str(sum(c["frames"])),
            "excitation": word,
            "smallest visible gain error": number(c["smallest_gain_error"]),
            "smallest visible delay, s": number(c["smallest_delay_s"]),
            **{s["fault"] + "?": yes_or_no(s["visible"], "visible", "invisible") for s in c["stated"]},
        }
        for n, *both in zip(names, typical, strongest, strict=False)
        for word, c in zip((f"{seen['percentile']}th percentile", "strongest"), both, strict=False)
    )


def _smallest_visible(seen: dict, estimator: Estimator, unit: str) -> str:
    """Return the tables of visibility.json, ``seen``, with |Z| in ``unit``."""
    typical, strongest = seen["at_percentile"], seen["at_strongest"]
    names = _cell_names(typical)
    labels = ["DC", *(f"{w:.3g}" for w in estimator.omega[1:])]
    stated = ", ".join(f"a gain of {c:g} has g = {abs(1 - c):.3g}" for c in STATED_GAINS)

    def by_bin(key: str, cells: list[dict]) -> list[list[str]]:
        return [[n, *(number(x, 2) for x in c[key])] for n, c in zip(names, cells, strict=False)]

    head = ["speed, m/s \\ bin, rad/s", *labels]
    floor = ["any excitation", *(number(x, 2) for x in seen["gain_error_floor"])]
    gain, gain_strongest = (
        html_table(head, [*by_bin("gain_error", cells), floor]) for cells in (typical, strongest)
    )
    delay, delay_strongest = (html_table(head, by_bin("delay_s", cells)) for cells in (typical, strongest))
    frames = html_table(
        head, [[n, *(str(x) for x in c["frames"])] for n, c in zip(names, typical, strict=False)]
    )
    size_table, size_strongest = (
        html_table(head, by_bin("excitation", cells)) for cells in (typical, strongest)
    )
    return f"""<h3>Smallest visible error per speed</h3>
<p>A frame of a vehicle that responds with c times the nominal output shows E = −gZ, |g| = |1 − c|, and \
exceeds the threshold
{seen["threshold"]:.4g} exactly when g &gt; threshold / t*(−Z, Z); with one output, when
g|Z| &gt; threshold · (B<sub>w</sub> + W<sub>Δ</sub>|Z|). A delay τ has g = |1 − e<sup>−jωτ</sup>|. Z is \
the
{seen["percentile"]}th percentile of the bound-setting and calibration drives in the cell (over at \
most
{seen["sampled_frames"]} of its frames), so one counted frame in {100 // (100 - seen["percentile"])} is at \
least
as strong. A second table takes Z from the strongest frame. A smaller fault is invisible, unless the \
excitation is stronger or the vehicle's ordinary
error adds to it; {stated}. A pool of frames and the change test can see smaller errors. The tables state \
the smallest that any of the three sees. “–”: none judged there.</p>{_overall(seen)}
<h3>Smallest visible gain error, per speed and bin, {seen["percentile"]}th percentile</h3>{gain}
<h3>At the strongest excitation</h3>{gain_strongest}\
<p class="note">Last line: threshold · W<sub>Δ</sub>. A smaller
gain error stays invisible in frames with any excitation. If the value is above 1,
 no frame notices even a vehicle that does not respond in that bin.</p>
<h3>Smallest visible delay [s], per speed and bin, {seen["percentile"]}th percentile</h3>{delay}
<h3>At the strongest excitation</h3>{delay_strongest}
<p class="note">“–”: no delay is large enough (g above 2), DC, or no frame.</p>
<h3>Excitation |Z| [{escape(unit)}] behind these numbers: {seen["percentile"]}th percentile, strongest</h3>\
{size_table}{size_strongest}
<h3>Counted frames</h3>{frames}"""
