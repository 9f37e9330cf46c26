"""Own gains of the vehicles of a fleet: where they come from, and what is learnt beside them."""

import numpy as np
import pyarrow as pa
import pyarrow.parquet as parquet
import pytest

from lpvguard.base.errors import InputError
from lpvguard.drives.tables import Experiment, list_experiments, read_drive
from lpvguard.extras.fleet.scores import DriveEstimate
from lpvguard.extras.refine.lineage import OWN
from lpvguard.extras.refine.own import RISK, OwnGain, OwnGains, mean_changes


def estimates(gains):
    return [(DriveEstimate("r", gain - 1, 0.0, 0.0),) for gain in gains]


def test_own_gains_are_relative_to_the_known_drives(tmp_path):
    own = OwnGains((0.8,)).joined("heavy", estimates([0.5, 0.7]))
    assert own.vehicles["heavy"] == OwnGain((pytest.approx(0.75),), 2)
    (tmp_path / OWN).write_text(own.text)
    assert OwnGains.read(tmp_path / OWN) == own
    np.testing.assert_allclose(own.changes(estimates([0.8, 0.4])), [[0.0], [-0.5]])
    for gain in (0.1, -0.8, 4.2):
        with pytest.raises(InputError, match=r"drives of still: own gains: .*; expected 0\.2 to 5 times"):
            own.joined("still", estimates([gain]))


def test_drives_of_a_vehicle_with_gains_are_divided_by_them(g80, synthetic, tmp_path):
    known = list_experiments(synthetic)[0].path
    lines = known.read_text().splitlines()
    cells = zip(lines[0].split(","), lines[3].split(","), strict=True)
    lines[3] = ",".join("" if name == "r" else cell for name, cell in cells)
    table = tmp_path / "gap.csv"
    table.write_text("\n".join(lines) + "\n")
    drives = [Experiment(name, table, "valid", "human", name) for name in ("a", "b")]
    own = OwnGains((1.0,), {"heavy": OwnGain((0.5,), 3)})
    with own.divided(g80, drives, {"a": "heavy", "b": "light"}, tmp_path) as (divided, same):
        assert same == drives[1] and divided.path.stem == "a"
        before, after = read_drive(table, g80), read_drive(divided.path, g80)
        np.testing.assert_array_equal(after.y, before.y / 0.5)
        for name in ("t", "v", "u", "missing"):
            np.testing.assert_array_equal(getattr(after, name), getattr(before, name))
        assert after.missing_samples == 1
    assert not divided.path.exists()
    parquet.write_table(pa.table({"t": [0.0]}), tmp_path / "t.parquet")
    with pytest.raises(InputError, match="column r is missing"):
        lacking = Experiment("t", tmp_path / "t.parquet", "valid", "human", "t")
        own.divided(g80, [lacking], {"t": "heavy"}, tmp_path).__enter__()


def test_a_mean_that_changed_by_the_tolerance_is_shown_below_it_as_seldom_as_stated():
    random = np.random.default_rng(5)
    least, vehicles, first, drives = 0.15, 40, 4, 4
    learnt = 0
    for _ in range(250):
        own, now = OwnGains((1.0,)), {}
        for i in range(vehicles):
            spread = 1 + 0.05 * random.standard_normal(first + drives)
            own = own.joined(f"{i}", estimates(spread[:first]))
            now[f"{i}"] = estimates(spread[first:] - least)
        learnt += sum(abs(c[0]) + error[0] < least for c, error in mean_changes(own, now).values())
    assert learnt <= 1.5 * RISK * 250 * vehicles


def test_one_drive_of_each_vehicle_shows_nothing():
    own = OwnGains((1.0,)).joined("a", estimates([1.0])).joined("b", estimates([1.0]))
    said = mean_changes(own, {"a": estimates([1.0]), "b": estimates([1.0]), "new": estimates([0.5])})
    assert set(said) == {"a", "b"} and np.isinf(said["a"][1]).all()
