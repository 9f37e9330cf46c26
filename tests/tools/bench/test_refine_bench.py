"""`lpvguard bench refine`: rounds of refinement over a fleet with a worn vehicle."""

import json
from dataclasses import replace

import numpy as np
import pytest

from lpvguard.base.errors import InputError
from lpvguard.extras.bench import refine
from lpvguard.extras.refine.decisions import Decisions, DriveDecision


@pytest.mark.slow("an identification and a round of refinement")
def test_a_small_fleet_is_counted_and_its_worn_vehicle_not_learnt(tmp_path, capsys):
    path = tmp_path / "fleet.json"
    refine.main(["--vehicles", "1", "--drives", "1", "--rounds", "1", "--json", str(path)])
    (only,) = json.loads(path.read_text())["rounds"]
    assert only["healthy"] == 1 and only["faults_found"] == 1
    assert (only["worn_below"], only["worn_learnt"]) == (1, 0), "one drive, at once with 0.7 of the gain"
    assert "of these learnt" in capsys.readouterr().out


@pytest.mark.parametrize("option", ["--vehicles", "--drives", "--rounds", "--seeds", "--seconds"])
def test_an_impossible_size_is_refused(option):
    with pytest.raises(InputError, match=f"bench refine: {option}: 0"):
        refine.main([option, "0"])


@pytest.mark.slow("10 s: drives of trucks")
def test_trucks_differ_by_their_own_and_wear_by_their_brakes(tmp_path):
    size = refine.FleetSize(vehicles=2, worn=1, drives=1, rounds=2, seconds=120.0)
    fleet = refine.FLEETS["truck"]
    first, again, later = (
        refine.fleet_drives(fleet, tmp_path / name, size, turn, 0)
        for name, turn in (("a", 0), ("b", 0), ("c", 1))
    )
    assert list(first.values()) == pytest.approx([1.0, 1.0, 0.85])
    assert list(later.values()) == pytest.approx([1.0, 1.0, 0.7]) and len(again) == 3
    tables = [[path.read_bytes() for path in sorted((tmp_path / name).glob("*.csv"))] for name in "abc"]
    assert tables[0][:3] == tables[1][:3] and len({*tables[0], *tables[2]}) == 8


def test_every_truck_of_a_large_fleet_is_one_that_the_simulator_drives():
    """One load in 750 was drawn below 0.4, which the simulator refuses: a fleet of 50 ended so."""
    random = np.random.default_rng(0)
    drawn = [refine.truck_variation(random) for _ in range(20_000)]
    for key, sd in refine.VARIATION.items():
        values = np.array([d[key] for d in drawn])
        assert values.min() >= 1 - 2.5 * sd and values.max() <= 1 + 2.5 * sd
        assert values.std() == pytest.approx(sd, rel=0.05)


def test_an_inspection_accepts_what_did_not_wear():
    entry = DriveDecision(
        "x", "x.csv", "", "car", "valid", "human", "x", "", [], {}, "new", "fault", "", "fault"
    )
    signed = Decisions("seal", "bench", [entry, replace(entry, name="worn")])
    healthy, worn = refine._inspected(signed, {"x"}).drives
    assert (healthy.action, healthy.accept, healthy.why) == ("spread", True, "inspected") and not worn.accept
