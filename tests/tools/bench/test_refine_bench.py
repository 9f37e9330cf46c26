"""`lpvguard bench refine`: rounds of refinement over a fleet with a worn vehicle."""

import json

import pytest

from lpvguard.base.errors import InputError
from lpvguard.extras.bench import refine


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
