"""The live page beside real sources, a SocketCAN interface and LCM's multicast: a source that is killed and
begins again, an interface that goes away, and a flood; nothing but the view waits."""

import json
import sys
from itertools import groupby
from pathlib import Path

import pytest

from lpvguard.can.play import write_candump
from lpvguard.core.compiled import VERDICTS, shipped_vehicle
from lpvguard.extras.loop.lcm_client import message_types
from lpvguard.extras.loop.sim import Simulator, load_scenario, steady_scenario
from lpvguard.replay.vehicle_core import replayer_for
from lpvguard.vehicle.project import load_project
from parts import require
from vcan import with_vcan

URL = "udpm://239.255.76.67:7667?ttl=0"
CLI = (sys.executable, "-m", "lpvguard.cli")


def beside(flood: str, live: list, source: list) -> dict:
    """What on_vcan.py says of the page and of the source's second, whole run."""
    script = Path(__file__).with_name("on_vcan.py")
    done = with_vcan(sys.executable, script, flood, *live, "--", *CLI, *source, timeout=900)
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert result["status"] == 0, "an interrupt ends the page with status 0"
    return result


def verdicts(view: dict, since: float = 0.0) -> list[int]:
    """Codes of the verdicts one after the other, of what is judged from ``since`` on [s]."""
    series = view["series"]
    codes = [v for t, v in zip(series["t"], series["verdict"], strict=True) if t > since and v is not None]
    return [int(code) for code, _ in groupby(codes)]


@pytest.mark.long("a minute and more in real time")
@pytest.mark.serial
@pytest.mark.slow("60 s in real time on vcan0")
def test_a_can_interface_that_goes_away_and_a_flood_on_it(g80, vehicle, core, faulty, tmp_path):
    frames = faulty[0]
    fault_ns = frames.t_ns[0] + (frames.t_ns[-1] - frames.t_ns[0]) * 2 // 3
    around = abs(frames.t_ns - fault_ns) < 12_000_000_000
    path = tmp_path / "around.log"
    write_candump(frames.at(around), path)
    replayer_for(g80, vehicle, "g80")  # compiled here, and not on the one processor of the guest
    live = ["--vehicle", "g80", "--coefficients", vehicle, "socketcan:vcan0"]
    source = ["replay", "--vehicle", "g80", "--coefficients", vehicle, path, "--to", "socketcan:vcan0"]
    result = beside("cangen vcan0 -g 1 -I 7F1 -L 8", live, source)
    views = result["views"]
    assert views["silent"]["now"]["trouble"] == "" and views["away"]["now"]["trouble"] != ""
    assert views["back"]["now"]["trouble"] == "" and views["back"]["now"]["silent"]
    before, after = views["killed"]["now"]["t"], views["after"]["now"]["t"]
    assert after - before > 20, "the second run was taken, and to its end"
    assert views["after"]["can"]["other"], "the flood was heard"
    assert views["killed"]["n_alarms"] == 0 < views["after"]["n_alarms"]


@pytest.mark.long("a minute and more in real time")
@pytest.mark.serial
@pytest.mark.slow("60 s of simulated time over LCM")
def test_a_simulation_over_lcm_that_is_killed_and_begins_again(tmp_path):
    require("lcm")
    folder = shipped_vehicle("truck")
    simulator = Simulator(folder, lcm=True)
    path = tmp_path / "steady.toml"
    path.write_text(steady_scenario(25.0))
    simulator.run(load_scenario(str(path)), lcm=f"file://{tmp_path / 'run.lcm'}?mode=w")
    message_types()  # made here, once
    replayer_for(load_project("truck"), folder, "truck")
    live = ["--vehicle", "truck", "--coefficients", folder, URL]
    source = ["sim", path, "--coefficients", folder, "--lcm", URL, "--pace", "2", "--json", "-"]
    result = beside("", live, source)
    views = result["views"]
    (run,) = json.loads(result["source"])
    after = views["after"]["now"]
    assert after["restarts"] == 1 and not views["killed"]["now"]["restarts"]
    whole = after["t"] - views["silent"]["now"]["t"]
    assert whole == pytest.approx(25.0, abs=4.0)
    assert views["after"]["can"]["live"] and all(views["after"]["can"]["live"].values())
    assert VERDICTS[verdicts(views["after"])[-1]] == run["verdict_final"]
