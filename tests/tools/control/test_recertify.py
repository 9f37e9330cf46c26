"""A designed controller against sets that grew: proved, proved at lower performance, or not."""

from dataclasses import asdict, replace

import jsonschema
import pytest

from lpvguard import schemas
from lpvguard.base.artefacts import read_json
from lpvguard.base.errors import InputError
from lpvguard.control.controller_file import PresentController
from lpvguard.control.design import design, verify
from lpvguard.control.design import save as save_design
from lpvguard.control.recertify import recertified


def grown(stored, factor: float):
    """The identification with bounds that are ``factor`` times as large."""
    return replace(stored, fitted=replace(stored.fitted, inflation=factor * stored.fitted.inflation))


@pytest.mark.slow("certificates of a truck's controller, a dozen times")
def test_a_controller_is_judged_against_the_set_that_grew(six_node_truck, few_truck_designed):
    _, path = few_truck_designed
    stated = read_json(path)["certificates"]
    same = recertified(path, six_node_truck)
    assert same.verdict == ("proved" if stated["off_grid"]["mu_upper"] < 1 else "proved at lower performance")
    stated_mu = [row["mu_upper"] for row in [*stated["speeds"], stated["off_grid"]]]
    assert [row["mu_after"] for row in same.rows][: len(stated_mu)] == pytest.approx(stated_mu, rel=1e-3)

    jsonschema.validate(asdict(same), schemas.schema("recertification"))

    assert recertified(path, grown(six_node_truck, 1.25)).proved
    more = recertified(path, grown(six_node_truck, 2.0))
    assert more.verdict == "proved at lower performance" and 1 < more.level < 64
    assert max(more.at_level) < 1 <= max(row["mu_after"] for row in more.rows)

    none = recertified(path, grown(six_node_truck, 8.0))
    assert none.verdict == "not proved" and none.level is None and max(none.at_level) >= 1


@pytest.mark.slow("certificates of a truck's controller, margins included")
def test_a_present_controller_that_is_proved_stays(six_node_truck, few_truck_designed, tmp_path):
    wider = grown(six_node_truck, 1.25)
    present = PresentController.from_path(few_truck_designed[1], wider)
    result = design(wider, moving_speed=False, present=present)
    assert result.schedule.digest() == present.schedule.digest()
    assert few_truck_designed[0].worst < result.worst < 1
    save_design(result, wider, tmp_path / "kept")
    verify(tmp_path / "kept" / "controller.json", wider)
    other = six_node_truck.project.design.model_copy(update={"structure": "K_i"})
    project = six_node_truck.project.model_copy(update={"design": other})
    with pytest.raises(InputError, match="structure, Ts_s, inputs, outputs, speeds: are"):
        PresentController.from_path(few_truck_designed[1], replace(six_node_truck, project=project))


@pytest.mark.long("60 s: a design")
def test_a_present_controller_that_is_not_proved_is_designed_anew(six_node_truck, few_truck_designed):
    present = PresentController.from_path(few_truck_designed[1], six_node_truck)
    weak = replace(present, schedule=replace(present.schedule, B=0.5 * present.schedule.B))
    result = design(six_node_truck, moving_speed=False, present=weak)
    assert result.schedule.digest() != weak.schedule.digest() and result.worst < 1
