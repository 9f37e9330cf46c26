"""What decides bounds and thresholds is named; a bin without evidence, or of few frames, is silent."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from lpvguard.core.compiled import FrameLog, Run
from lpvguard.drives.faults import Fault, inject
from lpvguard.drives.frames import Estimator
from lpvguard.drives.tables import read_drive
from lpvguard.identify import identification as stage
from lpvguard.identify.bounds import Deciders, FrameSet, fold, reduce_remainder
from lpvguard.identify.calibration import Calibration, Peak, calibrate, peaks
from lpvguard.identify.deciders import Decision, decides_bounds, decides_thresholds, outlying, silence
from lpvguard.identify.energy import UNBOUNDED
from lpvguard.identify.joint import joint_calibration, with_joint_thresholds
from lpvguard.identify.over_drives import Origins
from lpvguard.identify.visibility import Excitation
from lpvguard.identify.weights import coefficients_of, energy_filters
from lpvguard.vehicle.nominal import NominalModel

RARE = 5
"""A bin of the g80 with which the cases are made."""


def remainders(estimator: Estimator, sizes: list[float], starts: list[int]) -> dict[str, np.ndarray]:
    """The part of a drive whose frames of RARE leave these sizes."""
    E = np.array(sizes, complex)[:, None]
    frames = FrameSet(RARE, E, np.zeros_like(E), np.array(starts))
    return reduce_remainder([frames], estimator, np.zeros((estimator.n_bins, 1)), 1, "S1")[0]


def test_the_frame_that_decides_a_bound_is_known_and_what_the_bound_is_without_it(g80):
    estimator = Estimator.from_project(g80, NominalModel(g80))
    n = int(estimator.length[RARE])
    drives = {
        "a": remainders(estimator, [1.0, 2.0, 0.5], [0, n, 2 * n]),
        # 4.5 overlaps the largest; 3.0 begins where that ends.
        "b": remainders(estimator, [5.0, 4.5, 3.0], [7, 7 + n // 2, 7 + n]),
        "c": remainders(estimator, [2.5], [3]),
        "d": remainders(estimator, [], []),
    }
    for order in (list(drives), list(drives)[::-1]):
        deciders = Deciders("B_w", (estimator.n_bins, 1))
        parts = [{k: v.copy() for k, v in drives[name].items()} for name in order]
        total = fold(deciders.watched(order, iter(parts)))
        assert set(total) == {"B_w"} and total["B_w"][RARE, 0] == 5.0
        assert (deciders.drive[RARE, 0], deciders.first[RARE, 0]) == ("b", 7)
        assert deciders.without[RARE, 0] == 3.0, order
        assert (deciders.without[np.arange(estimator.n_bins) != RARE] == 0).all()


def said(stored, **changed) -> SimpleNamespace:
    """The fields of an Identification that the sentences use."""
    deciders = Deciders("B_w", (len(stored.bounds["omega_rad_s"]), 1))
    usual = {
        "project": stored.project,
        "bounds": SimpleNamespace(
            omega=stored.bounds["omega_rad_s"],
            B_w_floor=np.full((len(stored.bounds["omega_rad_s"]), 1), 0.02),
        ),
        "calibration": stored.calibration,
        "pools": None,
        "energy": stored.energy,
        "change": stored.change,
        "peaks": {},
        "decided": {"B_w": deciders},
        "weights": stored.fitted,
        "evidence": np.ones(len(stored.bounds["omega_rad_s"])),
    }
    of_origins = {k: changed.pop(k, usual.pop(k)) for k in ("peaks", "decided", "evidence")}
    return SimpleNamespace(**(usual | changed), origins=Origins(**of_origins))


def test_a_threshold_names_drive_time_and_bin_and_what_it_is_without_one_frame(identified):
    stored = stage.load(identified)
    names = [f"drive_{k}" for k in range(9)]
    scores = dict(zip(names, [*np.linspace(0.5, 1.5, 8), 2.89], strict=True))
    at = {n: {"frame": Peak(41.2, RARE, 1.1), "energy": Peak(7.0, 1), "change": Peak(9.0)} for n in names}
    c = Calibration(2.89, scores, 0.1, 0.3)
    result = said(
        stored,
        calibration=c,
        energy=replace(stored.energy, calibration=c),
        change=replace(stored.change, calibration=c),
        peaks=at,
    )
    frequency = f"{stored.bounds['omega_rad_s'][RARE]:.3g} rad/s"
    begin = "test: drive_8 decides the threshold 2.89"
    assert decides_thresholds(result) == [
        Decision(
            f"frame {begin}, at 41.2 s, {frequency}; one frame alone decides: without it 1.5", alone=True
        ),
        Decision(f"energy {begin}, at 7 s, band between", alone=False),
        Decision(f"change {begin}, at 9 s", alone=False),
    ]
    at["drive_8"]["frame"] = Peak(41.2, RARE, 2.8)
    others_are_as_large = Decision(f"frame {begin}, at 41.2 s, {frequency}", alone=False)
    assert decides_thresholds(result)[0] == others_are_as_large
    floor = said(
        stored, calibration=Calibration(1.0, dict.fromkeys(names, 0.2), 0.1, 0.3), energy=None, change=None
    )
    assert decides_thresholds(floor) == [
        Decision("frame test: the floor of the test decides the threshold 1", alone=False)
    ]


def test_a_joint_threshold_names_the_test_whose_score_decides_it(identified):
    stored = stage.load(identified)
    frames = {f"drive_{k}": 1.5 + k / 10 for k in range(9)} | {"drive_9": 6.0}
    change = dict.fromkeys(frames, 0.6)
    own = {"frame": calibrate(frames, 0.1), "change": calibrate(change, 0.1)}
    tests = with_joint_thresholds(own, joint_calibration(own, 0.1))
    result = said(
        stored,
        calibration=tests["frame"],
        energy=None,
        change=replace(stored.change, calibration=tests["change"]),
        peaks={"drive_9": {"frame": Peak(41.2, RARE, 1.1)}},
    )
    where = f"at 41.2 s, {stored.bounds['omega_rad_s'][RARE]:.3g} rad/s"
    text = f"all tests: drive_9 decides the threshold 2 by its score in frame, {where}"
    alone = Decision(f"{text}; one frame alone decides: without it 0.7667", alone=True)
    assert decides_thresholds(result) == [alone]


def test_a_drive_whose_score_lies_outside_the_others_is_named_and_still_calibrates(identified):
    stored = stage.load(identified)
    scores = {f"drive_{k}": s for k, s in enumerate(np.geomspace(0.4, 0.8, 9))} | {"slide": 6.0}
    at = {n: {"frame": Peak(41.2, RARE, 1.1), "energy": Peak(7.0, 1), "change": Peak(9.0)} for n in scores}

    def sentences(scores: dict[str, float], silent: tuple[int, ...] = ()) -> list[str]:
        c = Calibration(6.0, scores, 0.1, 0.3)
        return outlying(
            said(
                stored,
                calibration=c,
                energy=replace(stored.energy, calibration=c),
                change=None,
                peaks=at,
                weights=replace(stored.fitted, silent=silent),
            )
        )

    frequency = f"{stored.bounds['omega_rad_s'][RARE]:.3g} rad/s"
    begin = "test: the score of slide, 6, is an outlier among the calibration drives, whose median is 0.591"
    end = "; the drive calibrates unless experiments.csv sets it aside"
    frame, energy = (
        f"frame {begin}, at 41.2 s, {frequency}{end}",
        f"energy {begin}, at 7 s, band between{end}",
    )
    assert sentences(scores) == [frame, energy]
    # The logarithm of a normal drive of these ten is within 3.5 deviations.
    assert sentences(scores | {"slide": 1.5}) == []
    assert sentences(dict(list(scores.items())[-4:])) == [], "four scores are too few to compare"
    assert sentences(dict.fromkeys(scores, 0.7) | {"slide": 0.75}) == [], (
        "equal scores do not make one outlying"
    )
    assert sentences(dict.fromkeys(scores, 0.7) | {"slide": 0.8})[0].startswith(
        "frame test: the score of slide, 0.8, is an outlier"
    )
    assert sentences(scores, tuple(range(len(stored.bounds["omega_rad_s"])))) == [energy], (
        "silent bins say none"
    )


def test_a_bound_names_drive_and_time_and_what_it_is_without_one_frame(identified):
    stored = stage.load(identified)
    result = said(stored)
    deciders = result.origins.decided["B_w"]
    assert decides_bounds(result) == []
    deciders.largest[RARE], deciders.rest[RARE], deciders.drive[RARE], deciders.first[RARE] = (
        0.3,
        0.1,
        "slide",
        50,
    )
    frequency = f"{stored.bounds['omega_rad_s'][RARE]:.3g} rad/s"
    begin = f"{frequency}: slide decides B_w of yaw_rate, 0.3, from 1 s on"
    assert decides_bounds(result) == [
        Decision(f"{begin}; one frame alone decides: without it 0.1", alone=True)
    ]
    deciders.others[RARE] = 0.29
    assert decides_bounds(result) == [Decision(begin, alone=False)]
    deciders.largest[RARE] = 0.01
    assert decides_bounds(result) == [], "below its floor no frame decides"


def test_peaks_are_where_the_scores_come_from():
    Ts, length = 0.02, np.array([100, 50])
    frame = {
        "bin": [1, 0, 0, 0, 1],
        "t_end_s": [5.0, 7.0, 8.0, 9.0, 9.5],
        "reason": [0, 0, 0, 0, 9],
        "statistic": [1.5, 3.0, 2.9, 1.4, 99.0],
    }
    rows = {k: np.array(v) for k, v in frame.items()}
    blank = np.zeros(5)
    frames = FrameLog(**rows, **{k: blank for k in FrameLog.__dataclass_fields__ if k not in rows})
    energy, change = np.zeros(500), np.zeros(500)
    energy[123], band = 0.7, np.full(500, 2)
    run = Run(frames, blank, blank, energy, band, frames, change, frames, None, None)
    assert peaks(run, 1.0, Ts, length) == {"frame": Peak(6.0, 0, 1.5), "energy": Peak(123 * Ts, 2)}


def test_evidence_is_the_largest_of_all_speeds_by_bin(g80):
    Z = np.array([[1.0], [3.0], [2.0]], complex)
    W, B = np.full((2, 1), 0.5), np.ones((2, 1))
    met = Excitation.from_frames(
        "a", (3.0, 19.0), np.array([0, 0, 0]), np.array([4.0, 18.0, 4.0]), Z, W, B, np.arange(3)
    )
    assert met.evidence(2) == pytest.approx([3.0 / 2.5, 0.0])


@pytest.mark.unhurried
def test_a_silent_bin_raises_no_alarm_and_the_bands_below_do_not_where_all_are(
    identified, synthetic, g80, core
):
    stored, model = stage.load(identified), NominalModel(g80)
    estimator = Estimator.from_project(g80, model)
    drive = read_drive(synthetic / "synthetic_08.csv", g80)
    faulty = inject(drive, Fault("gain", 0.3), 60.0, g80.Ts_s)
    heard = core.monitor().run_drive(faulty)
    loud = sorted(set(heard.frames.bin[heard.frames.falsified].tolist()))
    assert len(loud) > 1 and (heard.energy_band[heard.energy > 1.5] < 2).any()

    def run(silent: tuple[int, ...]) -> Run:
        weights = replace(stored.fitted, silent=silent)
        energy = replace(stored.energy, silent=energy_filters(g80, estimator, weights).silent)
        numbers = coefficients_of(g80, model, estimator, weights, 1.0, energy, stored.change)
        return core.monitor(reals=numbers.flat_reals(), seal=True).run_drive(faulty)

    one, all_of_them = run((loud[0],)), run(tuple(range(estimator.n_bins)))
    assert loud[0] not in one.frames.bin[one.frames.falsified]
    assert set(loud[1:]) <= set(one.frames.bin[one.frames.falsified].tolist())
    assert one.frames.evidence[one.frames.bin == loud[0]].max() < 1e-3, "nor does it make a verdict valid"
    assert np.array_equal(one.energy, run(()).energy), "the energy test goes on while a bin speaks"
    assert not all_of_them.frames.falsified.any()
    assert set(all_of_them.energy_band[all_of_them.energy > 1e-3].tolist()) == {2}
    assert heard.frames.margin.max() < UNBOUNDED


def test_which_bins_are_silent_and_why_is_said_and_stored(identified, g80):
    stored = stage.load(identified)
    evidence = np.full(len(stored.bounds["omega_rad_s"]), 2.0)
    evidence[RARE] = 0.46
    weights = replace(stored.fitted, silent=(RARE, RARE + 1))
    low, high = (f"{stored.bounds['omega_rad_s'][k]:.3g} rad/s" for k in weights.silent)
    sentences = silence(said(stored, weights=weights, evidence=evidence))
    assert sentences == [
        f"{low} is silent: on the drives that set the bounds a vehicle that does not respond would have had "
        "margins of at most 0.46",
        f"{high} is silent: fewer than 8 successive frames set its bounds",
    ]
    energy = replace(stored.energy, silent=(0, 1))
    assert silence(said(stored, weights=replace(weights, silent=()), energy=energy)) == [
        "energy test: silent in the bands below, between, because every bin is silent"
    ]
    assert weights.to_dict()["silent_bins"] == [RARE, RARE + 1]
    assert stored.fitted.from_dict(stored.weights | {"silent_bins": [3]}, "here").silent == (3,)
    weak, steady = _evidence(stored) <= 1.0, stored.bounds["omega_rad_s"] == 0
    assert not weak[~steady].all()  # so zero frequency speaks, of the disturbance
    assert set(stored.fitted.silent) == set(np.flatnonzero(weak & ~steady).tolist())


def _evidence(stored) -> np.ndarray:
    """Of the bound-setting drives by bin, from the largest |Z| in bounds.json: exact with one output."""
    W_delta, B_w = stored.fitted.at(stored.bounds["omega_rad_s"])
    g = stored.bounds["excitation"] / B_w[:, 0]
    return g / (1 + W_delta[:, 0] * g)
