"""The reader of weights.json proves its statements about weights again, and refuses a planted number."""

import json

import numpy as np
import pytest

from lpvguard.base.errors import InputError
from lpvguard.engine.overbound.fit import fit_overbound
from lpvguard.identify.weights import LISTED, FittedWeight, Weights, use_of_weights


@pytest.fixture(scope="module")
def stored() -> dict:
    """weights.json with one weight in every place."""
    omega = np.geomspace(0.3, 30.0, 12)
    bound = 0.2 + 0.8 / (1 + (3.0 / omega) ** 2) + 0.05 * np.cos(5 * np.log(omega))
    one = FittedWeight(fit_overbound(omega, bound, max_order=2), omega, bound)
    lists = {name: [one] for name in LISTED}
    weights = Weights(**lists, gamma_w=one, floored={}, disturbance_set="paper")
    return json.loads(json.dumps(weights.to_dict(), default=np.ndarray.tolist))


def test_what_was_written_is_read_and_written_the_same(stored):
    again = Weights.from_dict(stored, "here").to_dict()
    assert json.loads(json.dumps(again, default=np.ndarray.tolist)) == stored


def test_it_is_said_which_bounds_the_frame_test_uses(stored):
    above = f"at most {stored['W_delta'][0]['worst_ratio_db']:.2f} dB above"
    assert "frame test uses the weights" in use_of_weights(stored) and above in use_of_weights(stored)
    assert "tabulated bounds of the healthy set" in use_of_weights(stored | {"healthy": {}})


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("worst_ratio_db", lambda one: {"worst_ratio_db": one["worst_ratio_db"] - 1e-5}),
        ("lp_optimum_db", lambda one: {"lp_optimum_db": one["worst_ratio_db"] + 1e-5}),
        ("certificate.min_ratio", lambda one: {"min_ratio": one["certificate"]["min_ratio"] * (1 + 1e-6)}),
        ("certificate.max_ratio", lambda one: {"max_ratio": one["certificate"]["max_ratio"] * (1 - 1e-6)}),
        ("certificate", lambda one: {"ok": False}),
        ("certificate", lambda one: {"minimum_phase": False}),
    ],
)
@pytest.mark.parametrize("place", ["W_delta", "gamma_w"])
def test_a_stated_ratio_that_is_not_proved_is_refused(stored, name, change, place):
    altered = json.loads(json.dumps(stored))
    one = altered[place] if place == "gamma_w" else altered[place][0]
    (one["certificate"] if name.startswith("certificate") else one).update(change(one))
    with pytest.raises(InputError, match=rf"here: {place}.*{name}: is not proved"):
        Weights.from_dict(altered, "here")


def test_a_claim_beyond_the_last_frequency_of_a_strictly_proper_weight_is_refused():
    omega, bound = np.geomspace(0.3, 30.0, 8), np.ones(8)
    fit = fit_overbound(omega, bound, max_order=2, proper="strict")
    one = json.loads(json.dumps(FittedWeight(fit, omega, bound).to_dict(), default=np.ndarray.tolist))
    whole = {name: [one] for name in LISTED} | {"gamma_w": one, "floored_rad_s": {}, "inflation": 1.0}
    whole |= {"disturbance_set": "paper"}
    Weights.from_dict(whole, "here")
    one["certificate"]["omega_max"] = "inf"
    with pytest.raises(InputError, match="omega_max: is not proved"):
        Weights.from_dict(whole, "here")
