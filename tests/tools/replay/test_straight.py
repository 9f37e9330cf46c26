"""Long straight driving could refute nothing: it drifts neither into an alarm nor into a verdict of valid."""

import numpy as np
import pytest
from scipy.signal import lfilter

from lpvguard.core.compiled import VERDICTS, Core, shipped_vehicle
from lpvguard.drives.tables import Drive, list_experiments, read_drive
from lpvguard.replay.replayer import Replayer
from lpvguard.vehicle.nominal import NominalModel

HOURS = 10.0
STEERED_RAD = 2e-4
"""Rms of the steering that keeps a car straight, about twice the grid of its sensor."""
STRAIGHT_RAD, WINDOW_S = 1e-3, 10.0
"""Measured driving is called straight where the steering's rms within a window is below this."""


def wandering(
    random: np.random.Generator, samples: int, memory_s: float, rms: float, Ts: float
) -> np.ndarray:
    """First-order noise (samples,) of so much memory and rms."""
    x = lfilter([1.0], [1.0, -np.exp(-Ts / memory_s)], random.standard_normal(samples))
    return rms * x / x.std()


@pytest.mark.unhurried
def test_ten_hours_straight_on_are_neither_an_alarm_nor_evidence(g80):
    random, Ts = np.random.default_rng(1), g80.Ts_s
    samples = round(HOURS * 3600 / Ts)
    v = 15.0 + wandering(random, samples, 60.0, 1.0, Ts)
    u = np.round(wandering(random, samples, 2.0, STEERED_RAD, Ts) / 1.1e-4) * 1.1e-4
    y = NominalModel(g80).simulate(v, u[:, None], np.zeros(1))[:, 0]
    # White noise, wind and bank as in the data's README, on the sensor's grid.
    y += 6.5e-4 * random.standard_normal(samples) + wandering(random, samples, 20.0, 3e-4, Ts)
    drive = Drive(
        "straight", np.arange(samples) * Ts, v, u[:, None], (np.round(y / 3.5e-4) * 3.5e-4)[:, None]
    )
    core = Core(shipped_vehicle("g80"))
    replay = Replayer(g80, core).replay(drive)
    verdicts = np.bincount(replay.run.verdict, minlength=len(VERDICTS)) / samples
    assert replay.alarms == [] and replay.judged.mean() > 0.9
    assert verdicts[VERDICTS.index("not_judged")] > 0.999
    assert verdicts[VERDICTS.index("unknown")] + verdicts[VERDICTS.index("not_judged")] == 1.0


def test_straight_pieces_of_measured_drives_alarm_never_and_are_valid_by_evidence_alone(g80, measured):
    replayer = Replayer(g80, Core(shipped_vehicle("g80")))
    window, low = round(WINDOW_S / g80.Ts_s), replayer.model.speed_range[0]
    straight_s = 0.0
    for e in list_experiments(measured):
        drive = read_drive(e.path, g80)
        quiet = np.zeros(len(drive.t) + 2, bool)
        for a in range(0, len(drive.t) - window, window // 2):
            part = slice(a, a + window)
            if drive.u[part].std() < STRAIGHT_RAD and drive.v[part].min() > low:
                quiet[a + 1 : a + window + 1] = True
        for a, b in np.flatnonzero(np.diff(quiet)).reshape(-1, 2):
            replay = replayer.replay(drive.before_sample(b).from_sample(a))
            straight_s += replay.duration_s
            assert replay.alarms == [], e.name
            evidence = replay.run.frames.evidence.max(initial=0.0)
            valid = (replay.run.verdict == VERDICTS.index("valid")).any()
            assert not valid or evidence > replayer.threshold, e.name
    assert straight_s > 100
