"""The table of varied trucks: the worst run of each, and what a certificate rules out is named."""

import json

import pytest

from lpvguard.base.errors import InputError
from lpvguard.core.compiled import shipped_vehicle
from lpvguard.extras.bench import steer

KEYS = {"differs", "value", "v_mps", "seed", "tracking", "limited_s", "line_bar", "line_radps", "falsified"}


@pytest.mark.slow("6 s: the simulator built, three runs")
def test_a_truck_that_oscillates_is_named_and_a_truck_as_designed_is_not(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(steer, "TRUCKS", (("brake_gain_ratio", 1.0), ("brake_gain_ratio", 5.0)))
    monkeypatch.setattr(steer, "workers", lambda _: NoWorkers())
    vehicle, written = shipped_vehicle("truck"), tmp_path / "steer.json"
    steer.main([str(vehicle), "--speeds", "8,22", "--seeds", "3", "--json", str(written)])
    rows = json.loads(written.read_text())["runs"]
    assert [(r["value"], r["v_mps"], r["seed"]) for r in rows] == [
        (x, v, 3) for x in (1.0, 5.0) for v in (8.0, 22.0)
    ]
    good, bad = rows[:2], rows[2:]
    assert all(set(r) == KEYS for r in rows)
    assert all(r["falsified"] == [] and r["line_bar"] == 0 and 0 < r["tracking"] < 0.1 for r in good)
    assert any("oscillates" in r["falsified"] and r["line_bar"] > 1 for r in bad)
    text = capsys.readouterr().out.splitlines()
    count = sum(bool(r["falsified"]) for r in bad)
    assert text[-1] == f"{count} of 4 runs show what a certificate rules out"
    assert [line.split()[:3] for line in text[1:3]] == [["brake_gain_ratio", x, "2"] for x in ("1", "5")]
    assert sum("brake_gain_ratio 5, " in line and "seed 3" in line for line in text) == count


class NoWorkers:
    def __enter__(self):
        return map

    def __exit__(self, *_):
        return None


@pytest.mark.parametrize("speeds", ["", "fast", "10,", "-1", "nan", "inf"])
def test_speeds_that_are_none_are_refused(speeds):
    with pytest.raises(InputError, match=r"--speeds.*numbers from 0 on"):
        steer.main(["vehicle", f"--speeds={speeds}"])


@pytest.mark.parametrize("seeds", ["1.5", "1,inf", "one"])
def test_seeds_that_are_no_whole_numbers_are_refused(seeds):
    with pytest.raises(InputError, match=r"--seeds.*whole numbers from 0 on"):
        steer.main(["vehicle", "--seeds", seeds])
