"""The firmware's supervision says what frames and message table require
(lpvguard/extras/loop/supervision.py)."""

import re
import tomllib

import numpy as np
import pytest

from lpvguard.can.catalogue import load_catalogue
from lpvguard.can.logs import EXTENDED, Frames, read_log
from lpvguard.can.play import encode, protect
from lpvguard.extras.loop.bus_faults import BUS_FAULTS
from lpvguard.extras.loop.campaign.one_run import supervision
from lpvguard.extras.loop.sim import (
    RECOVERY_S,
    can_fault_table,
    load_scenario,
    shipped_scenarios,
    steady_scenario,
)
from lpvguard.extras.loop.supervision import HOLD, LIVE, OFF, Reactions, limits, needed_messages, required
from lpvguard.vehicle.project import load_project

SEEDS = (1, 2, 3)
ON_BUS = [n for n in shipped_scenarios() if "can_fault" in load_scenario(n).path.read_text()]
PERIOD_US = 10_000
GUARD_IN, VDC2 = load_catalogue().message("GUARD_IN"), load_catalogue().message("VDC2")


def good(message, n: int, **values: np.ndarray) -> np.ndarray:
    """(n, 8) frames of a message with its supervised signals, 0 unless given."""
    return encode(message, {s.name: values.get(s.name, np.zeros(n)) for s in message.supervised}, n)


def frames(message, t_us, data, length=8) -> Frames:
    n = len(data)
    return Frames(
        np.asarray(t_us, np.int64) * 1000,
        np.full(n, message.id | EXTENDED, np.uint32),
        np.zeros(n, np.uint8),
        np.broadcast_to(np.uint8(length), n),
        data,
        ["can0"],
    )


def periods(n: int) -> np.ndarray:
    return PERIOD_US * np.arange(n)


@pytest.mark.parametrize("message", [VDC2, GUARD_IN], ids=lambda m: m.name)
def test_silence_holds_after_three_and_a_half_periods_and_is_off_after_five_and_a_half(message):
    bus = frames(message, periods(8), good(message, 8))
    last = 7 * PERIOD_US
    ticks = np.array(
        [
            0,
            4 * PERIOD_US - 1,
            4 * PERIOD_US,
            last + 35_000,
            last + 35_001,
            last + 55_000,
            last + 55_001,
            last + 10**9,
        ]
    )
    assert required(bus, [message], ticks).tolist() == [OFF, OFF, LIVE, LIVE, HOLD, HOLD, OFF, OFF]


@pytest.mark.parametrize(("bad_of_four", "at_the_end"), [(1, LIVE), (2, OFF), (3, OFF)])
def test_one_bad_frame_of_four_is_forgiven_and_half_of_them_are_not(bad_of_four, at_the_end):
    data = good(GUARD_IN, 60)
    data[(np.arange(60) % 4 < bad_of_four) & (np.arange(60) >= 20), 0] ^= 1
    assert required(frames(GUARD_IN, periods(60), data), [GUARD_IN], periods(60))[-1] == at_the_end


def spoiled(what: str) -> Frames:
    """40 frames of GUARD_IN or VDC2, of which the last 20 are spoiled."""
    n, late = 40, np.arange(40) >= 20
    message = VDC2 if what in ("length", "range", "gradient", "absent", "babbling") else GUARD_IN
    t, length, values = periods(n), np.full(n, 8), {}
    if what == "range":
        values["yaw_rate"] = np.where(late, 1.6, 1.45)
    elif what == "gradient":  # 10 rad/s2 allow 0.1 a period
        values["yaw_rate"] = np.where(late, np.where(np.arange(n) % 2, 0.9, -0.9), 0.0)
    elif what == "absent":
        values["yaw_rate"] = np.where(late, np.nan, 0.0)
    data = good(message, n, **values)
    if what == "stuck counter":
        for row in np.flatnonzero(late):
            protect(data[row : row + 1], GUARD_IN.e2e.data_id, 19 % 15)
    elif what == "counter of six":
        for i, row in enumerate(np.flatnonzero(late)):
            protect(data[row : row + 1], GUARD_IN.e2e.data_id, (19 + 6 * (i + 1)) % 15)
    elif what == "counter of five":
        for i, row in enumerate(np.flatnonzero(late)):
            protect(data[row : row + 1], GUARD_IN.e2e.data_id, (19 + 5 * (i + 1)) % 15)
    elif what == "length":
        length[late] = 7
    elif what == "babbling":
        t[late] = 19 * PERIOD_US + 2_499 * np.arange(1, 21)
    return frames(message, t, data, length)


