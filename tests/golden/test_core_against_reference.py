"""Golden vectors: the float core against the double reference, at least 94 dB, also when fed in two
pieces."""

import numpy as np
import pytest
import reference

from lpvguard.drives.frames import Estimator
from lpvguard.drives.tables import read_drive

SNR_DB = 94.0


def snr_db(reference_values: np.ndarray, values: np.ndarray) -> float:
    return 10 * np.log10(
        np.sum(np.abs(reference_values) ** 2) / np.sum(np.abs(values - reference_values) ** 2)
    )


@pytest.fixture(scope="module")
def drive(g80, synthetic):
    return read_drive(synthetic / "synthetic_02.csv", g80)


def check(drive, core, frames, g80, g80_model):
    estimator = Estimator.from_project(g80, g80_model)
    fields = core.fields(core.compiled[1])
    K, W_delta, B_w = core.n_bins, fields["W_delta"][:, 0], fields["B_w"][:, 0]
    yhat = reference.nominal(drive.v, drive.u[:, 0], drive.y[0, 0])
    e = drive.y[:, 0] - yhat
    counted = np.flatnonzero(frames.counted)
    assert len(counted) > 300 and set(frames.bin[counted]) == set(range(K))
    for k in range(K):
        rows = counted[frames.bin[counted] == k]
        N, cycles = int(estimator.length[k]), int(estimator.cycles[k])
        starts = np.round((frames.t_end_s[rows] - drive.t[0]) / g80.Ts_s).astype(int) + 1 - N
        E = np.array([reference.frame(e, s, N, cycles) for s in starts])
        Z = np.array([reference.frame(yhat, s, N, cycles) for s in starts])
        t = np.array([reference.margin(a, b, W_delta[k], B_w[k]) for a, b in zip(E, Z, strict=False)])
        assert snr_db(E, frames.E[rows, 0]) >= SNR_DB, f"E of bin {k}"
        assert snr_db(Z, frames.Z[rows, 0]) >= SNR_DB, f"Z of bin {k}"
        assert snr_db(t, frames.margin[rows]) >= SNR_DB, f"margin of bin {k}"
        np.testing.assert_allclose(
            frames.evidence[rows], np.abs(Z) / (B_w[k] + W_delta[k] * np.abs(Z)), rtol=1e-4
        )


@pytest.mark.requirement("REQ-MON-2")
def test_frames_and_margins_of_the_float_core(drive, core, g80, g80_model):
    reals = core.compiled[1].copy()
    core.fields(reals)["pool_scale"][:] = 0.0  # the evidence is that of frames alone
    check(drive, core, core.monitor(reals=reals, seal=True).run_drive(drive).frames, g80, g80_model)


@pytest.mark.parametrize("cut", [1, 777, 3001])
def test_state_is_carried_over_between_two_pieces(drive, core, cut):
    whole = core.monitor().run_drive(drive)
    monitor = core.monitor()
    parts = [
        monitor.run(drive.t[a:b], drive.v[a:b], drive.u[a:b], drive.y[a:b])
        for a, b in ((0, cut), (cut, None))
    ]
    for name in ("bin", "t_end_s", "margin", "statistic", "evidence", "E", "Z"):
        np.testing.assert_array_equal(
            np.concatenate([getattr(p.frames, name) for p in parts]), getattr(whole.frames, name)
        )
    np.testing.assert_array_equal(np.concatenate([p.verdict for p in parts]), whole.verdict)
