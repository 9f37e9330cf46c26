"""The first screen answers: where a fault could stay unseen, which drive came nearest to an alarm, what
alarmed. A reader who has the page alone finds the numbers that the identification and the core gave."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from html.parser import HTMLParser
from types import SimpleNamespace

import pytest
from report_case import DRIVES, Case

from lpvguard.core.compiled import Core
from lpvguard.identify import identification as stage
from lpvguard.identify.export import export_vehicle
from lpvguard.replay.replayer import Replayer
from lpvguard.report.blindness import LEVEL, cells, regions, speed_row
from lpvguard.report.sections.overview import _headline, outcome
from lpvguard.vehicle.nominal import NominalModel


@dataclass
class Element:
    """An element of a page: its data attributes, and the text in it."""

    data: dict[str, str]
    tag: str
    text: str = ""
    below: list[Element] = field(default_factory=list)


class Reader(HTMLParser):
    """Somebody who has the first screen alone: elements by id, text as it stands."""

    def __init__(self, page: str):
        super().__init__()
        self.found: dict[str, Element] = {}
        self._open: list[Element] = []
        screen = page[page.index('<section id="s1">') : page.index('<section id="s2">')]
        self.feed(screen)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        attributes = {k: v or "" for k, v in attrs}
        one = Element({k[5:]: v for k, v in attributes.items() if k.startswith("data-")}, tag)
        if self._open:
            self._open[-1].below.append(one)
        if "id" in attributes:
            self.found[attributes["id"]] = one
        self._open.append(one)

    def handle_endtag(self, tag: str) -> None:
        while self._open and self._open.pop().tag != tag:
            pass

    def handle_data(self, data: str) -> None:
        for one in self._open:
            one.text += data

    def could_stay_unseen(self) -> set[tuple[float, float, float]]:
        """Speeds [m/s] and frequencies [rad/s] at which a gain error of 30 % could stay unseen, by the
        cells."""
        return {
            (float(c.data["speed-low"]), float(c.data["speed-high"]), float(c.data["omega"]))
            for name, c in self.found.items()
            if name.startswith("cell-") and c.data["state"] in ("blind", "no_data")
        }

    def said(self, name: str) -> list[tuple[float, float, float, float]]:
        """Ranges of a list in words: speeds [m/s] from, to, and frequencies [rad/s] from, to."""
        ranges = []
        for item in self.found[name].below:
            for run in item.data.get("omega", "").split():
                low, high = map(float, run.split(":"))
                ranges.append((float(item.data["speed-low"]), float(item.data["speed-high"]), low, high))
        return ranges


def answers(case: Case, page: str) -> Reader:
    """The reader, after all answers of the first screen were held against the numbers behind it."""
    reader, seen = Reader(page), case.stored.visibility
    want = {
        tuple(float(f"{x:.4g}") for x in (*c["speed_mps"], w))
        for c in seen["at_percentile"]
        for w, g in zip(seen["omega_rad_s"], c["gain_error"], strict=True)
        if g is None or g > 0.3
    }
    alarmed_cells = {
        (float(c.data["speed-low"]), float(c.data["speed-high"]), float(c.data["omega"]))
        for name, c in reader.found.items()
        if name.startswith("cell-") and c.data["state"] == "violated"
    }
    assert reader.could_stay_unseen() == want - alarmed_cells
    every = {
        (float(c.data["speed-low"]), float(c.data["speed-high"]), float(c.data["omega"]))
        for name, c in reader.found.items()
        if name.startswith("cell-")
    }
    in_words = {
        (low, high, omega)
        for low, high, omega in every
        for a, b, first, last in reader.said("unseen")
        if a <= low < b and first <= omega <= last
    }
    assert in_words == reader.could_stay_unseen()
    ratios, alarms = {}, {}
    for name in case.drives.experiments:
        replay = case.replayer.replay(case.drives.load(name)[0])
        frames = replay.run.frames
        statistic = frames.statistic[frames.counted]
        ratios[name] = max(
            float(statistic.max(initial=0.0)) / case.replayer.threshold,
            float(replay.run.energy.max()) / case.replayer.energy_threshold,
            float(replay.run.change.max()) / case.replayer.change_threshold,
        )
        alarms[name] = replay.alarms
    quiet = {n: r for n, r in ratios.items() if not alarms[n]}
    nearest = max(quiet, key=lambda n: quiet[n])
    element = reader.found["nearest"]
    assert element.data["drive"] == nearest and nearest in element.text
    assert float(element.data["ratio"]) == pytest.approx(quiet[nearest], rel=1e-3)
    count = sum(map(len, alarms.values()))
    assert reader.found["alarms"].data["alarms"] == str(count)
    shown = sum(int(c.data["alarms"]) for n, c in reader.found.items() if n.startswith("cell-"))
    assert shown == sum(a.test == "frame" for drive_alarms in alarms.values() for a in drive_alarms)
    for name, drive_alarms in alarms.items():
        ratio = f"{ratios[name]:.4g}" if ratios[name] else ""
        assert f'data-drive="{name}" data-ratio="{ratio}" data-alarms="{len(drive_alarms)}"' in page
    return reader


@pytest.mark.slow("9 s: a page of two outputs")
def test_a_reader_finds_the_answers_on_the_first_screen(case, page):
    reader = answers(case, page)
    rate = reader.found["alarm-rate"].text
    assert rate.startswith("Alarms without a fault: ") and "not measured" in rate
    assert page.index('id="alarm-rate"') < page.index('id="headline"')
    assert "weak" in reader.found["alarms"].text and reader.found["headline"].text.startswith("Falsified")
    assert "None on this page" in reader.found["promise"].text
    assert page.index('id="glance"') < page.index("<svg", page.index('id="glance"'))


@pytest.mark.long("12 s: the measured drives replayed twice and their page")
def test_a_reader_of_the_measured_drives_finds_the_answers(g80, measured, measured_identified, tmp_path):
    stored = stage.load(measured_identified)
    export_vehicle(stored, tmp_path / "g80")
    drives = stage.DriveSet(g80, NominalModel(g80), measured)
    case = Case(stored, drives, Replayer(g80, Core(tmp_path / "g80")))
    page = case.page(tmp_path / "g80.html")
    assert len(page) < 2e6 + 80e3 * len(drives.experiments), "50 drives would not fit into 6 MB"
    reader = answers(case, page.decode())
    assert reader.could_stay_unseen() and reader.found["seen"].below[0].data
    assert "30 %" in reader.found["glance"].text


@pytest.mark.parametrize(
    ("verdicts_of_drives", "said"),
    [
        ([[], []], "Not falsified: no alarm on 2 drives"),
        ([["degraded", "degraded"], []], "Degraded, not falsified: 2 alarms on 1 of 2 drives"),
        ([["degraded"], ["invalid"]], "Falsified: 2 alarms on 2 of 2 drives"),
        ([["invalid"]], "Falsified: 1 alarm on 1 of 1 drives"),
    ],
)
def test_alarms_that_refute_no_certificate_falsify_nothing(verdicts_of_drives, said):
    drives = [
        SimpleNamespace(alarms=[SimpleNamespace(verdict=v) for v in alarms]) for alarms in verdicts_of_drives
    ]
    assert outcome(drives) == said


@pytest.mark.parametrize(
    ("alarms", "independent", "start"),
    [
        ([], 0, "Not falsified: no alarm on 1 drives, but every drive that was judged set the bounds"),
        ([], 1, '<span class="yes">Not falsified'),
        ([SimpleNamespace(verdict="invalid")], 0, '<span class="no">Falsified'),
    ],
)
def test_the_headline_is_green_only_where_a_drive_set_nothing(alarms, independent, start):
    drive = SimpleNamespace(alarms=alarms, judged_s=60.0)
    text = _headline([[]], [drive], True, independent)
    assert text.startswith(f'<p id="headline" data-proved="0">{start}')


@pytest.mark.unhurried
def test_every_drive_has_a_row_linked_to_its_section(page):
    rows = re.findall(
        r'<tr data-drive="(\w+)" data-ratio="[^"]*" data-alarms="\d+"><td><a href="#(\w+)">', page
    )
    assert [name for name, _ in rows] == [name for name, *_ in DRIVES]
    for name, key in rows:
        assert f'<div class="drive" id="{key}"><h3>{name} ' in page
    assert page.count('class="small"') == len(DRIVES)


SEEN = {
    "omega_rad_s": [0.0, 1.0, 2.0],
    "gain_error_floor": [0.1, 0.1, 0.4],
    "at_percentile": [
        {"speed_mps": [5.0, 10.0], "frames": [9, 9, 9], "gain_error": [0.2, LEVEL, 0.5]},
        {"speed_mps": [10.0, 15.0], "frames": [9, 9, 9], "gain_error": [0.2, 0.25, 0.5]},
        {"speed_mps": [15.0, 20.0], "frames": [0, 9, 9], "gain_error": [None, 0.2, 0.5]},
    ],
}
SEEN["at_strongest"] = SEEN["at_percentile"]


def states(*alarms: SimpleNamespace) -> list[list[str]]:
    return [[c.state for c in row] for row in cells(SEEN, alarms)]


def test_a_cell_is_proved_blind_without_data_or_violated():
    assert states() == [
        ["proved", "proved", "blind"],
        ["proved", "proved", "blind"],
        ["no_data", "proved", "blind"],
    ]
    energy = SimpleNamespace(bin_rad_s=None, speed_mps=7.0)
    assert states(energy) == states(), "the energy test has no bin"
    frame = SimpleNamespace(bin_rad_s=1.0, speed_mps=10.0)
    assert states(frame)[1] == ["proved", "violated", "blind"]
    assert [speed_row(SEEN, v) for v in (3.0, 5.0, 9.99, 10.0, 20.0, 30.0)] == [0, 0, 0, 1, 2, 2]


def test_neighbouring_speeds_with_the_same_bins_are_said_together():
    joined = regions(cells(SEEN, []), lambda c: c.state == "proved")
    assert [(r.speed_mps, [(a.omega, b.omega) for a, b in r.runs]) for r in joined] == [
        ((5.0, 15.0), [(0.0, 1.0)]),
        ((15.0, 20.0), [(1.0, 1.0)]),
    ]
    gap = regions(cells(SEEN, []), lambda c: c.bin != 1)
    assert [len(r.runs) for r in gap] == [2] and gap[0].speed_mps == (5.0, 20.0)
    assert regions(cells(SEEN, []), lambda c: False) == []


@pytest.mark.long("7 s: an identification")
def test_drives_that_the_model_leaves_unexplained_stand_on_the_first_screen(
    case, page, tmp_path, monkeypatch
):
    assert "unexplained" not in Reader(page).found
    monkeypatch.setattr("lpvguard.identify.unexplained.UNEXPLAINED_VAF", 0.7)
    page = case.page(tmp_path / "strict.html").decode()
    groups = case.stored.manifest["drives"]
    left = {}
    for name in [*groups["bounds"], *groups["calibration"]]:
        drive, e, _ = case.drives.load(name)
        left[name] = float((e.var(axis=0) / drive.y.var(axis=0)).max())
    assert [name for name in left if left[name] > 0.3] == ["weak"] and "weak" in groups["calibration"]
    element = Reader(page).found["unexplained"]
    assert element.data["drives"] == "1" and "weak (calibrates, " in element.text
    assert float(re.search(r"([\d.]+)% of", element.text).group(1)) == pytest.approx(
        100 * left["weak"], abs=3
    )
    rows = dict(re.findall(r'<tr data-drive="(\w+)" data-ratio(.*?)</tr>', page, re.S))
    for name, part in left.items():
        value, bad = re.search(
            r'data-value="([^"]*)">(<span class="no">)?[\d.]+%<[^%]*<svg', rows[name]
        ).groups()
        assert float(value) == pytest.approx(1 - part, abs=0.03)
        assert (bad is not None) == (name == "weak")
