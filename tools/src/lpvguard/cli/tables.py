"""Tables and sentences of the verbs for people, on standard error, from the objects of the JSON."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.table import Table

from ..base.claims import claim_words
from ..base.rates import hourly_words, share_words
from ..replay.alarm_text import alarm_sentence
from .shared import console

if TYPE_CHECKING:
    from ..control.design import Design, LargestA_t
    from ..control.robust_run import RobustRun
    from ..control.tradeoff import TradeOff
    from ..engine.synthesis.cases import TableRow
    from ..engine.synthesis.table import Cell
    from ..extras.loop.sim import Simulator
    from ..fit.fitted_model import FittedModel
    from ..identify.identification import Identification
    from ..identify.premise import Premise
    from ..replay.replayer import Replayer


def table_of(head: Iterable[str], rows: Iterable[Iterable[str]]) -> Table:
    """Return a table without a frame."""
    table = Table(*head, box=None)
    for row in rows:
        table.add_row(*row)
    return table


def print_rows(rows: Iterable[dict[str, str]]) -> None:
    """Print a table whose columns are the keys of its rows, if it has a row."""
    if every := list(rows):
        console.print(table_of(every[0], (row.values() for row in every)))


def print_replays(done: list[dict[str, Any]], replayer: Replayer) -> None:
    """The objects of `lpvguard replay --json`: a row per drive, then alarms and what became of CAN frames."""
    print_rows(
        {
            "drive": r["run"],
            "duration s": f"{r['duration_s']:.1f}",
            "judged s": f"{r['judged_s']:.1f}",
            "verdict": r["verdict_final"],
            "first degraded s": _or_dash(r["first_degraded_s"], ".2f"),
            "first invalid s": _or_dash(r["first_invalid_s"], ".2f"),
            "max margin": _or_dash(r["max_margin"], ".3f"),
            "max energy ratio": _or_dash(r["max_energy_ratio"], ".3f"),
            "max change ratio": _or_dash(r["max_change_ratio"], ".3f"),
            "alarms": str(len(r["alarms"])),
        }
        for r in done
    )
    console.print(
        f"thresholds: frame test {replayer.threshold:.4g}, energy test {replayer.energy_threshold:.4g}, "
        f"change test {replayer.change_threshold:.4g}; "
        f"core {replayer.core.folder}"
    )
    print_missing(done)
    for r in done:
        for a in r["alarms"][:3]:
            console.print(
                f"{r['run']}: t = {a['t_s']:.2f} s, {alarm_sentence(a)}; "
                f"a dead vehicle would read {a['evidence']:.2f}"
            )
        if len(r["alarms"]) > 3:
            console.print(f"{r['run']}: {len(r['alarms']) - 3} more alarms (--json lists all)")
        for d in r["diagnoses"]:
            console.print(f"{r['run']}: t = {d['t_s']:.2f} s, cause: {d['says']}", markup=False)
        for named in r.get("parts", []):
            console.print(f"{r['run']}: t = {named['until_s']:.2f} s, part: {named['says']}", markup=False)
        if "can" in r:
            _print_reception(r["run"], r["can"])


def _or_dash(value: float | None, form: str) -> str:
    return "–" if value is None else format(value, form)


def print_missing(rows: list[dict[str, Any]]) -> None:
    """Print a line per drive with missing samples; those of a raw log are reported with its frames."""
    from ..drives.tables import missing_words

    for r in rows:
        if r["missing_samples"] and "can" not in r:
            console.print(missing_words(r["run"], r["missing_samples"]))


def _print_reception(run: str, can: dict[str, Any]) -> None:
    for message, kinds in can["messages"].items():
        rejected = ", ".join(
            f"{n} {kind}" for kind, n in kinds.items() if kind not in ("accepted", "recovering")
        )
        if rejected:
            console.print(f"{run}: {message}: {kinds.get('accepted', 0)} frames used; {rejected}")
    for gap in can["gaps"][:3]:
        console.print(
            f"{run}: no sample from {gap['from_s']:.2f} to {gap['to_s']:.2f} s: "
            f"{', '.join(gap['messages'])} not live"
        )
    if len(can["gaps"]) > 3:
        console.print(f"{run}: {len(can['gaps']) - 3} more gaps (--json lists all)")


def print_fleet(result: dict[str, Any]) -> None:
    """The object of `lpvguard fleet --json`: what calibrates, a row per vehicle, and what changed."""
    terms, calibration = result["terms"], result["calibration"]
    console.print(
        f"{calibration['recordings']} recordings ({calibration['drives']} drives) of {terms['judged_s']:g} s "
        f"judged driving calibrate; a bet grows by {calibration['largest_factor']:.3g} at most in a recording"
    )
    console.print(
        f"P(ever in a life) <= {terms['alpha']:g} for all calibration sets but a share {terms['eta']:g}, "
        f"<= {terms['alpha'] + terms['eta']:g} over all; null: recordings like those that calibrate"
    )
    print_rows(
        {
            "vehicle": name,
            "recordings": str(v["recordings"]),
            "new": str(len(v["new"])),
            "left out": str(len(v["left_out"])),
            "wealth": f"{v['wealth']:.3g}",
            "alarms at": f"{1 / terms['alpha']:.3g}",
            "at the earliest after": "–" if v["earliest"] is None else f"{v['earliest']} above all",
        }
        for name, v in result["vehicles"].items()
    )
    for name, v in result["vehicles"].items():
        rate, hourly = share_words(v["alarmed"]), hourly_words(v["alarmed_per_judged_h"])
        console.print(f"{name}: new recordings with an alarm of their own: {rate}; a judged hour: {hourly}")
        if v["changed_at"] is not None:
            console.print(f"{name}: changed by recording {v['changed_at']}, {v['changed_by']}{_estimated(v)}")
    left_out = {**calibration["left_out"], **result["left_out"]}
    for v in result["vehicles"].values():
        left_out |= v["left_out"]
    for name, why in left_out.items():
        console.print(f"left out: {name}: {why}")


def _estimated(vehicle: dict[str, Any]) -> str:
    """Estimate of a vehicle's alarming recording, if it is among the new ones."""
    rows = [r for r in vehicle["new"] if r["recording"] == vehicle["changed_by"]]
    return "".join(
        f"; {e['output']}: gain {1 + e['gain']:.3f} of the model's, delay {1e3 * e['delay_s']:+.0f} ms, "
        f"bias {e['bias']:+.3g}"
        for row in rows
        for e in row["estimates"]
    )


