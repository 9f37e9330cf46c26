"""Time series of a replay: a row a sample, and what the columns say is what the core said."""

import json
from dataclasses import replace

import numpy as np
import pyarrow.parquet as parquet
import pytest

from lpvguard.core.compiled import VERDICTS
from lpvguard.replay.replayer import Recorded
from lpvguard.replay.series import margin_column


@pytest.mark.unhurried
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
        margins = table[column].drop_null().to_numpy()
        assert np.array_equal(margins, frames.margin[frames.counted & (frames.bin == k)]), column
    assert max(table[c].drop_null().to_numpy().max(initial=0) for c in columns) == said.max_margin
    assert table["energy_ratio"].drop_null().to_numpy().max() == said.run.energy.max()


def test_samples_that_were_not_there_are_null(replayer, synthetic):
    drive = replayer.read_file(synthetic / "synthetic_01.csv").drive
    missing = np.zeros(len(drive.t), bool)
    missing[100:110] = True
    recorded = Recorded(replace(drive, missing=missing))
    said = replayer.replay_recorded(recorded)
    assert said.missing_samples == 10
    table = replayer.series(recorded, said)
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


@pytest.mark.unhurried
def test_an_mcap_recording_is_read_back_with_the_same_verdicts_margins_and_alarms(
    lpvguard, replayer, vehicle, alarmed, tmp_path
):
    reader = pytest.importorskip("mcap.reader", reason="the package mcap (lpvguard[mcap])")
    path, said = alarmed
    out = tmp_path / "out"
    words = ("replay", "--vehicle", "g80", "--coefficients", vehicle, path, "--table", out, "--as", "mcap")
    assert lpvguard(*words).returncode == 1
    by_topic = {topic: [] for topic in ("/lpvguard/sample", "/lpvguard/margin", "/lpvguard/alarm")}
    with (out / "weak.mcap").open("rb") as stream:
        for schema, channel, message in reader.make_reader(stream, validate_crcs=True).iter_messages():
            assert schema.encoding == "jsonschema" and channel.message_encoding == "json"
            by_topic[channel.topic].append((message.log_time, json.loads(message.data)))
    samples, margins, alarms = by_topic.values()
    assert [m["verdict"] for _, m in samples] == [VERDICTS[code] for code in said.run.verdict]
    assert [t for t, _ in samples] == [round(k * 0.02 * 1e9) for k in range(len(samples))]
    frames = said.run.frames
    assert sorted(m["margin"] for _, m in margins) == sorted(frames.margin[frames.counted])
    assert len(alarms) == len(said.alarms) > 0
    assert [t for t, _ in alarms] == [round(a.t_s * 1e9) for a in said.alarms]
    assert alarms[0][1]["message"].startswith(f"{said.alarms[0].test} test")


@pytest.mark.unhurried
def test_an_mf4_has_margins_as_channels_with_units_and_no_time_of_day(
    lpvguard, replayer, vehicle, alarmed, tmp_path
):
    from asammdf import MDF

    path, said = alarmed
    words = ("replay", "--vehicle", "g80", "--coefficients", vehicle, path, "--as", "mf4", "--table")
    assert lpvguard(*words, tmp_path / "one").returncode == 1
    assert lpvguard(*words, tmp_path / "two").returncode == 1
    one = tmp_path / "one" / "weak.mf4"
    assert one.read_bytes() == (tmp_path / "two" / "weak.mf4").read_bytes()
    frames = said.run.frames
    with MDF(one) as mdf:
        assert mdf.get("yaw_rate").unit == "rad/s" == mdf.get("e/yaw_rate").unit
        assert np.array_equal(mdf.get("verdict_code").samples, said.run.verdict)
        for k, w in enumerate(replayer.estimator.omega):
            counted = frames.counted & (frames.bin == k)
            signal = mdf.get(margin_column(w))
            assert np.array_equal(signal.samples, frames.margin[counted])
            assert signal.timestamps == pytest.approx(frames.t_judged_s[counted] - said.start_s)


def test_a_form_without_a_folder_is_refused(lpvguard, vehicle, alarmed):
    done = lpvguard("replay", "--vehicle", "g80", "--coefficients", vehicle, alarmed[0], "--as", "mf4")
    assert done.returncode == 2 and "--as mf4: given without --table" in done.stderr
