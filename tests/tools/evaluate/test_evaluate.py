"""What counts as found, from when and until when; what a threshold promises; and drives that offer less than
the measured ones."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

from lpvguard.base.errors import InputError
from lpvguard.drives.faults import Fault, inject
from lpvguard.drives.tables import Drive, index_text, read_drive
from lpvguard.evaluate import evaluation as stage
from lpvguard.evaluate.comparison import equal_rates
from lpvguard.evaluate.detection import FaultOutcome, Injection, JudgedClock, margins, refutable
from lpvguard.evaluate.false_alarms import alarmed_pieces, alarming, piece_starts
from lpvguard.identify import identification as identify
from lpvguard.identify.calibration import Calibration, Recordings, calibrate
from lpvguard.identify.joint import FLOORS, UNITS, joint_scores
from lpvguard.replay.replayer import Replay, Replayer
from lpvguard.vehicle.nominal import NominalModel
from lpvguard.vehicle.project import EvaluationSettings

TS = 0.02
USUAL = Injection.usual()
FOUND_WITHIN_S = USUAL.within_s


def hits(n: int, *at: int) -> np.ndarray:
    marks = np.zeros(n, bool)
    marks[list(at)] = True
    return marks


def replay(seconds: float, relevant=slice(None), *, name: str = "made up", falsified=(), over=()) -> Replay:
    """A replay of which only what evaluate reads is filled in; ``relevant``: the judged, excited samples."""
    n = round(seconds / TS) + 1
    judged = np.zeros(n, bool)
    judged[relevant] = True
    return Replay(
        name,
        seconds,
        None,
        judged,
        np.ones(n, bool),
        np.ones(n, bool),
        hits(n, *falsified),
        hits(n),
        hits(n, *over),
        hits(n),
        [],
        TS,
    )


# ------------------------------------------------------------------------------------------------ what counts


def test_the_clock_runs_in_judged_driving_from_the_first_faulty_sample_on():
    clock = JudgedClock.from_replay(replay(100.0, slice(0, 3500)), 3000, FOUND_WITHIN_S)
    assert clock.read(hits(5001, 2999)) is None
    assert clock.read(hits(5001, 2999, 3000)) == pytest.approx(TS), "the first faulty sample counts"
    assert clock.read(hits(5001, 3499)) == clock.read(hits(5001, 4500)) == pytest.approx(10.0), (
        "it stands where nothing is judged"
    )
    whole = JudgedClock.from_replay(replay(100.0), 3000, FOUND_WITHIN_S)
    assert whole.end == 3000 + round(FOUND_WITHIN_S / TS)


@pytest.mark.parametrize(
    ("faulty", "untouched", "s"),
    [
        (3009, None, 0.2),
        (3009, 3010, 0.2),  # the twin is silent until then, or for ever
        (3009, 3009, None),
        (3009, 3001, None),  # it alarms with it, or first: not the fault's doing
        (4499, None, 30.0),
        (4500, None, None),
    ],
)  # in time, and one sample too late
def test_found_means_before_the_untouched_drive_and_in_time(faulty, untouched, s):
    clock = JudgedClock.from_replay(replay(120.0), 3000, FOUND_WITHIN_S)
    other = None if untouched is None else clock.read(hits(6001, untouched))
    case = FaultOutcome.from_times("made up", TS, clock, clock.read(hits(6001, faulty)), other)
    assert case.untouched_s == other
    assert (
        case.s == (None if s is None else pytest.approx(s))
        and case.detected == (s is not None)
        and case.start_s == 60.0
    )


def test_what_the_untouched_drive_says_later_does_not_matter():
    clock = JudgedClock.from_replay(replay(120.0), 3000, FOUND_WITHIN_S)
    case = FaultOutcome.from_times("made up", TS, clock, *(clock.read(hits(6001, k)) for k in (3009, 4501)))
    assert case.detected and case.untouched_s is None


def test_an_alarm_that_stands_when_the_fault_starts_is_none_of_it():
    clock = JudgedClock.from_replay(replay(120.0), 3000, FOUND_WITHIN_S)
    standing = hits(6001, *range(2900, 3100))
    faulty = standing | hits(6001, 3200)
    assert not FaultOutcome.from_times(
        "made up", TS, clock, clock.read(faulty), clock.read(standing)
    ).detected


def test_starts_leave_time_to_find_and_do_not_depend_on_other_drives():
    long = replay(300.0, name="a")
    clocks = USUAL.clocks(long, seed=1)
    assert len(clocks) == USUAL.starts
    firsts = [c.first for c in clocks]
    assert firsts == sorted(firsts) and firsts[0] >= 3000 and firsts[-1] < 13501
    assert (
        [c.first for c in USUAL.clocks(long, seed=1)]
        == firsts
        != [c.first for c in USUAL.clocks(replay(300.0, name="b"), seed=1)]
    )
    # Judged until 100 s alone: every start leaves 30 s of that.
    for clock in USUAL.clocks(replay(300.0, slice(0, 5000)), seed=1):
        assert clock.first >= 3000 and clock.seconds[-1] >= FOUND_WITHIN_S - 1e-9
    assert USUAL.clocks(replay(300.0, slice(0, 4400)), seed=1) == [], "28 s are not enough"
    assert USUAL.clocks(replay(300.0, slice(0, 0)), seed=1) == [], "never excited"
    assert USUAL.clocks(replay(120.0), seed=1) == [], "no longer than 120 s"


def test_every_second_counts_in_pieces_of_which_the_last_may_be_shorter():
    made = replay(170.0, falsified=(10, 20, 3000), over=(8400,))
    assert (
        alarmed_pieces(made) == (3, 3)
        and alarmed_pieces(made, "energy") == (1, 3)
        and alarmed_pieces(made, "frame") == (2, 3)
    )
    assert alarmed_pieces(replay(59.0, over=(5,))) == (1, 1)
    assert alarmed_pieces(replay(140.0, falsified=(6500,))) == (1, 3), "an alarm in the last 20 s"
    assert alarmed_pieces(replay(140.0, slice(0, 6000), over=(6500,))) == (1, 3), (
        "where nothing is judged, too"
    )
    assert alarmed_pieces(replay(120.0, over=(6000,))) == (1, 2), "the closing sample is no piece of its own"
    assert piece_starts(1, TS).tolist() == [0]


def test_equal_rates_are_claimed_only_where_all_are_stated():
    assert "one guaranteed rate" in equal_rates({"monitor": 0.1, "rms": 0.1})
    said = equal_rates({"monitor": 0.1, "rms": None})
    assert (
        said.startswith("by counts only") and said.endswith("for rms") and "one guaranteed rate" not in said
    )
    assert stage.one_rate([0.1, 0.1]) == 0.1 and stage.one_rate([0.1, None]) is None


def first_alarm_s(replay: Replay) -> float:
    """Time of the first verdict "degraded" or "invalid"."""
    return min(t for t in (replay.first_degraded_s, replay.first_invalid_s) if t is not None)


def test_an_alarm_stands_where_the_core_says_so(core, g80, synthetic):
    """The verdict turns degraded or invalid with the very samples that are counted; a frame waits for its
    turn after its end."""
    drive = inject(read_drive(synthetic / "synthetic_06.csv", g80), Fault("gain", 0.3), 60.0, g80.Ts_s)
    replay = Replayer(g80, core, threshold=1.5, energy_threshold=1e6, change_threshold=1e6).replay(drive)
    assert not replay.over.any() and replay.falsified.any()
    assert first_alarm_s(replay) == pytest.approx(np.flatnonzero(alarming(replay))[0] * replay.Ts)
    frames = replay.run.frames
    wait = np.round((frames.t_judged_s - frames.t_end_s) / replay.Ts)
    assert (wait >= 0).all() and wait.max() > 0
    of_energy = Replayer(g80, core, threshold=1e6, energy_threshold=1.5, change_threshold=1e6).replay(drive)
    assert first_alarm_s(of_energy) == pytest.approx(np.flatnonzero(alarming(of_energy))[0] * replay.Ts)


# ------------------------------------------------------------------------------------------- what is promised


@pytest.mark.unhurried
def test_one_threshold_for_all_tests_keeps_alpha_and_two_do_not():
    """10 calibration drives, independent tests: by either, the joint threshold lets 1/11 alarm, the two 1 -
    (10/11)^2 = 21/121. A third test's scores, all below its floor, change neither."""
    random, n, alpha, trials = np.random.default_rng(3), 10, 0.1, 4000
    joint = apart = 0
    for _ in range(trials):
        frame, change = random.lognormal(-0.2, 0.3, (2, n + 1)) * [[UNITS["frame"]], [1.0]]
        by_test = [{str(i): s for i, s in enumerate(x[:n])} for x in (frame, change)]
        scores = joint_scores(
            {"frame": by_test[0], "change": by_test[1], "energy": dict.fromkeys(by_test[0], 1.0)}
        )
        threshold = calibrate(scores, alpha, floor=FLOORS["change"]).threshold
        joint += frame[n] > max(UNITS["frame"] * threshold, FLOORS["frame"]) or change[n] > threshold
        own = [calibrate(s, alpha, floor=0.05).threshold for s in by_test]
        apart += frame[n] > own[0] or change[n] > own[1]
    spread = 3 * np.sqrt(0.25 / trials)
    assert joint / trials == pytest.approx(1 / 11, abs=spread) and apart / trials == pytest.approx(
        21 / 121, abs=spread
    )


