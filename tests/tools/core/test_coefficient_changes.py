"""Coefficients that changed between two generated folders of a vehicle."""

from dataclasses import replace

import pytest

from lpvguard.base.errors import InputError
from lpvguard.core.coefficient_changes import coefficient_changes
from lpvguard.core.compiled import shipped_vehicle
from lpvguard.identify import identification as stage
from lpvguard.identify.export import export_vehicle


@pytest.mark.unhurried
def test_only_what_changed_is_listed_with_its_size(identified, vehicle, tmp_path):
    stored = stage.load(identified)
    calibration = replace(stored.calibration, threshold=1.1 * stored.calibration.threshold)
    export_vehicle(replace(stored, calibration=calibration, pools=None), tmp_path / "g80")
    export_vehicle(replace(stored, pools=None), tmp_path / "before/g80")
    seal, only = coefficient_changes(tmp_path / "before/g80", tmp_path / "g80")
    assert (seal.name, seal.changed, seal.largest) == ("crc32", 1, None)
    assert (only.name, only.numbers, only.changed) == ("threshold", 1, 1)
    assert only.largest == pytest.approx(0.1, rel=1e-5)
    assert coefficient_changes(vehicle, vehicle) == []
    assert {c.name for c in coefficient_changes(vehicle, tmp_path / "g80")} >= {"threshold", "pool_scale"}
    with pytest.raises(InputError, match="--delta: truck"):
        coefficient_changes(shipped_vehicle("truck"), vehicle)


@pytest.mark.unhurried
def test_export_prints_what_changed(lpvguard, identified, vehicle, tmp_path):
    done = lpvguard("export", "--vehicle", "g80", identified, "-o", tmp_path / "g80", "--delta", vehicle)
    assert done.returncode == 0, done.stderr
    assert "no coefficient changed" in done.stderr
