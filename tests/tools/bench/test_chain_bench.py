"""The chain beside a peer: what counts, and that a missing peer is told and not taken for a ratio."""

from lpvguard.bench import chain as bench
from lpvguard.bench._peers import Peers
from made import ROOT

CASE = ROOT / "tests" / "data" / "paper_case.toml"
STAGES = [
    bench.Stage("identification", 40.0, 30.0),
    bench.Stage("frozen design and proofs", 50.0, 45.0),
    bench.Stage("moving speed", 500.0, 400.0, False),
]


def test_the_ratio_is_of_processor_seconds_and_leaves_the_moving_speed_out():
    peer = {"seconds": 90.0, "processor": 25.0, "claimed": 0.9, "level": 0.91, "order": 9, "note": ""}
    assert bench.ratio(STAGES, peer) == 3.0
    text, found = bench.table(STAGES, 0.99, peer), bench.as_dict(STAGES, 0.99, peer)
    assert "ratio of processor seconds 3.00 (wanted 2)" in text and "not in the sum" in text
    assert found["ok"] is False and bench.as_dict(STAGES, 0.99, peer | {"processor": 37.5})["ok"] is True


def test_without_a_peer_there_is_no_ratio_and_the_table_says_why():
    peer = bench.synthesis_by_peer(CASE, Peers(None))
    assert peer == {"note": "not asked for"} and bench.ratio(STAGES, peer) is None
    assert bench.table(STAGES, 0.99, peer).endswith("dkpy, K_i of the paper's case: not asked for")
    assert bench.as_dict(STAGES, 0.99, peer)["ok"] is None


def test_the_stages_are_those_of_the_commands(monkeypatch):
    """Each stage gets what the one before wrote; only frozen speeds are designed for."""
    asked = []
    monkeypatch.setattr(bench, "load_project", lambda name: f"project {name}")
    monkeypatch.setattr(bench.identify, "identify", lambda project, drives: (project, drives))
    monkeypatch.setattr(bench.identify, "save", lambda *given: asked.append(given[:2]))
    monkeypatch.setattr(bench.identify, "load", lambda folder: f"stored {folder.name}")

    class Result:
        schedule, scaling, worst = "schedule", "scaling", 0.97

    def design(stored, moving_speed):
        asked.append((stored, moving_speed))
        return Result

    monkeypatch.setattr(bench.design, "design", design)
    monkeypatch.setattr(bench.design, "save", lambda *given: asked.append(given[2].name))
    monkeypatch.setattr(bench, "moving_certificates", lambda *given: asked.append(given[1:]))
    monkeypatch.setattr(bench, "export_chosen", lambda stored, out, folder: asked.append(folder.name))
    stages, worst = bench.chain("truck", "drives", True)
    moving = ("schedule", "scaling")
    assert asked == [("project truck", "drives"), ("stored identify", False), "design", "design", moving]
    assert [stage.summed for stage in stages] == [True, True, True, False] and worst == 0.97
