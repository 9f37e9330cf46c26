"""The energy test of the float core against the double reference, from the weight in s on."""

import numpy as np
import pytest
import reference

from lpvguard.base import artefacts
from lpvguard.drives.tables import read_drive


@pytest.mark.requirement("REQ-MON-14")
def test_the_ratio_of_the_float_core(core, g80, synthetic):
    drive = read_drive(synthetic / "synthetic_02.csv", g80)
    inside = (drive.v >= reference.SPEED[0]) & (drive.v <= reference.SPEED[1])
    first = int(np.argmax(inside))
    end = first + int(np.argmin(np.r_[inside[first:], False]))
    assert end - first > 2000
    manifest = artefacts.read_manifest(core.folder, "vehicle")
    stored, fitted = manifest["energy_test"], manifest["weights"]["W_delta_healthy"][0]["weight"]
    test = {key: np.ravel(stored[key]) for key in ("sigma", "start", "band_radps")}
    test |= {key: stored[key] for key in ("memory_s", "settle_samples")}
    num = np.array(fitted["num"]) * manifest["final_inflation"] * stored["gain"][0]
    yhat = reference.nominal(drive.v[:end], drive.u[:end, 0], drive.y[0, 0])[first:]
    e = drive.y[first:end, 0] - yhat
    wanted = reference.energy_ratios(e, yhat, (num, np.array(fitted["den"])), test)
    run = core.monitor().run(drive.t[:end], drive.v[:end], drive.u[:end], drive.y[:end])
    judged = np.flatnonzero(run.energy != np.r_[0.0, run.energy[:-1]])
    assert len(judged) > 0.5 * (end - first - stored["settle_samples"])
    np.testing.assert_allclose(run.energy[judged], wanted[judged - first], rtol=3e-4)