@pytest.mark.parametrize(
    ("drives", "alpha", "says"),
    [
        (25, 0.04, "alpha 0.04 from 25 drives, with 95 % confidence below 0.113"),
        (25, 0.038, "not stated"),
        (23, 0.04, "not stated"),
        (24, 0.04, "alpha 0.04 from 24 drives"),
        (8, 0.2, "not stated"),
        (9, 0.1, "alpha 0.1 from 9 drives"),
        (0, 0.1, "not stated"),
    ],
)
def test_a_claim_comes_with_its_conditional_bound_or_is_refused(drives, alpha, says):
    """n < 1/alpha - 1, or fewer than 9 drives: alpha is not stated."""
    assert says in calibrate({str(i): 1.0 + i for i in range(drives)}, alpha).claim()


def test_settings_say_when_and_how_large_faults_are():
    settings = EvaluationSettings(
        fault_from_s=5.0,
        shortest_drive_s=20.0,
        found_within_s=10.0,
        starts=2,
        gains=(0.5,),
        delays_s=(0.1, 0.2),
    )
    injection = Injection.from_settings(settings, np.array([2.0, 0.4]))
    times = {"from_s": 5.0, "shortest_s": 20.0, "within_s": 10.0, "starts": 2, "ramp_s": 20.0}
    assert injection.to_dict() == times | {"ways": ["step", "ramp", "start"]}
    assert [f.label for f in injection.faults] == [
        "output × 0.5",
        "output frozen",
        "input delayed by 0.1 s",
        "output delayed by 0.1 s",
        "output + 0.5 of its spread",
        "input delayed by 0.2 s",
        "output delayed by 0.2 s",
    ]
    assert injection.clocks(replay(20.0), seed=1) == []
    clocks = injection.clocks(replay(20.1), seed=1)
    assert len(clocks) == 2 and all(c.first >= 250 and c.end - c.first == 500 for c in clocks)
    into = [(case.way, clock.first) for case, clock in injection.into(replay(20.1), seed=1)]
    firsts = [c.first for c in clocks]
    assert into[:2] == [("step", first) for first in firsts] and into[14:16] == [("ramp", f) for f in firsts]
    assert into[28:] == [("start", 0)] * 7
    assert {case.way: case.ramp_s for case in injection.cases} == {"step": 0.0, "ramp": 20.0, "start": 0.0}
    still = Drive("d", np.arange(3) * TS, np.ones(3), np.zeros((3, 1)), np.zeros((3, 2)))
    biased = inject(still, injection.faults[4], TS, TS)
    np.testing.assert_allclose(biased.y, [[0, 0], [1.0, 0.2], [1.0, 0.2]])
    with pytest.raises(ValueError, match="at least fault_from_s"):
        EvaluationSettings(fault_from_s=100.0)
    with pytest.raises(ValueError, match="each way at most once"):
        EvaluationSettings(ways=("step", "step"))


