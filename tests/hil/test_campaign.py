"""Campaigns: what runs show off line, what stopping and going on does, and that scenarios expect what follows
from the bounds."""

import json
import os
from dataclasses import replace
from functools import cache
from itertools import pairwise
from pathlib import Path

import jsonschema
import numpy as np
import pyarrow.parquet as pq
import pytest

from lpvguard import schemas
from lpvguard.base.errors import InputError
from lpvguard.base.parallel import workers
from lpvguard.base.rates import rate
from lpvguard.core.compiled import Core
from lpvguard.evaluate import baseline_study
from lpvguard.evaluate.baselines import Baseline
from lpvguard.evaluate.detection import Injection
from lpvguard.extras.loop.campaign import chunked_runs, conduct, faults, one_run, scenarios, summary, trucks
from lpvguard.extras.loop.campaign.chunked_runs import campaign
from lpvguard.extras.loop.campaign.scenarios import Drawn, PlannedRun, Size
from lpvguard.extras.loop.campaign.tracking import TrackingBound
from lpvguard.extras.loop.sim import Scenario, Simulator, load_scenario, shipped_scenarios
from lpvguard.identify import identification as identify
from lpvguard.replay.replayer import Replayer
from lpvguard.vehicle.nominal import NominalModel

FULL = os.environ.get("LPVGUARD_FULL") == "1"
SEEDS = (1, 2, 3) if FULL else (1,)
NO_DETECTORS = one_run.Detectors(((0.01, 0.01), (1.0,), ((1.0,),)), ())
NO_VERDICT_FOLLOWS = {"bank_15mrad", "coarse_sensors", "crosswind_5", "jitter", "lossy_bus"}
"""Disturbances beyond those of the bounds: neither a frequency response nor the frames of a run oblige
anyone."""
ENDING_SPNS = {520204, 520205}
"""What DM1 says behind a finding that is not the monitor's: locked, or the actuator does not follow."""


@pytest.fixture(scope="module")
def stored(truck, truck_drives, truck_identified):
    """The truck identified as it is shipped, and its drives."""
    return identify.load(truck_identified), identify.DriveSet(truck, NominalModel(truck), truck_drives)


@pytest.fixture(scope="module")
def context(truck_folder, stored) -> one_run.Context:
    return one_run.Context(truck_folder, 1, NO_DETECTORS, TrackingBound.from_identification(stored[0]))


@pytest.fixture(scope="module")
def replayer(simulator, truck_folder) -> Replayer:
    return Replayer(simulator.project, Core(truck_folder))


@pytest.fixture(scope="module")
def ratio(stored):
    """Largest |delta|/W_delta of a truck, by its scenario tables; each measured once."""
    certified = trucks.CertifiedSet.from_identification(stored[0])
    return cache(lambda tables: certified.distance(tables).ratio)


def plant_tables(name: str) -> str:
    text = load_scenario(name).path.read_text()
    return "\n".join(
        line
        for line in text[text.index("[plant]") : text.index("[command]")].splitlines()[1:]
        if not line.startswith("speed_profile")
    )


def ended_s(run: dict, scenario: Scenario) -> float:
    """From the fault until a finding that is not the monitor's has ended the engagement: DM1 tells it or the
    lock within a second."""
    start = scenario.expect.fault_start_s
    return next(t for t, code in run["trouble_codes"] if t >= start and code["spn"] in ENDING_SPNS) - start


