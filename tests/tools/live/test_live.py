"""The live page: what it shows is what replay says of the same frames, it keeps no more than its window, and
a source or a browser that goes away stops nothing."""

import json
import os
import re
import time
import urllib.error
import urllib.request
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from live_case import Given, asked, cut, served

from lpvguard.base.errors import InputError
from lpvguard.can.catalogue import load_catalogue
from lpvguard.can.logs import EXTENDED
from lpvguard.can.play import write_candump
from lpvguard.core.compiled import Core, shipped_vehicle
from lpvguard.drives.tables import read_drive
from lpvguard.extras.live.server import LOOPBACK, MOST_ROWS
from lpvguard.extras.live.sources import LogSource
from lpvguard.extras.live.watch import ALARMS, Ring, Watch
from lpvguard.extras.loop.sim import Simulator, load_scenario, steady_scenario
from lpvguard.replay.replayer import Replayer, bus_frames
from lpvguard.vehicle.nominal import RunningModel
from lpvguard.vehicle.project import load_project
from parts import chromium, require


def column(watch: Watch, name: str) -> np.ndarray:
    return watch._ring.rows(0, 10**9)[:, watch.columns.index(name)]


@pytest.mark.unhurried
def test_a_vehicle_on_two_interfaces_asks_for_one(replayer, faulty):
    frames = faulty[0].at(slice(0, 4000))
    both = replace(frames, channel=np.arange(4000) // 2000 % 2, channels=["can0", "can1"])
    watch = Watch(replayer, Given(), 3600)
    watch.take(both.at(slice(0, 1000)))
    with pytest.raises(InputError, match="come from can0, can1; expected the option --channel"):
        watch.take(both.at(slice(1000, 3000)))
    watch.source.pieces = lambda: iter([both])
    watch.run()
    assert watch.failed.startswith("live: channel: the vehicle's messages come from can0, can1")
    chosen = Watch(replayer, Given(), 3600, "can1")
    chosen.take(both)
    assert chosen.failed == ""


@pytest.mark.unhurried
@pytest.mark.parametrize("size", [37, 5000])
def test_what_is_shown_is_what_replay_says_of_the_same_frames(replayer, faulty, size):
    frames, path = faulty
    said, watch = replayer.replay_frames(frames, path), Watch(replayer, Given(), 3600)
    for piece in cut(frames, size):
        watch.take(piece)
    n = watch._ring.count
    assert n >= len(said.run.verdict) - 1  # the last tick waits for a frame after it
    assert np.array_equal(column(watch, "verdict"), said.run.verdict[:n])
    assert np.array_equal(np.nan_to_num(column(watch, "energy")), said.run.energy[:n])
    assert np.array_equal(np.nan_to_num(column(watch, "change")), said.run.change[:n])
    view = watch.view(3600, None, MOST_ROWS)
    assert view["n_alarms"] == len(said.alarms) > 0
    assert view["frames"] == said.left_out()
    assert view["can"]["messages"] == {k: pytest.approx(v, abs=2) for k, v in said.can["messages"].items()}
    largest = max(x for x in view["bins"]["largest"] if x is not None)
    assert largest == pytest.approx(said.run.frames.statistic[said.run.frames.counted].max(), abs=1e-5)


def test_the_page_says_whether_commands_are_authenticated(replayer, faulty):
    """Two bits of GUARD_OUT, from bit 52 on; no drive has such a frame."""
    watch, (frames, _) = Watch(replayer, Given(), 60), faulty
    first = frames.at(slice(0, 200))
    watch.take(first)
    assert watch.view(60, None, MOST_ROWS)["now"]["command_authentication"] is None
    message = load_catalogue().message("GUARD_OUT")
    for bits, said in enumerate(("not_authenticated", "authenticated", "error", "not_available")):
        data = np.zeros_like(first.data)
        data[:, 6] = bits << 4 | 0xCF
        reports = replace(first, id=np.full_like(first.id, message.id | EXTENDED), data=data)
        reports.length[:] = 8
        watch.take(reports)
        watch.take(first)
        assert watch.view(60, None, MOST_ROWS)["now"]["command_authentication"] == said


def test_the_nominal_model_in_pieces_is_the_model_in_one(replayer, synthetic):
    drive, model = replayer.read_file(synthetic / "synthetic_01.csv").drive, replayer.model
    running = RunningModel(model, drive.y[0])
    edges = [0, 1, 2, 9, 9, 1000, len(drive.t)]
    pieces = [running.run(drive.v[a:b], drive.u[a:b]) for a, b in pairwise(edges)]
    assert np.concatenate(pieces) == pytest.approx(model.simulate(drive.v, drive.u, drive.y[0]), abs=1e-12)


def test_a_ring_keeps_the_newest_rows_in_their_order():
    ring, rows = Ring(10, 2), []
    for size in (3, 4, 0, 25, 1, 9):
        new = np.column_stack([len(rows) + np.arange(size), np.arange(size)])
        rows += new.tolist()
        ring.put(new)
        assert ring.rows(0, 10**9).tolist() == rows[-10:]
    assert ring.count == 42 and ring.find(35.5) == 36 and ring.find(-1) == 32 and ring.find(99) == 42
    assert ring.rows(0, 42, 4)[:, 0].tolist() == [32, 36, 40]


def test_memory_and_answers_are_bounded(replayer, faulty):
    watch = Watch(replayer, Given(), 20)
    for piece in cut(faulty[0], 1000):
        watch.take(piece)
    rows = column(watch, "t")
    assert len(rows) == 1000 and rows[-1] - rows[0] < 20 < rows[0]
    view = watch.view(86_400, None, 100)
    assert 50 < len(view["series"]["t"]) <= 101 and watch._alarms.maxlen == ALARMS
    # Rows that are drawn stay drawn while time goes on.
    step = np.diff(view["series"]["t"])
    assert step == pytest.approx(np.full(len(step), step[0]))


def test_a_source_that_begins_again_goes_on_and_one_that_is_silent_is_said_to_be(replayer, faulty):
    now = [100.0]
    watch = Watch(replayer, Given(), 3600, clock=lambda: now[0])
    assert watch.view(60, None, 100)["now"]["silent_s"] is None
    half = faulty[0].at(slice(0, len(faulty[0]) // 2))
    watch.take(half)
    before = watch.view(60, None, 100)["now"]
    now[0] += 30
    silent = watch.view(60, None, 100)["now"]
    assert not before["silent"] and silent["silent"] and silent["silent_s"] == 30
    watch.take(half)
    after = watch.view(60, None, 100)["now"]
    assert not after["silent"] and after["restarts"] == 1 and after["t"] > 1.9 * before["t"]
    t = column(watch, "t")
    assert (np.diff(t) > 0).all() and watch._ring.count == pytest.approx(2 * before["t"] / 0.02, abs=120)
    assert after["verdict"] == before["verdict"]


def test_a_growing_log_is_read_by_whole_lines_and_anew_when_it_is_replaced(faulty, tmp_path):
    whole, path = tmp_path / "whole.log", tmp_path / "grows.log"
    frames = faulty[0].at(slice(0, 40))
    write_candump(frames, whole)
    text = whole.read_bytes()
    path.write_bytes(b"")
    pieces = LogSource(path).pieces()

    def came():
        piece, count = next(pieces), 0
        while piece is not None:
            count += len(piece)
            piece = next(pieces)
        return count

    assert came() == 0
    with path.open("ab", buffering=0) as stream:
        stream.write(text[:1000])
        assert came() == text[:1000].count(b"\n")
        stream.write(text[1000:])
        assert came() == 40 - text[:1000].count(b"\n")
    path.write_bytes(text[: text.index(b"\n") + 1])
    assert came() + came() == 1  # shorter than it was: begun anew
    whole.replace(path)
    assert came() + came() == 40


def test_the_page_is_for_browsers_of_this_machine_and_only_reads(replayer, faulty, g80, tmp_path):
    source = Given(cut(faulty[0], 500))
    with served(Watch(replayer, source, 3600)) as url:
        assert url.startswith(f"http://{LOOPBACK}:") and source.taken.wait(60)
        page, what = asked(url).decode(), json.loads(asked(url + "what"))
        assert "https:" not in page and what["omega"] == replayer.estimator.omega.tolist()
        view = json.loads(asked(url + "view?span=30&until=60"))
        assert 29 < max(view["series"]["t"]) - min(view["series"]["t"]) <= 30 > 60 - max(view["series"]["t"])
        saved = tmp_path / "saved.csv"
        saved.write_bytes(asked(url + "drive.csv?from=20&to=50"))
        drive, whole = read_drive(saved, g80), read_drive(faulty[1], g80)
        # The page's clock begins a message's period before the first frame; a tick lies half of one later.
        sent = np.interp(drive.t - 0.015, whole.t, whole.y[:, 0])
        assert len(drive.t) == 1500 and drive.y[:, 0] == pytest.approx(sent, abs=5e-4)
        for path, headers, data, status in (
            ("", {"Host": "elsewhere.example"}, None, 403),
            ("view", {}, b"x", 405),
            ("../server.py", {}, None, 404),
            ("view?span=nan", {}, None, 400),
            ("drive.csv?from=9e9", {}, None, 404),
        ):
            with pytest.raises(urllib.error.HTTPError) as refused:
                urllib.request.urlopen(urllib.request.Request(url + path, data, headers))
            assert refused.value.code in (status, 400 if data else status), path
        policy = urllib.request.urlopen(url).headers["Content-Security-Policy"]
        assert policy.startswith("default-src 'none'") and "http" not in policy


def test_a_source_that_is_none_is_refused(lpvguard, vehicle, tmp_path):
    words = ("live", "--vehicle", "g80", "--coefficients", vehicle)
    lost = lpvguard(*words, tmp_path / "lost.log")
    assert lost.returncode == 2 and "a candump log that grows" in lost.stderr
    interface = lpvguard(*words, "socketcan:nowhere0")
    assert interface.returncode == 2 and "a SocketCAN interface that is up" in interface.stderr


@pytest.mark.slow("10 s: a browser opens the page")
@pytest.mark.parametrize("width", [1280, 800])
def test_a_browser_draws_every_picture_and_complains_of_nothing(replayer, faulty, tmp_path, width):
    require("chromium")
    source = Given(cut(faulty[0], 500))
    with served(Watch(replayer, source, 3600)) as url:
        assert source.taken.wait(60)
        options = (f"--window-size={width},1000", "--virtual-time-budget=6000", "--enable-logging=stderr")
        done = chromium(tmp_path, url, *options, "--dump-dom", host=LOOPBACK)
    complaints = [line for line in done.stderr.splitlines() if "CONSOLE" in line]
    # The browser's own notice that a picture fitted itself in two steps.
    harmless = ("setting log level", "ResizeObserver loop completed")
    assert [c for c in complaints if not any(h in c for h in harmless)] == []
    pictures = re.findall(r'<figure id="([^"]+)"', done.stdout)
    assert pictures == [
        "margins",
        "evidence",
        "energy",
        "change",
        "input-road_wheel_angle",
        "output-yaw_rate",
        "speed",
    ]
    assert re.search(r'data-drawn="1[45]\d', done.stdout) and "frame test" in done.stdout


@pytest.fixture(scope="module")
def at_100_hz(tmp_path_factory):
    """The truck's monitor, frames of a drive of 6 min, and from its first to that of the next [ns]."""
    folder, out = shipped_vehicle("truck"), tmp_path_factory.mktemp("truck")
    replayer = Replayer(load_project("truck"), Core(folder))
    assert replayer.project.Ts_s == 0.01
    (out / "steady.toml").write_text(steady_scenario(360.0))
    Simulator(folder).run(load_scenario(str(out / "steady.toml")), out=out)
    frames = bus_frames(next(out.glob("*.log")), replayer.project)
    return replayer, frames, int(frames.t_ns[-1] - frames.t_ns[0]) + 10**7


@pytest.mark.long("a minute in real time")
@pytest.mark.parametrize("pace", [1, 20])
def test_the_page_is_less_than_ten_pieces_behind(at_100_hz, pace):
    """Every 50 ms comes a piece of 50 ms times ``pace`` of driving, 600 in all. Behind are the pieces that
    have come and that a browser has not been shown when its answer is there: 10 are half a second."""
    replayer, frames, drive_ns = at_100_hz
    step_ns = 5 * 10**7 * pace
    come: list[int] = []

    def pieces():
        for n in range(600):
            k, first = divmod(n * step_ns, drive_ns)
            since_ns = frames.t_ns - frames.t_ns[0]
            here = (since_ns >= first) & (since_ns < first + step_ns)
            time.sleep(0.05)
            come.append(n)
            yield replace(frames.at(here), t_ns=frames.t_ns[here] + k * drive_ns)

    behind, source = [], Given(pieces())
    with served(Watch(replayer, source, 3600)) as url:
        while not source.taken.wait(0.1):
            shown_s = json.loads(asked(url + "view?span=60"))["now"]["t"]
            if shown_s is not None:
                behind.append(len(come) - round(shown_s * 1e9 / step_ns))
    print(f"{pace} x real time: {np.median(behind):.0f} pieces behind in the median, {max(behind)} at most")
    assert len(behind) > 100 and max(behind) < 10


@pytest.mark.long("8 simulated hours")
def test_eight_hours_that_flood_leave_memory_flat(at_100_hz):
    """Frames of 8 h at 100 Hz as fast as they are taken, while a browser asks: resident memory after every
    hour but the last; the window is full after the first."""
    replayer, frames, drive_ns = at_100_hz
    hours = 8
    each = round(3600e9 / drive_ns)
    resident: list[float] = []
    began = time.process_time()

    def pieces():
        for k in range(hours * each):
            if k % each == 0 and k:
                with open("/proc/self/statm", encoding="ascii") as stream:
                    resident.append(int(stream.read().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20)
            yield from cut(replace(frames, t_ns=frames.t_ns + k * drive_ns), 2000)

    source = Given(pieces())
    with served(Watch(replayer, source, 3600)) as url:
        answers = 0
        while not source.taken.wait(0.2):
            answers += len(json.loads(asked(url + "view?span=600"))["series"]["t"]) > 0
        view = json.loads(asked(url + "view?span=3600"))
    quick = hours * 3600 / (time.process_time() - began)
    print(
        f"resident MiB by hour {[round(x, 1) for x in resident]}, {answers} views answered, "
        f"{quick:.0f} s of driving a second of processor time"
    )
    assert view["now"]["t"] > hours * 3600 * 0.99 and view["now"]["restarts"] == 0 and answers > 10
    assert max(resident[1:]) < 1.1 * resident[0]