def print_members(runs: Sequence[RobustRun]) -> None:
    """Ratios of the compiled controller with members of the identified set, beside what is proved."""
    shown = Table("v m/s", "mu", "members", "largest ratio", "worst member", "in theory", "kept", box=None)
    for r in runs:
        numbers = (r.v, r.bound, r.draws, r.sampled, r.worst, r.worst_gain)
        shown.add_row(*(f"{x:.4g}" for x in numbers), "yes" if r.kept else "NO")
    console.print(shown)
    console.print(
        "ratio of the norms of z and [w; n; r_c] with the compiled controller; at most mu is proved"
    )


def print_runs(runs: list[dict[str, Any]], bus: str, simulator: Simulator) -> None:
    """The objects of `lpvguard sim --json`: a row per run, then what an emulated ECU took."""
    print_rows(
        {
            "scenario": r["scenario"],
            "seed": str(r["seed"]),
            "verdict": r["verdict_final"],
            "invalid at s": _or_dash(r["first_invalid_s"], ".2f"),
            "judged s to it": _or_dash(r["judged_to_invalid_s"], ".2f"),
            "max margin": f"{r['max_margin']:.3f}",
            "tracking": f"{r['tracking_rms'] / r['command_rms']:.1%}" if r["command_rms"] else "–",
            "x real time": f"{r['real_time_factor']:.0f}",
            "missed": "; ".join(r["missed"]) or "nothing",
        }
        for r in runs
    )
    console.print(f"{bus} bus, controller {simulator.controller}, coefficients {simulator.folder}")
    keyed = all(r["reception"]["authentication"] for r in runs)
    console.print(f"GUARD_IN {'authenticated' if keyed else 'not authenticated'}")
    for r in runs:
        for diagnosis in r["diagnoses"]:
            console.print(f"{r['scenario']}, seed {r['seed']}, {diagnosis['t_s']:.1f} s: {diagnosis['says']}")
        if "ecu" in r:
            ecu, counted = r["ecu"], r["ecu"]["instructions"]
            console.print(
                f"{r['scenario']}: {ecu['target']}, ELF {ecu['elf_sha256'][:16]}; "
                f"of {counted['ticks']} ticks the worst took {counted['worst']} instructions, "
                f"the mean {counted['total'] / counted['ticks']:.0f} (not cycles)"
            )


