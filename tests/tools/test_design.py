"""The scheduled controller: its certificate holds for the coefficients as they stand, and for no others."""

from __future__ import annotations

import json

import numpy as np
import pytest

from lpvguard import design as stage
from lpvguard import generate
from lpvguard import identify as identification
from lpvguard.control_export import load_controller
from lpvguard.errors import InputError
from lpvguard.project import load_project
from lpvguard.synthesis.statespace import StateSpace, lft


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    """The truck identified on few drives."""
    folder, truck = tmp_path_factory.mktemp("truck"), load_project("truck")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(generate, "BOUND_SPEEDS", (8.3, 12.0, 17.0, 21.7))
        patch.setattr(generate, "CALIBRATION_SPEEDS", (10.0,))
        patch.setattr(generate, "ZERO_INPUT_SPEEDS", (12.0, 17.0))
        generate.generate(truck, folder / "drives", truck.seed)
    identification.save(*identification.identify(truck, folder / "drives"), folder / "identify")
    return identification.load(folder / "identify")


@pytest.fixture(scope="module")
def designed(stored, tmp_path_factory):
    result, folder = stage.design(stored), tmp_path_factory.mktemp("design") / "design"
    stage.save(result, stored, folder)
    return result, folder / "controller.json"


def test_robust_performance_is_proved_at_every_node_and_midway(designed):
    result, _ = designed
    assert len(result.certificates) == 2 * len(result.schedule.speeds) - 1
    assert all(proved.lower <= proved.upper * (1 + 1e-9) and proved.upper < 1.2 for _, proved in result.certificates)


def test_the_certificate_is_proved_anew_and_an_altered_coefficient_is_refused(stored, designed, tmp_path):
    _, path = designed
    stage.verify(path, stored)
    document = json.loads(path.read_text())
    random = np.random.default_rng(3)
    for key in ("A", "B", "C"):
        changed = np.array(document[key])
        biggest = np.argsort(np.abs(changed).ravel())[-5:]
        index = np.unravel_index(random.choice(biggest), changed.shape)
        changed[index] *= 1.001
        (tmp_path / "controller.json").write_text(json.dumps({**document, key: changed.tolist()}))
        with pytest.raises(InputError, match="certificate at"):
            stage.verify(tmp_path / "controller.json", stored)


def test_the_certified_controller_is_the_one_the_core_is_given(designed):
    result, path = designed
    coefficients, schedule = load_controller(path), result.schedule
    n = schedule.A.shape[1]
    rows = np.repeat(np.arange(n), np.diff(coefficients.words["row_begin"]))
    A1 = np.zeros((len(schedule.speeds), n, n))
    A1[:, rows, coefficients.words["column"]] = coefficients.reals["A1"]
    v = schedule.speeds[2]
    np.testing.assert_array_equal(schedule.at(v).A, np.eye(n) + A1[2].astype(np.float32).astype(float))
    np.testing.assert_array_equal(schedule.at(v).B, coefficients.reals["B"][2].astype(np.float32).astype(float))


def test_random_deltas_within_the_bound_keep_the_certified_performance(stored, designed):
    """Closed with stable Delta of size at most 1 / mu the norm from disturbances to objectives is at most mu."""
    result, _ = designed
    v, proved = result.certificates[4]
    plant = stage._plant(stored, stage.NominalModel(stored.project), stage._weights(stored, stored.project.design), v, False)
    loop = lft(plant.system, result.schedule.at(v))
    level, random = proved.upper, np.random.default_rng(5)
    omega = np.concatenate([[0.0], np.logspace(-3, np.log10(np.pi / plant.system.dt), 400)])
    for _ in range(50):
        pole, sign = random.uniform(-0.99, 0.99), random.choice([-1.0, 1.0])
        size = sign * (1 - abs(pole)) / level / max(1.0, level)
        delta = StateSpace(np.array([[pole]]), np.eye(1), np.array([[size]]), np.zeros((1, 1)), plant.system.dt)
        M, D = loop.response(omega), delta.response(omega)
        closed = M[:, 1:, 1:] + M[:, 1:, :1] @ (D / (1 - M[:, :1, :1] * D)) @ M[:, :1, 1:]
        assert np.linalg.norm(closed, 2, axis=(1, 2)).max() <= level * (1 + 1e-9)


def test_without_zero_input_drives_or_objectives_the_reason_is_named(stored, g80, identified):
    with pytest.raises(InputError, match=r"no \[design\] table"):
        stage.design(identification.load(identified))