@pytest.mark.parametrize("name", shipped_scenarios())
def test_scenarios_expect_what_follows_from_the_bounds(name, simulator, replayer, ratio):
    """ "invalid" only where, and no later than, an alarm is due; "never_invalid" only for trucks within the
    bounds, which a faulty bus shows as they are or not at all; else nothing, where another finding ends the
    engagement before an alarm is due too. What the supervision must say: tests/hil/test_supervision.py."""
    scenario, due, largest = load_scenario(name), [], 0.0
    expect = scenario.expect
    for seed in SEEDS:
        _, drive = simulator.drive(scenario.path, seed=seed)
        offline = one_run.Offline.from_drive(replayer, drive, expect.fault_start_s or 0.0)
        due.append(offline.due_s)
        largest = max(largest, offline.largest)
    tables = plant_tables(name)
    if expect.verdict == "invalid":
        assert None not in due and max(due) <= expect.within_judged_s, due
        # The latest of three seeds states it.
        assert not FULL or expect.within_judged_s <= 1.5 * max(due) + 10.0, due
    elif expect.verdict == "never_invalid":
        assert "sensor_fault" not in tables
        assert ratio(tables) <= 1.0
        assert "can_fault" not in scenario.path.read_text() or largest <= 1.0
    else:
        late = [np.inf if d is None else d for d in due]
        if max(late) <= 60.0:
            ended = [ended_s(simulator.run(scenario, seed=seed), scenario) for seed in SEEDS]
            assert all(e < d for e, d in zip(ended, late, strict=True)), (ended, late)
        assert name in NO_VERDICT_FOLLOWS or "sensor_fault" in tables or ratio(tables) > 1.0


@pytest.mark.unhurried
def test_the_core_sees_in_the_written_drive_what_the_ecu_saw(simulator, replayer, tmp_path):
    scenario = load_scenario("brake_gain_40")
    run = simulator.run(scenario, out=tmp_path, report_only=True)
    seen = np.genfromtxt(tmp_path / "brake_gain_40-1.frames.csv", delimiter=",", names=True)
    facts, drive = simulator.drive(scenario.path)
    replay = replayer.replay(drive)
    assert drive.missing is None and facts["frames_hash"] == run["frames_hash"]
    np.testing.assert_allclose(replay.run.frames.margin, seen["margin"], rtol=1e-6, atol=1e-9)
    np.testing.assert_array_equal(replay.run.frames.bin, seen["bin"])
    assert replay.first_invalid_s + drive.t[0] == pytest.approx(run["first_invalid_s"], abs=0.011)
    # As `replay` reads it from the file: the same.
    assert replayer.replay_file(tmp_path / "brake_gain_40-1.drive.csv").max_margin == pytest.approx(
        replay.max_margin, rel=1e-6
    )


def test_where_the_ecu_withheld_samples_the_drive_has_none(simulator, replayer, tmp_path):
    path = tmp_path / "lost.toml"
    text = load_scenario("dead_yaw_sensor").path.read_text()
    path.write_text(text)
    _, drive = simulator.drive(path)
    gap = np.flatnonzero(drive.missing) * 0.01 + drive.t[0]
    assert 4.5 < len(gap) * 0.01 < 5.2 and 30.0 <= gap.min() < 30.1 and gap.max() < 35.2
    assert (
        np.allclose(np.diff(drive.t), 0.01) and not replayer.estimator.settled(drive.v)[drive.missing].any()
    )


def test_a_frame_that_an_alarm_is_due_for_is_judged_whatever_the_phase(replayer):
    """first_stretch: a run of starts of half a frame, unbroken."""
    starts = np.arange(0, 1000, one_run.STRIDE)
    above = np.zeros(len(starts), bool)
    above[20:30] = True
    assert one_run.first_stretch(starts, above, 90) == 200
    assert one_run.first_stretch(starts, above, 91) is None
    above[25] = False
    assert one_run.first_stretch(starts, above, 90) is None
    assert one_run.first_stretch(np.delete(starts, 24), np.delete(above, 24), 41) is None
    assert one_run.first_stretch(starts[:0], above[:0], 0) is None


def test_nobody_is_best_at_a_kind_where_nobody_found_a_fault():
    def row(**counts: int) -> dict:
        counts = dict.fromkeys(summary.DETECTORS, 0) | counts
        return {"runs": 4, "found": counts, "matched": counts}

    assert (
        summary.kind_row("k", [row(), row()])["best"] == summary.kind_row("k", [row()])["best_matched"] == []
    )
    assert summary.kind_row("k", [row(nis=1, rms=1), row()])["best_matched"] == ["rms", "nis"]