def print_fit(result: FittedModel) -> None:
    """Print values with their standard errors, the fit of each drive, and the findings."""
    from ..fit.quality import gaps

    e, u = result.estimate, result.estimate.unknowns
    values = zip(u.names, e.theta, e.standard_error, u.low, u.high, u.start, strict=True)
    console.print(
        table_of(
            ("", "value", "standard error", "from", "to", "start"),
            ([name, f"{x:.5g}", f"{s:.2g}", *(f"{v:.4g}" for v in rest)] for name, x, s, *rest in values),
        )
    )
    outputs = [s.name for s in result.project.outputs]
    columns = [f"{kind} {name}" for name in outputs for kind in ("VAF %", "gain", "own past", "input's past")]
    fits = Table("", "judged s", *columns, box=None)
    groups = (("", result.by_drive), (", not fitted", result.of_unseen), ("", result.by_speed))
    for mark, qualities in groups:
        for q in qualities:
            cells = [
                cell
                for j in range(len(outputs))
                for cell in (
                    f"{100 * q.vaf[j]:.2f}",
                    f"{q.gain[j]:.3f}",
                    # Tests of residuals are per drive, not per speed.
                    *("–" if math.isnan(x[j]) else f"{x[j]:.1f}" for x in (q.whiteness, q.left_by_input)),
                )
            ]
            fits.add_row(q.name + mark, f"{q.judged_s:.0f}", *cells)
    console.print(fits)
    for line in gaps([*result.by_drive, *result.of_unseen]):
        console.print(line)
    if (r := result.recentring) is not None:
        console.print(
            f"recentring: median error of frames {r.fitted:.3f} by least squares, {r.left_out:.3f} on "
            f"drives that were left out: {'taken' if r.taken else 'not taken'}"
        )
    for text in result.findings:
        console.print(f"finding: {text}")
    for text in result.differences:
        console.print(f"warning: {text}", markup=False)
    console.print(result.outlook)
    for name, why in result.left_out.items():
        if why not in result.findings:
            console.print(f"left out: {name}: {why}", markup=False)


def print_evidence(result: Identification, further: list[str]) -> None:
    """Print the model's fit to the bound-setting drives, missing samples, and counted frames by bin.

    The ``further`` sentences follow.
    """
    from ..fit.quality import gaps
    from ..identify.model_fit import evidence, sentences

    bounds, estimator = result.bounds, result.estimator
    for line in (
        *sentences(result.project, result.model_fit),
        *gaps([*result.model_fit, *result.others_fit]),
        *evidence(bounds.omega, bounds.frames, estimator.length, estimator.Ts, result.model_fit),
        *further,
    ):
        console.print(line)


