"""The confirmation of the frame test: the core's statistics, the compared designs, the chosen one."""

import numpy as np
import pytest

from lpvguard import schemas
from lpvguard.base.layout import COEFF
from lpvguard.drives.faults import Fault, inject
from lpvguard.drives.frames import Estimator
from lpvguard.drives.tables import read_drive
from lpvguard.identify import confirmation as stage
from lpvguard.identify.calibration import Recordings
from lpvguard.identify.confirmation import DESIGNS, ERRORS, Confirmation, Confirmed
from lpvguard.report.sections.confirmation import confirmation_section
from lpvguard.vehicle.nominal import NominalModel


def test_the_kth_largest_of_the_last_scores_by_hand():
    scores = np.array([[3.0, 1.0, 2.0, 5.0]])
    assert stage.confirmed(scores, 1, 1).tolist() == scores.tolist()
    assert stage.confirmed(scores, 2, 2).tolist() == [[-np.inf, 1.0, 1.0, 2.0]]
    assert stage.confirmed(scores[0], 2, 3).tolist() == [-np.inf, 1.0, 2.0, 2.0]


@pytest.mark.parametrize("design", DESIGNS)
def test_the_statistics_are_those_of_the_core(core, synthetic, g80, design):
    drive = inject(read_drive(synthetic / "synthetic_01.csv", g80), Fault("gain", 0.5), 70.0, g80.Ts_s)
    words = core.compiled[0].copy()
    fields = COEFF.split("words", words, core.sizes)
    fields["confirm"][:], fields["of_last"][:] = design
    frames = core.monitor(words=words, seal=True).run_drive(drive).frames
    counted = frames.counted
    ours = stage.statistics(frames.bin[counted], frames.margin[counted], [design])[design]
    np.testing.assert_array_equal(ours, frames.statistic[counted])


def rated(project, **settings):
    """The project with a rate of 1000 alarms in 1000 h for each of four tests, and with ``settings``."""
    update = {"alarms_per_1000_h": 4000.0, **settings}
    return project.model_copy(update={"frame_test": project.frame_test.model_copy(update=update)})


def test_gain_errors_begin_at_instants_and_are_reached_in_time(core, synthetic, g80):
    project = rated(g80)
    drive = read_drive(synthetic / "synthetic_01.csv", g80)
    length = Estimator.from_project(g80, NominalModel(g80)).length
    reals = core.compiled[1]
    judged = stage.judged_drive(core, reals, drive, project, length, DESIGNS, planted=True)
    frames = core.monitor().run_drive(drive).frames
    assert judged.maxima[0].max() == frames.margin[frames.counted].max()
    assert 0 < judged.judged_s <= drive.duration_s
    assert judged.reached.shape == (g80.evaluation.starts, len(ERRORS), len(DESIGNS) + 2, stage.DELAYS)
    assert (np.diff(judged.reached, axis=-1) >= 0).all()
    at_once = judged.reached[:, -1, 0, -1]
    assert (at_once > 2 * judged.reached[:, 0, 0, -1]).all()
    assert (judged.reached[..., 0, :] >= judged.reached[..., 1, :]).all()
    none = stage.judged_drive(core, reals, drive, project, length, DESIGNS, planted=False)
    assert len(none.reached) == 0 and (none.maxima == judged.maxima).all()


def drives(floor: dict[int, float], rise: dict[int, float]) -> dict[str, Confirmed]:
    """Twenty drives of a quarter of an hour whose tests have the maxima ``floor``, and with an error g the
    statistics ``rise`` times g."""
    n = max([7, *(i + 1 for i in rise)])
    slope = np.array([rise.get(i, 1.0) for i in range(n)])
    reached = np.tile((ERRORS[:, None] * slope)[None, :, :, None], (2, 1, 1, stage.DELAYS))
    reached[..., : stage.DELAYS // 2] = 0.0
    maxima = np.tile(np.array([floor.get(i, 2.0) for i in range(n)])[:, None], (1, 30))
    return {f"d{k:02}": Confirmed(maxima * (1 - 0.001 * k), 900.0, reached) for k in range(20)}


def compared(project, **made) -> Confirmation:
    return Confirmation.compared(project, stage.designs_of(project), drives(**made), Recordings())


def test_the_design_is_chosen_that_finds_the_smallest_error(g80):
    of_three = compared(rated(g80), floor={0: 8.0, 1: 6.0}, rise=dict.fromkeys(range(7), 10.0))
    assert of_three.chosen == (2, 6)  # the first of equals
    chosen = of_three.of_project(g80).frame_test
    assert (chosen.confirm, chosen.of_last) == (2, 6)
    rows = {r["label"]: r for r in of_three.rows}
    assert rows["2 of 6"]["threshold"] == pytest.approx(2.0, rel=0.05)
    least = rows["2 of 6"]["least"]
    assert least == min(e for e in ERRORS if 10 * e > rows["2 of 6"]["threshold"])
    assert of_three.shown == rows["1 of 1"]["least"] > rows["2 of 2"]["least"] > least
    at = of_three.rates.index(4000.0)
    delay = of_three.within_s * (stage.DELAYS // 2 + 1) / stage.DELAYS
    assert rows["3 of 3"]["delay_by_rate"][at] == pytest.approx(delay)
    assert "confirmation: 2 of 6 frames, chosen" in of_three.sentence()
    assert Confirmation.from_dict(of_three.to_dict()) == of_three


def test_a_single_frame_stays_where_nothing_finds_less(g80):
    blind = compared(rated(g80), floor={}, rise=dict.fromkeys(range(7), 0.0))
    assert blind.chosen == (1, 1) and blind.rows[0]["least"] is None
    assert "finds no gain error within 30 s" in blind.sentence()
    short = {n: d._replace(reached=d.reached[:0]) for n, d in drives({}, {}).items()}
    none = Confirmation.compared(rated(g80), DESIGNS, short, Recordings())
    assert none.chosen == (1, 1) and none.starts == 0 and none.rows[0]["delay_by_rate"] == [None] * 8


def test_a_stated_design_is_kept(g80):
    project = rated(g80, confirm=2, of_last=4)
    own = compared(project, floor={5: 8.0}, rise=dict.fromkeys(range(8), 10.0))
    assert own.chosen == (2, 4) and own.stated and own.rows[5]["label"] == "2 of 4"
    assert "2 of 4 frames, as the project states" in own.sentence()


def test_the_page_shows_the_choice_and_the_trade_off():
    section = confirmation_section(Confirmation.from_dict(schemas.example("confirmation")))
    assert "promised alarms in 1000 h" in section and "<td>2 of 6</td>" in section
    assert "confirmation: 1 of 1 frames, chosen" in section