def test_refutable_is_when_the_faulty_margin_exceeds_1_and_the_untouched_one_does_not(core, g80, synthetic):
    clock = JudgedClock.from_replay(replay(120.0), 3000, FOUND_WITHIN_S)
    faulty, untouched = np.zeros(6001), np.zeros(6001)
    faulty[[2000, 3100, 3200, 3300]] = [9.0, 1.0, 1.5, 1.5]
    untouched[3200] = 1.2
    assert refutable(clock, faulty, untouched) == pytest.approx(301 * TS)
    assert refutable(clock, faulty[:3250], untouched) is None
    late = np.zeros(6001)
    late[4600] = 2.0
    assert refutable(clock, late, untouched) is None
    # Of a replay: the t* of a frame where it ends, and the energy test's ratio, whatever is larger.
    drive = read_drive(synthetic / "synthetic_06.csv", g80)
    seen = Replayer(g80, core).replay(inject(drive, Fault("gain", 0.3), 60.0, g80.Ts_s))
    by_sample, frames = margins(seen, drive.t[0]), seen.run.frames
    assert (
        by_sample.max() == max(seen.max_margin, seen.run.energy.max())
        and (by_sample >= seen.run.energy).all()
    )
    worst = np.flatnonzero(frames.counted)[np.argmax(frames.margin[frames.counted])]
    assert by_sample[round((frames.t_end_s[worst] - drive.t[0]) / g80.Ts_s)] >= seen.max_margin


