"""Section "Settings and proofs": drives, estimator, claims, tightness of the weights."""

from collections import Counter
from collections.abc import Iterable
from html import escape

import numpy as np

from ...base.errors import InputError
from ...drives.frames import Estimator
from ...identify.change import ChangeTest
from ...identify.energy import EnergyTest
from ...identify.identification import DriveSet, StoredIdentification
from ...identify.premise import premise
from ...identify.weights import DC_STAND_IN, use_of_weights
from ...identify.window_error import PERCENTILE, SPEEDS
from ...replay.replayer import Replayer
from ...vehicle.project import Project, Signal
from ..markup import html_rows, html_table, number, premise_words, yes_or_no


def _estimator_words(stored: StoredIdentification, estimator: Estimator) -> str:
    """Sentence with the settings of the frames."""
    frames, length_s = stored.project.frames, estimator.length * estimator.Ts
    common = (
        f"{estimator.n_bins - 1} bins from {estimator.omega[1]:.3g} to {estimator.omega[-1]:.3g} rad/s and "
        f"DC; speed within ±{estimator.speed_tolerance:.0%} of the frame's mean"
    )
    if estimator.window == "rectangular":
        return (
            f"the paper's plain DFT: one rectangular frame of {length_s[0]:.4g} s a drive, its transient "
            f"removed by least squares; {common}; identifier {estimator.identifier():#010x}"
        )
    return (
        f"periodic Hann window, {frames.periods} periods a frame, {frames.bins_per_decade} bins a decade, "
        f"hop 1/{frames.hop_per_frame} frame; {common}; frames {length_s[1]:.4g} s long in the lowest bin "
        f"and at DC, {length_s[-1]:.3g} s in the highest; settling {estimator.settle * estimator.Ts:.3g} s; "
        f"identifier {estimator.identifier():#010x}"
    )


def _core_words(stored: StoredIdentification, replayer: Replayer | None) -> str:
    """Sentence on whether the replaying core has the numbers of this identification."""
    if replayer is None:
        return (
            "none: the core computes Hann frames only; these bounds are for analysis, and export, replay and "
            "evaluate refuse them"
        )
    same = _same_numbers(stored, replayer)
    return yes_or_no(
        same <= 1e-6,
        f"carries the numbers of this identification (largest relative difference {same:.1e}, float32)",
        f"carries other numbers than this identification (largest relative difference {same:.1e}): maps and "
        "verdicts below are that core's",
    )


def _claim(stored: StoredIdentification) -> str:
    """Promise of the thresholds."""
    calibration = stored.calibration.joint or stored.calibration
    if calibration.groups or calibration.extrapolation is not None:
        return escape(calibration.claim())
    if calibration.alpha is None:
        return f"{calibration.claim()}; the threshold is the largest score"
    one = "recording" if calibration.recordings.by_drive else "drive"
    return (
        f"{calibration.alpha:g}: a further {one}, exchangeable with the {calibration.units()} that "
        f"calibrate, alarms with probability at most {calibration.alpha:g} (on average over "
        f"calibration sets){calibration.hourly}"
        + (", by any test" if stored.calibration.joint else _by_each_test(stored))
    )


def _by_each_test(stored: StoredIdentification) -> str:
    if stored.energy is None:
        return ""
    return f", by each test; by any, at most {'three' if stored.pools is None else 'four'} times that"


def _conditional_claim(stored: StoredIdentification) -> str:
    """Promise of the threshold with 95 % confidence over the calibration drives."""
    bound = stored.calibration.conditional_bound
    if bound is None:
        return "–"
    return f"with 95 % confidence over the calibration drives the probability is below {bound:.3f}"


def _drive_rows(stored: StoredIdentification) -> list[tuple[str, str]]:
    """Label and text of every group of drives."""
    groups, drivers = stored.manifest["drives"], stored.manifest["drivers"]

    def listed(names: list[str]) -> str:
        """Number of drives and their drivers; the index of drives names them."""
        by_driver = Counter(drivers[n] for n in names)
        return f"{len(names)}" + (
            f" ({', '.join(f'{n} {escape(d)}' for d, n in by_driver.items())})" if by_driver else ""
        )

    left_out = "".join(f"<br>{escape(n)}: {escape(why)}" for n, why in groups["left_out"].items())
    return [
        ("drives that set the bounds", listed(groups["bounds"])),
        ("drives that calibrate the threshold", listed(groups["calibration"])),
        ("zero-input drives (noise)", listed(groups["noise"])),
        ("drives left out", f"{len(groups['left_out'])}{left_out or ': none'}"),
    ]