def test_speeds_are_constant_drift_or_sweep_the_range():
    profiles = [scenarios.speed_profile(np.random.default_rng(n)) for n in range(200)]
    assert {len(p) for p in profiles} == {1, 3, 4}
    assert all(8.1 <= v <= 21.9 for p in profiles for _, v in p), "within the grid of the controller"
    sweeps = [p for p in profiles if len(p) == 4]
    slopes = [abs(b[1] - a[1]) / (b[0] - a[0]) for p in sweeps for a, b in pairwise(p[1:])]
    assert min(slopes) >= 0.05 - 1e-9 and max(slopes) <= 0.3 + 1e-9


def test_a_fault_found_with_its_first_sample_is_not_taken_for_an_alarm_before_it(context):
    """A steering-wheel angle that jumps by 1 rad: seen as soon as the receiver takes it, some samples after
    the fault's time. The drive's 6000th sample is later, since a drive begins after its run."""
    jump = '[[plant.sensor_fault]]\nsignal = "steering_wheel"\nstart_s = 60.0\nbias = 1.0\n'
    row = one_run.run_planned(
        context, PlannedRun(scenarios.FIRST_FAULT, "steering-wheel bias", 1.0, -1, 60.0, jump)
    )
    assert not row["monitor_before"] and row["monitor_score_before"] < 1.0
    assert row["monitor_found_s"] < 0.1 and row["ecu_invalid_s"] == pytest.approx(60.0, abs=0.1)


def test_a_quantity_that_happens_to_be_whole_is_a_real_number_in_every_chunk(context, monkeypatch):
    """JSON has 60 for 60.0. One chunk of 66 had a column of integers so, and the campaign could not end."""
    drive = Simulator.drive

    def whole(self: Simulator, path: Path, **options):
        facts, *rest = drive(self, path, **options)
        return facts | {"verdicts": [[60, "invalid"]], "demand_max_bar": 2, "duration_s": 180}, *rest

    monkeypatch.setattr(Simulator, "drive", whole)
    row = one_run.run_planned(context, PlannedRun(0, "within", 0.0, 0, 0.0, ""))
    quantities = {k: v for k, v in row.items() if k.endswith(("_s", "_bar", "_mps", "_radps"))}
    assert len(quantities) > 15 and row["ecu_invalid_s"] == 60.0
    assert {type(v) for v in quantities.values()} <= {float, type(None)}, quantities


def test_what_is_drawn_depends_on_seed_and_number_alone():

    def text(seed: int, planned: PlannedRun) -> str:
        return Drawn.for_run(2.0, seed, planned).text(planned.tables, 0.05)

    planned = PlannedRun(17, "within", 0.0, 0, 0.0, scenarios.draw_variation(5, 3))
    assert text(5, planned) == text(5, planned)
    other = PlannedRun(18, "within", 0.0, 0, 0.0, scenarios.draw_variation(5, 4))
    assert text(5, planned) != text(6, planned) and planned.tables != other.tables
    two = [("a", 1.0), ("b", 0.9)]
    runs = scenarios.plan(Size(0.2, 2), two)
    assert [c.number for c in runs[:4]] == [0, 1, 2, 3] and [c.plant for c in runs[:4]] == [0, 1, 0, 1]
    assert [(c.tables, c.gain) for c in runs[:2]] == two
    longer = scenarios.plan(Size(1.0, 2), two)
    assert longer[20:] == runs[4:], "the faulty runs are the same, however many hours are driven within"
    assert {c.kind for c in runs[4:]} == {k.name for k in faults.KINDS}
    names = [k.name for k in faults.KINDS]
    assert len(set(names)) == len(names), "a kind is found by its name"
    assert all(k.of_truck or k.of_bus for k in faults.KINDS) and any(
        k.of_truck and k.of_bus for k in faults.KINDS
    )


