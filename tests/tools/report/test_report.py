"""The report page: whole, self-contained, the same bytes every time, and saying what was left out and why."""

import copy
import re
from dataclasses import replace

import numpy as np
import pytest
from report_case import DRIVES, LEFT_OUT, Case, vehicle, write_drives

from lpvguard import schemas
from lpvguard.base import artefacts
from lpvguard.base.errors import InputError
from lpvguard.evaluate.comparison import HELD_OUT, LEFT_ONE_OUT
from lpvguard.evaluate.detection import WAY_WORDS
from lpvguard.evaluate.evaluation import evaluate
from lpvguard.identify import identification as stage
from lpvguard.report.page import write_report
from lpvguard.report.sections.campaign import campaign_section
from lpvguard.report.sections.design import design_section
from lpvguard.report.sections.evaluation import evaluation_section
from lpvguard.vehicle.project import parse_project

TITLES = [
    "At a glance",
    "Settings and proofs",
    "Disturbance bound",
    "Weights over the bounds",
    "Model error",
    "Trade-off between disturbance and uncertainty",
    "The nominal model in time",
    "Excitation and what stays invisible",
    "Margin over time and frequency, drive by drive",
]


def without_scripts(page: str) -> str:
    """What a browser without scripts shows."""
    return re.sub(r"<script.*?</script>", "", page, flags=re.DOTALL)