# ------------------------------------------------------------------------------------------------- recordings


def pieces(recordings: int, each: int) -> tuple[dict[str, float], Recordings]:
    """Scores that grow from piece to piece, and the recording of each."""
    recording_of = {f"r{r}_{k}": f"r{r}" for r in range(recordings) for k in range(each)}
    return {n: 1.0 + i for i, n in enumerate(recording_of)}, Recordings(recording_of)


def test_pieces_of_two_recordings_buy_no_alpha():
    scores, recordings = pieces(2, 11)
    scores.pop("r1_10")
    calibration = calibrate(scores, 0.05, recordings=recordings)
    assert calibration.alpha is None and calibration.conditional_bound is None
    assert calibration.threshold == max(scores.values())
    assert calibration.claim() == (
        "alpha is not stated: 21 drives calibrate, from 2 recordings that did not set the bounds; "
        "drives of one recording are not independent"
    )
    assert calibrate(scores, 0.05).alpha == 0.05, "as they would as drives of their own"


def test_a_recordings_score_is_its_largest_and_one_that_sets_the_bounds_does_not_count():
    scores, recordings = pieces(10, 3)
    calibration = calibrate(scores, 0.1, recordings=recordings)
    assert calibration.threshold == max(scores.values()) and calibration.alpha == 0.1
    assert calibration.claim().startswith("alpha 0.1 from 10 recordings, with 95 % confidence below")
    one_sets = replace(recordings, setting=("r9",))
    calibration = calibrate(scores, 0.1, recordings=one_sets)
    assert calibration.threshold == scores["r8_2"] and "from 9 recordings" in calibration.claim()
    two_set = calibrate(scores, 0.1, recordings=replace(recordings, setting=("r8", "r9")))
    assert two_set.alpha is None and two_set.threshold == max(scores.values())
    assert two_set.claim().endswith("and 6 drives belong to recordings that set the bounds")
    assert recordings.others(scores, "r3_1") == [n for n in scores if not n.startswith("r3_")]
    for c in (calibration, two_set, calibrate(scores, 0.1)):
        assert Calibration.from_dict(json.loads(json.dumps(c.to_dict()))) == c


