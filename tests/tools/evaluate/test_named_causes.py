"""Whether a named cause is right, on replays made up for it."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from lpvguard.drives.faults import Fault, inject, injected_delay_s, no_single_cause, share_of
from lpvguard.drives.tables import Drive
from lpvguard.evaluate.causes import (
    CauseOutcome,
    can_be_named,
    cause_rows,
    cause_sentences,
    cause_table,
    true_cause,
)
from lpvguard.evaluate.detection import Case, JudgedClock
from lpvguard.replay.causes import Diagnosis

START_S, ALARM_S, FOUND_S = 10.0, 15.0, 25.0


def made_drive(project, seconds: float = 60.0, amplitude=lambda t: 0.2) -> Drive:
    """A sine of 0.4 Hz and a speed in range."""
    t = np.arange(round(seconds / project.Ts_s)) * project.Ts_s
    y = (amplitude(t) * np.sin(2 * np.pi * 0.4 * t))[:, None]
    return Drive("made", t, np.full(len(t), 10.0), 0 * y, y)


def diagnosis(
    project, cause: str, *numbers: float, alarm_s: float = ALARM_S, after_s: float = FOUND_S - ALARM_S
) -> Diagnosis:
    """Of the whole record where it is ``after_s`` long, else of its half."""
    value, low, high = (*numbers, None, None, None)[:3]
    name, final = project.outputs[0].name, after_s == FOUND_S - ALARM_S
    return Diagnosis(alarm_s + after_s, alarm_s, name, cause, value, low, high, alarm_s, False, final, "")


def outcome(project, fault: Fault, *diagnoses: Diagnosis, ramp_s: float = 0.0, drive: Drive | None = None):
    drive = drive or made_drive(project)
    clock = JudgedClock(drive.t, round(START_S / project.Ts_s), 50.0)
    case = Case("ramp" if ramp_s else "step", fault, ramp_s)
    replay = SimpleNamespace(Ts=project.Ts_s, diagnoses=diagnoses)
    faulty = inject(drive, fault, START_S, project.Ts_s, ramp_s)
    return CauseOutcome.from_replay(case, project, clock, drive, faulty, replay)


@pytest.mark.parametrize(
    ("fault", "cause", "truth"),
    [
        (Fault("gain", 0.6), "gain", 0.6),
        (Fault("gain", -1.0), "sign", -1.0),
        (Fault("bias", 0.5, (0.1,)), "bias", 0.05),
        (Fault("input_delay", 0.3), "delay", -0.3),
        (Fault("output_delay", 0.3), "delay", 0.3),
    ],
    ids=lambda x: x.label if isinstance(x, Fault) else "",
)
def test_a_known_fault_has_one_cause_and_a_size(g80, fault, cause, truth):
    assert true_cause(fault) == cause
    right = outcome(g80, fault, diagnosis(g80, cause, truth, truth - 0.02, truth + 0.02))
    assert (right.judgement, right.outputs[0].held, right.after_s) == ("right", True, 10.0)
    assert right.outputs[0].truth == pytest.approx(truth)
    beside = outcome(g80, fault, diagnosis(g80, cause, truth + 0.1, truth + 0.08, truth + 0.12))
    assert (beside.judgement, beside.outputs[0].held) == ("right", False)
    assert outcome(g80, fault, diagnosis(g80, "other")).judgement == "other"
    assert outcome(g80, fault, diagnosis(g80, "noise", 0.1)).judgement == "wrong"
    assert outcome(g80, fault).judgement == "not yet"
    before = diagnosis(g80, cause, truth, truth - 0.02, truth + 0.02, alarm_s=START_S - 1)
    assert outcome(g80, fault, before).judgement == "not yet", "the alarm stood when the fault came"


def test_the_size_of_a_delay_is_that_which_was_injected(g80):
    """Delays are whole samples: at 25 Hz 0.3 s are 0.32 s."""
    slow = g80.model_copy(update={"Ts_s": 0.04})
    assert injected_delay_s(0.3, 0.04) == pytest.approx(0.32) and injected_delay_s(
        0.15, 0.04
    ) == pytest.approx(0.16)
    drive = made_drive(slow)
    late = inject(drive, Fault("output_delay", 0.3), START_S, 0.04).y
    first = round(START_S / 0.04)
    np.testing.assert_array_equal(late[first:], drive.y[first - 8 : -8])
    for kind, sign in (("output_delay", 1.0), ("input_delay", -1.0)):
        cause = outcome(
            slow, Fault(kind, 0.3), diagnosis(slow, "delay", sign * 0.3, *sorted((sign * 0.31, sign * 0.33)))
        )
        assert cause.outputs[0].truth == pytest.approx(sign * 0.32) and cause.outputs[0].held


def test_a_fault_can_be_named_where_healthy_vehicles_differ_by_less(g80):
    scales = SimpleNamespace(least=np.array([[0.33, 0.11, 0.94]]))
    named = {
        Fault("gain", 0.7): True,  # 0.3 is above 0.33 of 0.7
        Fault("gain", 0.76): False,
        Fault("gain", 1.3): False,
        Fault("gain", 1.5): True,
        Fault("gain", -1.0): True,
        Fault("output_delay", 0.1): False,
        Fault("input_delay", 0.12): True,
        Fault("bias", 0.5, (1.5,)): False,
        Fault("bias", 0.95): True,
        Fault("freeze"): True,
    }
    assert {f: can_be_named(f, g80, scales) for f in named} == named


def test_a_frozen_output_has_a_value_and_no_interval(g80):
    cause = outcome(g80, Fault("freeze"), diagnosis(g80, "frozen", 0.1))
    assert cause.judgement == "right" and cause.outputs[0].held is None


def test_the_size_of_a_fault_that_grows_is_its_mean_from_alarm_to_diagnosis(g80):
    after = np.arange(round(ALARM_S / g80.Ts_s), round(FOUND_S / g80.Ts_s)) - round(START_S / g80.Ts_s)
    share = share_of(after, g80.Ts_s, 20.0).mean()
    assert share == pytest.approx(0.5, abs=1e-3)
    cause = outcome(g80, Fault("gain", 0.6), diagnosis(g80, "gain", 0.8, 0.75, 0.85), ramp_s=20.0)
    assert cause.outputs[0].truth == pytest.approx(1 + share * -0.4)
    assert cause.outputs[0].held


@pytest.mark.parametrize("fault", no_single_cause(np.array([0.15])), ids=lambda f: f.label)
def test_without_a_single_cause_other_is_right_and_a_gain_that_holds_the_equivalent_one(g80, fault):
    assert true_cause(fault) is None
    assert outcome(g80, fault, diagnosis(g80, "other")).judgement == "right"
    y, faulty = made_drive(g80), inject(made_drive(g80), fault, START_S, g80.Ts_s)
    span = slice(round(ALARM_S / g80.Ts_s), round(FOUND_S / g80.Ts_s))
    (equivalent,) = np.linalg.lstsq(y.y[span], faulty.y[span, 0], rcond=None)[0]
    near = diagnosis(g80, "gain", equivalent, equivalent - 0.01, equivalent + 0.01)
    assert outcome(g80, fault, near).judgement == "right"
    far = diagnosis(g80, "gain", equivalent + 0.1, equivalent + 0.09, equivalent + 0.11)
    assert outcome(g80, fault, far).judgement == "wrong"
    assert outcome(g80, fault, diagnosis(g80, "bias", 0.1, 0.0, 0.2)).judgement == "wrong"


def test_uneven_is_an_amplitude_that_differs_by_two(g80):
    dead = Fault("dead_zone", 0.05)
    growing = made_drive(g80, amplitude=lambda t: np.where(t < (ALARM_S + FOUND_S) / 2, 0.1, 0.25))
    assert outcome(g80, dead, diagnosis(g80, "other"), drive=growing).uneven
    assert not outcome(g80, dead, diagnosis(g80, "other")).uneven


def test_what_half_of_the_record_says_counts_where_the_drive_ends_before_all_of_it(g80):
    fault = Fault("gain", 0.6)
    half, whole = diagnosis(g80, "bias", 0.1, 0.0, 0.2, after_s=5.0), diagnosis(g80, "gain", 0.6, 0.5, 0.7)
    cause = outcome(g80, fault, half)
    assert (cause.judgement, cause.after_s, cause.preliminary) == ("wrong", 5.0, True)
    cause = outcome(g80, fault, half, whole, replace(half, alarm_s=40.0, t_s=45.0))
    assert (cause.judgement, cause.after_s, cause.preliminary) == ("right", 10.0, False)
    assert len(cause.outputs) == 1


def test_an_output_with_a_wrong_cause_outweighs_one_with_the_right_one(g80):
    right = diagnosis(g80, "gain", 0.6, 0.5, 0.7)
    wrong = replace(right, cause="bias")
    assert outcome(g80, Fault("gain", 0.6), right, wrong).judgement == "wrong"
    assert outcome(g80, Fault("gain", 0.6), right, replace(right, cause="other")).judgement == "right"


def test_the_table_counts_what_was_found(g80):
    gain, dead = Fault("gain", 0.6), Fault("dead_zone", 0.05)
    outcomes = {
        Case("step", gain, 0.0): [
            outcome(g80, gain, diagnosis(g80, "gain", 0.6, 0.5, 0.7)),
            outcome(g80, gain, diagnosis(g80, "gain", 0.9, 0.8, 1.0)),
            outcome(g80, gain, diagnosis(g80, "other")),
            outcome(g80, gain, diagnosis(g80, "bias", 0.1, 0.0, 0.2, after_s=5.0)),
            outcome(g80, gain),
        ],
        Case("step", dead, 0.0): [outcome(g80, dead, diagnosis(g80, "other"))],
    }
    scales = SimpleNamespace(least=np.array([[0.1, 0.1, 0.1]]))
    table = cause_table(outcomes, g80, scales)
    assert table["can_be_named"] == table["known"]
    small = cause_table(outcomes, g80, SimpleNamespace(least=np.array([[0.7, 0.1, 0.1]])))
    assert small["known"] == table["known"] and small["can_be_named"]["found"] == 0
    judged = {"right": 2, "other": 1, "wrong": 1, "not_yet": 1, "preliminary": 1}
    assert table["known"] == {"found": 5, **judged, "intervals": 2, "held": 1}
    assert table["no_single_cause"]["right"] == table["no_single_cause"]["said_other"] == 1
    assert table["rows"][0]["named"] == {"bias": 1, "gain": 2, "other": 1}
    first, *_, known, single = cause_rows(table)
    assert first[:7] == ["step: output × 0.6", "gain", "5", "2", "1", "1", "1"]
    assert known[2] == "5" and single[2] == "1"
    assert cause_sentences(table)[0].startswith("right cause: 2 of 5, 5.27 to 85.34 %")
    large = "of the faults larger than the difference between healthy vehicles: right 2 of 5, 5.27 to 85.34 %"
    assert cause_sentences(table)[2].startswith(f"{large}, wrong 1 of 5")
    unknown = cause_table(outcomes, g80, None)
    assert unknown["can_be_named"] is None and "is unknown" in cause_sentences(unknown)[2]
