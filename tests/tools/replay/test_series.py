"""Time series of a replay: a row a sample, and what the columns say is what the core said."""

from __future__ import annotations

import numpy as np
import pyarrow.parquet as parquet
import pytest

from lpvguard.core.compiled import VERDICTS
from lpvguard.replay.run import Recorded, Replayer
from lpvguard.replay.series import margin_column


@pytest.fixture(scope="module")
def replayer(g80, core):
    return Replayer(g80, core)


def test_the_table_of_the_command_is_what_the_core_said(lpvguard, replayer, vehicle, synthetic, tmp_path):
    path, out = synthetic / "synthetic_01.csv", tmp_path / "series"
    done = lpvguard("replay", "--vehicle", "g80", "--coefficients", vehicle, path, "--table", out)
    assert done.returncode == 0, done.stderr
    assert sorted(p.name for p in out.iterdir()) == ["MANIFEST.json", "synthetic_01.parquet"]
    table = parquet.read_table(out / "synthetic_01.parquet")
    drive, said = replayer.read_file(path).drive, replayer.replay_file(path)
    assert table.num_rows == len(drive.t)
    assert table["t"].to_numpy()[[0, -1]] == pytest.approx([0, drive.duration_s])
    assert table["verdict"].to_pylist() == [VERDICTS[code] for code in said.run.verdict]
    r, yhat, e = (table[name].to_numpy() for name in ("yaw_rate", "yhat/yaw_rate", "e/yaw_rate"))
    assert r == pytest.approx(drive.y[:, 0]) and yhat + e == pytest.approx(r)
    # Every counted frame stands once, in the column of its bin.
    columns = [margin_column(w) for w in replayer.estimator.omega]
    frames = said.run.frames
    for k, column in enumerate(columns):
        found = table[column].drop_null().to_numpy()
        assert np.array_equal(found, frames.margin[frames.counted & (frames.bin == k)]), column
    assert max(table[c].drop_null().to_numpy().max(initial=0) for c in columns) == said.max_margin
    assert table["energy_ratio"].drop_null().to_numpy().max() == said.run.energy.max()


def test_samples_that_were_not_there_are_null(replayer, synthetic):
    drive = replayer.read_file(synthetic / "synthetic_01.csv").drive
    present = np.ones(len(drive.t), bool)
    present[100:110] = False
    recorded = Recorded(drive, present)
    table = replayer.series(recorded, replayer.replay_recorded(recorded))
    for column in ("speed", "yaw_rate", "yhat/yaw_rate", "e/yaw_rate"):
        assert np.flatnonzero(table[column].is_null().to_numpy()).tolist() == list(range(100, 110))


def test_a_series_is_refused_where_two_would_have_one_name_and_where_nothing_is_judged(
    lpvguard, vehicle, synthetic, tmp_path
):
    path, out = synthetic / "synthetic_01.csv", tmp_path / "series"
    words = ("replay", "--vehicle", "g80", "--coefficients", vehicle, path)
    twice = lpvguard(*words, path, "--table", out)
    assert twice.returncode == 2 and "two logs are called synthetic_01" in twice.stderr
    played = lpvguard(*words, "--to", "socketcan:nowhere0", "--table", out)
    assert played.returncode == 2 and "judges nothing" in played.stderr
    assert not out.exists()