@pytest.mark.unhurried
def test_the_window_error_is_shown_per_bin(case, page):
    text = page[page.index("<h3>Window error</h3>") :]
    shown = re.findall(r"<td>([^<]*)</td>", text[: text.index("</table>")])
    for key, row in (
        ("window_error_median", shown[1:]),
        ("window_error_percentile", shown[len(shown) // 2 + 1 :]),
    ):
        np.testing.assert_allclose(
            [float(x) for x in row[: case.replayer.estimator.n_bins]], case.stored.bounds[key], rtol=0.06
        )


@pytest.mark.long("11 s: an identification and two pages")
def test_bounds_of_the_plain_dft_have_a_page_without_a_core(tmp_path):
    document = vehicle(1).model_dump(by_alias=True)
    document["frames"] |= {"estimator": "dft", "length_s": 8.0}
    document["name"] = "plain"
    project = parse_project(document, "test")
    write_drives(project, tmp_path / "drives")
    result, drives = stage.identify(project, tmp_path / "drives")
    stage.save(result, drives, tmp_path / "identified")
    for name in ("a.html", "b.html"):
        write_report(stage.load(tmp_path / "identified"), drives, None, tmp_path / name, None, lambda _: None)
    text = (tmp_path / "a.html").read_text()
    assert text == (tmp_path / "b.html").read_text()
    assert re.findall("<h2>(.*?)</h2>", text) == [*TITLES[:-1], "Margin drive by drive"]
    assert "one rectangular frame of 8 s a drive" in text and "the core computes Hann frames only" in text
    assert "Hann window" not in text and "<h3>Window error</h3>" in text
    rows = dict(re.findall(r"<tr><td>(\w+)</td><td>robot</td>.*?<td>([^<]*)</td><td>[^<]*</td></tr>", text))
    assert set(rows) == {name for name, *_ in DRIVES} and rows[LEFT_OUT] == "–"
    assert all(0 < float(rows[name]) <= 1 for name in result.bound_drives)


@pytest.mark.unhurried
def test_has_every_section_in_order(page):
    assert re.findall("<h2>(.*?)</h2>", page) == TITLES
    markup = without_scripts(page)
    assert markup.count("<svg") == markup.count("</svg>") >= 2 * len(DRIVES) + 5
    for figure in ("Fig. 2", "Fig. 3", "Fig. 4"):
        assert f"Counterpart of {figure}" in page


@pytest.mark.unhurried
def test_needs_nothing_from_outside(page):
    markup = without_scripts(page)
    assert not re.search(
        r"https?:|//[a-z]|<script|<link|<iframe|@import|javascript:", re.sub(r"base64,[^\"]*", "", markup)
    )
    assert set(re.findall(r'(?:href|src)="(data:|#)?', markup)) <= {"data:", "#"}
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', page)
    assert policy and policy.group(1).startswith("default-src 'none';") and "http" not in policy.group(1)


@pytest.mark.unhurried
def test_references_within_the_page_resolve_and_are_unique(page):
    markup = without_scripts(page)
    ids = re.findall(r' id="([^"]+)"', markup)
    assert len(ids) == len(set(ids))
    assert set(re.findall(r'(?:href="|url\()#([^")]+)', markup)) <= set(ids)


@pytest.mark.slow("5 s: another page")
def test_same_input_gives_the_same_bytes(case, page, tmp_path):
    assert case.page(tmp_path / "again.html") == page.encode()
    assert [p.name for p in tmp_path.iterdir()] == ["again.html"]


@pytest.mark.unhurried
def test_names_every_drive_with_its_part_and_those_left_out_with_their_reason(case, page):
    assert case.stored.manifest["drives"]["left_out"], "the case must leave a drive out"
    for name, reason in case.stored.manifest["drives"]["left_out"].items():
        assert f"{name}: {reason}" in page
        assert f"left out: {reason}" in page
    for name in case.drives.experiments:
        assert f"<h3>{name} " in page


@pytest.mark.unhurried
def test_alarms_are_listed_with_their_evidence(case, page):
    replay = case.replayer.replay(case.drives.load("weak")[0])
    assert replay.alarms, "half the gain must alarm"
    first = replay.alarms[0]
    assert f"<td>{first.t_s:.2f}</td><td>frame</td>" in page
    assert "alarm at, s" in page


def campaign_of_two_severities() -> dict:
    """The example of the format, with numbers that can be told apart."""
    example = schemas.example("campaign")
    detectors = example["detectors"] | {"nis": "NIS"}
    seen = {"count": 1, "of": 50, "interval": [0.0005, 0.1065]}

    def each(value: object) -> dict:
        return dict.fromkeys(detectors, value)

    known = example["severities"][0] | {"severity": 0.5, "runs": 4, "found": each(4), "mu_upper": 2.345}
    unstable = known | {"severity": 0.7, "found": each(1), "mu_upper": None, "loop_stable": False}
    calibrated = {
        test: numbers | {"claim": f"alpha 0.05 from {drives} drives"}
        for (test, numbers), drives in zip(example["calibrated"].items(), (25, 0, 24), strict=True)
    }
    calibrated["energy"] = dict.fromkeys(calibrated["energy"]) | {
        "claim": "alpha is not stated",
        "threshold": 1.1,
    }
    average = each({"calibrated": 0.5, "matched": 0.25})
    rates = seen | {
        "per_hour": {"rate": 0.4, "interval": [0.01, 2.23]},
        "per_judged_hour": {"rate": 0.5, "interval": [0.0127, 2.79]},
        "alarms": 3,
    }
    lost = {"kind": "GUARD_IN lost", "severity": 0.5, "runs": 4, "as_required": 3, "due": 77, "met": 76}
    return example | {
        "detectors": detectors,
        "units": {"brake gain": "×", "GUARD_IN lost": "of the frames"},
        "baselines": [example["baselines"][0] | {"label": "rms, 2 s"}],
        "calibrated": calibrated,
        "due": seen,
        "visible": each(seen),
        "average": average,
        "ways": {"ramp": {"runs": 4, "average": average, "median_s": each(2.5)}},
        "matched_stated": each(0.05),
        "matched_claim": "equal false alarms in the loop",
        "within": example["within"] | {"alarmed": each(seen), "tests": dict.fromkeys(calibrated, rates)},
        "falsified": {"rate": {"count": 0, "of": 50, "interval": [0.0, 0.0711]}, "runs": []},
        "supervision": {kind: {"as_required": seen, "due": 77, "met": 76} for kind in ("faulty", "healthy")},
        "bus": [example["bus"][0] | lost | {"away": 0.125}],
        "beaten": [{"kind": "brake gain", "detector": "nis", "matched": 0.5, "monitor": 0.25}],
        "severities": [known, unstable],
        "invisible": [unstable],
        "kinds": [example["kinds"][0] | {"best": ["monitor", "nis"]}],
    }


@pytest.mark.long("8 s: another page")
def test_a_campaign_is_told_with_every_severity_and_whoever_was_best(case, tmp_path):
    summary = campaign_of_two_severities()
    write_report(
        case.stored,
        case.drives,
        case.replayer,
        tmp_path / "report.html",
        None,
        lambda _: None,
        campaign=summary,
    )
    text = without_scripts((tmp_path / "report.html").read_text())
    assert (
        "Campaign in the closed loop" in text
        and "1 of 50, 0.05 to 10.65 %" in text
        and "lpvguard, NIS" in text
    )
    assert (
        "frame test: alpha 0.05 from 25 drives; energy test: alpha is not stated; "
        "change test: alpha 0.05 from 24 drives." in text
    )
    assert "brake gain 0.7 × (mu unstable, found 1 of 4)" in text and "2.34" in text and "rms, 2 s" in text
    assert text.count("Detection against severity") == 2
    assert "50.0%, 25.0%, 2.50 s" in text
    assert text.count("equal false alarms in the loop") >= 4 and "counts only" not in text
    (falsifying,) = schemas.example("campaign")["falsified"]["runs"]
    summary |= {
        "matched_stated": {**summary["matched_stated"], "nis": None},
        "matched_claim": "counts only: too few runs",
        "falsified": {
            "rate": {"count": 1, "of": 50, "interval": [0.0005, 0.1065]},
            "runs": [falsifying | {"number": 7, "seed": 99, "did": ["oscillates at 9.11 rad/s"]}],
        },
    }
    section = campaign_section(summary)
    assert "equal" not in section and "<td>counts only</td>" in section
    assert "Falsified certificates: 0 of 50, 0.00 to 7.11 %" in text and "contradiction" not in text
    assert "3 frequencies from 0.02 to 60 rad/s, at 8, 22 m/s, 0.25 to 2.06 bar" in text
    assert (
        section.index("Falsified certificates: 1 of 50") < section.index("oscillates") < section.index("h of")
    ), "first in its section"
    assert "<td>7</td><td>99</td><td>0</td><td>21.40</td><td>oscillates at 9.11 rad/s</td>" in section
    assert (
        "NIS on brake gain, 50% against 25%" in text
        and "0.40, 0.01 to 2.23" in text
        and "0.50, 0.01 to 2.79" in text
        and "10.50 %" in text
    )
    assert (
        "<td>GUARD_IN lost</td><td>0.5 of the frames</td><td>3 of 4</td><td>77, 76</td><td>12.5%</td>" in text
    )


@pytest.mark.long("15 s: an evaluation and two more pages")
def test_evaluation_and_a_core_of_another_identification_are_told(case, page, tmp_path):
    assert "carries the numbers of this identification" in page
    stored = stage.load(case.stored.folder)
    name, numbers = next(iter(stored.coefficients.reals.items()))
    stored.coefficients.reals[name] = np.asarray(numbers) * 1.01
    evaluation = evaluate(case.stored, case.drives, case.replayer.core)
    plain = evaluation_section(evaluation)
    assert (
        plain.count("no drive qualifies") == 2  # a line of the summary, a row of the table
        and all(row["fault"] in plain for row in evaluation["faults"])
        and "Time to find" not in plain
    )
    assert "30.0 s long, no more than 120 s" in plain and LEFT_OUT + ": no frame counts" in plain
    assert "alpha is not stated: too few calibration drives (1)" in plain and "(2)" in plain
    assert (
        "<td>counts only</td>" in plain and "guaranteed" not in plain and "compared\nby counts only" in plain
    )
    assert (
        "<th>last piece, s</th>" in plain and "<td>30.0</td>" in plain and "alarmed drives, no fault" in plain
    )
    stated = dict.fromkeys(evaluation["stated_rates"], 0.1) | {"exported": 0.2}
    equal = evaluation_section(evaluation | {"stated_rates": stated})
    assert (
        equal.count("one guaranteed rate") == 2
        and "counts only" not in equal
        and "together allow at most 0.2" in equal
    )
    # No drive is long enough for injected faults here: made-up cases make the picture.
    cases = [{"run": "check", "start_s": 61.0, "s": 2.0}, {"run": "weak", "start_s": 62.0, "s": None}]
    evaluation["faults"] = [
        row
        | {
            "drives": 2,
            "drives_found": 1,
            "counted": 2,
            "untouched_alarms": 1,
            "found": 1,
            "median_s": 2.0,
            "cases": cases,
            "best": ["rms"],
        }
        for row in evaluation["faults"]
    ]
    text = Case(stored, case.drives, case.replayer).page(tmp_path / "report.html", evaluation).decode()
    text = without_scripts(text)
    assert "carries other numbers than this identification" in text
    assert re.findall("<h2>(.*?)</h2>", text) == [*TITLES, "Evaluation, leave one drive out"]
    assert "<td>1 of 2</td>" in text and "Time to find" in text and "1 of 2 (1 of 2), 2.00 s" in text
    assert "lead alone: step: output × 0.6 (residual RMS);" in text
    assert "behind on" in text and "<th>refutable</th>" in text
    for row in evaluation["faults"]:
        assert f"{WAY_WORDS[row['way']]}: {row['fault']}" in text
    assert "Each left out of its own threshold: " in text
    claims = evaluation["claims"] | {HELD_OUT: evaluation["claims"][LEFT_ONE_OUT]}
    evaluation |= {"mode": HELD_OUT, "claims": claims}
    held_out = case.page(tmp_path / "held_out.html", evaluation).decode()
    assert "Drives that the identification never saw: " in held_out
    assert "Each left out of its own threshold: " not in held_out


@pytest.mark.long("6 s: another page")
def test_a_weight_that_is_nearest_its_bound_at_infinity_is_shown(case, page, tmp_path):
    weights = copy.deepcopy(case.stored.weights)
    weights["W_delta"][0]["certificate"]["min_ratio_at"] = "inf"  # as Certificate.to_dict writes it
    other = replace(case, stored=replace(case.stored, weights=weights)).page(tmp_path / "report.html")
    assert other.decode().count("<td>∞</td>") == page.count("<td>∞</td>") + 1


def test_the_design_section_tells_true_margins_where_they_lie_beside_it(tmp_path):
    folder, truth = tmp_path / "design", schemas.example("robust")
    folder.mkdir()
    certificates = schemas.example("controller")["certificates"]
    (folder / "controller.json").write_text(artefacts.to_json({"certificates": certificates}))
    assert "what is promised" not in design_section(folder)
    truth |= {"coefficients_sha256": certificates["coefficients_sha256"], "beyond": 1}
    true = truth["true"][0]
    true["deviations"][0] |= {"ratio": 1.25, "delta": 0.75, "W_delta": 0.6, "omega_rad_s": 7.5}
    true["margins"]["gain_up"] |= {"value": 1.625}
    truth["true"].append(true | {"unstable_poles": 2, "margins": None, "deviations": []})
    (tmp_path / "robust.json").write_text(artefacts.to_json(truth))
    text = design_section(folder)
    name = true["deviations"][0]["output"]
    assert f'{name} <span class="no">1.25</span>: 0.75 against 0.6 at 7.5 rad/s' in text
    assert "<td>1.62</td>" in text and '<span class="no">unstable</span>' in text and "1 of 2 ratios" in text
    (tmp_path / "robust.json").write_text(artefacts.to_json(truth | {"coefficients_sha256": "0" * 64}))
    with pytest.raises(InputError, match="another controller"):
        design_section(folder)
