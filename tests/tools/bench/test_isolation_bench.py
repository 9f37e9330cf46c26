"""`lpvguard bench isolation`: one drive a fault."""

import json

import pytest

from lpvguard.base.errors import InputError
from lpvguard.extras.bench import isolation, run


@pytest.mark.slow("6 s: 25 faults")
def test_the_confusion_table_counts_every_drive(tmp_path, capsys):
    out = tmp_path / "isolation.json"
    run("isolation", ["--drives", "1", "--json", str(out)])
    text, found = capsys.readouterr().out, json.loads(out.read_text())
    assert all(sum(r["outcomes"].values()) == 1 for r in found["rows"])
    assert found["right"]["of"] == 12 and found["right"]["count"] >= 10 and found["wrong"]["count"] == 0
    assert "by structure vehicle is told from yaw_rate, wheel_rate" in text


def test_outcomes_tell_one_of_several_and_wrong_apart():
    of = isolation.outcome
    assert of((), False, {"a"}) == "healthy" and of((), True, {"a"}) == "no single"
    assert of(("a",), True, {"a"}) == "right" and of(("b",), True, {"a"}) == "wrong"
    assert of(("b", "a"), True, {"a"}) == "one of" and of(("b", "c"), True, {"a"}) == "wrong"


@pytest.mark.parametrize("option", ["--drives", "--window", "--jobs"])
def test_sizes_that_make_no_sense_are_refused(option):
    with pytest.raises(InputError, match=option):
        run("isolation", [option, "0"])
