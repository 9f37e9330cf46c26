"""Weight fits: tightness, speed and proof, in comparison with a public overbounding fit in the same run.

There are 32 seeded bounds over 3 to 6 decades. They are exact third-order weights, rippled ones, random
walks, 60 dB cliffs, steps and raw scatter of 1024 points. The fitted weight is proved above the log-log
linear bound at every frequency, and its worst ratio is over all frequencies. The exact weights are fitted
once more at their order, which shows the distance of the fit from the weight.

The peer (``--peers``) is dkpy's ``fit_uncertainty_weight``, a bisection over linear programs, at the order of
our fit. It is judged only at the samples, as it claims. It runs twice: with uniform frequency weighting,
which minimises the same worst ratio as ours, and with its defaults. One process, one thread.
"""

import math
import statistics
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ...engine.overbound.fit import fit_overbound
from ...engine.overbound.weight import Weight
from . import parser, show
from ._peers import Peers

DECADES = (3, 4, 5, 6)
PEER_LIMIT_S = 120.0

_PEER_SCRIPT = """
import json, sys, time, warnings
warnings.filterwarnings("ignore")
import control, dkpy, numpy as np
job = json.load(open(sys.argv[1]))
omega, bound = (np.array(job[k]) for k in ("omega", "bound"))
answer = {}
for name, weighting in (("uniform", np.ones((len(omega), 1))), ("default", None)):
    start = time.perf_counter()
    try:
        response = bound[:, None, None].astype(complex)
        weight = dkpy.fit_uncertainty_weight(response, omega, job["order"], weight=weighting)
        ratio = np.abs(control.frequency_response(weight, omega).complex.ravel()) / bound
        seconds, least, largest = time.perf_counter() - start, float(ratio.min()), float(ratio.max())
        answer[name] = {"seconds": seconds, "least": least, "largest": largest}
    except Exception as failure:
        answer[name] = {"note": f"failed: {failure}"[:80]}
json.dump(answer, open(sys.argv[2], "w"))
"""


def third_order(rng: np.random.Generator, decades: int) -> Weight:
    """A weight with three real zeros and three real poles. All lie at least a decade inside a band of
    ``decades`` about 1 rad/s."""
    half = decades / 2 - 1
    return Weight(*(np.poly(-(10.0 ** rng.uniform(-half, half, 3))) for _ in range(2)))