def print_tests(result: Identification) -> None:
    """Print who uses which bounds, thresholds, promises and sizes of the tests, and what has no name."""
    from ..identify.weights import use_of_weights

    energy, change = result.energy, result.change
    console.print(use_of_weights(result.weights.to_dict()))
    if energy is not None:
        console.print(f"energy test: {energy.calibration.stated}, sigma {energy.sigma_text(result.project)}")
        console.print(f"energy test: {energy.claim_text}")
    if change is not None:
        sizes = change.sizes_text(result.project)
        console.print(f"change test: {change.calibration.stated}, largest {sizes}")
    if result.pools is not None:
        console.print(result.pools.speeds_text())
    if result.pools is not None and (c := result.pools.calibration).target:
        share = "" if c.joint else "; rates are a quarter of all tests'"
        console.print(f"pools: {c.stated}{share}")
    if result.confirmation is not None:
        print_rows(result.confirmation.table())
        console.print(result.confirmation.sentence())
    if (i := result.isolation) is not None:
        console.print(f"parts: least sizes told apart in {i.window_s:g} s; * by structure, too")
        print_rows(i.isolable_rows(result.project))
    if result.diagnosis is not None:
        console.print(
            "causes: smaller changes have no name, because healthy vehicles differ as much: "
            f"{result.diagnosis.least_text(result.project)}"
        )


def print_certificates(rows: list[dict[str, Any]]) -> None:
    """The objects of `lpvguard design --json`: mu of the scheduled controller at every speed."""
    print_rows(
        {
            "v m/s": f"{row['v_mps']:.4g}",
            "mu upper": f"{row['mu_upper']:.4f}",
            "mu lower": f"{row['mu_lower']:.4f}",
            "peak rad/s": f"{row['peak_rad_s']:.3g}",
        }
        for row in rows
    )


def print_premise(premise: Premise) -> None:
    """The premise of a certificate with its evidence, and a warning where the evidence leaves room."""
    console.print(premise.sentence())
    if premise.doubtful:
        console.print(f"warning: {premise.doubting.sentence('+')}", style="yellow")


def print_largest_A_t(largest: LargestA_t | None) -> None:
    """The largest A_t found with mu below 1 at the speeds looked at; None: the search found none."""
    console.print(
        "largest A_t: none found with mu < 1, searched from half the DC floor's limit upwards"
        if largest is None
        else f"largest A_t found with mu < 1 at every speed looked at: {largest.A_t:.4g}, "
        f"times the DC floor {largest.product:.3f} "
        f"(mu {largest.worst:.4f}; not reached at {largest.failed:.4g})"
    )


def print_moving_speed(result: Design) -> None:
    """Print the proofs for a controller while the speed moves."""
    if not result.moving:
        console.print("moving speed: not asked for, nothing is claimed")
    for claim, moving in result.moving.items():
        console.print(
            f"moving speed: no proof of robust {claim} was found, nothing is claimed"
            if moving is None
            else f"moving speed: {claim_words(claim, moving.lpv.level, moving.lpv.rate)}, "
            f"{moving.lpv.proof.cells} cells"
        )


def print_robustness(result: Design) -> None:
    """The worst of what the nodes have beside mu; nothing where it was not asked for."""
    if result.further is None:
        return
    nodes = result.further.robustness.nodes
    gains = [node.worst_gain for node in nodes]
    gain = "not bounded" if None in gains else f"at most {max(g for g in gains if g is not None):.4f}"
    nearest = min((n.nu_margin / n.nu_gap_next for n in nodes if n.nu_gap_next), default=None)
    console.print(
        f"at the nodes, between frequencies too: mu at most {max(n.mu_interval for n in nodes):.4f}, "
        f"worst-case gain {gain}; least disk margins S {min(n.disk_S for n in nodes):.3g}, "
        f"T {min(n.disk_T for n in nodes):.3g}, balanced {min(n.disk_balanced for n in nodes):.3g}"
        + ("" if nearest is None else f"; nu-margin at least {nearest:.3g} times the nu-gap to the next node")
    )


def print_slow_delta(result: Design) -> None:
    """How fast Delta may vary, beside what frames can hide; nothing for a design without Delta."""
    slowness = None if result.further is None else result.further.slow_delta
    if slowness is None:
        return
    stable = (
        "at any rate" if slowness.stability_rate is None else f"up to {slowness.stability_rate:.3g} a second"
    )
    console.print(
        f"a Delta that varies: gain below 1 is proved up to a rate of "
        f"{slowness.performance_rate:.3g} per second, "
        f"stable {stable}; frames hide {slowness.hidden_slow:.3g} (the longest) to "
        f"{slowness.hidden_fast:.3g} a second (the shortest)"
    )


