"""`lpvguard bench confirmation`: designs of k of m frames."""

import json

import numpy as np
import pytest

from lpvguard.base.errors import InputError
from lpvguard.extras.bench import confirmation, run


def test_the_least_fault_is_what_the_confirmed_scores_miss():
    noise = np.tile([1.0, 3.0, 2.0], (10, 1))
    assert confirmation.least_found(noise, 10.0, 1, 1) == 7.0
    assert confirmation.least_found(noise, 10.0, 2, 2) == 8.0
    assert confirmation.least_found(noise[:, :1], 10.0, 2, 2) == np.inf


@pytest.mark.unhurried
def test_designs_stand_beside_each_other(tmp_path, capsys):
    out = tmp_path / "confirmation.json"
    run("confirmation", ["--hours", "10", "--fresh", "300", "--delays", "10,60", "--json", str(out)])
    text, result = capsys.readouterr().out, json.loads(out.read_text())
    assert len(result["rows"]) == 5 * len(confirmation.DESIGNS) * 3
    single, three = (result["rows"][i] for i in (0, 3))
    assert single["design"] == [1, 1] and three["design"] == [3, 3] and three["least"]["10"] is None
    assert three["least"]["60"] < 0.6 * single["least"]["60"]
    assert "3 of 3" in text and "–" in text and "counted within the interval" in text


@pytest.mark.parametrize("option", [["--hours", "1"], ["--delays", "5"]])
def test_sizes_that_make_no_sense_are_refused(option):
    with pytest.raises(InputError, match=option[0]):
        run("confirmation", option)