def bounds() -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
    """(name, omega (K,) rad/s, bound (K,)), 32 of them, always the same."""
    for decades in DECADES:
        rng = np.random.default_rng(decades)
        omega = np.geomspace(10 ** (-decades / 2), 10 ** (decades / 2), 40 * decades)
        fine = np.geomspace(omega[0], omega[-1], 1024)

        def smooth(at, rng=rng, decades=decades):
            return third_order(rng, decades).magnitude(at)

        yield f"third order, {decades} decades", omega, smooth(omega)
        yield f"ripple, {decades} decades", omega, smooth(omega) * 10 ** (0.1 * np.sin(5 * np.log(omega)))
        yield f"walk, {decades} decades", omega, np.exp(np.cumsum(0.15 * rng.standard_normal(omega.size)))
        yield f"cliff down, {decades} decades", omega, np.where(omega < 1, 1.0, 1e-3)
        yield f"cliff up, {decades} decades", omega, np.where(omega < 3, 1e-3, 1.0)
        yield f"steps, {decades} decades", omega, np.repeat(10.0 ** rng.uniform(-1, 1, omega.size // 10), 10)
        yield f"scatter, {decades} decades", fine, smooth(fine) * np.exp(0.5 * rng.standard_normal(1024))
        yield (
            f"rayleigh scatter, {decades} decades",
            fine,
            smooth(fine) * np.abs(rng.standard_normal(1024) + 1j * rng.standard_normal(1024)),
        )


def exact_weights() -> Iterator[dict]:
    """The weights behind the bounds "third order", fitted at order 3: largest distance [dB] of the fit from
    the weight. Sampled two decades beyond their breaks: the bound is constant beyond its ends, and a weight
    that still falls there is not above it. 1024 samples: a chord of the log-log bound lies above a weight
    that bends upwards."""
    for decades in DECADES:
        truth = third_order(np.random.default_rng(decades), decades)
        omega = np.geomspace(10 ** (-decades / 2 - 1), 10 ** (decades / 2 + 1), 1024)
        start = time.perf_counter()
        fit = fit_overbound(omega, truth.magnitude(omega), order=3)
        seconds = time.perf_counter() - start
        dense = np.geomspace(omega[0], omega[-1], 20 * omega.size)
        distance = 20 * np.log10(fit.weight.magnitude(dense) / truth.magnitude(dense))
        yield {
            "weight": f"third order, {decades} decades",
            "order": fit.order,
            "seconds": seconds,
            "distance_db": float(np.abs(distance).max()),
        }


def bench_weights(peers: Path | None = None) -> dict:
    """One row a bound and the summary: proved least ratio, gap to the LP optimum [dB], seconds; the peer's
    where asked for. ``peers``: folder of the peers' environment, made when missing."""
    environment = Peers(peers)
    rows = []
    for name, omega, bound in bounds():
        start = time.perf_counter()
        fit = fit_overbound(omega, bound, name=name)
        rows.append(
            {
                "bound": name,
                "samples": len(omega),
                "order": fit.order,
                "worst_db": fit.worst_ratio_db,
                "gap_db": fit.worst_ratio_db - fit.lp_optimum_db,
                "least_ratio": fit.certificate["min_ratio"],
                "seconds": time.perf_counter() - start,
            }
        )
        if peers is not None:
            question = {"omega": omega.tolist(), "bound": bound.tolist(), "order": max(fit.order, 1)}
            rows[-1]["peer"] = _judged(environment.ask(_PEER_SCRIPT, question, PEER_LIMIT_S))
    exact = list(exact_weights())
    summary = {
        "fits": len(rows),
        "median_s": statistics.median(r["seconds"] for r in rows),
        "largest_gap_db": max(r["gap_db"] for r in rows),
        "least_ratio": min(r["least_ratio"] for r in rows),
        "exact_distance_db": max(r["distance_db"] for r in exact),
    }
    return {
        "rows": rows,
        "exact": exact,
        "summary": summary | (_peer_summary(rows) if peers is not None else {}),
    }


def _judged(answer: dict) -> dict:
    """The peer's answer with ratios in dB; a ``note`` wherever there is none."""
    if "note" in answer:
        answer = {"uniform": answer, "default": answer}
    return {
        name: a
        if "note" in a
        else {"seconds": a["seconds"], "least_ratio": a["least"], "worst_db": 20 * math.log10(a["largest"])}
        for name, a in answer.items()
    }


def _peer_summary(rows: list[dict]) -> dict:
    summary: dict[str, float] = {}
    for name in ("uniform", "default"):
        done = [r["peer"][name] for r in rows if "note" not in r["peer"][name]]
        summary |= {
            f"peer_{name}_failed": len(rows) - len(done),
            f"peer_{name}_below_the_bound": sum(d["least_ratio"] < 1 - 1e-6 for d in done),
        }
        if done:
            summary |= {
                f"peer_{name}_least_ratio": min(d["least_ratio"] for d in done),
                f"peer_{name}_median_s": statistics.median(d["seconds"] for d in done),
            }
    return summary


def table(result: dict) -> str:
    """The result as text: a line a bound, a line an exact weight, the summary."""
    with_peer = "peer" in result["rows"][0]
    head = (
        f"{'bound':<28}{'samples':>8}{'order':>6}{'worst dB':>10}{'gap dB':>9}{'|W|/bound':>12}{'seconds':>9}"
    )
    if with_peer:
        head += f"   dkpy:{'worst dB':>9}{'|W|/bound':>11}{'seconds':>9}"
        head += f"   as it comes:{'worst dB':>9}{'|W|/bound':>11}"
    lines = [head]
    for r in result["rows"]:
        line = (
            f"{r['bound']:<28}{r['samples']:>8}{r['order']:>6}{r['worst_db']:>10.3f}{r['gap_db']:>9.4f}"
            f"{r['least_ratio']:>12.9f}{r['seconds']:>9.3f}"
        )
        if with_peer:
            uniform, default = (r["peer"][k] for k in ("uniform", "default"))
            line += " " * 8 + (
                f"{uniform['worst_db']:>9.3f}{uniform['least_ratio']:>11.6f}{uniform['seconds']:>9.3f}"
                if "note" not in uniform
                else f"{uniform['note']:>29.29}"
            )
            line += " " * 15 + (
                f"{default['worst_db']:>9.3f}{default['least_ratio']:>11.6f}"
                if "note" not in default
                else f" {default['note']}"
            )
        lines.append(line)
    lines += [
        f"{r['weight']:<28} exact, fitted at order {r['order']}: within {r['distance_db']:.4f} dB of the "
        f"weight itself, {r['seconds']:.3f} s"
        for r in result["exact"]
    ]
    return "\n".join(
        [
            *lines,
            "; ".join(
                f"{k} {v:.4g}" if isinstance(v, float) else f"{k} {v}" for k, v in result["summary"].items()
            ),
        ]
    )


def main(argv: list[str]) -> None:
    """`lpvguard bench weights`."""
    options = parser("weights", __doc__)
    options.add_argument("--peers", type=Path, help="folder for the peers' environment, made when missing")
    given = options.parse_args(argv)
    result = bench_weights(given.peers)
    show(table(result), result, given.json_out)