@pytest.mark.unhurried
def test_thresholds_by_recordings_keep_alpha_where_those_by_pieces_do_not():
    """19 recordings of 10 pieces that share a level, alpha 0.05: the next recording alarms in 1 of 20."""
    random, trials = np.random.default_rng(4), 2000
    by_piece = by_recording = 0
    for _ in range(trials):
        x = random.normal(size=(20, 1)) + 0.3 * random.normal(size=(20, 10))
        scores = {f"r{r}_{k}": float(np.exp(x[r, k])) for r in range(19) for k in range(10)}
        recordings = Recordings({n: n.split("_")[0] for n in scores})
        further = np.exp(x[19]).max()
        by_recording += further > calibrate(scores, 0.05, floor=0.0, recordings=recordings).threshold
        by_piece += further > calibrate(scores, 0.05, floor=0.0).threshold
    assert by_recording / trials == pytest.approx(0.05, abs=0.015) and by_piece / trials > 0.1


# ----------------------------------------------------------------------------------------------- fewer drives


@pytest.fixture
def folder(synthetic, tmp_path):
    """Makes a folder of chosen synthetic drives: name -> split, changed by a function of the table's text
    lines."""

    def make(chosen: dict[str, str], change=lambda name, lines: lines):
        made = tmp_path / "drives"
        made.mkdir()
        for name in chosen:
            lines = (synthetic / f"{name}.csv").read_text().splitlines()
            (made / f"{name}.csv").write_text("\n".join(change(name, lines)) + "\n")
        (made / "experiments.csv").write_text(
            "experiment,split\n" + "".join(f"{n},{s}\n" for n, s in chosen.items())
        )
        return made

    return make


ONE_WAY = EvaluationSettings(bias=0.05, ways=("step",))


def evaluated(g80, core, drives):
    result, drive_set = identify.identify(g80, drives)
    folder = drives.parent / "identified"
    identify.save(result, drive_set, folder)
    return stage.evaluate(identify.load(folder), drive_set, core, settings=ONE_WAY)


@pytest.mark.slow("10 s: an identification and its evaluation")
def test_a_single_drive_to_evaluate_has_no_baselines_and_no_alpha(folder, g80, core):
    table = evaluated(
        g80, core, folder({"synthetic_01": "train", "synthetic_02": "train", "synthetic_06": "valid"})
    )
    assert table["baselines"] == [] and all(
        row["best"] == (["monitor"] if row["found"] else []) for row in table["faults"]
    )
    assert table["claims"]["identified"]["frame"].endswith("too few calibration drives (1)")
    assert table["claims"]["left_one_out"]["monitor"] == [
        "alpha is not stated: too few calibration drives (0)"
    ]
    assert all(row["drives"] == 1 and row["counted"] == USUAL.starts for row in table["faults"])
    assert table["stated_rates"] == dict.fromkeys(
        ("monitor", "frame", "energy", "change", "pools", "exported")
    )
    (drive,) = table["drives"]
    assert (
        drive["last_piece_s"] == pytest.approx(drive["duration_s"] - 60 * (drive["pieces"] - 1))
        and 0 < drive["last_piece_s"] <= 60
    )
    assert table["false_alarms"]["all"]["judged_h"] == pytest.approx(drive["judged_s"] / 3600)