def premise_of(stored: StoredIdentification) -> str:
    """Sentence on the premise and its conclusion, or why it cannot be judged."""
    try:
        return premise_words(premise(stored).to_dict())
    except InputError as error:
        return f'<span class="no">Premise not judged:</span> {escape(str(error))}'


def _rows(
    stored: StoredIdentification, replayer: Replayer | None, estimator: Estimator
) -> list[tuple[str, str]]:
    """Label and text of every line of the summary."""
    project, design = stored.project, stored.designed.frame_test
    threshold = stored.calibration.carried if replayer is None else replayer.threshold
    if replayer is None:
        judge = "the exact margin finds none above 1 on the bound-setting drives"
    else:
        judge = (
            "the compiled core finds no margin above 1 on the bound-setting drives, whole or with their "
            "first samples cut"
        )
    return [
        (
            "vehicle",
            f"{escape(project.name)}: {escape(project.title)}; inputs {_signals(project.inputs)}; outputs "
            f"{_signals(project.outputs)}; speed {estimator.speed_range[0]:g} to "
            f"{estimator.speed_range[1]:g} m/s; sampled every {project.Ts_s:g} s",
        ),
        *_drive_rows(stored),
        (
            "model error class",
            f"{project.bounds.structure}, disturbance set “{project.bounds.disturbance_set}”",
        ),
        ("estimator", _estimator_words(stored, estimator)),
        (
            "threshold of the frame test",
            f"{threshold:.4g} on the {design.confirm}-of-{design.of_last} margin",
        ),
        ("alpha", _claim(stored)),
        ("conditional bound", _conditional_claim(stored)),
        *([("energy test", _energy_words(stored.energy, project))] if stored.energy else []),
        *([("change test", _change_words(stored.change, project))] if stored.change else []),
        ("premise of every certificate", premise_of(stored)),
        ("use of bounds and weights", use_of_weights(stored.weights)),
        (
            "final inflation of the weights",
            f"{stored.weights['inflation']:.6g}, the least factor with which {judge}",
        ),
        ("core that replayed the drives", _core_words(stored, replayer)),
    ]


def _proof_table(stored: StoredIdentification) -> str:
    """Tightness and proof of each weight."""
    weights = [
        (f"W<sub>{index}</sub> of {escape(s.name)}", w)
        for index in ("w", "n")
        for s, w in zip(stored.project.outputs, stored.weights[f"W_{index}"], strict=False)
    ]
    weights += [
        ("W<sub>Δ</sub>" if stored.project.n_delta == 1 else f"W<sub>Δ</sub> of {escape(s.name)}", w)
        for s, w in zip(stored.project.outputs, stored.weights["W_delta"], strict=False)
    ]
    weights += [("γ<sub>w</sub> smoothed", stored.weights["gamma_w"])]
    return html_rows(
        {
            "weight": label,
            "order": str(w["order"]),
            "worst |W|/bound, dB": f"{w['worst_ratio_db']:.3f}",
            "no weight of this order found below, dB": f"{w['lp_optimum_db']:.3f}",
            "smallest |W|/bound proved": f"{w['certificate']['min_ratio']:.15g}",
            "at, rad/s": _limit(w["certificate"]["min_ratio_at"]),
            "proved up to, rad/s": _limit(w["certificate"]["omega_max"]),
            "stable, minimum phase": yes_or_no(
                w["certificate"]["stable"] and w["certificate"]["minimum_phase"] and w["certificate"]["ok"],
                "proved",
                "not proved",
            ),
            "bins bridged for want of data, rad/s": ", ".join(
                number(x) for x in w["certificate"]["without_data"]
            )
            or "none",
        }
        for label, w in weights
    )


