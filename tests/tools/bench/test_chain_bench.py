"""The chain beside a peer: what counts, and that a missing peer is told and not taken for a ratio."""

import time
from types import SimpleNamespace

from lpvguard.base.parallel import workers
from lpvguard.extras.bench import chain as bench
from lpvguard.extras.bench._peers import Peers
from made import ROOT

CASE = ROOT / "tests" / "data" / "paper_case.toml"
STAGES = [
    bench.Stage("identification", 40.0, 30.0),
    bench.Stage("frozen design and proofs", 50.0, 45.0),
    bench.Stage("moving speed", 500.0, 400.0, False),
]


def test_the_ratio_is_by_the_clock_and_leaves_the_moving_speed_out():
    peer = {"seconds": 36.0, "processor": 25.0, "claimed": 0.9, "level": 0.91, "order": 9, "note": ""}
    assert bench.ratios(STAGES, peer) == (2.5, 3.0)
    text, fields = bench.table(STAGES, 0.99, peer), bench.as_dict(STAGES, 0.99, peer)
    assert "ratio of seconds 2.50 (wanted 2), of processor seconds 3.00" in text and "not in the sum" in text
    assert (fields["ratio"], fields["ratio_processor"], fields["ok"]) == (2.5, 3.0, False)
    assert bench.as_dict(STAGES, 0.99, peer | {"seconds": 45.0})["ok"] is True


def test_without_a_peer_there_is_no_ratio_and_the_table_says_why():
    peer = bench.synthesis_by_peer(CASE, Peers(None))
    assert peer == {"note": "not asked for"} and bench.ratios(STAGES, peer) is None
    assert bench.table(STAGES, 0.99, peer).endswith("dkpy, K_i of the paper's case: not asked for")
    assert bench.as_dict(STAGES, 0.99, peer)["ok"] is None


def test_the_stages_are_those_of_the_commands(monkeypatch):
    """Each stage gets what the one before wrote; only frozen speeds are designed for."""
    asked = []
    monkeypatch.setattr(bench, "load_project", lambda name: f"project {name}")
    monkeypatch.setattr(bench.identify, "identify", lambda project, drives, workers: (project, drives))
    monkeypatch.setattr(bench.identify, "save", lambda *arguments: asked.append(arguments[:2]))
    monkeypatch.setattr(bench.identify, "load", lambda folder: f"stored {folder.name}")

    class Result:
        schedule, scaling, worst = "schedule", "scaling", 0.97

    def design(stored, moving_speed, workers):
        asked.append((stored, moving_speed))
        return Result

    monkeypatch.setattr(bench.design, "design", design)
    monkeypatch.setattr(bench.design, "save", lambda *arguments: asked.append(arguments[2].name))
    monkeypatch.setattr(bench, "DesignProblem", SimpleNamespace(from_identification=lambda stored: stored))
    monkeypatch.setattr(
        bench, "moving_certificates", lambda stored, *arguments, workers: asked.append((*arguments, workers))
    )
    monkeypatch.setattr(
        bench, "export_chosen", lambda stored, out, folder, workers: asked.append(folder.name)
    )
    stages, worst = bench.chain("truck", "drives", True)
    moving = ("schedule", "scaling", map)
    assert asked == [("project truck", "drives"), ("stored identify", False), "design", "design", moving]
    assert [stage.summed for stage in stages] == [True, True, True, False] and worst == 0.97


def _busy(seconds: float) -> float:
    """Keeps its process busy, and returns the processor time that it took."""
    began = time.process_time()
    while time.process_time() - began < seconds:
        pass
    return time.process_time() - began


def test_processor_seconds_of_workers_count_too():
    with workers(2) as run:
        before = bench._processor()
        used = sum(run(_busy, [0.2, 0.2]))
        assert bench._processor() - before >= 0.95 * used