@pytest.mark.long("15 s: an identification and its evaluation")
def test_recordings_of_the_index_reach_the_claims_and_whole_ones_are_left_out(folder, g80, core):
    splits = dict.fromkeys(("synthetic_01", "synthetic_02"), "train") | dict.fromkeys(
        ("synthetic_06", "synthetic_07", "synthetic_08"), "valid"
    )
    made = folder(splits)
    day = {"synthetic_06": "monday", "synthetic_07": "monday", "synthetic_02": "tuesday"}
    (made / "experiments.csv").write_text(index_text((n, s, day.get(n, n)) for n, s in splits.items()))
    table = evaluated(g80, core, made)
    said = "alpha is not stated: 3 drives calibrate, from 2 recordings that did not set the bounds"
    assert table["claims"]["identified"]["frame"].startswith(said)
    left = {r["run"]: r["calibration"]["monitor"]["drives"] for r in table["drives"]}
    assert left == {"synthetic_06": 1, "synthetic_07": 1, "synthetic_08": 2}
    counted = table["false_alarms"]["all"]
    assert counted["drives"] == 3 and counted["recordings"]["of"] == 2
    assert {r["run"]: r["recording"] for r in table["drives"]} == {n: day.get(n, n) for n in left}
    stored = identify.load(made.parent / "identified")
    assert stored.calibration.recordings == Recordings(day)
    assert stored.energy.calibration.recordings == stored.calibration.recordings
    shutil.copy(made / "synthetic_06.csv", made / "again.csv")
    with (made / "experiments.csv").open("a") as index:
        index.write("again,valid,\n")
    with pytest.raises(InputError, match=r"again is the same table as synthetic_06, byte for byte"):
        identify.identify(g80, made)


