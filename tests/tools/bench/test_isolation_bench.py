"""`lpvguard bench isolation`: one drive a fault."""

import json

import pytest

from lpvguard.base.errors import InputError
from lpvguard.extras.bench import isolation, run


@pytest.mark.slow("6 s: 25 faults")
def test_the_confusion_table_counts_every_drive(tmp_path, capsys):
    out = tmp_path / "isolation.json"
    run("isolation", ["--drives", "1", "--json", str(out)])
    text, result = capsys.readouterr().out, json.loads(out.read_text())
    assert all(sum(r["outcomes"].values()) == 1 for r in result["rows"])
    assert result["right"]["of"] == 12 and result["right"]["count"] >= 10 and result["wrong"]["count"] == 0
    assert "by structure vehicle is told from yaw_rate, wheel_rate" in text


def test_outcomes_tell_one_of_several_and_wrong_apart():
    judged = isolation.outcome
    assert judged((), False, {"a"}) == "healthy" and judged((), True, {"a"}) == "no single"
    assert judged(("a",), True, {"a"}) == "right" and judged(("b",), True, {"a"}) == "wrong"
    assert judged(("b", "a"), True, {"a"}) == "one of" and judged(("b", "c"), True, {"a"}) == "wrong"


@pytest.mark.parametrize("option", ["--drives", "--window", "--jobs"])
def test_sizes_that_make_no_sense_are_refused(option):
    with pytest.raises(InputError, match=option):
        run("isolation", [option, "0"])