def print_limits(result: Design) -> None:
    """Print the proofs for a demand at its limits, if any."""
    if result.further is None:
        return
    limits = result.further.limits
    kappa, energy = limits.largest_kappa, limits.energy()
    console.print(
        "limits: "
        + (
            f"stable while the wanted demand is within {kappa:.3g} times its limit"
            if kappa
            else "nothing proved beyond the limit"
        )
        + (f"; kept there by every \\[w; n; r_c] of norm up to {energy:.3g}" if energy else "")
    )


def print_summary(name: str, result: Design, out: Path) -> None:
    """Print the result of a design in a line."""
    low, high = result.schedule.speeds[0], result.schedule.speeds[-1]
    held = "certified" if result.worst < 1 else "NOT certified"
    speeds = len(result.certificates) + 1
    claims = [
        claim_words(claim, moving.lpv.level, moving.lpv.rate)
        for claim, moving in result.moving.items()
        if moving is not None
    ]
    console.print(
        f"{name}: robust performance {held}, worst mu {result.worst:.4f} at {speeds} frozen speeds from "
        f"{low:.4g} to {high:.4g} m/s; "
        f"of a moving speed {', '.join(claims) or 'nothing'}; written to {out}"
    )


def print_cells(cells: Sequence[Cell]) -> None:
    """Table II on the console, with the times that no file holds."""
    print_rows(
        {
            "Table II": c.structure,
            "A_t": f"{c.A_t:.4g}",
            "A_u": f"{c.A_u:.2g}",
            "mu upper": f"{c.upper:.5f}",
            "mu lower": f"{c.lower:.5f}",
            "none below": f"{c.floor.value:.5f}",
            "order": str(c.order),
            "before": str(c.full_order),
            "time s": f"{c.seconds:.2f}",
        }
        for c in cells
    )


def print_tradeoff(tradeoff: TradeOff) -> None:
    """Every candidate of a trade-off, the sentence of the best, and what to write into the project file."""
    print_rows(
        {
            "structure": o.candidate.structure + (" (project)" if o.candidate.own else ""),
            "nu low": f"{o.ceiling[1]:.3g}",
            "nu high": f"{o.ceiling[-1]:.3g}",
            "lambda_s": _or_dash(o.candidate.lambda_s, ".3g"),
            "worst mu": _or_dash(o.level, ".4f"),
            "none below": f"{o.floor.value:.4f}",
        }
        for o in tradeoff.outcomes
    )
    console.print(tradeoff.sentence)
    for key, value in tradeoff.setting().items():
        console.print(f"to take it, write into the project file {key} = {_toml(value)} and identify again")


def _toml(value: dict[str, Any] | float) -> str:
    """A number, or an inline table of numbers, as TOML writes it."""
    return (
        "{ " + ", ".join(f"{k} = {v}" for k, v in value.items()) + " }"
        if isinstance(value, dict)
        else f"{value:g}"
    )


def print_case(rows: list[TableRow], table: list[dict[str, Any]]) -> None:
    """Table II of a case file, ours beside the paper's."""
    print_cells(rows)
    print_rows(
        {
            "Table II": r.structure,
            "A_t": f"{r.A_t:.4g}",
            "A_u": f"{r.A_u:.2g}",
            "ours": f"{r.upper:.5f}",
            "reference": _or_dash(r.reference, "g"),
            "its order": _or_dash(r.reference_order, "g"),
            "paper": _or_dash(r.paper, "g"),
            "paper's order": _or_dash(r.paper_order, "g"),
        }
        for r in rows
    )
    for row in table:
        console.print(f"{row['structure']}, A_t {row['A_t']:g}, A_u {row['A_u']:g}: {row['difference']}")
