"""The premise of certificates: a W_delta that is too small is refused by drives that did not set it."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lpvguard.base import artefacts
from lpvguard.base.errors import InputError
from lpvguard.control import design as step8
from lpvguard.control.frozen import FrozenProblem
from lpvguard.control.plants import DesignProblem, design_settings
from lpvguard.drives.frames import Estimator
from lpvguard.identify import identification as identification
from lpvguard.identify.premise import Least, Premise, premise, require_premise, weight_met
from lpvguard.identify.weights import Weights, energy_filters
from lpvguard.vehicle.nominal import NominalModel

JUDGED = "W_delta = .* times .delta_c. - k se = .* rad/s and .* m/s"


@pytest.fixture(scope="module")
def stored(identified) -> identification.StoredIdentification:
    return identification.load(identified)


def scaled(stored, factor: float):
    """The identification with W_delta times ``factor``."""
    fitted = replace(stored.fitted, inflation=factor * stored.fitted.inflation)
    return replace(stored, fitted=fitted)


def asking(stored, share: float):
    """The identification with a judging estimate of ``share`` times W_delta at one place, and k se a tenth of
    it; and the place."""
    judging = stored.model_error.judging
    g = int(np.argmax(np.isfinite(judging.se).any(axis=(1, 2, 3))))
    at = (g, 0, *np.argwhere(np.isfinite(judging.se[g, 0]))[0])
    size = share * float(weight_met(stored, stored.model_error.grid.omega[[g]])[0, 0])
    delta, se = np.full_like(judging.delta, np.nan), np.full_like(judging.se, np.nan)
    delta[at], se[at] = size, 0.1 * size
    alone = replace(judging, delta=delta, se=se)
    se[at] /= alone.k
    return replace(stored, model_error=replace(stored.model_error, judging=alone)), at


def test_the_drives_that_judge_do_not_refute_what_was_identified(stored):
    judged = require_premise(stored)
    assert not judged.refuted and judged.folds == len(stored.manifest["drives"]["bounds"])
    assert "W_delta" in judged.sentence() and "that the bound of the other folds covers" in judged.sentence()
    document = json.loads(artefacts.to_json(judged.to_dict()))
    assert (
        document["doubting"]["ratio"] == judged.doubting.ratio and document["sentence"] == judged.sentence()
    )


def test_a_weight_that_is_too_small_is_refused_with_frequency_and_both_numbers(stored):
    small = scaled(stored, 1e-3)
    judged = premise(small)
    assert judged.refuted and judged.doubtful
    least = judged.refuting
    assert least.W_delta == pytest.approx(weight_met(small, np.array([least.omega]))[0, 0])
    assert least.ratio == pytest.approx(least.W_delta / (least.delta - least.spread))
    with pytest.raises(InputError, match=JUDGED) as refused:
        require_premise(small)
    for value in (least.omega, least.W_delta, least.delta):
        assert f"{value:.3g}" in str(refused.value)


@pytest.mark.parametrize(
    ("share", "refuted", "doubtful"), [(1.2, True, True), (1.0, False, True), (0.8, False, False)]
)
def test_between_the_two_the_gate_warns(stored, share, refuted, doubtful):
    """W_delta beside 0.9 and 1.1 times ``share`` of it."""
    one, at = asking(stored, share)
    judged = premise(one)
    assert (judged.refuted, judged.doubtful) == (refuted, doubtful)
    assert judged.refuting.ratio == pytest.approx(1 / (0.9 * share))
    assert judged.doubting.ratio == pytest.approx(1 / (1.1 * share))
    assert judged.doubting.omega == stored.model_error.grid.omega[at[0]]
    assert judged.doubting.v == stored.model_error.judging.v[at]


def test_what_cannot_tell_is_no_objection(stored):
    """k se of 1 and more: a vehicle that does not respond would not have been refuted."""
    one, at = asking(stored, 50.0)
    judging = one.model_error.judging
    judging.se[at] = 1.01 / judging.k
    with pytest.raises(InputError, match="gives information about the model error"):
        premise(one)


def test_the_console_warns_where_the_evidence_leaves_room(stored, monkeypatch, capsys):
    from lpvguard.cli import tables

    said = []
    monkeypatch.setattr(tables.console, "print", lambda text, **_: said.append(text))
    tables.print_premise(premise(asking(stored, 1.0)[0]))
    assert len(said) == 2 and said[1].startswith("warning: W_delta = ")
    said.clear()
    tables.print_premise(premise(asking(stored, 0.5)[0]))
    assert len(said) == 1 and said[0].startswith("premise |delta| <= W_delta")


def test_without_drives_that_judge_the_gate_is_shut(stored):
    blind = replace(stored, model_error=replace(stored.model_error, judging=None))
    with pytest.raises(InputError, match="no drive judges W_delta"):
        premise(blind)


def test_a_drive_alone_says_that_none_was_left_out():
    least = Least(1.1, "yaw_rate", 1.0, 10.0, 0.5, 0.1, 0.44)
    assert "none, because there is only one" in Premise(None, least, float("nan"), 0).sentence()
    assert "need no uncertainty" in Premise(None, least, 1.0, 4).sentence()


# ------------------------------------------------------------------------------- the truck's identification


@pytest.fixture(scope="module")
def truck_stored(few_truck_identified) -> identification.StoredIdentification:
    return identification.load(few_truck_identified)


def shrunk(folder: Path, target: Path, factor: float) -> Path:
    """A copy of an identification with W_delta and what it was fitted above times ``factor``, sealed anew."""
    project = identification.load(folder).project
    shutil.copytree(folder, target)
    weights = artefacts.read_json(target / "weights.json")
    for entry in weights["W_delta"]:
        entry["weight"]["num"] = [factor * x for x in entry["weight"]["num"]]
        entry["bound"] = [None if b is None else factor * b for b in entry["bound"]]
    (target / "weights.json").write_text(artefacts.to_json(weights))
    estimator = Estimator.from_project(project, NominalModel(project))
    filters = energy_filters(project, estimator, Weights.from_dict(weights, "here")).to_dict()
    energy = artefacts.read_json(target / "energy.json")
    energy |= {name: filters[name] for name in ("gain", "certificate")}
    (target / "energy.json").write_text(artefacts.to_json(energy))
    artefacts.seal(target)
    return target


def test_design_refuses_an_identification_whose_weights_were_scaled_down(truck_stored, tmp_path, lpvguard):
    small = shrunk(truck_stored.folder, tmp_path / "idn", 0.2)
    done = lpvguard("design", "--vehicle", "truck", small, "--no-table", "-o", tmp_path / "out")
    assert done.returncode == 2 and "W_delta" in done.stderr and "do not refute" in done.stderr
    assert "rad/s" in done.stderr and not (tmp_path / "out").exists()


def test_design_without_drives_that_judge_is_refused(truck_stored):
    blind = replace(truck_stored, model_error=replace(truck_stored.model_error, judging=None))
    with pytest.raises(InputError, match="no drive judges W_delta"):
        step8.design(blind)


def test_one_structure_goes_from_identification_to_certificate(truck_stored):
    """S1_diagonal and K_o: as many Deltas in the bounds, the frame margin, the energy test, the
    interconnection and the certificate; any other pair is refused."""
    project, fitted = truck_stored.project, truck_stored.fitted
    settings = design_settings(truck_stored)
    assert (project.bounds.structure, settings.structure) == ("S1_diagonal", "K_o")
    model = NominalModel(project)
    estimator = Estimator.from_project(project, model)
    deltas = project.n_delta
    assert deltas == 2 == truck_stored.bounds["nu"].shape[1] == len(fitted.W_delta)
    assert truck_stored.model_error.bound.shape[1] == deltas
    assert fitted.at(estimator.omega)[0].shape[1] == deltas
    assert truck_stored.energy.W.shape[0] == deltas
    plant = DesignProblem.from_identification(truck_stored).plant(15.0)
    assert [(b.rows, b.cols) for b in plant.blocks] == [(1, 1)] * deltas
    # The weights in the interconnection are those of the identification, times the inflation.
    weights, omega = DesignProblem(truck_stored, settings).weights, np.array([0.1, 2.0, 20.0])
    for W, own in zip(weights.W_delta_o, fitted.W_delta, strict=True):
        np.testing.assert_allclose(
            np.abs(W.response(omega)[:, 0, 0]), fitted.inflation * own.magnitude(omega), rtol=1e-9
        )
    for structure in ("K_i", "K_is"):
        with pytest.raises(InputError, match=r"S1_diagonal with design\.structure"):
            _ = DesignProblem(truck_stored, settings.model_copy(update={"structure": structure})).weights
    common = replace(truck_stored, fitted=replace(fitted, W_delta=fitted.W_delta[:1]))
    with pytest.raises(InputError, match="the same uncertainty for bounds and design"):
        _ = DesignProblem(common, settings).weights
    with pytest.raises(InputError, match="2 Deltas, one per output; expected S0 or S1"):
        FrozenProblem(truck_stored, None)
