"""A vehicle and frames for the live page."""

import pytest

from lpvguard.replay.replayer import Replayer, bus_frames


@pytest.fixture(scope="session")
def replayer(g80, core):
    return Replayer(g80, core)


@pytest.fixture(scope="session")
def faulty(synthetic, g80, tmp_path_factory):
    """The frames of a drive of which the last third has 1.6 times its yaw rate, and the drive's table."""
    import pandas

    table = pandas.read_csv(synthetic / "synthetic_01.csv")
    table.loc[len(table) * 2 // 3 :, "r"] *= 1.6
    path = tmp_path_factory.mktemp("live") / "faulty.csv"
    table.to_csv(path, index=False)
    return bus_frames(path, g80), path