def test_faults_of_the_truck_alone_come_in_three_ways_and_keep_their_numbers(monkeypatch):
    runs = scenarios.plan(Size(0.05, 2), [("", 1.0)])[1:]
    kinds = {k.name: k for k in faults.KINDS}
    first = [r for r in runs if r.way == kinds[r.kind].ways[0]]
    monkeypatch.setattr(faults, "WAYS", ("step",))
    assert scenarios.plan(Size(0.05, 2), [("", 1.0)])[1:] == first == runs[: len(first)]
    ways = {name: {r.way for r in runs if r.kind == name} for name in kinds}
    assert ways["load"] == {"start"} and ways["VDC2 lost"] == {"step"}
    assert ways["brake gain, 5 % of VDC2 lost"] == {"step"}
    assert ways["brake gain"] == ways["yaw-rate bias"] == ways["crosswind"] == {"step", "ramp", "start"}
    for r in runs:
        if len(ways[r.kind]) == 3:
            starts, ramps = (
                {"step": "60", "ramp": "60", "start": "0"},
                {"step": "0", "ramp": "20", "start": "0"},
            )
            assert f"start_s = {starts[r.way]}\nramp_s = {ramps[r.way]}\n" in r.tables
            assert r.fault_s == float(starts[r.way])


def test_the_ways_are_told_apart():
    def row(way: str, found_s: float | None) -> dict:
        run = {"found_s": found_s, "before": False, "score_before": 0.0, "score_within": 2.0}
        detected = {f"{d}_{key}": value for d in summary.DETECTORS for key, value in run.items()}
        shown = {"visible_share": 1.0, "excited_after_s": 60.0}
        return {"kind": "brake gain", "severity": 0.5, "way": way} | shown | detected

    rows = [row("step", 1.0), row("step", 3.0), row("ramp", 9.0), row("ramp", None), row("ramp", None)]
    ways = summary.by_way(rows, dict.fromkeys(summary.DETECTORS, 1.0))
    assert {way: way_results["runs"] for way, way_results in ways.items()} == {"step": 2, "ramp": 3}
    assert ways["step"]["average"]["monitor"] == {"calibrated": 1.0, "matched": 1.0}
    assert ways["ramp"]["average"]["monitor"]["calibrated"] == pytest.approx(1 / 3)
    assert ways["step"]["median_s"]["glr"] == 2.0 and ways["ramp"]["median_s"]["glr"] is None


FIVEFOLD = "[plant.variation]\nbrake_gain_ratio = 5.0\n"
"""Brakes beyond any gain margin: the loop ends in a limit cycle."""


def steering_runs(count: int) -> list[PlannedRun]:
    """The first runs "within" whose command is of the steering task at a speed above 15 m/s."""
    runs: list[PlannedRun] = []
    number = 0
    while len(runs) < count:
        planned = PlannedRun(number, "within", 0.0, 0, 0.0, "")
        drawn = Drawn.for_run(2.0, 1, planned)
        if drawn.command.size is not None and min(v for _, v in drawn.profile) > 15.0:
            runs.append(planned)
        number += 1
    return runs


def test_a_loop_that_limit_cycles_falsifies_and_ordinary_noisy_runs_do_not(context):
    for planned in steering_runs(2):
        good = one_run.run_planned(context, planned)
        assert good["line_bar"] == 0.0 and good["limited_stretch_s"] < conduct.SATURATED_S
        assert 0 < good["free_rms_radps"] < good["wanted_rms_radps"] and good["brake_gain"] == 1.0
        assert list(conduct.ruled_out(good)) == [] and not conduct.beyond_wish(good)
        assert 0.1 < good["allowed_rms_radps"] / good["wanted_rms_radps"] < 0.7, "a bound that can be broken"
        assert 0.045 < good["wanted_rms_radps"] < 0.06 and good["demand_max_bar"] > 0.5
        bad = one_run.run_planned(context, replace(planned, tables=FIVEFOLD))
        assert bad["brake_gain"] == 5.0 and bad["line_bar"] > 1.0 and 3.0 < bad["line_radps"] < 20.0
        assert next(conduct.ruled_out(bad)).startswith("oscillates at ")


