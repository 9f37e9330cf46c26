"""Many drives: the same bytes for any workers and any order, memory that does not grow, and what the passes
over drives compute."""

import json
import os
import pickle
import re
import shutil
import subprocess
import sys
import time
from dataclasses import replace
from importlib import resources
from pathlib import Path

import numpy as np
import pytest

import lpvguard as lpvguard_package
from lpvguard.base.errors import InputError
from lpvguard.base.parallel import SILENT_S, UNDER_WAY_PER_WORKER, workers
from lpvguard.base.sampling import first_of_each, row_hash, stacked
from lpvguard.drives.dft import spectra
from lpvguard.drives.frames import Estimator
from lpvguard.drives.tables import Drive, list_experiments, read_drive
from lpvguard.engine.validation import s1
from lpvguard.extras.bench import fleet
from lpvguard.identify import identification as stage
from lpvguard.identify import passes
from lpvguard.identify.bounds import (
    FRONT_POINTS,
    FrameSet,
    explain,
    front,
    front_grid,
    reduce_disturbance,
    reduce_uncertainty,
)
from lpvguard.identify.export import export_vehicle
from lpvguard.identify.visibility import Excitation
from lpvguard.identify.window_error import window_error
from lpvguard.vehicle.nominal import NominalModel, recursion
from lpvguard.vehicle.project import load_project, parse_project

DRIVES = 9