@pytest.mark.parametrize(
    ("what", "state"),
    [
        ("stuck counter", OFF),
        ("counter of six", OFF),
        ("counter of five", LIVE),
        ("length", OFF),
        ("range", OFF),
        ("gradient", OFF),
        ("absent", OFF),
        ("babbling", OFF),
    ],
)
def test_five_frames_that_may_not_be_used_switch_off(what, state):
    bus = spoiled(what)
    message = GUARD_IN if bus.id[0] == np.uint32(GUARD_IN.id | EXTENDED) else VDC2
    fourth, fifth = bus.t_ns[23:25] // 1000
    assert required(bus, [message], np.array([fourth, fifth])).tolist() == [
        HOLD if what not in ("counter of five", "babbling") else LIVE,
        state,
    ]


def test_bus_off_ends_everything_and_five_good_frames_bring_back():
    bus = frames(VDC2, periods(40), good(VDC2, 40))
    off_us = 20 * PERIOD_US + 1
    states = required(bus, [VDC2], np.r_[off_us - 1, off_us, periods(40)[21:27]], (off_us,))
    assert states.tolist() == [LIVE, OFF, OFF, OFF, OFF, OFF, LIVE, LIVE]
    assert (required(bus, [VDC2, GUARD_IN], periods(40)) == OFF).all(), "the worst message counts"


def test_reactions_tell_late_missing_and_unwarranted():
    must = np.array([2, 2, 1, 0, 0, 2, 2, 0, 2, 2])
    assert Reactions.from_states(must, must, 0.01) == Reactions(2, 2, 0.0, 0.0, pytest.approx(0.04))
    late = np.array([2, 2, 2, 2, 0, 2, 2, 0, 2, 2])
    assert Reactions.from_states(late, must, 0.01) == Reactions(
        2, 1, pytest.approx(0.02), 0.0, pytest.approx(0.04)
    )
    worse = np.array([2, 1, 1, 0, 0, 0, 2, 0, 2, 2])
    assert Reactions.from_states(worse, must, 0.01) == Reactions(
        2, 2, 0.0, pytest.approx(0.02), pytest.approx(0.04)
    )
    healthy = np.full(5, LIVE)
    assert Reactions.from_states(healthy, healthy, 0.01) == Reactions(0, 0, 0.0, 0.0, 0.0)


def reactions(simulator, path, log, from_s: float = 0.0, **options) -> Reactions:
    facts, _ = simulator.drive(path, log=log, **options)
    return supervision(simulator, facts, tomllib.loads(path.read_text()), log, from_s)


@pytest.mark.slow("7 s: 26 runs")
@pytest.mark.parametrize("fault", BUS_FAULTS, ids=lambda c: f"{c.message} {c.name}")
def test_the_firmware_says_what_the_frames_require(fault, simulator, tmp_path):
    """The fault table again, with each fault at random for ten seconds: whatever comes of it, at the very
    tick."""
    more = {} if fault.delay_s is None else {"delay_s": fault.delay_s}
    for probability in (0.1, 0.4, 0.8):
        table = can_fault_table(fault.message, fault.kind, 5.0, 15.0, probability=probability, **more)
        path = tmp_path / "fault.toml"
        path.write_text(steady_scenario(20.0, table))
        seen = reactions(simulator, path, tmp_path / "fault.log")
        assert seen.met == seen.due and seen.late_s == seen.unwarranted_s == 0.0, (probability, seen)


