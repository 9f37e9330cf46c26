"""Pictures from Python: the numbers of the page's pictures, shown by a notebook, written as SVG and CSV."""

import csv
import io
import json
import xml.etree.ElementTree as xml

import numpy as np
import pytest

import lpvguard
from lpvguard import plots
from lpvguard.cli.shared import stored_with_drives
from lpvguard.report.blindness import BLIND, VIOLATED
from lpvguard.report.page import write_report
from made import ROOT


@pytest.fixture(scope="module")
def identification(identified):
    return lpvguard.load(identified)


@pytest.fixture(scope="module")
def run(vehicle, synthetic):
    return lpvguard.replay_drive("g80", synthetic / "synthetic_01.csv", coefficients=vehicle)


@pytest.fixture(scope="module")
def weak(vehicle, synthetic, tmp_path_factory):
    """A run at which the core alarms."""
    import pandas

    path = tmp_path_factory.mktemp("weak") / "weak drive.csv"
    table = pandas.read_csv(synthetic / "synthetic_01.csv")
    table.assign(r=1.6 * table.r).to_csv(path, index=False)
    return lpvguard.replay_drive("g80", path, coefficients=vehicle)


def ids(svg: str) -> set[str]:
    """Ids of an SVG file, which must be one."""
    return {e.attrib["id"] for e in xml.fromstring(svg).iter() if "id" in e.attrib}


@pytest.mark.long("20 s: every picture of a page")
def test_they_have_the_numbers_of_the_pages_pictures(
    identification, vehicle, synthetic, identified, tmp_path
):
    stored, drives = stored_with_drives(identified, synthetic)
    runs = [lpvguard.replay_drive("g80", e.path, coefficients=vehicle) for e in drives.experiments.values()]
    pictures = tmp_path / "pictures"
    write_report(
        stored, drives, runs[0].replayer, tmp_path / "page.html", None, lambda _: None, pictures=pictures
    )
    same = {
        "f2": plots.disturbance(identification),
        "f3": plots.weights(identification),
        "model-error": plots.model_error(identification),
        "front": plots.front(identification),
        "f5": plots.excitation(identification, *runs),
        **{f"d{i}": plots.margins(run) for i, run in enumerate(runs)},
    }
    for name, picture in same.items():
        assert picture.csv == (pictures / f"{name}.csv").read_text(), name
    shown = plots.blind(identification, *runs)
    body = shown.page.partition("<body>")[2].partition("<script>")[0].strip()
    assert body.startswith('<figure class="map">') and body in (tmp_path / "page.html").read_text()


@pytest.mark.slow("2 s: pictures")
def test_a_notebook_shows_them_and_files_hold_them(identification, run, tmp_path):
    picture = plots.weights(identification)
    picture.save(tmp_path / "weights.svg")
    picture.save(tmp_path / "weights.csv")
    assert (tmp_path / "weights.svg").read_text() == picture._repr_svg_()
    assert (tmp_path / "weights.csv").read_text() == picture.csv and picture.csv.count("\n") > 100
    with pytest.raises(lpvguard.InputError, match=r"\.svg or \.csv"):
        picture.save(tmp_path / "weights.png")
    # Pictures of one notebook share its ids: none may mean two things.
    both = ids(picture._repr_svg_()), ids(plots.disturbance(identification)._repr_svg_())
    assert both[0] and both[1] and not both[0] & both[1]
    assert plots.weights(identification).svg == picture.svg


def test_the_model_in_time_is_the_stretch_that_was_asked_for(run):
    rows = list(csv.DictReader(io.StringIO(plots.in_time(run, 10.0, 20.0).csv)))
    t = [float(x) for row in rows if "measured" in row.values() for x in [row["x"]]]
    inside = run.series[(run.series.t >= 10) & (run.series.t <= 20)]
    assert len(t) == len(inside) == 501 and min(t) == 10 and max(t) == 20
    y = [float(row["y"]) for row in rows if "measured" in row.values()]
    assert y == pytest.approx(inside.yaw_rate.tolist(), rel=1e-4)
    with pytest.raises(lpvguard.InputError, match="no two samples"):
        plots.in_time(run, 1e6)