@pytest.mark.slow("10 s: an identification of 21 pieces")
def test_21_pieces_of_two_recordings_buy_no_alpha_and_the_sentence_says_why(folder, synthetic, lpvguard):
    """From the drive folder to console and JSON: 11 drives of two days, each but one cut in two."""
    names = [f"synthetic_{k:02d}" for k in range(5, 16)]
    made = folder(dict.fromkeys(("synthetic_01", "synthetic_02"), "train"))
    rows = [("synthetic_01", "train", ""), ("synthetic_02", "train", "")]
    for k, name in enumerate(names):
        header, *lines = (synthetic / f"{name}.csv").read_text().splitlines()
        cuts = [lines] if k == 0 else [lines[: len(lines) // 2], lines[len(lines) // 2 :]]
        for i, piece in enumerate(cuts):
            (made / f"{name}_{i}.csv").write_text("\n".join([header, *piece]) + "\n")
            rows.append((f"{name}_{i}", "valid", "monday" if k < 6 else "tuesday"))
    (made / "experiments.csv").write_text(index_text(rows))
    out = made.parent / "identified"
    done = lpvguard("identify", "--vehicle", "g80", made, "-o", out, "--json", made.parent / "told.json")
    assert done.returncode == 0, done.stderr
    why = (
        "alpha is not stated: 21 drives calibrate, from 2 recordings that did not set the bounds; "
        "drives of one recording are not independent"
    )
    assert " ".join(done.stderr.split()).count(why) == 3, "of every test"
    identification = json.loads((made.parent / "told.json").read_text())
    for calibration, floor in (
        (identification, 1.0),
        (identification["energy"]["calibration"], 1.001),
        (identification["change"]["calibration"], 0.05),
    ):
        assert calibration["alpha"] is None is calibration["conditional_bound"]
        assert len(calibration["scores"]) == 21
        assert calibration["threshold"] == max(floor, *calibration["scores"].values())


@pytest.mark.long("8 s: an identification and its evaluation")
def test_short_and_unexcited_drives_are_counted_and_named(folder, g80, core):
    def change(name: str, lines: list[str]) -> list[str]:
        if name == "synthetic_06":
            return lines[: 1 + 50 * 100]
        if name == "synthetic_08":
            header, rows = lines[0].split(","), [line.split(",") for line in lines[1:]]
            steering = header.index("delta")
            return [
                lines[0],
                *(",".join("0" if i == steering else x for i, x in enumerate(row)) for row in rows),
            ]
        return lines

    splits = dict.fromkeys(("synthetic_01", "synthetic_02"), "train") | dict.fromkeys(
        ("synthetic_06", "synthetic_08"), "valid"
    )
    table = evaluated(g80, core, folder(splits, change))
    assert set(table["without_faults"]) == {"synthetic_06", "synthetic_08"}
    assert "s long, no more than 120 s" in table["without_faults"]["synthetic_06"]
    assert "less than 30 s of judged, excited" in table["without_faults"]["synthetic_08"]
    still = next(r for r in table["drives"] if r["run"] == "synthetic_08")
    assert (
        still["judged_of_in_range_excited"] is None
        and still["pieces"] == len(piece_starts(round(still["duration_s"] / TS) + 1, TS)) == 3
    )
    assert all(
        row["drives"] == row["counted"] == 0 and row["best"] == [] and row["median_s"] is None
        for row in table["faults"]
    )
    assert len(table["baselines"]) == 5 and all(
        r["counted"] == 0 for b in table["baselines"] for r in b["faults"]
    )


def test_nothing_to_evaluate_is_an_error_that_says_what_is_missing(identified, synthetic, g80, core):
    """Energy and change test may calibrate where no frame counts."""
    stored = identify.load(identified)
    frameless = replace(stored, calibration=replace(stored.calibration, scores={}))
    drives = identify.DriveSet(g80, NominalModel(g80), synthetic)
    with pytest.raises(InputError, match=r"no calibration drive has a counted frame.*split is not train"):
        stage.evaluate(frameless, drives, core, settings=ONE_WAY)


@pytest.mark.slow("2 s: an identification")
def test_a_missing_column_is_named_with_its_file(synthetic, identified, core, g80, tmp_path):
    drives = tmp_path / "drives"
    shutil.copytree(synthetic, drives)
    path = drives / "synthetic_07.csv"
    path.write_text(path.read_text().replace("delta", "angle", 1))
    drive_set = identify.DriveSet(g80, NominalModel(g80), drives)
    with pytest.raises(InputError, match="column delta is missing") as caught:
        stage.evaluate(identify.load(identified), drive_set, core)
    assert caught.value.source.endswith("synthetic_07.csv")


def test_a_claim_is_stated_an_hour_judged_too():
    scores = {f"d{i}": 1.0 + 0.1 * i for i in range(10)} | {"piece": 3.0, "bound": 2.0}
    recordings = Recordings({"piece": "d9", "bound": "b"}, ("b",))
    plain = calibrate(scores, 0.1, recordings=recordings)
    assert "hour" not in plain.claim()
    timed = plain.over(dict.fromkeys((*scores, "another"), 360.0))
    assert timed.claim() == f"{plain.claim()}; {timed.hourly[2:]}"
    bound = plain.conditional_bound * 10 / 1.1
    assert timed.hourly == f"; 0.909 and {bound:.3g} per judged hour, from 1.1 h", (
        "eleven drives, ten recordings"
    )
    assert Calibration.from_dict(timed.to_dict()) == timed
    few = calibrate({"a": 1.0}, 0.1).over({"a": 360.0})
    assert few.hourly == "", "without alpha there is no claim"
    grouped = Recordings(groups=dict.fromkeys((f"d{i}" for i in range(10)), "wet"))
    ten = {k: v for k, v in scores.items() if k.startswith("d")}
    said = calibrate(ten, 0.1, recordings=grouped).over(dict.fromkeys(ten, 720.0)).claim()
    assert said.count("per judged hour, from 2 h") == 2
