"""200 spoiled headers, times and units: each is read right, or refused by an error that names it. There is no
traceback, and no wrong unit in silence. A header that states a false unit is found where it is wrong by three
times or more: no log tells a mile from a kilometre where the understeer is not known."""

import warnings
from collections import Counter
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from known_car import KnownCar
from lpvguard.base.errors import InputError
from lpvguard.drives.units import unit_factor
from lpvguard.start.new_project import recordings_of
from lpvguard.start.readings import ROLES, Known
from lpvguard.start.signals import proposed

CAR = KnownCar(2.8, 0.003, 0.006, 0.04, 0.0, 0.0)
SI = ("m/s", "rad", "rad/s")
UNITS = (("m/s", "km/h", "mph", "kn"), ("rad", "deg", "mrad"), ("rad/s", "deg/s"))
STATED = ("{} [{}]", "{} ({})", "{}_{}", "{} in {}", "{}{{{}}}")
NAMES = (
    ("speed", "vehicle_speed", "Geschwindigkeit", "v"),
    ("steering_angle", "Lenkwinkel", "delta", "road_wheel_angle"),
    ("yaw_rate", "Gierrate", "r", "gyro_z"),
)
TIMES = {
    "time": lambda t: f"{t:.3f}",
    "time_ms": lambda t: f"{1000 * t:.0f}",
    "Time [us]": lambda t: f"{1e6 * t:.0f}",
    "timestamp": lambda t: f"{1_700_000_000_000_000_000 + round(t * 1e9)}",
    "t": lambda t: f"{1000 * t:.0f}",
    "Zeit": lambda t: f"2026-04-22T10:{int(t // 60):02d}:{t % 60:06.3f}",
    "time ": lambda t: f"{int(t)}",
    "counter": lambda t: f"{t:.3f}",
    "time_s": lambda t: f"{t:.3f}" if int(50 * t) % 700 else "",
    "uhrzeit": lambda t: f"23:5{int(t // 60)}:{t % 60:06.3f}",
}


@cache
def drive() -> np.ndarray:
    """Time, speed, steering and yaw rate of a known car, (N, 4) in SI units."""
    d = CAR.drive(np.random.default_rng(7), 14.0, 40.0, "d")
    return np.column_stack([d.t, d.v, d.u[:, 0], d.y[:, 0]])


def spoiled(random: np.random.Generator) -> tuple[str, tuple[str, ...]]:
    """The text of a log with a spoiled header, time or unit, and the units that its numbers are in."""
    units = tuple(str(random.choice(choices)) for choices in UNITS)
    stated = [
        u if random.random() < 0.85 else str(random.choice(choices))
        for u, choices in zip(units, UNITS, strict=True)
    ]
    if stated[0] != units[0] and {stated[0], units[0]} != {"m/s", "km/h"}:
        stated[0] = units[0]
    names = [str(random.choice(choices)) for choices in NAMES]
    as_stated = str(random.choice(STATED))
    header = [
        as_stated.format(n, u) if random.random() < 0.6 else n for n, u in zip(names, stated, strict=True)
    ]
    time = str(random.choice(list(TIMES)))
    scale = [1 / unit_factor(u, si) for u, si in zip(units, SI, strict=True)]
    rows = [
        [TIMES[time](t), *(f"{x * s:.6g}" for x, s in zip(values, scale, strict=True))]
        for t, *values in drive()
    ]
    return damaged(random, [[time, *header], *rows]), units


def damaged(random: np.random.Generator, cells: list[list[str]]) -> str:
    """The lines of a table after one accident more, or none."""
    delimiter = str(random.choice([",", ";", "\t"]))
    accident, row = int(random.integers(14)), int(random.integers(1, len(cells)))
    if accident == 0:
        cells = cells[1:]  # no header
    elif accident == 1:
        cells = [*cells[:row], cells[0], *cells[row:]]  # the header again
    elif accident == 2:
        cells[row] = cells[row][:2]
    elif accident == 3:
        cells[row][int(random.integers(4))] = str(random.choice(["", "oops", "1e999", "-", "0x12", "١٢"]))
    elif accident == 4:
        cells[0][int(random.integers(4))] = str(random.choice(["", "x", "12", cells[0][1], '"', "time"]))
    elif accident == 5:
        cells = cells[:1] + cells[:0:-1]  # backwards
    elif accident == 6:
        cells = [[c[0], c[3], c[1], c[2]] for c in cells]
    elif accident == 7:
        cells = [[*c, "1"] for c in cells]
        cells[0][-1] = "steering_rate"
    text = "\n".join(delimiter.join(c) for c in cells) + "\n"
    if accident == 8:
        text = text.replace(".", ",") if delimiter != "," else text[: len(text) // 2]
    elif accident == 9:
        text = text.replace("\n", "\r\n")
    elif accident == 10:
        text = "log of a car\n\n" + text
    elif accident == 11:
        text = text.replace(delimiter, delimiter + " ")
    return text


def outcome(folder: Path, text: str, units: tuple[str, ...]) -> str:
    """Right, refused, or what went wrong."""
    log = folder / "log.csv"
    log.write_text(text, encoding="utf-8")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            logs, _ = recordings_of([log], None)
            proposals = proposed(logs, {}, Known("car", 2.8))
    except InputError as error:
        return "refused" if len(str(error)) > 20 else f"says nothing: {error}"
    truth = drive()
    step = float(np.median(np.diff(logs[0].t)))
    if abs(step / 0.02 - 1) > 0.05:
        return f"wrong time: a step of {step:g} s"
    for k, role in enumerate(ROLES):
        p = proposals[role]
        values = logs[0].values[p.name] * p.factor * (unit_factor(p.unit, SI[k]) or np.nan)
        spread = np.nanstd(values) / np.std(truth[:, k + 1])
        if not 0.8 < spread < 1.25:
            return f"wrong {role}: {spread:.3g} times the right one, {p.unit} of {units[k]}"
    return "right"


def counted(folder: Path, seeds: range) -> tuple[Counter[str], list[str]]:
    """Outcomes by kind, and those that are wrong."""
    counts: Counter[str] = Counter()
    wrong = []
    for seed in seeds:
        said = outcome(folder, *spoiled(np.random.default_rng(seed)))
        counts[said.split(":")[0]] += 1
        if said not in ("right", "refused"):
            wrong.append(f"seed {seed}: {said}")
    return counts, wrong


@pytest.mark.slow("4 s: 20 logs")
def test_spoiled_logs_are_read_right_or_refused(tmp_path):
    counts, wrong = counted(tmp_path, range(20))
    assert not wrong and counts["right"] >= 3, wrong


@pytest.mark.long("40 s: 200 logs")
def test_200_spoiled_logs_are_read_right_or_refused(tmp_path, capsys):
    counts, wrong = counted(tmp_path, range(200))
    with capsys.disabled():
        print("\nof 200 spoiled logs:", ", ".join(f"{n} {what}" for what, n in sorted(counts.items())))
    assert not wrong, wrong