def test_the_map_says_where_the_model_is_blind_and_where_a_run_violated_it(identification, weak, tmp_path):
    quiet, loud = plots.blind(identification), plots.blind(identification, weak)
    cells = [c for row in loud.cells for c in row]
    of_frames = [a for a in weak.alarms if a.test == "frame"]
    assert sum(c.alarms for c in cells) == len(of_frames) > 0
    assert not any(c.state == VIOLATED for row in quiet.cells for c in row)
    loud.save(tmp_path / "map.csv")
    rows = list(csv.DictReader((tmp_path / "map.csv").open()))
    assert [row["state"] for row in rows] == [c.state for c in cells] and BLIND in {c.state for c in cells}
    assert np.allclose([float(row["omega"]) for row in rows], [c.omega for c in cells])
    shown = loud._repr_html_()
    assert (
        shown.startswith("<iframe")
        and "http:" not in shown
        and "https:" not in shown
        and "&lt;script&gt;" in shown
    )
    loud.save(tmp_path / "map.html")
    assert (tmp_path / "map.html").read_text() == loud.page
    with pytest.raises(lpvguard.InputError, match=r"\.html or \.csv"):
        loud.save(tmp_path / "map.svg")


def test_a_drive_whose_name_is_no_id_is_drawn(weak):
    svg = plots.margins(weak)._repr_svg_()
    assert ids(svg) and not any(" " in name for name in ids(svg))


@pytest.mark.unhurried
def test_the_pictures_of_files_have_their_numbers(tmp_path):
    omega, size = [0.1, 1.0, 10.0], [0.03, 0.02, 0.01]
    fig5 = {"omega_rad_s": omega, "signals": [["W_C", size, "rad/s"]], "objectives": [["W_t", size]]}
    (tmp_path / "figures.json").write_text(json.dumps({"fig5": fig5 | {"command": None}}))
    drawn = plots.design(tmp_path)
    assert set(drawn) == {"fig5"} and ids(drawn["fig5"]._repr_svg_())
    rows = list(csv.DictReader(io.StringIO(drawn["fig5"].csv)))
    assert [float(row["y"]) for row in rows] == size + size
    with pytest.raises(lpvguard.InputError, match="a folder of `lpvguard design`"):
        plots.design(tmp_path.parent)
    examples = ROOT / "tools/src/lpvguard/schemas/examples"
    assert len(plots.evaluation(examples / "evaluate.json").panels) == 1
    with pytest.raises(lpvguard.InputError, match=r"results of lpvguard\.replay"):
        plots.excitation(None)


@pytest.mark.unhurried
def test_the_pictures_of_a_campaign_and_of_a_simulation_have_their_numbers(tmp_path):
    rows = [
        {"kind": "gain", "severity": x, "runs": 10, "visible_runs": 10, "found": {"monitor": n}}
        | {"matched": {"monitor": n + 1}, "median_s": {"monitor": 10.0 / n}}
        for x, n in ((0.7, 8), (0.9, 2))
    ]
    summary = {"severities": rows, "units": {"gain": "times"}, "detectors": {"monitor": "monitor"}}
    (tmp_path / "summary.json").write_text(json.dumps(summary))
    drawn = plots.campaign(tmp_path / "summary.json")
    for name, y in (("matched", [0.9, 0.3]), ("found", [0.8, 0.2]), ("time", [1.25, 5.0])):
        rows = csv.DictReader(io.StringIO(drawn[name].csv))
        assert [float(row["y"]) for row in rows if row["series"] == "monitor"] == y, name
    run = {"scenario": "steady", "seed": 1, "threshold": 1.5, "expected": {}, "first_invalid_s": None}
    (tmp_path / "results.json").write_text(json.dumps([run]))
    telemetry = "t_s,wanted_radps,yaw_rate_radps,demand_bar\n0,0.1,0.2,0.3\n1,0.4,0.5,0.6\n"
    (tmp_path / "steady-1.telemetry.csv").write_text(telemetry)
    (tmp_path / "steady-1.frames.csv").write_text("t_end_s,reason,margin\n0,0,0.7\n1,0,0.8\n")
    rows = list(csv.DictReader(io.StringIO(plots.simulated(tmp_path)["steady-1"].csv)))
    shown = {row["series"]: float(row["y"]) for row in rows}
    assert shown["truck"] == 0.5 and shown["frame"] == 0.8
