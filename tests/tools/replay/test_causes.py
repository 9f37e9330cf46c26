"""What is said of the cause of an alarm, and the project file's advice."""

import pytest

from lpvguard.base.errors import InputError
from lpvguard.replay.causes import diagnosed
from lpvguard.vehicle.project import parse_project


@pytest.mark.parametrize(
    ("cause", "numbers", "at_least", "advice", "said"),
    [
        (
            "gain",
            (0.71, 0.66, 0.76),
            False,
            "check tyre circumference",
            "yaw_rate 0.71 of the nominal output (0.66 to 0.76), since about 41 s; check tyre circumference",
        ),
        (
            "sign",
            (-1.0, -1.1, -0.9),
            False,
            None,
            "yaw_rate inverted: -1.00 of the nominal output (-1.10 to -0.90), since about 41 s",
        ),
        (
            "delay",
            (0.3, 0.25, 0.35),
            True,
            None,
            "yaw_rate 0.30 s later than the nominal output (0.25 to 0.35), since before 41 s",
        ),
        (
            "delay",
            (-0.3, -0.35, -0.25),
            False,
            None,
            "yaw_rate 0.30 s earlier than the nominal output (0.25 to 0.35), since about 41 s",
        ),
        (
            "bias",
            (0.05, 0.04, 0.06),
            False,
            None,
            "yaw_rate +0.05 rad/s off the nominal output (+0.04 to +0.06), since about 41 s",
        ),
        ("frozen", (0.1, 0.0, 0.0), False, None, "yaw_rate is frozen at 0.1 rad/s, since about 41 s"),
        (
            "noise",
            (0.1, 0.0, 0.0),
            False,
            None,
            "yaw_rate is noisy, with a standard deviation of 0.1 rad/s, since about 41 s",
        ),
        ("other", (0.0, 0.0, 0.0), False, None, "yaw_rate: no single cause explains what it does"),
    ],
)
def test_a_cause_in_words(g80, cause, numbers, at_least, advice, said):
    document = {**g80.model_dump(by_alias=True), "advice": {} if advice is None else {cause: advice}}
    project = parse_project(document, "x")
    diagnosis = diagnosed(
        project, cause, 0, numbers, found_s=60.0, alarm_s=50.0, since_s=41.2, at_least=at_least
    )
    assert diagnosis.says == said
    assert (diagnosis.t_s, diagnosis.alarm_s, diagnosis.since_s, diagnosis.at_least) == (
        60.0,
        50.0,
        41.2,
        at_least,
    )
    soon = diagnosed(
        project, cause, 0, numbers, found_s=55.0, alarm_s=50.0, since_s=41.2, at_least=at_least, final=False
    )
    assert (diagnosis.final, soon.final, soon.says) == (True, False, f"so far {said}")
    shown = [x for x in (diagnosis.value, diagnosis.low, diagnosis.high) if x is not None]
    assert shown == list(numbers[: {"other": 0, "frozen": 1, "noise": 1}.get(cause, 3)])


def test_advice_is_a_text_or_one_an_output(g80):
    document = g80.model_dump(by_alias=True)
    output = g80.outputs[0].name
    advised = parse_project({**document, "advice": {"gain": "a", "bias": {output: "b"}}}, "x")
    assert advised.advice.for_cause("gain", output) == "a"
    assert advised.advice.for_cause("bias", output) == "b"
    assert advised.advice.for_cause("delay", output) is None
    assert advised.advice.for_cause("other", output) is None
    assert "advice" not in advised.model_dump(by_alias=True), "no part of an identification"
    with pytest.raises(InputError, match="no output is named"):
        parse_project({**document, "advice": {"gain": {"speedo": "a"}}}, "x")
