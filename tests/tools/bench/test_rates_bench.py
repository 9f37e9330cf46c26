"""`lpvguard bench rates`: a few fleets."""

import json

import pytest

from lpvguard.base.errors import InputError
from lpvguard.extras.bench import rates, run


@pytest.mark.unhurried
def test_promised_stands_beside_counted(tmp_path, capsys):
    out = tmp_path / "rates.json"
    run("rates", ["--fleets", "4", "--hours", "10", "--fresh", "2000", "--json", str(out)])
    text, result = capsys.readouterr().out, json.loads(out.read_text())
    assert len(result["rows"]) == len(rates.FAMILIES) * len(rates.RATES_PER_1000_H)
    assert all(r["covered"]["of"] == 4 for r in result["rows"])
    assert sum(r["kept"]["count"] for r in result["rows"]) > 0.7 * 4 * len(result["rows"])
    assert "exponential" in text and "clusters" in text


@pytest.mark.parametrize("option", [["--fleets", "0"], ["--hours", "0.5"], ["--hours", "x"]])
def test_sizes_that_make_no_sense_are_refused(option):
    with pytest.raises(InputError, match=option[0]):
        run("rates", option)
