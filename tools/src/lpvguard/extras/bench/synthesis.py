"""Compare the time and the levels of our synthesis, certificates included, with public packages ("peers").

The problems are H∞ on Fig. 1 with third-order weights (23 states, the paper's order), and K_i and K_is of the
paper case. The peers (_peers.py) are python-control with slycot (``hinfsyn``) and dkpy (D-K iteration). A
peer's controller is judged like ours, by the certified norm or μ bound of its closed loop. The level that the
peer claims is not used.
"""

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from lpvguard.engine.synthesis.cases import case_plant, read_case
from lpvguard.engine.synthesis.dk import certify, dk_synthesis
from lpvguard.engine.synthesis.hinf import hinf_synthesis
from lpvguard.engine.synthesis.interconnection import (
    PAPER_WEIGHTS,
    GeneralisedPlant,
    PlantWeights,
    generalised_plant,
    weight_from_table,
    zeros_poles,
)
from lpvguard.engine.synthesis.norms import hinf_norm
from lpvguard.engine.synthesis.statespace import StateSpace, lft, series
from lpvguard.extras.bench import parser, show
from lpvguard.extras.bench._peers import Peers
from lpvguard.vehicle import truck_model

TARGET_S = {"H_inf": 0.06, "K_i": 0.5, "K_is": 1.0}
"""Largest allowed time [s] of each synthesis, certificate included."""

PEER_LIMIT_S = 300.0

PEER_SCRIPT = """
import json, sys, time, warnings
warnings.filterwarnings("ignore")
import numpy as np, control
job = json.load(open(sys.argv[1]))
P = control.ss(*(np.array(job[k]) for k in "ABCD"))
start, busy = time.perf_counter(), time.process_time()
if job["blocks"]:
    import dkpy
    omega = np.concatenate([[1e-6], np.logspace(-4, 3, 60)])
    parts = dkpy.HinfSynSlicot(), dkpy.SsvLmiBisection(n_jobs=1), dkpy.DScaleFitSlicot()
    run = dkpy.DkIterFixedOrder(*parts, 3, 2)
    K, _, level, _, _ = run.synthesize(P, job["n_y"], job["n_u"], omega, np.array(job["blocks"]))
else:
    K, _, level, _ = control.hinfsyn(P, job["n_y"], job["n_u"])
seconds, processor = time.perf_counter() - start, time.process_time() - busy
if K is None:
    raise SystemExit("no controller")
matrices = {k: np.asarray(getattr(K, k)).tolist() for k in "ABCD"}
json.dump({"seconds": seconds, "processor": processor, "claimed": float(level), **matrices},
open(sys.argv[2], "w"))
"""


@dataclass(frozen=True)
class SynthesisRow:
    """Line of the table with our synthesis and a peer's.

    ``level`` is the certified bound. ``peer_claimed`` is the level that the peer claims. Peer fields are None
    if the peer did not run. ``peer_note`` states the reason or the peer's error.
    """

    job: str
    states: int
    seconds: float
    target_s: float
    level: float
    order: int
    peer: str
    peer_seconds: float | None
    peer_level: float | None
    peer_claimed: float | None
    peer_order: int | None
    ratio: float | None
    peer_note: str

    @property
    def ok(self) -> bool:
        """Tell if the synthesis meets its target."""
        return self.seconds <= self.target_s


def order_23_plant(case: dict) -> GeneralisedPlant:
    """Make the plant of K_inf with W_C and the noise and disturbance weights of third order, as in the paper.

    The plant has 23 states.
    """
    objective = case["objective"][0]
    weights = {
        name: weight_from_table(case[name], A_t=objective["A_t"], A_u=objective["A_u"])
        for name in PAPER_WEIGHTS
    }
    ripple = {1: zeros_poles(1.0, [0.4], [0.5]), 2: zeros_poles(1.0, [0.4, 9.0], [0.5, 11.0])}
    for name in ("W_C", "W_nr", "W_ndelta", "W_wr", "W_wdelta"):
        weights[name] = series(ripple[3 - weights[name].order], weights[name])
    A, B = truck_model.continuous(case["v"], case["wheelbase"])
    return generalised_plant(A, B, PlantWeights.of_paper(weights), "K_inf")