WEAK = "[plant.variation]\nbrake_gain_ratio = 0.1\n"


def test_a_loop_too_weak_to_follow_falsifies(context):
    """Brakes of a tenth of the gain saturate nothing where little is commanded; the track alone tells."""
    row = one_run.run_planned(context, replace(steering_runs(1)[0], tables=WEAK))
    assert any(text.startswith("loses track") for text in conduct.ruled_out(row))


def test_the_tracking_bound_is_the_sum_of_the_inputs_over_their_weights(context):
    bound, t = context.tracking, np.arange(1800) * 0.1
    omega = 2 * np.pi * 20 / 180
    line = 0.02 * np.sin(omega * t)
    W, none = bound.weights, np.zeros((1800, 2))

    own = dict(zip(("W_wr", "W_wdelta", "W_nr", "W_ndelta"), (*W.W_w, *W.W_n), strict=True)) | {"W_C": W.W_C}

    def gain(name: str) -> float:
        return abs((own[name].response([omega]) * W.W_t.response([omega]))[0, 0, 0])

    alone = {
        "W_C": bound.rms(line, none, none, 0.1, 0.1),
        "W_wr": bound.rms(0 * t, np.column_stack([line, 0 * t]), none, 0.1, 0.1),
        "W_wdelta": bound.rms(0 * t, np.column_stack([0 * t, line]), none, 0.1, 0.1),
        "W_nr": bound.rms(0 * t, none, np.column_stack([line, 0 * t]), 0.1, 0.1),
        "W_ndelta": bound.rms(0 * t, none, np.column_stack([0 * t, line]), 0.1, 0.1),
    }
    for name, rms in alone.items():
        assert rms == pytest.approx(0.02 / np.sqrt(2) / gain(name)), name
    both = np.column_stack([line, line])
    assert bound.rms(line, both, both, 0.1, 0.1) == pytest.approx(np.linalg.norm(list(alone.values())))
    above = np.sin(2 * np.pi * 40 / 180 * t)
    assert bound.rms(above, none, none, 0.1, 0.1) < 1e-9, "nothing above the steering task"


@pytest.fixture
def small(monkeypatch):
    """A campaign of minutes made one of seconds: faults of the truck, of the bus and of both, one truck at
    few amplitudes and frequencies, one fault and setting to choose a baseline by."""
    kinds = [
        k
        for k in faults.KINDS
        if k.name in ("brake gain", "yaw rate frozen", "GUARD_IN repeated", "brake gain, 5 % of VDC2 lost")
    ]
    monkeypatch.setattr(
        faults,
        "KINDS",
        tuple(faults.Kind(k.name, k.unit, k.values[:1], k.table, k.loop, k.response) for k in kinds),
    )
    usual = Injection.usual()
    monkeypatch.setattr(Injection, "usual", lambda: replace(usual, faults=usual.faults[:1]))
    monkeypatch.setattr(faults, "WAYS", ("step",))
    monkeypatch.setattr(trucks, "PLANTS", 1)
    monkeypatch.setattr(chunked_runs, "CHUNK", 3)
    monkeypatch.setattr(trucks, "RESPONSE_SPEEDS", (15.0,))
    monkeypatch.setattr(trucks, "RESPONSE_BAR", (0.7, np.inf))
    monkeypatch.setattr(trucks, "OMEGA", (trucks.OMEGA[0][::3], trucks.OMEGA[1][-3:]))
    monkeypatch.setattr(
        baseline_study,
        "GRID",
        (
            Baseline("rms", window_s=0.2),
            Baseline("cusum", drift=4.0),
            Baseline("nis", window_s=0.5, process_ratio=0.03),
            Baseline("tracker", window_s=2.0, prior=0.2),
            Baseline("glr", window_s=5.0),
        ),
    )


@pytest.fixture
def few_to_choose_by(stored):
    """The truck with an eighth of the drives that baselines are chosen by: how a campaign goes on, and where
    its workers are, does not ask which baselines it has."""
    identification, drives = stored
    used = identification.manifest["drives"]
    return replace(
        identification, manifest=identification.manifest | {"drives": used | {"bounds": used["bounds"][::8]}}
    ), drives


