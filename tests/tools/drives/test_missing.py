"""A spike or a reverse piece is missing samples: nothing is judged there, and the drive is not refused."""

import json

import numpy as np
import pytest

from drive_table import table
from lpvguard.base.errors import InputError, InputWarning
from lpvguard.drives.frames import Estimator
from lpvguard.drives.ingest import ingest
from lpvguard.drives.resample import standing_alone
from lpvguard.drives.tables import list_experiments, read_drive
from lpvguard.identify.bounds import counted_frames, nominal_error

SPIKE, REVERSE = slice(3000, 3003), slice(6000, 6200)


@pytest.fixture(scope="module")
def drives(g80, synthetic, tmp_path_factory):
    """A drive as it is, and with three impossible yaw rates and four seconds of reverse."""
    folder = tmp_path_factory.mktemp("missing")
    d = read_drive(list_experiments(synthetic)[1].path, g80)
    v, r = d.v.copy(), d.y[:, 0].copy()
    r[SPIKE], v[REVERSE] = 40.0, -3.0
    for name, speed, rate in (("plain", d.v, d.y[:, 0]), ("spoiled", v, r)):
        table(folder, f"{name}.csv", t=d.t, v=speed, delta=d.u[:, 0], r=rate)
    return folder


def test_frames_over_missing_samples_do_not_count_and_the_others_are_as_before(g80, g80_model, drives, core):
    plain, spoiled = (read_drive(drives / f"{n}.csv", g80) for n in ("plain", "spoiled"))
    assert plain.missing is None and spoiled.missing_samples == 203
    assert np.flatnonzero(spoiled.missing).tolist() == [*range(3000, 3003), *range(6000, 6200)]
    assert np.array_equal(spoiled.before_sample(3001).missing, spoiled.missing[:3001])
    assert len(spoiled.present.t) == len(plain.t) - 203
    estimator = Estimator.from_project(g80, g80_model)
    of_plain, of_spoiled = (
        list(counted_frames(d, *nominal_error(d, g80_model), g80_model, estimator)) for d in (plain, spoiled)
    )
    for a, b in zip(of_plain, of_spoiled, strict=True):
        assert set(b.starts) < set(a.starts)
        length = estimator.length[b.bin]
        for gone in (SPIKE, REVERSE):
            assert not np.any((b.starts + length > gone.start) & (b.starts < gone.stop))
        before = b.starts < SPIKE.start - length
        assert before.any()
        same = np.isin(a.starts, b.starts[before])
        assert np.allclose(b.E[before], a.E[same], rtol=0, atol=1e-12)


@pytest.mark.parametrize("value", ["", "nan", "inf", "null", "NA"])
def test_a_sample_without_a_value_is_missing(g80, drives, tmp_path, value):
    lines = (drives / "plain.csv").read_text().splitlines()
    for k in range(SPIKE.start, SPIKE.stop):
        cells = lines[k + 1].split(",")
        lines[k + 1] = ",".join([*cells[:3], value])
    path = tmp_path / "holes.csv"
    path.write_text("\n".join(lines) + "\n")
    assert lines[0].endswith(",r")
    holes, plain = read_drive(path, g80), read_drive(drives / "plain.csv", g80)
    assert np.flatnonzero(holes.missing).tolist() == [*range(SPIKE.start, SPIKE.stop)]
    assert np.array_equal(holes.present.y, plain.y[~holes.missing]) and np.isfinite(holes.y).all()
    with pytest.raises(InputError, match=r"column r: (nan|inf); expected a finite number"):
        read_drive(path, g80, any_values=True)


def test_replay_judges_the_rest_and_does_not_alarm(lpvguard, drives, vehicle):
    words = ("replay", "--vehicle", "g80", "--coefficients", vehicle, "--json", "-")
    done = lpvguard(*words, drives / "plain.csv", drives / "spoiled.csv")
    assert done.returncode == 0, done.stderr
    plain, spoiled = json.loads(done.stdout)
    assert 0 < spoiled["judged_s"] < plain["judged_s"] and spoiled["alarms"] == []
    assert (plain["missing_samples"], spoiled["missing_samples"]) == (0, 203)


def test_more_than_a_tenth_of_impossible_values_is_refused_by_place(g80, drives, tmp_path):
    d = read_drive(drives / "plain.csv", g80)
    r = d.y[:, 0].copy()
    r[1000 : 1000 + len(r) // 8] = 40.0
    path = table(tmp_path, t=d.t, v=d.v, delta=d.u[:, 0], r=r)
    with pytest.raises(InputError, match=rf"line 1002, column r: 40.*\({len(r) // 8} such values"):
        read_drive(path, g80)


def test_samples_that_stand_alone_are_left_out_and_named(tmp_path):
    t = np.arange(0.0, 60.0, 0.02)
    r = 0.2 * np.sin(0.5 * t) + 1e-3 * np.random.default_rng(4).standard_normal(len(t))
    spoiled = r.copy()
    at = np.random.default_rng(5).permutation(np.arange(1, 700))[:60] * 4
    spoiled[at] = -327.68
    np.savetxt(tmp_path / "log.csv", np.c_[t, spoiled], delimiter=",", header="t,r", comments="")
    (tmp_path / "map.toml").write_text('schema = 1\nTs_s = 0.02\n[columns.r]\nunit = "rad/s"\nsignal = "r"\n')
    with pytest.warns(InputWarning, match="column r: 60 of 3000 samples stand alone and are left out"):
        report = ingest(
            [tmp_path / "log.csv"], dbc=None, signals_map=tmp_path / "map.toml", out=tmp_path / "out"
        )
    (term,) = report["log"]["stretches"][0]["columns"]["r"]["terms"]
    assert term["left_out"] == {"stand alone": 60}
    read = np.loadtxt(tmp_path / "out" / "log.csv", delimiter=",", skiprows=1)[:, 1]
    assert np.abs(read - r).max() < 0.02
    absent = np.where((t > 20) & (t < 20.3), -999.0, r)
    assert standing_alone(absent).sum() == 14
    absent[(t > 30) & (t < 36)], absent[(t > 40) & (t < 50)] = 655.35, 655.34  # and 27 % more
    assert standing_alone(absent).sum() == 14 + 299 + 499
    assert standing_alone(-absent).sum() == 14 + 299 + 499
    assert not standing_alone(np.round(r, 2)).any() and not standing_alone(np.zeros(50)).any()
