"""Section "Controller and its certificates": robustness of the truck's loop, Table II, and Figs. 5 and 6."""

from html import escape
from pathlib import Path

from ...base import artefacts
from ...base.claims import worst_frozen
from ...base.errors import InputError
from ...engine.synthesis.margins import SHOWN, SKEWS, disk_gain_and_phase, shown
from ..design_pictures import draw
from ..markup import captioned, html_rows, html_table, number, premise_words, yes_or_no
from ..pictures.drawing import Picture

ROBUST = "robust.json"
"""File of `lpvguard bench robust --json`, beside the design's folder."""
MARGINS = {
    "gain_up": "gain, up",
    "phase": "phase",
    "delay": "delay",
    "Ms": "M<sub>s</sub>",
    "Mt": "M<sub>t</sub>",
    "disk_balanced": "disk margin",
    "disk_gain": "disk: gain",
    "disk_phase": "disk: phase",
}
"""Margins on the page, with their titles."""


def design_section(folder: Path) -> str:
    """Return the section of a folder that `lpvguard design` wrote.

    Table II, its pictures and ROBUST may be missing. Raises InputError if ROBUST belongs to another
    controller.
    """
    controller = artefacts.read_json(folder / "controller.json")["certificates"]
    speeds = html_table(
        ["speed, m/s", "μ upper", "μ lower", "peak, rad/s"],
        [
            [number(r["v_mps"], 4), f"{r['mu_upper']:.4f}", f"{r['mu_lower']:.4f}", number(r["peak_rad_s"])]
            for r in controller["speeds"]
        ],
        "tight",
    )
    highest = worst_frozen(controller)["mu_upper"]
    text = f"""<h2>Controller and its certificates</h2>
<p>{escape(controller["structure"])} scheduled over speed, {controller["order"]} states: \
{escape(controller["claim"])}. Largest μ proved: {highest:.4f}.</p>
<p>{premise_words(controller["premise"])}</p>{speeds}"""
    text += _robustness(controller.get("robustness")) + _slow_delta(controller.get("slow_delta"))
    text += _limits(controller.get("limits"))
    beside = folder.absolute().parent / ROBUST
    if beside.is_file():
        text += _true_loop(beside, controller["coefficients_sha256"])
    if not (folder / "table2.json").is_file():
        return text
    table, figures = (artefacts.read_json(folder / name) for name in ("table2.json", "figures.json"))
    pictures = draw(figures)
    text += _table_2(table, pictures["fig5"])
    if "fig6" in figures:
        text += _worst_case(figures["fig6"], pictures["fig6"])
    return text


def _robustness(robustness: dict | None) -> str:
    """Robustness measures other than mu at every node; "" without a claim."""
    if robustness is None:
        return ""

    def cell(value: float | None) -> str:
        return "–" if value is None else f"{value:.4f}"

    rows = []
    for node in robustness["nodes"]:
        low, high, phase = disk_gain_and_phase(node["disk_balanced"], SKEWS["balanced"])
        rows.append(
            [
                number(node["v_mps"], 4),
                cell(node["mu_interval"]),
                cell(node["worst_gain"]),
                cell(node["worst_gain_found"]),
                *(number(node[name]) for name in ("disk_S", "disk_T", "disk_balanced")),
                f"{number(low)} to {number(high)}, {number(shown('phase', phase))}°",
                *(cell(node[name]) for name in ("nu_margin", "nu_gap_next", "nu_gap_midpoint")),
            ]
        )
    titles = [
        "speed, m/s",
        "μ, every frequency",
        "worst-case gain, at most",
        "found",
        "disk S",
        "disk T",
        "balanced disk",
        "its gain and phase",
        "ν-margin",
        "ν-gap to next node",
        "to midpoint",
    ]
    return f"""<h3>Beside μ, at every node</h3>
<p>μ and worst-case gain are bounds proved between frequencies, over every LTI Δ of size 1 (THEORY 7.10). \
Disk margins are those of the nominal loop, opened at the vehicle's input. The ν-margin is the largest \
ν-gap up to which every vehicle is stabilised.</p>{html_table(titles, rows, "tight")}"""