def test_a_firmware_that_held_too_long_would_be_found(simulator, tmp_path):
    path, log = tmp_path / "lost.toml", tmp_path / "lost.log"
    path.write_text(steady_scenario(20.0, can_fault_table("VDC2", "lost", 5.0, 10.0)))
    facts, _ = simulator.drive(path, log=log)
    scenario = tomllib.loads(path.read_text())
    assert supervision(simulator, facts, scenario, log, 0.0).met == 1
    slow = facts | {
        "supervision": [
            [t + 0.02 if state != "live" and t > 1.0 else t, state] for t, state in facts["supervision"]
        ]
    }
    seen = supervision(simulator, slow, scenario, log, 0.0)
    assert (seen.due, seen.met) == (1, 0) and seen.late_s == pytest.approx(0.04), (
        "two ticks late with hold, then with off"
    )
    # Of a bus without fault the same report is worse than required.
    assert supervision(simulator, facts, scenario, None, 0.0).unwarranted_s == pytest.approx(5.01)


def test_a_value_that_the_bus_allows_and_the_vehicle_does_not_is_off_while_it_lasts():
    """As the ECU does: a speed of 145 km/h, where the message table ends at 150 and the truck's signals at 40
    m/s."""
    at = np.arange(40)
    bus = frames(VDC2, periods(40), good(VDC2, 40, yaw_rate=np.where((at >= 20) & (at < 30), 0.05, 0.0)))
    within = {("VDC2", "yaw_rate"): (-0.04, 0.04)}
    states = required(bus, [VDC2], periods(40), within=within)
    assert (states[4:20] == LIVE).all() and (states[20:30] == OFF).all() and (states[30:] == LIVE).all()
    late = required(bus, [VDC2], 29 * PERIOD_US + np.array([0, 35_001]), within=within)
    assert late.tolist() == [OFF, LIVE], "the frame after it is good"
    silent = frames(VDC2, periods(30), bus.data[:30])
    assert required(silent, [VDC2], 29 * PERIOD_US + np.array([0, 35_001]), within=within).tolist() == [
        OFF,
        HOLD,
    ]
    truck = limits(load_project("truck"))
    assert truck["EBC2", "front_axle_speed"][1] == pytest.approx(144.0)


@pytest.mark.parametrize("name", ON_BUS)
@pytest.mark.slow("every shipped scenario on a bus")
def test_scenarios_expect_of_the_supervision_what_the_frames_require(name, simulator, tmp_path):
    """ "live" where never another state is required; "reacts" where one is, no later than the scenario says,
    and live again after."""
    scenario, log = load_scenario(name), tmp_path / "run.log"
    expect, Ts = scenario.expect, simulator.project.Ts_s
    off = [
        round(f["start_s"] * 1e6)
        for f in tomllib.loads(scenario.path.read_text())["can_fault"]
        if f["kind"] == "bus_off"
    ]
    for seed in SEEDS:
        facts, _ = simulator.drive(scenario.path, seed=seed, log=log)
        ticks = np.arange(round(RECOVERY_S / Ts), round(facts["duration_s"] / Ts))
        must = required(
            read_log(log),
            needed_messages(simulator.project),
            ticks * round(Ts * 1e6),
            off,
            limits(simulator.project),
        )
        if expect.supervision == "live":
            assert (must == LIVE).all()
            continue
        t = ticks * Ts
        away = t[must < LIVE]
        assert expect.fault_start_s <= away[0] <= expect.fault_start_s + expect.within_periods * Ts + 1e-9
        assert away[-1] < expect.fault_end_s + RECOVERY_S


def test_needed_messages_are_those_of_the_generated_core(simulator, truck_folder):
    listed = re.search(r"\.needed = (.*)", (truck_folder / "lpvguard_bus.c").read_text())[1]
    assert {m.name for m in needed_messages(simulator.project)} == set(
        re.findall(r"LPVG_CAN_(\w+)_INDEX", listed)
    )