def summary_section(stored: StoredIdentification, replayer: Replayer | None, drives: DriveSet) -> str:
    """Return the settings and proofs; ``replayer`` is None if the core does not compute these frames."""
    estimator = drives.reader.estimator
    table = html_table([], _rows(stored, replayer, estimator), "words")
    return f"""<h2>Settings and proofs</h2>{table}
<p>Each weight lies above its bound at every frequency. Exact Routh arrays and Bernstein coefficients prove \
it piece by piece,
without a grid. The proof was repeated when this page was made (for W<sub>w</sub> and W<sub>Δ</sub>). \
Between bins a bound is log-log
linear. The worst ratio is the largest ratio of the weight to its bound. The next column is a proved lower
limit for any weight of the same order.
DC is drawn at {DC_STAND_IN:g} times the lowest bin's frequency, so “at”
{estimator.omega[1] * DC_STAND_IN:.3g} rad/s means DC.</p>\
{_proof_table(stored)}{_window_error(stored, estimator)}"""


def _window_error(stored: StoredIdentification, estimator: Estimator) -> str:
    """Table of the estimator's error per bin if dynamics are inverted."""

    def row(label: str, key: str) -> list[str]:
        return [label, *(number(x, 2) for x in stored.bounds[key])]

    table = html_table(
        ["relative error of ξ<sub>s</sub> \\ bin, rad/s", "DC", *(f"{w:.3g}" for w in estimator.omega[1:])],
        [row("median", "window_error_median"), row(f"{PERCENTILE}th percentile", "window_error_percentile")],
    )
    return f"""<h3>Window error</h3>{table}
<p class="note">|ξ̂<sub>s</sub> − ξ<sub>s</sub>| / |ξ<sub>s</sub>|, where a known simulated ξ<sub>s</sub> \
drives the nominal model's state and
ξ̂<sub>s</sub> is its estimate from frames of that state (largest over {SPEEDS} frozen speeds). It is the \
error of class S2, and of any LFT that inverts
dynamics, with frames of this estimator. It shows whether these frames are long enough for these classes. \
Class S1
compares spectra of e and ŷ. It inverts no dynamics and does not have this error.</p>"""


def _limit(value: float | str) -> str:
    """Format a frequency [rad/s]; a certificate states infinity as the text "inf"."""
    return "∞" if isinstance(value, str) else number(value)


def _signals(signals: Iterable[Signal]) -> str:
    """Name, unit and positive direction of each signal."""
    return ", ".join(f"{escape(s.name)} [{escape(s.unit)}], positive: {escape(s.positive)}" for s in signals)


def _same_numbers(stored: StoredIdentification, replayer: Replayer) -> float:
    """Largest relative difference between the coefficients of this identification and those of the core."""
    ours, theirs = stored.coefficients.flat_reals(), replayer.core.compiled[1]
    if len(ours) != len(theirs):
        return float("inf")
    scale = np.maximum(np.abs(ours), np.finfo(np.float32).tiny)
    return float(np.max(np.abs(ours - theirs) / scale))


def _change_words(test: ChangeTest, project: Project) -> str:
    """Sentence with the settings and numbers of the change test."""
    c = test.calibration
    return (
        f"memory {test.memory_s:g} s; largest on the bound-setting drives: "
        f"{escape(test.sizes_text(project))}; {c.stated}"
    )


def _energy_words(test: EnergyTest, project: Project) -> str:
    """Sentence with the settings and numbers of the energy test."""
    c = test.calibration
    least = min(certificate["min_ratio"] for certificate in test.certificate)
    *corners, last = (f"{2 * np.pi * f:.3g}" for f in test.band_hz)
    return (
        f"corners {', '.join(corners)} and {last} rad/s; judged {test.settle * test.Ts:.3g} s after entering "
        f"the range; {escape(test.claim_text)}; σ: {escape(test.sigma_text(project))}; "
        f"{len(test.directions)} direction(s); W<sub>Δ</sub> as a filter proved above its bound on the "
        f"circle |z| = {test.rho:.6g} (least ratio {least:.9g}); {c.stated}"
    )