def _slow_delta(slow_delta: dict | None) -> str:
    """Allowed rate of change of Δ; "" without a claim."""
    if slow_delta is None:
        return ""

    def rate(value: float | None) -> str:
        return "any" if value is None else number(value)

    rows = [
        [
            number(node["v_mps"], 4),
            number(node["performance_rate"]),
            rate(node["stability_rate"]),
            f"{node['stability_level']:.4f}",
        ]
        for node in slow_delta["nodes"]
    ]
    table = html_table(
        ["speed, m/s", "gain below 1 up to, 1/s", "stable up to, 1/s", "its level"], rows, "tight"
    )
    hidden = [slow_delta[f"hidden_{end}_per_s"] for end in ("slow", "fast")]
    proved = slow_delta["performance_rate_per_s"]
    words = [
        yes_or_no(proved >= value, f"above {number(value)}/s", f"below {number(value)}/s") for value in hidden
    ]
    least = slow_delta["stability_rate_per_s"]
    stable = "at any rate" if least is None else f"up to {number(least)}/s"
    return f"""<h3>A Δ that varies</h3>
<p>Proved for every causal linear Δ of gain 1 whose gain changes by at most the rate (THEORY 7.11). A frame \
sees only the mean of a Δ that changes its sign within the frame. Such a Δ changes by {number(hidden[0])}/s \
in the longest frame, and by {number(hidden[1])}/s in the shortest. The proved rate with a gain below 1, \
{number(proved)}/s, is {words[0]} and {words[1]}. The loop is stable {stable}.</p>{table}"""


def _limits(limits: dict | None) -> str:
    """Proof for a demand at its limits (saturation); "" without a claim."""
    if limits is None:
        return ""
    rows = []
    for row in limits["rows"]:
        stable = row["stability_level"] is not None and row["stability_level"] < 1
        rows.append(
            [
                number(row["v_mps"], 4),
                "any" if row["kappa"] is None else number(row["kappa"]),
                yes_or_no(stable, "proved", "not proved"),
                *("–" if row[name] is None else number(row[name]) for name in ("gain", "energy")),
            ]
        )
    table = html_table(
        [
            "speed, m/s",
            "wanted demand over limit, up to",
            "stable",
            "gain at most",
            "norm of [w; n; r_c] up to",
        ],
        rows,
        "tight",
    )
    return f"""<h3>Limits of the demand</h3>
<p>Proved for every LTI Δ within W<sub>Δ</sub>, with the anti-windup of the core (THEORY 7.12). \
If the wanted demand stays within the stated multiple of its limit, the loop is stable and the gain is \
bounded. Every [w; n; r<sub>c</sub>] up to the stated norm keeps the demand within this multiple and does \
not reach the rate limit.</p>{table}"""


def _true_loop(path: Path, controller: str) -> str:
    """Write promised and true margins, and the distance from the nominal model, from ROBUST at ``path``.

    ``controller`` is its SHA-256.
    """
    truth = artefacts.read_json(path)
    if truth["coefficients_sha256"] != controller:
        raise InputError(
            path,
            "coefficients_sha256",
            "belongs to another controller",
            "bench robust of this design, or no file",
        )
    promised = {row["v_mps"]: row["margins"] for row in truth["promised"]}
    rows = []
    for v, held in promised.items():
        rows.append([number(v, 4), "promised", *_margin_cells(held), ""])
        for row in (r for r in truth["true"] if r["v_mps"] == v):
            cells = _margin_cells(row["margins"])
            rows.append(["", number(row["amplitude"]), *cells, _farthest(row["deviations"])])
    titles = [f"{title}, {SHOWN[name][0]}" if name in SHOWN else title for name, title in MARGINS.items()]
    table = html_table(
        ["speed, m/s", "amplitude", *titles, "|δ|/W<sub>Δ</sub>, largest of each output"], rows, "tight"
    )
    within = yes_or_no(truth["beyond"] == 0, "within W<sub>Δ</sub> everywhere", "beyond W<sub>Δ</sub>")
    return f"""<h3>What the loop has, and what is promised</h3>
<p>Promised: the least margins over every vehicle within W<sub>Δ</sub> (THEORY 7.5). They are computed on a \
refined grid of frequencies and not proved between its points. True: the margins of the loop with the \
simulated truck's response to sines of each amplitude. The response lies {within}: {truth["beyond"]} of \
{sum(len(r["deviations"]) for r in truth["true"])} ratios exceed 1. The promise holds only for a truck \
within W<sub>Δ</sub>.</p>{table}"""


