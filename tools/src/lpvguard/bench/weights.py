"""Weight fits: how tight, how fast, never below the bound, against a public overbounding fit in the same run.

32 seeded bounds over 3 to 6 decades: exact third-order weights, rippled ones, random walks, 60 dB cliffs, steps and raw scatter
of 1024 points. The peer is dkpy's ``fit_uncertainty_weight`` (a bisection over linear programs with Clarabel), when
installed, at the order that our fit chose. One process, one thread.
"""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Iterator

import numpy as np

from ..weights import Weight, fit_overbound
from . import parser, show


def bounds() -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
    """(name, omega (K,) rad/s, bound (K,)), 32 of them, always the same."""
    for decades in (3, 4, 5, 6):
        rng = np.random.default_rng(decades)
        omega = np.geomspace(10 ** (-decades / 2), 10 ** (decades / 2), 40 * decades)
        fine = np.geomspace(omega[0], omega[-1], 1024)

        def third_order(at, rng=rng, half=decades / 2 - 1):
            num, den = (np.poly(-(10.0 ** rng.uniform(-half, half, 3))) for _ in range(2))
            return Weight(num, den).magnitude(at)

        yield f"third order, {decades} decades", omega, third_order(omega)
        yield f"ripple, {decades} decades", omega, third_order(omega) * 10 ** (0.1 * np.sin(5 * np.log(omega)))
        yield f"walk, {decades} decades", omega, np.exp(np.cumsum(0.15 * rng.standard_normal(omega.size)))
        yield f"cliff down, {decades} decades", omega, np.where(omega < 1, 1.0, 1e-3)
        yield f"cliff up, {decades} decades", omega, np.where(omega < 3, 1e-3, 1.0)
        yield f"steps, {decades} decades", omega, np.repeat(10.0 ** rng.uniform(-1, 1, omega.size // 10), 10)
        yield f"scatter, {decades} decades", fine, third_order(fine) * np.exp(0.5 * rng.standard_normal(1024))
        yield f"rayleigh scatter, {decades} decades", fine, third_order(fine) * np.abs(
            rng.standard_normal(1024) + 1j * rng.standard_normal(1024))


def bench_weights() -> dict:
    """One row a bound and the summary: proved least ratio, gap to the LP optimum [dB], seconds; the peer's where installed."""
    peer = _peer()
    rows = []
    for name, omega, bound in bounds():
        start = time.perf_counter()
        fit = fit_overbound(omega, bound, name=name)
        row = {"bound": name, "samples": len(omega), "order": fit.order, "worst_db": fit.worst_ratio_db,
               "gap_db": fit.worst_ratio_db - fit.lp_optimum_db, "least_ratio": fit.certificate["min_ratio"],
               "seconds": time.perf_counter() - start}
        rows.append(row | (peer(omega, bound, max(fit.order, 1)) if peer else {}))
    summary = {"fits": len(rows), "median_s": statistics.median(r["seconds"] for r in rows),
               "largest_gap_db": max(r["gap_db"] for r in rows), "least_ratio": min(r["least_ratio"] for r in rows)}
    done = [r for r in rows if "peer_least_ratio" in r]
    if done:
        summary |= {"peer": "dkpy.fit_uncertainty_weight", "peer_median_s": statistics.median(r["peer_seconds"] for r in done),
                    "peer_least_ratio": min(r["peer_least_ratio"] for r in done), "peer_failed": len(rows) - len(done)}
    return {"rows": rows, "summary": summary}


def _peer():
    try:
        import control
        import dkpy
    except ImportError:
        return None

    def fit(omega: np.ndarray, bound: np.ndarray, order: int) -> dict:
        start = time.perf_counter()
        try:
            weight = dkpy.fit_uncertainty_weight(bound[:, None, None].astype(complex), omega, order)
        except Exception as failure:  # whatever it raises is its result
            return {"peer_failure": f"{type(failure).__name__}: {failure}"[:120]}
        ratio = np.abs(control.frequency_response(weight, omega).complex.ravel()) / bound
        return {"peer_seconds": time.perf_counter() - start, "peer_least_ratio": float(ratio.min()),
                "peer_worst_db": 20 * math.log10(float(ratio.max()))}

    return fit


def main(argv: list[str]) -> None:
    """`lpvguard bench weights`."""
    given = parser("weights", __doc__).parse_args(argv)
    result = bench_weights()
    head = f"{'bound':<24}{'samples':>8}{'order':>6}{'worst dB':>10}{'gap dB':>9}{'|W|/bound':>12}{'seconds':>9}"
    rows = [f"{r['bound']:<24}{r['samples']:>8}{r['order']:>6}{r['worst_db']:>10.3f}{r['gap_db']:>9.4f}{r['least_ratio']:>12.9f}"
            f"{r['seconds']:>9.3f}" for r in result["rows"]]
    total = "; ".join(f"{k} {v:.4g}" if isinstance(v, float) else f"{k} {v}" for k, v in result["summary"].items())
    show("\n".join([head, *rows, total]), result, given.json_out)
