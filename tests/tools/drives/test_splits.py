"""Both halves of the recordings have all days, surfaces and speeds; the calibrating one allows alpha 0.1."""

from collections import Counter

import numpy as np
import pytest

from lpvguard.drives.splits import day, groups_of, split_advice, split_notes, splits_of


def drives(count: int, prefix: str = "r") -> dict[str, np.ndarray]:
    return {f"{prefix}{k:02d}": np.full(10, 5.0 + k) for k in range(count)}


@pytest.mark.parametrize(("count", "setting"), [(2, 1), (6, 3), (13, 7), (14, 5), (16, 7), (18, 9), (22, 11)])
def test_nine_recordings_calibrate_where_enough_remain(count, setting):
    speeds = drives(count)
    splits = splits_of(speeds, {n: n for n in speeds}, {})
    assert Counter(splits.values())["train"] == setting
    train = [speeds[n][0] for n, split in splits.items() if split == "train"]
    assert min(train) == 5.0 and max(train) >= 5.0 + count - 2  # the bounds know all speeds


def test_each_day_and_each_surface_is_in_both_halves():
    speeds = drives(4, "wet_") | drives(4, "dry_") | drives(4, "dry2_")
    days = {n: "2025-01-01" if n.startswith("dry_") else "2025-02-03" for n in speeds}
    splits = splits_of(speeds, {n: n for n in speeds}, days)
    for prefix in ("wet_", "dry_", "dry2_"):
        halves = [split for n, split in splits.items() if n.startswith(prefix)]
        assert sorted(halves) == ["train", "train", "valid", "valid"]
    said = (
        "6 drives set the bounds, 6 calibrate, parted by speed and day (2025-01-01, 2025-02-03) and surface"
    )
    assert split_notes(splits, {n: n for n in speeds}, days) == [
        f"{said} (dry, wet)",
        "groups, each left out in turn: 2025-01-01, 2025-02-03",
    ]


def test_a_day_in_one_half_alone_gives_a_recording_of_about_its_speed():
    speeds = drives(8)
    days = {n: ("2025-01-01", "2025-02-03")[k % 2] for k, n in enumerate(speeds)}
    splits = splits_of(speeds, {n: n for n in speeds}, days)
    for name in set(days.values()):
        assert Counter(splits[n] for n in speeds if days[n] == name) in (
            {"train": 3, "valid": 1},
            {"train": 1, "valid": 3},
        )
    changed = [k for k, n in enumerate(speeds) if splits[n] != ("train", "valid")[k % 2]]
    assert len(changed) == 2 and abs(changed[0] - changed[1]) == 1


def test_drives_of_a_recording_stay_together_and_a_single_recording_is_parted():
    speeds = drives(4)
    together = splits_of(speeds, {"r00": "a", "r01": "a", "r02": "b", "r03": "b"}, {})
    assert together == {"r00": "train", "r01": "train", "r02": "valid", "r03": "valid"}
    assert Counter(splits_of(speeds, dict.fromkeys(speeds, "a"), {}).values())["train"] == 2


def test_the_day_is_that_of_the_name_before_that_of_the_times():
    assert day("drive_2026-04-22.csv", 1.7e9) == "2026-04-22"
    assert day("drive.csv", 1.7e9) == "2023-11-14" and day("drive.csv", 12.0) == ""


def test_groups_are_days_and_drivers_where_every_recording_tells_one():
    days = {
        f"run{k}_fahrer_{who}": day for k, (who, day) in enumerate([("A", "d1"), ("A", "d1"), ("B", "d1")])
    }
    assert list(groups_of(days).values()) == ["d1 A", "d1 A", "d1 B"]
    assert groups_of({"a": "d1", "b": "d1", "c": ""}) == {}  # one tells nothing
    assert groups_of({"a": "d1", "b": "d2"}) == {} == groups_of({"a": "d1", "b": "d1"})


def test_advice_names_what_one_half_lacks_and_parts_otherwise():
    speeds = drives(6)
    halves = {n: k < 3 for k, n in enumerate(speeds)}
    days = {n: "2025-01-01" if k in (0, 1) else "2025-02-03" for k, n in enumerate(speeds)}
    said = split_advice(halves, speeds, days)
    assert "r03, r04, r05 calibrate at higher speeds" in said and "group or day 2025-01-01 only sets" in said
    assert said.endswith("by speed and day: r00, r02, r04 train, r01, r03, r05 valid")
    by_speed = {n: k % 2 == 0 for k, n in enumerate(speeds)}
    assert split_advice(by_speed, speeds, days) == ""