def run(case_path, repeats: int = 5, peers: Path | None = None) -> list[SynthesisRow]:
    """Measure the three syntheses.

    ``peers`` is the folder of the peers' environment, which is made if it is missing. With None, no peer
    runs. Our time is the least of ``repeats`` runs, because other work on the machine can only add time. A
    peer runs once.
    """
    case = read_case(case_path)
    big = order_23_plant(case)
    jobs: list[tuple[str, GeneralisedPlant, Callable]] = [
        ("H_inf", big, lambda: hinf_synthesis(big.system, big.n_control, big.n_measurement))
    ]
    for name in ("K_i", "K_is"):
        plant = case_plant(case, case["objective"][0], name)
        jobs.append((name, plant, lambda plant=plant: dk_synthesis(plant)))
    environment = Peers(peers)
    rows = []
    for name, plant, job in jobs:
        seconds, result = min((_timed(job) for _ in range(repeats)), key=lambda pair: pair[0])
        level = result.gamma_achieved if name == "H_inf" else result.performance.upper
        peer = judged(environment.ask(PEER_SCRIPT, question(plant), PEER_LIMIT_S), plant)
        rows.append(
            SynthesisRow(
                name,
                plant.system.order,
                seconds,
                TARGET_S[name],
                level,
                result.controller.order,
                "control" if name == "H_inf" else "dkpy",
                peer.get("seconds"),
                peer.get("level"),
                peer.get("claimed"),
                peer.get("order"),
                peer["seconds"] / seconds if "seconds" in peer else None,
                peer.get("note", ""),
            )
        )
    return rows


def _timed(job):
    start = time.perf_counter()
    result = job()
    return time.perf_counter() - start, result


def judged(answer: dict, plant: GeneralisedPlant) -> dict:
    """Add to a peer's answer the certified ``level`` of its closed loop, its ``order`` and a ``note``."""
    if "A" not in answer:
        return answer
    P, K = plant.system, _system(answer)
    level = certify(plant, K).upper if plant.blocks else hinf_norm(lft(P, K)).upper
    note = (
        "its loop is unstable"
        if not np.isfinite(level)
        else ""
        if level <= answer["claimed"] * 1.01
        else "claim not met"
    )
    return {
        "seconds": answer["seconds"],
        "claimed": answer["claimed"],
        "level": level,
        "order": K.order,
        "note": note,
    }


def _system(answer: dict) -> StateSpace:
    """Make a peer's continuous controller from its matrices A, B, C and D."""
    A, B, C, D = (np.array(answer[k]) for k in "ABCD")
    return StateSpace(A, B, C, D)


def question(plant: GeneralisedPlant) -> dict:
    """Make the question for the peers' script."""
    P = plant.system
    blocks = [[b.rows, b.cols] for b in (*plant.blocks, plant.performance_block)] if plant.blocks else []
    return {
        "A": P.A.tolist(),
        "B": P.B.tolist(),
        "C": P.C.tolist(),
        "D": P.D.tolist(),
        "n_u": plant.n_control,
        "n_y": plant.n_measurement,
        "blocks": blocks,
    }


def table(rows: list[SynthesisRow]) -> str:
    """Write the rows as text, one line each."""
    lines = [
        (
            f"{'job':6}{'states':>7}{'time s':>9}{'target':>8}{'level':>10}{'order':>7}   "
            f"{'peer':8}{'time s':>8}{'claims':>10}{'certified':>11}{'order':>7}{'ratio':>7}"
        )
    ]
    for r in rows:
        peer = (
            f"{r.peer_seconds:>8.2f}{r.peer_claimed:>10.4f}{r.peer_level:>11.4f}{r.peer_order:>7d}{r.ratio:>7.1f}"
            if r.peer_seconds is not None
            else f"{'-':>8}{'-':>10}{'-':>11}{'-':>7}{'-':>7}"
        )
        lines.append(
            f"{r.job:6}{r.states:>7d}{r.seconds:>9.3f}{r.target_s:>8.2f}{r.level:>10.5f}{r.order:>7d}   "
            f"{r.peer:8}{peer}  {r.peer_note}"
        )
    return "\n".join(lines)


def as_dicts(rows: list[SynthesisRow]) -> list[dict]:
    """Rows for ``--json``."""
    return [asdict(r) | {"ok": r.ok} for r in rows]


def main(argv: list[str]) -> None:
    """Run `lpvguard bench synthesis CASE.toml`."""
    arguments = parser("synthesis", __doc__)
    arguments.add_argument("case", type=Path, help="the paper case, tests/data/paper_case.toml")
    arguments.add_argument("--peers", type=Path, help="folder for the peers' environment, made when missing")
    options = arguments.parse_args(argv)
    rows = run(options.case, peers=options.peers)
    show(table(rows), as_dicts(rows), options.json_out)