@pytest.fixture(scope="module")
def drives(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("fleet") / "drives"
    fleet.write_fleet(folder, DRIVES)
    return folder


@pytest.fixture(scope="module")
def identification(drives) -> stage.Identification:
    return stage.identify(fleet.vehicle(), drives)[0]


def files(folder: Path, run=map) -> dict[str, bytes]:
    """The identification folder of ``folder``, without the manifest, which lists drives in their order."""
    target = folder.parent / f"{folder.name}_identified"
    stage.save(*stage.identify(fleet.vehicle(), folder, workers=run), target)
    content = {p.name: p.read_bytes() for p in target.iterdir() if p.name != "MANIFEST.json"}
    shutil.rmtree(target)
    return content


# ------------------------------------------------------------------------------------------------- bad frames


@pytest.fixture(scope="module")
def bad_frames():
    project = fleet.vehicle()
    model = NominalModel(project)
    estimator = Estimator.from_project(project, model)
    rng = np.random.default_rng(7)
    E, Z = (rng.normal(size=(3, model.n_y)) + 1j * rng.normal(size=(3, model.n_y)) for _ in range(2))
    return estimator, FrameSet(2, E, Z, np.array([100, 250, 400]), "lap_7")


def test_a_spectrum_that_is_not_finite_names_experiment_bin_and_frame(bad_frames):
    estimator, good = bad_frames
    E = good.E.copy()
    E[1, 0] = np.nan
    place = re.escape(f"lap_7: bin 2 ({estimator.omega[2]:.6g} rad/s), frame from sample 250: ")
    ceiling = np.full(estimator.n_bins, 0.3)
    with pytest.raises(InputError, match=place + "E or Z is not finite; expected finite spectra"):
        reduce_disturbance([good, replace(good, E=E)], estimator, ceiling, E.shape[1])
    with pytest.raises(InputError, match=place):
        explain(replace(good, E=E), estimator, np.full(estimator.n_bins, 1e3), "S1")


def test_a_disturbance_bound_that_is_missing_or_below_b1_names_experiment_bin_and_frame(bad_frames):
    estimator, s = bad_frames
    K, n_y = estimator.n_bins, s.E.shape[1]
    # y = 0 where the model moves nothing: all of E is disturbance, B1 = |E|, whatever the number of outputs.
    s = replace(s, Z=np.where(np.arange(3)[:, None] == 2, 0.0, s.Z))
    size = np.linalg.norm(s.E[2])
    below, grid = np.full(K, 1e3), np.full((K, FRONT_POINTS), np.nan)
    below[2] = (1 - 1e-6) * size
    s = replace(s, E=np.where(np.arange(3)[:, None] == 2, s.E, 0.1 * s.Z))
    place = re.escape(
        f"lap_7: bin 2 ({estimator.omega[2]:.6g} rad/s), frame from sample 400: "
        f"B1 = {size:.6g} and gamma_w = "
    )
    with pytest.raises(InputError, match=place + ".*expected finite spectra and gamma_w >= B1"):
        reduce_uncertainty([s], estimator, below, grid, n_y, "S1")
    reduce_uncertainty([s], estimator, np.where(np.arange(K) == 2, size, below), grid, n_y, "S1")
    none = below.copy()
    none[2] = np.nan  # a bin that set no bound, met by a drive that has frames there
    with pytest.raises(InputError, match=r"lap_7: bin 2 .*gamma_w = nan"):
        explain(s, estimator, none, "S1")
    empty = replace(s, E=s.E[:0], Z=s.Z[:0], starts=s.starts[:0])
    assert explain(empty, estimator, none, "S1")[0].shape == (0,), "an empty bin asks for nothing"


# ---------------------------------------------------------------------------------------------------- workers


@pytest.mark.slow("9 s: the fleet identified five times")
def test_workers_and_order_do_not_change_a_byte(drives, tmp_path):
    alone = files(drives)
    with workers(2) as run:
        assert files(drives, run) == alone
    shuffled = tmp_path / "shuffled"
    shutil.copytree(drives, shuffled)
    head, *rows = (drives / "experiments.csv").read_text().splitlines()
    (shuffled / "experiments.csv").write_text(
        "\n".join([head, *np.random.default_rng(1).permutation(rows)]) + "\n"
    )
    other = files(shuffled)
    equal = "bounds.json", "front.json", "model_error.json", "weights.json", "change.json", "visibility.json"
    for name in equal:
        assert other[name] == alone[name], name
    a, b = (json.loads(f["calibration.json"]) for f in (alone, other))
    assert a == b  # scores are listed in the order of the drives


@pytest.mark.slow("4 s: a cluster is started")
def test_dask_gives_the_same_bytes(drives):
    distributed = pytest.importorskip("distributed")
    with (
        distributed.LocalCluster(
            n_workers=1, threads_per_worker=2, processes=False, dashboard_address=None
        ) as cluster,
        workers(scheduler=cluster.scheduler_address) as run,
    ):
        assert files(drives, run) == files(drives)


@pytest.mark.slow("4 s: clusters are started")
@pytest.mark.parametrize(
    ("ttl", "after"), [("2 s", SILENT_S), (f"{2 * SILENT_S:.0f} s", 2 * SILENT_S), (None, None)]
)
def test_a_dask_scheduler_waits_for_busy_workers(ttl, after):
    """A worker that holds the interpreter sends no heartbeat, and would be removed with its drive."""
    distributed, dask = pytest.importorskip("distributed"), pytest.importorskip("dask")
    with (
        dask.config.set({"distributed.scheduler.worker-ttl": ttl}),
        distributed.LocalCluster(n_workers=1, processes=False, dashboard_address=None) as cluster,
        workers(scheduler=cluster.scheduler_address) as run,
    ):
        assert list(run(abs, [-1])) == [1]
        assert cluster.scheduler.worker_ttl == after


def test_a_core_is_sent_as_its_sources_and_can_be_sent_on(core):
    again = pickle.loads(pickle.dumps(pickle.loads(pickle.dumps(core))))
    for a, b in zip(core.compiled, again.compiled, strict=False):
        np.testing.assert_array_equal(a, b)


def test_results_come_in_order_and_few_are_under_way():
    taken = []

    def items():
        for i in range(40):
            taken.append(i)
            yield -i

    with workers(2) as run:
        for i, result in enumerate(run(abs, items())):
            assert result == i
            assert len(taken) <= i + 2 * UNDER_WAY_PER_WORKER


def test_workers_begin_before_a_result_is_asked_for(tmp_path):
    """Workers compute a result while the caller still does other work."""
    with workers(2) as run:
        results = run(os.mkdir, [tmp_path / "made"])
        end = time.monotonic() + 60
        while not (tmp_path / "made").is_dir() and time.monotonic() < end:
            time.sleep(0.01)
        assert (tmp_path / "made").is_dir() and list(results) == [None]


def _worker(item: object) -> tuple[int, object]:
    """The process that got an item."""
    time.sleep(0.01)
    return os.getpid(), item


def test_an_item_goes_to_the_worker_that_had_it_and_any_may_be_sent():
    """What a worker keeps of a drive serves its later passes; arrays are equal to none, and go anywhere."""
    items = list(range(12))
    with workers(2) as run:
        first, again = (dict(reversed(pair) for pair in run(_worker, items)) for _ in range(2))
        assert len(set(first.values())) == 2
        assert sum(first[i] == again[i] for i in items) >= 10
        # Only those of one worker: the other one takes what that has no time for.
        own = [i for i in items if first[i] == first[0]]
        assert len({process for process, _ in run(_worker, own * 4)}) == 2
        arrays = [np.full(2, i) for i in items]
        assert [x.tolist() for _, x in run(_worker, arrays)] == [x.tolist() for x in arrays]


POOL = """
import os, sys
from lpvguard.base.parallel import workers

def process(item):
    return os.getpid()

if __name__ == "__main__":
    with workers(2) as run:
        print(*set(run(process, range(20))), flush=True)
        sys.stdin.read()
"""


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="asks /proc which processes run")
def test_workers_end_with_a_pool_that_was_killed(tmp_path):
    """The workers get no message, because their parent was killed."""
    script = tmp_path / "pool.py"
    script.write_text(POOL)
    with subprocess.Popen(
        [sys.executable, script], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as pool:
        started = [int(p) for p in pool.stdout.readline().split()]
        assert started and all(map(alive, started))
        pool.kill()
    for _ in range(6000):  # a hang ends after five minutes
        if not any(map(alive, started)):
            return
        time.sleep(0.05)
    pytest.fail(f"still running: {started}")


def alive(process: int) -> bool:
    """Whether a process runs; one that nobody has asked for its status yet does not."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


def test_an_input_error_of_a_worker_keeps_its_parts(drives, tmp_path):
    broken = tmp_path / "broken"
    shutil.copytree(drives, broken)
    (broken / "drive_00004.parquet").write_bytes(b"")
    with workers(2) as run, pytest.raises(InputError, match="the file is empty") as caught:
        stage.identify(fleet.vehicle(), broken, workers=run)
    assert caught.value.source.endswith("drive_00004.parquet")


@pytest.mark.parametrize(
    ("settings", "says"),
    [
        ({"jobs": 0}, "at least 1"),
        ({"jobs": 2, "scheduler": "tcp://x:1"}, "one of them"),
        ({"scheduler": "nonsense"}, "no scheduler answers"),
    ],
)
def test_bad_worker_settings_are_named(settings, says, monkeypatch):
    monkeypatch.setattr("lpvguard.base.parallel.CONNECT_TIMEOUT_S", 1)
    if settings.get("scheduler") == "nonsense":
        pytest.importorskip("distributed")
    with pytest.raises(InputError, match=says), workers(**settings):
        pass


@pytest.mark.long("15 s: 120 drives shared by processes")
def test_replay_and_evaluate_share_drives(lpvguard, vehicle, identified, synthetic, few_baselines, tmp_path):
    shipped = Path(lpvguard_package.__file__).parent / "vehicle/shipped/g80.toml"
    once = tmp_path / "g80.toml"
    once.write_text(shipped.read_text().replace("[evaluation]\n", "[evaluation]\nstarts = 1\n"))
    logs = [synthetic / f"synthetic_{i:02d}.csv" for i in (5, 6, 8)]
    replay = ("replay", "--vehicle", "g80", "--coefficients", vehicle, *logs, "--json", "-")
    alone, shared = lpvguard(*replay), lpvguard(*replay, "--jobs", 2)
    assert alone.returncode == shared.returncode == 0, shared.stderr
    assert alone.stdout == shared.stdout and len(json.loads(alone.stdout)) == 3
    evaluate = (
        "evaluate",
        "--vehicle",
        once,
        "--coefficients",
        vehicle,
        "--json",
        "-",
        identified,
        synthetic,
    )
    alone, shared = lpvguard(*evaluate), lpvguard(*evaluate, "--jobs", 2)
    assert alone.returncode == shared.returncode == 0, shared.stderr
    assert alone.stdout == shared.stdout


@pytest.mark.long("1000 drives identified")
@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="peak memory is read from /proc")
def test_memory_does_not_grow_with_the_number_of_drives(tmp_path):
    many = 1000
    peak = {}
    for count in (10, many):
        fleet.write_fleet(tmp_path / str(count), count)
        peak[count] = fleet.peak_memory_kib(tmp_path / str(count))
    assert peak[many] <= 1.2 * peak[10] + passes.KEPT_BYTES / 1024, peak


def test_a_reader_keeps_as_many_drives_as_have_room(tmp_path, monkeypatch):
    fleet.write_fleet(tmp_path / "drives", 3)
    project, drives = fleet.vehicle(), list_experiments(tmp_path / "drives")
    reader, files = passes.DriveReader(project, NominalModel(project)), []
    monkeypatch.setattr(
        passes, "read_drive", lambda path, project: files.append(path.stem) or read_drive(path, project)
    )
    drive, e, yhat = reader.read(drives[0])
    size = sum(x.nbytes for x in (drive.t, drive.v, drive.u, drive.y, yhat))
    np.testing.assert_array_equal(e, drive.y - yhat)
    monkeypatch.setattr(passes, "KEPT_BYTES", int(2.5 * size))
    reader, files[:] = passes.DriveReader(project, reader.model), []
    for drive in (*drives, *drives):
        reader.read(drive)
    assert files == [d.name for d in (*drives, drives[2])]
    with pytest.raises(ValueError, match="read-only"):
        reader.read(drives[0])[0].y[0] = 1.0
    sent = pickle.loads(pickle.dumps(reader))
    assert len(pickle.dumps(reader)) < size
    np.testing.assert_array_equal(sent.read(drives[0])[1], reader.read(drives[0])[1])


@pytest.mark.slow("12 s: the fleet bench")
def test_bench_names_what_there_is(lpvguard):
    done = lpvguard("bench", "nothing")
    names = "bounds or can or chain or confirmation or core or fleet or isolation or lives or proofs"
    assert done.returncode == 2
    assert f"{names} or rates or refine or robust or sharpness or soak" in done.stderr
    assert "steer or synthesis or validation" in done.stderr
    done = lpvguard("bench", "fleet", "--drives", 3, "--memory", "--json", "-")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["same_bytes"] is True


# --------------------------------------------------------------------------------------------------- sampling


def test_samples_are_associative_and_commutative():
    random = np.random.default_rng(0)
    parts = [
        {
            "group": random.integers(0, 4, n),
            "hash": row_hash(f"drive {i}", np.arange(n)),
            "x": random.standard_normal(n),
        }
        for i, n in enumerate((50, 0, 7, 90, 200))
    ]
    whole = first_of_each(stacked(parts), 20, "x")
    for order in ([4, 3, 2, 1, 0], [1, 0, 4, 2, 3]):
        folded = first_of_each(parts[order[0]], 20, "x")
        for i in order[1:]:
            folded = first_of_each(stacked([folded, first_of_each(parts[i], 20, "x")]), 20, "x")
        for name in whole:
            np.testing.assert_array_equal(folded[name], whole[name])
    for g in range(4):
        x = np.concatenate([p["x"][p["group"] == g] for p in parts])
        np.testing.assert_array_equal(whole["x"][whole["group"] == g], np.sort(x)[:20])


def test_a_draw_by_hash_is_uniform():
    rows = {
        "group": np.zeros(100_000, int),
        "hash": row_hash("drive", np.arange(100_000)),
        "x": np.arange(100_000) / 1e5,
    }
    drawn = first_of_each(rows, 2000)["x"]
    assert abs(drawn.mean() - 0.5) < 0.03 and abs(np.quantile(drawn, 0.9) - 0.9) < 0.03


@pytest.mark.unhurried
def test_spectra_are_thinned_to_the_stated_cap_and_keep_the_largest(monkeypatch, drives, identification):
    monkeypatch.setattr(passes, "LARGEST_SPECTRA", 5)
    monkeypatch.setattr(passes, "DRAWN_SPECTRA", 15)
    thin = stage.identify(fleet.vehicle(), drives)[0].spectra
    for k in range(identification.estimator.n_bins):
        whole, kept = (
            np.linalg.norm(r["E"][r["group"] == k], axis=1) for r in (identification.spectra, thin)
        )
        assert min(len(whole), 15) <= len(kept) <= 20
        np.testing.assert_array_equal(np.sort(kept)[-5:], np.sort(whole)[-5:])


def test_excitation_of_all_drives_is_that_of_their_frames_together():
    random = np.random.default_rng(2)
    W_delta, B_w, K = np.full((4, 1), 0.1), np.full((4, 1), 0.01), 4
    frames = [
        (random.integers(0, K, n), random.uniform(4, 19, n), random.standard_normal((n, 1)) + 0j)
        for n in (300, 700)
    ]
    parts = [
        Excitation.from_frames(f"d{i}", (4.0, 19.0), b, v, Z, W_delta, B_w, np.arange(len(b)))
        for i, (b, v, Z) in enumerate(frames)
    ]
    joined = Excitation.joined(parts)
    np.testing.assert_array_equal(joined.count, parts[0].count + parts[1].count)
    assert joined.strongest["size"].max() == max(np.abs(Z).max() for _, _, Z in frames)
    for name in joined.sample:
        np.testing.assert_array_equal(joined.sample[name], Excitation.joined(parts[::-1]).sample[name])


# ---------------------------------------------------------------------------------------------- kernel, front


@pytest.mark.parametrize("n", [1, 2, 3, 5])
def test_the_recursion_is_its_definition(n):
    random = np.random.default_rng(n)
    Ad = 0.5 * random.standard_normal((400, n, n)) / n
    forced, x = random.standard_normal((400, n)), random.standard_normal(n)
    for k, state in enumerate(recursion(Ad, forced, x)):
        np.testing.assert_allclose(state, x, rtol=1e-12, atol=1e-14)
        x = Ad[k] @ x + forced[k]


@pytest.mark.parametrize("vehicle", ["g80", "truck"])
def test_the_nominal_model_runs_on_its_table(vehicle):
    model = NominalModel(load_project(vehicle))
    random, (low, high) = np.random.default_rng(0), model.speed_range
    v = np.linspace(low - 1, high + 1, 400)
    older, newer = random.standard_normal((2, 400, model.n_u))
    Ad, B_old, B_new = model.split(model.table.at(v))
    x = np.ones(model.n)
    for k, state in enumerate(model.states(v, older, newer, x)):
        np.testing.assert_allclose(state, x, rtol=1e-12, atol=1e-14)
        if k < len(v):
            x = Ad[k] @ x + B_old[k] @ older[k] + B_new[k] @ newer[k]


@pytest.mark.parametrize("alike", [False, True])
@pytest.mark.parametrize("n_y", [1, 2])
def test_front_is_the_largest_exact_nu_of_all_frames(n_y, alike, g80, g80_model):
    random = np.random.default_rng(n_y)
    E, Z = (random.standard_normal((500, n_y)) + 1j * random.standard_normal((500, n_y)) for _ in range(2))
    E *= random.uniform(0, 1, (500, 1))
    if alike:  # neighbours, as frames one sample apart are: whole blocks of them are passed over
        E, Z = (np.cumsum(x, axis=0) for x in (E, Z))
    size = np.linalg.norm(E, axis=1)
    estimator = replace(
        Estimator.from_project(g80, g80_model), length=np.array([100, 100]), cycles=np.array([0, 3])
    )
    B1, B2 = np.full(2, s1.solve(E, Z, size).b1.max()), np.full(2, size.max())
    grid = front_grid(B1, B2, estimator, "S1")
    assert np.isnan(grid[0]).all() and grid[1, 0] == B1[1] and grid[1, -1] == B2[1]
    nu = front(E, Z, grid[1])
    # At B2 a norm summed in another order leaves some 1e-16 where 0 is meant; everywhere else the bits agree.
    np.testing.assert_array_equal(nu[:-1], [s1.solve(E, Z, g).nu.max() for g in grid[1, :-1]])
    assert nu[-1] == 0.0 and (np.diff(nu) <= 0).all() and np.isfinite(nu).all()
    assert np.isnan(front_grid(B1, B2, estimator, "S0")).all()


def test_what_was_taken_lies_on_the_front(identification):
    b = identification.bounds
    assert b.front_nu.shape == (identification.estimator.n_bins, FRONT_POINTS)
    for k in range(1, identification.estimator.n_bins):
        below, above = b.front_gamma_w[k] <= b.gamma_w[k], b.front_gamma_w[k] >= b.gamma_w[k]
        assert b.front_nu[k][below].min() >= b.nu[k] >= (b.front_nu[k][above].max() if above.any() else 0.0)


# -------------------------------------------------------------------------------------------------- plain DFT


def plain(name: str = "g80", **frames):
    document = load_project(name).model_dump(by_alias=True)
    document["frames"] |= {
        "estimator": "dft",
        "length_s": 10.0,
        "omega_min_radps": 1.2566371,
        "omega_max_radps": 15.707963,
        **frames,
    }
    document["bounds"]["nu_ceiling"] = {"omega_radps": [6.2831853], "nu": [0.1]}
    document["name"] = "plain"
    return parse_project(document, "test")


@pytest.mark.parametrize("name", ["g80", "truck"])
def test_plain_dft_of_the_models_own_data_is_zero_once_the_transient_is_out(name):
    project = plain(name, omega_max_radps=12.566371)
    model = NominalModel(project)
    estimator = Estimator.from_project(project, model)
    random = np.random.default_rng(5)
    n = int(estimator.length[0]) + 300
    v = np.full(n, 12.0)
    u = 0.05 * random.standard_normal((n, project.n_u))
    drive = Drive("d", np.arange(n) * model.Ts, v, u, model.simulate(v, u, np.full(project.n_y, 0.3)))
    E, Z = spectra(drive, 40, model, estimator)
    # All that is left is the speed table's tolerance (1e-6 of each entry); with the transient in, E is of the
    # output's size.
    assert np.abs(E[1:]).max() < 1e-4 * np.abs(Z[1:]).max()
    G = model.frequency_response(estimator.omega[1:], 12.0)
    assert np.median(np.linalg.norm(Z[1:], axis=1) / np.linalg.norm(G[:, :, 0], axis=1)) < 0.05


def test_plain_dft_finds_a_known_gain_and_disturbance(g80):
    project = plain()
    model = NominalModel(project)
    estimator = Estimator.from_project(project, model)
    n = int(estimator.length[0])
    t = np.arange(n) * model.Ts
    v, line = np.full(n, 9.0), estimator.omega[7]
    u = model.input_offset + 0.02 * np.sin(np.outer(t, estimator.omega[[3, 12]])).sum(axis=1)[:, None]
    yhat = model.simulate(v, u, np.zeros(1))
    y = yhat + 1e-3 * np.cos(line * t)[:, None]
    E, _ = spectra(Drive("d", t, v, u, y), 0, model, estimator)
    # The fitted transient, one real number against 2 K, takes a little of the disturbance with it.
    assert abs(E[7, 0]) == pytest.approx(1e-3, rel=0.1)
    assert np.delete(np.abs(E[1:, 0]), 6).max() < 1e-4


@pytest.mark.slow("2 s: an identification")
def test_identify_with_the_plain_dft_leaves_out_unsteady_drives_and_the_core_refuses(lpvguard, tmp_path):
    project = plain()
    fleet.write_fleet(tmp_path / "drives", 6)
    moving = tmp_path / "drives" / "drive_00003.parquet"
    import pyarrow as pa
    import pyarrow.parquet as pa_parquet

    table = pa_parquet.read_table(moving)
    t = table["t"].to_numpy()
    pa_parquet.write_table(table.set_column(1, "v", pa.array(10.0 + 6.0 * np.sin(1.5 * t))), moving)
    result, drive_set = stage.identify(project, tmp_path / "drives")
    assert list(result.left_out) == ["drive_00003"] and "15%" in result.left_out["drive_00003"]
    assert "drive_00003" not in result.bound_drives and len(result.bound_drives) == 3
    assert (result.bounds.frames == 3).all() and np.isfinite(result.bounds.B2).all()
    assert result.weights.inflation >= 1.0 and set(result.calibration.scores) == {
        "drive_00002",
        "drive_00005",
    }
    stage.save(result, drive_set, tmp_path / "found")
    stored = stage.load(tmp_path / "found")
    assert stored.bounds["window_error_median"].max() < 1e-8
    with pytest.raises(InputError, match="plain DFT, which the core does not compute"):
        export_vehicle(stored, tmp_path / "vehicle")
    assert not (tmp_path / "vehicle").exists()
    settings = tmp_path / "plain.toml"
    text = resources.files("lpvguard.vehicle").joinpath("shipped", "g80.toml").read_text()
    settings.write_text(re.sub(r'estimator = "hann"', 'estimator = "dft"\nlength_s = 10.0', text))
    done = lpvguard("replay", "--vehicle", settings, tmp_path / "drives" / "drive_00001.parquet")
    assert (
        done.returncode == 2
        and "frames.estimator: the plain DFT, which the core does not compute" in done.stderr
    )
    hann = Estimator.from_project(load_project("g80"), NominalModel(load_project("g80")))
    assert result.estimator.identifier() != hann.identifier()


def test_plain_dft_settings_are_checked():
    with pytest.raises(InputError, match="length_s"):
        plain(length_s=None)
    with pytest.raises(InputError, match="unknowns of the transient"):
        project = plain(length_s=1.0, omega_min_radps=0.62831853, omega_max_radps=1.2566371)
        Estimator.from_project(project, NominalModel(project))


def test_window_error_falls_with_the_number_of_periods():
    document = load_project("truck").model_dump(by_alias=True)
    document["frames"] |= {"omega_min_radps": 1.2566371, "bins_per_decade": 3}
    medians = []
    for periods in (4, 16):
        document["frames"] |= {"periods": periods}
        project = parse_project(document, "test")
        model = NominalModel(project)
        error = window_error(model, Estimator.from_project(project, model), seed=1)
        assert (error["percentile"] >= error["median"]).all()
        medians.append(error["median"][1:])
    assert (medians[1] < medians[0]).all() and 0.01 < medians[0].max() < 1.0