class Stopped(Exception):
    pass


def test_a_cluster_gives_the_same_bytes(small, few_to_choose_by, truck_folder, tmp_path):
    """Workers of a Dask cluster: the very files of a campaign in this process."""
    distributed = pytest.importorskip("distributed")
    identification, drives = few_to_choose_by
    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, processes=False, dashboard_address=None
        ) as cluster,
        workers(scheduler=cluster.scheduler_address) as shared,
    ):
        campaign(
            identification,
            drives,
            truck_folder,
            tmp_path / "cluster",
            seed=3,
            size=Size(0.1, 1),
            workers=shared,
        )
    campaign(identification, drives, truck_folder, tmp_path / "here", seed=3, size=Size(0.1, 1))
    files = [
        sorted(p.relative_to(tmp_path / name) for p in (tmp_path / name).rglob("*") if p.is_file())
        for name in ("cluster", "here")
    ]
    assert files[0] == files[1] and Path("runs.parquet") in files[0]
    for file in files[0]:
        assert (tmp_path / "cluster" / file).read_bytes() == (tmp_path / "here" / file).read_bytes(), file


def test_a_campaign_that_was_stopped_goes_on_and_ends_the_same(
    small, few_to_choose_by, truck_folder, tmp_path
):
    identification, drives = few_to_choose_by
    size = Size(0.25, 2)
    runs = 5 + 4 * 2

    def go_on(out: Path, stop_at: int | None = None) -> dict:
        def progress(text: str) -> None:
            if stop_at is not None and text.startswith(f"run {stop_at} "):
                raise Stopped

        return campaign(identification, drives, truck_folder, out, seed=3, size=size, progress=progress)

    out = tmp_path / "stopped"
    with pytest.raises(Stopped):
        go_on(out, stop_at=5)
    chunks = sorted((out / "chunks").iterdir())
    assert [c.name for c in chunks] == ["00000.parquet"] and not (out / "summary.json").exists()
    kept = {p: os.stat(p).st_mtime_ns for p in [*chunks, out / "plants.json", out / "baselines.json"]}
    resumed = go_on(out)
    described = jsonschema.Draft202012Validator(schemas.schema("campaign"))
    assert [e.message for e in described.iter_errors(json.loads((out / "summary.json").read_text()))] == []
    assert kept == {p: os.stat(p).st_mtime_ns for p in kept}, "what was finished is not done again"
    whole = tmp_path / "whole"
    (whole / "chunks").mkdir(parents=True)
    for name in ("MANIFEST.json", "plants.json", "baselines.json"):
        (whole / name).write_bytes((out / name).read_bytes())
    assert go_on(whole) == resumed
    rows = pq.read_table(whole / "runs.parquet")
    for file in ("runs.parquet", "summary.json"):
        assert (whole / file).read_bytes() == (out / file).read_bytes(), file
    assert rows.num_rows == runs and len(set(rows["seed"].to_pylist())) == runs, (
        "every run's seed is recorded"
    )

    assert resumed["within"]["runs"] == 5 and resumed["within"]["hours"] == pytest.approx(0.25)
    assert resumed["falsified"] == {"rate": rate(0, 5), "runs": []}
    assert resumed["command_authentication"] == "authenticated"
    assert 0 < resumed["within"]["largest_ratio"] <= 1
    assert resumed["within"]["tests"].keys() == {"frame", "energy", "change"}
    assert set(resumed["matched_stated"].values()) == {None} and resumed["matched_claim"].startswith(
        "counts only"
    ), "five runs are too few"
    truck = [("brake gain", 0.0), ("yaw rate frozen", 1.0), ("brake gain, 5 % of VDC2 lost", 0.15)]
    assert [(s["kind"], s["severity"]) for s in resumed["severities"]] == truck
    assert [s["found"]["monitor"] for s in resumed["severities"]] == [2, 2, 2], (
        "lost brakes and a dead sensor are found, on a faulty bus too"
    )
    assert all(s["median_s"]["monitor"] < one_run.FOUND_WITHIN_S for s in resumed["severities"])
    assert (
        resumed["visible"]["monitor"]["count"]
        == resumed["visible"]["monitor"]["of"]
        == sum(s["visible_runs"] for s in resumed["severities"])
        > 0
    )
    assert resumed["due"]["count"] == resumed["due"]["of"] > 0
    assert [s["kind"] for s in resumed["bus"]] == ["brake gain, 5 % of VDC2 lost", "GUARD_IN repeated"], (
        "the bus is scored apart"
    )
    said = resumed["supervision"]
    assert said["faulty"]["as_required"]["count"] == 4 and all(s["as_required"] == 2 for s in resumed["bus"])
    assert (
        said["faulty"]["met"] == said["faulty"]["due"] > 10
        and said["healthy"]["as_required"]["count"] == 5
        and said["healthy"]["due"] == 0
    )
    assert resumed["bus"][0]["alarmed"]["monitor"] == 2 and resumed["bus"][0]["judged"] > 0.9
    with pytest.raises(InputError, match="other settings"):
        campaign(identification, drives, truck_folder, out, seed=4, size=size)


