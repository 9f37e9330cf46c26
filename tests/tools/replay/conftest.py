"""A vehicle's core, and a drive at which it alarms."""

import pytest

from lpvguard.replay.replayer import Replayer


@pytest.fixture(scope="session")
def replayer(g80, core):
    return Replayer(g80, core)


@pytest.fixture(scope="session")
def alarmed(replayer, synthetic, tmp_path_factory):
    """A drive whose sensor reads 1.6 times the yaw rate, and what the core says of it."""
    import pandas

    path = tmp_path_factory.mktemp("alarmed") / "weak.csv"
    table = pandas.read_csv(synthetic / "synthetic_01.csv")
    table.assign(r=1.6 * table.r).to_csv(path, index=False)
    return path, replayer.replay_file(path)