def _margin_cells(margins: dict | None) -> list[str]:
    """Cells of MARGINS; a dash is an unlimited margin, words mark an unstable loop."""
    if margins is None:
        return ['<span class="no">unstable</span>', *[""] * (len(MARGINS) - 1)]
    return [
        "–" if (value := margins[name]["value"]) is None else number(shown(name, value)) for name in MARGINS
    ]


def _farthest(deviations: list[dict]) -> str:
    """Largest ratio of each output, with both numbers and its place."""
    return "<br>".join(
        f"{escape(d['output'])} {yes_or_no(d['ratio'] <= 1, number(d['ratio']), number(d['ratio']))}: "
        f"{number(d['delta'])} against {number(d['W_delta'])} at {number(d['omega_rad_s'])} rad/s"
        for d in deviations
    )


def _table_2(table: dict, fig5: Picture) -> str:
    """Return Table II from table2.json, and the picture of its weights."""
    rows = html_rows(
        {
            "Table II": escape(r["structure"]),
            "A<sub>t</sub>": number(r["A_t"], 4),
            "A<sub>u</sub>": number(r["A_u"]),
            "μ upper": f"{r['mu_upper']:.4f}",
            "μ lower": f"{r['mu_lower']:.4f}",
            "no controller below": f"{r['floor']:.4f}",
            "order": str(r["order"]),
            "before reduction": str(r["full_order"]),
            "peak, rad/s": number(r["peak_rad_s"]),
        }
        for r in table["rows"]
    )
    weights = captioned(
        fig5,
        "<b>Counterpart of Fig. 5.</b> Weights of the control problem: left the weights that normalise "
        "signals, right the objectives of Table II.",
    )
    return f"""<h3>Table II for these drives</h3>
<p>At {table["speed_mps"]:g} m/s, sampled every {table["Ts_s"]:g} s, one sample of delay. μ upper is \
certified over all frequencies
(K<sub>∞</sub>: the closed-loop norm). K<sub>is</sub> has state uncertainty with Λ<sub>ν</sub> = diag(1, \
{table["lambda_s"]:g} s²) and
bounds from the {escape(table["state_uncertainty_from"])}. “No controller below” is a lower bound of μ for \
controllers of any order, with these weights, at one frequency and for scalings from \
e<sup>−15</sup> to e<sup>15</sup>.</p>{rows}{weights}"""


def _worst_case(run: dict, fig6: Picture) -> str:
    """Return the picture of the runs with the worst uncertainty, from fig6 of figures.json."""
    measured = html_table(
        [
            "controller",
            "A<sub>t</sub>",
            "A<sub>u</sub>",
            "‖Δ‖∞",
            "Δ exact at, rad/s",
            "gain with Δ",
            "without Δ",
            "tracking error with Δ, rad/s rms",
            "without Δ",
        ],
        [
            [
                escape(r["structure"]),
                number(r["A_t"], 4),
                number(r["A_u"]),
                number(r["delta_norm"]),
                number(r["delta_rad_s"]),
                f"{r['worst_gain']:.4f}",
                f"{r['nominal_gain']:.4f}",
                number(r["tracking_rms"]),
                number(r["tracking_rms_without_delta"]),
            ]
            for r in run["runs"]
        ],
    )
    left = (
        f" Left out, because μ is not below 1 for any objective: {', '.join(run['left_out'])}."
        if run["left_out"]
        else ""
    )
    figure = captioned(
        fig6,
        f"<b>Counterpart of Fig. 6.</b> Reference: the filtered yaw rate of {escape(run['drive'])} through "
        f"W<sub>R</sub>. Disturbance: the nominal error of this drive, with that of the yaw rate times "
        f"{run['factor']:.2g} to keep the DC bound. Noise: band-limited, of power {run['noise_power']:g}, "
        "before W<sub>n</sub>. K<sub>∞</sub> runs without Δ. K<sub>i</sub> and K<sub>is</sub> run with the "
        "worst Δ that the lower bound of μ found within the band of the data. This Δ is a stable system of "
        f"constant size.{left}",
    )
    return figure + measured
