"""The numbers behind a picture are those that it shows, for zooming and for CSV."""

import csv
import json
import re

import numpy as np
import pytest
from matplotlib.figure import Figure
from report_case import DRIVES

from lpvguard.base import artefacts
from lpvguard.base.errors import InputError
from lpvguard.report.page import write_report
from lpvguard.report.pictures.drawing import kept, new_figure, picture, standalone
from lpvguard.report.pictures.numbers import MOST_POINTS, plain, to_csv, to_json


@picture
def drawn(x: np.ndarray, y: np.ndarray) -> Figure:
    figure = new_figure(6.0, 4.0)
    top, low = figure.subplots(2, 1, sharex=True)
    top.plot(x, y, "--s", color="#1b84c6", label=r"$\gamma_w$ of a frame")
    top.axhline(0.5, color="#d55e00", label="threshold")
    top.axvline(1.0)
    top.text(0.5, 0.5, "no number")
    top.set_yscale("log")
    top.set_ylabel("size, rad/s")
    low.errorbar([1.0, 2.0], [3.0, 4.0], yerr=[[0.5, 0.5], [1.0, 2.0]], fmt="o", label="bars")
    low.bar([1.0, 2.0], [5.0, 6.0], width=0.5, label="counted")
    low.set_yticks([3, 6], ["three", "six"])
    low.set_xlabel("frequency, rad/s")
    return figure


def test_every_artist_placed_by_data_is_read_back():
    top, low = drawn("p", np.array([1.0, 2.0, 3.0]), np.array([0.1, np.nan, 0.3])).panels
    assert [t.kind for t in top.traces] == ["line", "level", "instant"]
    line = top.traces[0]
    assert (line.label, line.look["dash"], line.look["marker"]) == ("γ_w of a frame", "--", "s")
    np.testing.assert_array_equal(line.y, [0.1, np.nan, 0.3])
    assert top.log == (False, True) and top.labels == ("frequency, rad/s", "size, rad/s")
    assert top.shared == low.shared and (top.row, low.row) == (0, 1)
    assert low.ticks[1] == {3.0: "three", 6.0: "six"}
    kinds = {t.kind: t for t in low.traces}
    assert kinds["bar"].x.tolist() == [1.0, 2.0] and kinds["bar"].y.tolist() == [5.0, 6.0]
    assert low.traces[0].label == "bars"
    ends = low.traces[1].y
    assert ends[np.isfinite(ends)].tolist() == [2.5, 4.0, 3.5, 6.0]


@pytest.mark.unhurried
def test_a_table_has_every_finite_point_and_the_page_the_extremes_of_long_lines():
    x = np.arange(10 * MOST_POINTS, dtype=float)
    y = np.sin(x)
    y[777] = 9.0
    panels = drawn("p", x, y).panels
    rows = list(csv.DictReader(to_csv(panels).splitlines()))
    of_line = [r for r in rows if r["series"] == "γ_w of a frame"]
    assert len(of_line) == len(x) and float(of_line[777]["y"]) == 9.0
    series = json.loads(to_json(panels))[0]["series"][0]
    assert len(series["x"]) == len(series["y"]) <= 1.1 * MOST_POINTS and max(series["y"]) == 9.0
    assert series["x"] == sorted(series["x"])


def test_text_of_a_picture_cannot_end_the_script_that_holds_its_numbers():
    figure = drawn("p", np.array([1.0]), np.array([1.0]))
    panel = figure.panels[0]
    object.__setattr__(panel.traces[0], "label", "</script>")
    assert "</" not in to_json(figure.panels)


def test_mathematical_text_is_said_in_characters():
    assert plain(r"$|W_\Delta|$, ceiling $\bar\nu(\omega)$") == "|W_Δ|, ceiling ν̄(ω)"


@pytest.mark.unhurried
def test_pictures_are_kept_only_while_asked():
    with kept() as pictures:
        one = drawn("a", np.array([1.0]), np.array([1.0]))
    drawn("b", np.array([1.0]), np.array([1.0]))
    assert pictures == [one] and standalone(one).startswith("<svg xmlns=")


@pytest.mark.long("13 s: a page with its pictures")
def test_every_picture_of_the_page_is_written_as_svg_and_csv(case, page, tmp_path):
    def write() -> None:
        write_report(
            case.stored,
            case.drives,
            case.replayer,
            tmp_path / "report.html",
            None,
            lambda _: None,
            pictures=tmp_path / "pictures",
        )

    write()
    assert (tmp_path / "report.html").read_text() == page
    folder = tmp_path / "pictures"
    artefacts.read_manifest(folder, "report")
    names = set(re.findall(r'<figure id="picture-([^"]+)"', page))
    assert {p.stem for p in folder.glob("*.svg")} == names
    assert {p.stem for p in folder.glob("*.csv")} == names - {"key"}
    replay = case.replayer.replay(case.drives.load(DRIVES[3][0])[0])
    rows = [r for r in csv.DictReader((folder / "d3.csv").open()) if r["series"] == "margin of a frame"]
    frames = replay.run.frames
    assert len(rows) == len(frames.bin)
    assert max(float(r["value"]) for r in rows) == pytest.approx(float(frames.margin.max()), rel=1e-6)
    assert max(float(r["x_end"]) for r in rows) <= replay.duration_s + replay.Ts + 1e-6, "the sample after"
    (folder / "d3.csv").write_text("mine")
    with pytest.raises(InputError, match=r"d3\.csv"):
        write()
