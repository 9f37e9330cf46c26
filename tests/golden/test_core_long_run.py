"""Does float wear out? The float core beside the double one over a long run with a burst 500 times as large
as the signals.

300 000 samples; with LPVGUARD_FULL=1 ten million, that is 56 hours of g80 and 28 of the truck.
"""

import os

import numpy as np
import pytest

from lpvguard.core.compiled import Core, shipped_vehicle
from lpvguard.drives.frames import Estimator
from lpvguard.vehicle.nominal import NominalModel
from lpvguard.vehicle.project import load_project

FULL = os.environ.get("LPVGUARD_FULL") == "1"
SAMPLES = 10_000_000 if FULL else 300_000
CHUNK = 50_000
BURST, BURST_SAMPLES = 500.0, 200
RELATIVE = 1e-5
"""Of the rms of the output's spectrum in the bin, E + Z: E is a small difference of two such numbers."""


def chunks(project, model):
    """Pieces (k, v, u, y) of one seeded drive, rounded to float; the burst lies in the second piece."""
    rng = np.random.default_rng(8)
    scale = np.array([0.1 * s.max for s in project.inputs])
    low, high = model.speed_range
    for start in range(0, SAMPLES, CHUNK):
        k = start + np.arange(min(CHUNK, SAMPLES - start))
        v = 0.5 * (low + high) * (1 + 0.05 * np.sin(0.003 * k))
        # Steps of random height and length hold every bin's frequency.
        u = scale * np.repeat(rng.standard_normal((len(k) // 10 + 1, model.n_u)), 10, axis=0)[: len(k)]
        y = np.zeros((len(k), model.n_y))
        y[:] = (
            1.2 * model.simulate(v, u, model.output_offset)
            + 0.02 * rng.standard_normal(y.shape) * scale.mean()
        )
        if start == CHUNK:
            u[:BURST_SAMPLES] *= BURST
            y[:BURST_SAMPLES] *= BURST
        yield k, *(a.astype(np.float32).astype(float) for a in (v, u, y))


@pytest.mark.requirement("REQ-CORE-6")
@pytest.mark.parametrize(
    "name", ["g80", pytest.param("truck", marks=pytest.mark.slow("8 s: a core in double"))]
)
def test_float_follows_double_to_the_end(name, record_property):
    project = load_project(name)
    model = NominalModel(project)
    monitors = []
    for double in (False, True):
        core = Core(shipped_vehicle(name), double=double)
        words, reals = core.compiled
        reals = reals.copy()
        for field in ("input_valid", "output_valid"):  # the burst must be taken
            core.fields(reals)[field] *= 1e4
        monitors.append((core, core.monitor(words=words, reals=reals, seal=True)))
    frames = [[], []]
    for k, v, u, y in chunks(project, model):
        for log, (_, monitor) in zip(frames, monitors, strict=False):
            run = monitor.run(k * project.Ts_s, v, u, y)
            assert (run.status == 0).all()
            log.append(run.frames)
    number = {
        key: np.concatenate([getattr(f, key) for f in frames[0]])
        for key in ("bin", "t_end_s", "E", "Z", "counted")
    }
    exact = {
        key: np.concatenate([getattr(f, key) for f in frames[1]])
        for key in ("bin", "t_end_s", "E", "Z", "counted")
    }
    for key in ("bin", "t_end_s", "counted"):
        np.testing.assert_array_equal(number[key], exact[key])
    Ts, longest = project.Ts_s, Estimator.from_project(project, model).length[0]
    burst = (CHUNK * Ts, (CHUNK + BURST_SAMPLES) * Ts)
    recovered = burst[1] + 4 * model.settle_samples * Ts + longest * Ts
    t = exact["t_end_s"]
    before, after = exact["counted"] & (t < burst[0]), exact["counted"] & (t > recovered)
    assert np.abs(exact["Z"][(t >= burst[0]) & (t < recovered)]).max() > 50 * np.abs(exact["Z"][after]).max()
    worst = {}
    for key in ("E", "Z"):
        error = np.abs(number[key] - exact[key])
        for b in range(monitors[0][0].n_bins):
            of_bin = exact["bin"] == b
            rows = of_bin & before
            size = np.sqrt(np.mean(np.abs(exact["E"][rows] + exact["Z"][rows]) ** 2, axis=0))
            rows = np.flatnonzero(of_bin & after)
            assert len(rows) > 50
            relative = error[rows] / size
            assert relative.max() <= RELATIVE, (key, b)
            worst[key] = max(worst.get(key, 0.0), float(relative.max()))
            # No drift: the last tenth errs no more than the first.
            tenth = len(rows) // 10
            assert np.sqrt(np.mean(relative[-tenth:] ** 2)) <= 1.5 * np.sqrt(
                np.mean(relative[:tenth] ** 2)
            ), (key, b)
    record_property("worst_relative_error", worst)
    print(name, SAMPLES, worst)