def test_a_falsified_certificate_fails_the_command_and_is_named(
    small, stored, truck_folder, truck_identified, truck_drives, lpvguard, monkeypatch, tmp_path
):
    """Planted: brakes of five times the gain, which the measurement takes for a truck within the bounds."""
    monkeypatch.setattr(trucks, "draw_variation", lambda seed, candidate: FIVEFOLD)
    within = trucks.Distance(0.9, "yaw_rate", 1.0, 15.0, 0.25, 1.0)
    monkeypatch.setattr(trucks.CertifiedSet, "distance", lambda self, tables: within)
    out = tmp_path / "campaign"
    done = lpvguard(
        *("campaign", truck_identified, truck_drives, "-o", out, "--coefficients", truck_folder),
        *("--hours", 0.1, "--repeats", 1, "--seed", 3),
    )
    assert done.returncode == 1
    written = json.loads((out / "summary.json").read_text())
    rows = pq.read_table(out / "runs.parquet").to_pylist()
    falsified = written["falsified"]
    refuting = [row for row in rows[:2] if list(conduct.ruled_out(row))]
    assert refuting and [r["number"] for r in falsified["runs"]] == [row["number"] for row in refuting]
    assert falsified["rate"] == rate(len(refuting), 2)
    assert written["missed"][0].startswith(f"{len(refuting)} of 2 runs")
    said = " ".join(done.stderr.split())
    for named, row in zip(falsified["runs"], refuting, strict=True):
        assert named["seed"] == row["seed"] and named["tables"] == FIVEFOLD and named["plant"] == 0
        assert any(text.startswith("oscillates") for text in named["did"])
        assert (
            f"FALSIFIED CERTIFICATE: run {row['number']}, seed {row['seed']}, truck 0, "
            f"{row['speed_mps']:.2f} m/s: oscillates"
        ) in said


def test_a_folder_of_something_else_and_bounds_of_another_export_are_refused(
    small, stored, truck_folder, tmp_path
):
    identification, drives = stored
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match="no campaign"):
        campaign(identification, drives, truck_folder, tmp_path, seed=1, size=Size(0.05, 1))
    other = replace(identification, fitted=replace(identification.fitted, inflation=1.1))
    with pytest.raises(InputError, match="not those of the identification"):
        campaign(other, drives, truck_folder, tmp_path / "new", seed=1, size=Size(0.05, 1))
    with pytest.raises(InputError, match=r"controller\.json"):
        campaign(
            identification,
            drives,
            truck_folder,
            tmp_path / "new",
            seed=1,
            size=Size(0.05, 1),
            controller=tmp_path / "controller.json",
        )
    assert not (tmp_path / "new").exists(), "refused before anything is begun"
