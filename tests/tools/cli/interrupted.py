"""Every writing command, killed, or with a full disk, at chosen steps or instants: what it leaves must be the
old result or the new one.

    interrupted.py steps EVERY [COMMAND...]
        SIGKILL, SIGTERM and a full disk before each step that touches the disk, with and without the system
        call that exchanges two names. EVERY 1: each of them at every step; N: at every Nth, each at others,
        so that up to 3 no step is left out
    interrupted.py kills SEED COUNT
        COUNT kills at random instants of the time in which the commands write, SIGTERM and SIGKILL in turn

The commands run in forked copies of one process that has all imports, and Typer's commands. What they
compute is replaced here by small results of one of two variants; what they write goes the way it always
goes. Prints JSON: runs, those that were torn and why, and where the kills fell.
"""

import hashlib
import json
import os
import random
import select
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import typer.main

import lpvguard.can.dbc
import lpvguard.control.design
import lpvguard.control.design_files
import lpvguard.control.frozen
import lpvguard.control.stored_frames
import lpvguard.control.tradeoff
import lpvguard.core.compiled
import lpvguard.drives.fixture
import lpvguard.drives.ingest
import lpvguard.engine.synthesis.cases
import lpvguard.evaluate.evaluation
import lpvguard.extras.bench
import lpvguard.extras.loop.campaign.chunked_runs
import lpvguard.extras.loop.generate
import lpvguard.extras.loop.lcm_client
import lpvguard.extras.loop.sim
import lpvguard.extras.problems.solve
import lpvguard.fit.fitted_model
import lpvguard.identify.deciders
import lpvguard.identify.export
import lpvguard.identify.identification
import lpvguard.identify.premise
import lpvguard.report.design_pictures
import lpvguard.report.page
import lpvguard.start.new_project
from lpvguard import cli, schemas
from lpvguard.base import artefacts, system

MAP = 'schema = 1\nTs_s = 0.1\n[columns.v]\nunit = "m/s"\nsignal = "v"\n'
ROW = schemas.example("sim")[0] | {"scenario": "a", "seed": 1, "real_time_factor": 1.0}
REPLAYED = schemas.example("replay")[0] | {"run": "a", "alarms": []}


def commands(variant: str) -> dict[str, tuple[list[str], str]]:
    """Words and target of every writing command, of variant a or b of its inputs."""
    return {
        "generate": (
            ["generate", "--vehicle", "g80", "-o", "out/drives", "--seed", {"a": "1", "b": "2"}[variant]],
            "out/drives",
        ),
        "ingest": (
            ["ingest", f"{variant}/log.csv", "--signals", "map.toml", "-o", "out/tables"],
            "out/tables",
        ),
        "ingest --json": (
            ["ingest", f"{variant}/log.csv", "--signals", "map.toml", "-o", "tables", "--json", "out/i.json"],
            "out/i.json",
        ),
        "dbc": (["dbc", "-o", "out/our.dbc"], "out/our.dbc"),
        "new": (["new", "car", f"{variant}/log.csv", "-o", "out/car"], "out/car"),
        "fit": (["fit", "--vehicle", "g80", "drives", "-o", "out/fit"], "out/fit"),
        "identify": (["identify", "--vehicle", "g80", "drives", "-o", "out/identify"], "out/identify"),
        "design": (["design", "--vehicle", "g80", "idn", "--no-table", "-o", "out/design"], "out/design"),
        "design --case": (["design", "--case", "case.toml", "-o", "out/case"], "out/case"),
        "design --tradeoff": (
            ["design", "--vehicle", "g80", "idn", "--tradeoff", "-o", "out/tradeoff"],
            "out/tradeoff",
        ),
        "export": (["export", "--vehicle", "g80", "idn", "-o", "out/g80"], "out/g80"),
        "replay": (
            ["replay", "--vehicle", "g80", "a/log.csv", "--json", "out/replay.json"],
            "out/replay.json",
        ),
        "sim": (["sim", "nominal", "-o", "out/sim"], "out/sim"),
        "evaluate": (
            ["evaluate", "--vehicle", "g80", "idn", "drives", "--json", "out/evaluation.json"],
            "out/evaluation.json",
        ),
        "campaign": (
            ["campaign", "idn", "drives", "-o", "out/campaign", "--seed", "1", "--coefficients", "vehicle"],
            "out/campaign",
        ),
        "report": (
            ["report", "idn", "drives", "--vehicle", "g80", "-o", "out/report.html"],
            "out/report.html",
        ),
        "solve": (["solve", f"{variant}/problems.json", "-o", "out/answers.json"], "out/answers.json"),
        "bench": (["bench", "bounds", "--count", "11", "--json", "out/bench.json"], "out/bench.json"),
        "lcm bus": (["lcm", "bus", f"{variant}/log.csv", "-o", "out/bus.log"], "out/bus.log"),
        "plant": (["plant", "generate", "-o", "out/drive.csv"], "out/drive.csv"),
    }


RESUMED, NEVER_REPLACED = ("campaign",), ("lcm bus", "plant")
"""Whose folder only grows; whose file has no mark, so that it is only ever new."""


def folder_of(kind: str, files: dict[str, str], vehicle: str = "g80"):
    def write(target: Path) -> None:
        with artefacts.new_folder(target, kind, vehicle) as folder:
            for name in files:
                (folder / name).parent.mkdir(exist_ok=True)
            text = artefacts.manifest(kind, vehicle=vehicle, project={})
            artefacts.write_files(folder, files | {artefacts.MANIFEST: text})

    return write


def replace_in_cli(name: str, value: object) -> None:
    """Replace what the modules of the command line call by this name."""
    modules = [m for n, m in sys.modules.items() if n.startswith("lpvguard.cli.") and hasattr(m, name)]
    assert modules, name
    for module in modules:
        setattr(module, name, value)


def replace_computing(variant: str) -> None:
    """Small results instead of long computations, in this (forked) process only."""
    text = f"variant {variant}\n" * 400
    stored = SimpleNamespace(
        manifest={"variant": variant},
        calibration=SimpleNamespace(groups={}),
        project=SimpleNamespace(
            name="g80", frames=SimpleNamespace(estimator="hann"), design=SimpleNamespace(structure="K_i")
        ),
    )
    replace_in_cli("stored_for", lambda *_: stored)
    replace_in_cli("stored_with_drives", lambda *_: (stored, None))
    replace_in_cli("require_settings", lambda *_: None)
    replace_in_cli("print_premise", lambda _: None)
    lpvguard.identify.premise.premise = lambda _: None
    lpvguard.drives.fixture.PLAN[:] = [("train", "human", 5.0, 1.0), ("valid", "human", 9.0, 1.0)]
    plain = lpvguard.can.dbc.dbc_text
    lpvguard.can.dbc.dbc_text = lambda: plain() + f'CM_ "{variant}";\n'
    lpvguard.start.new_project.new = lambda name, logs, out, **_: (
        folder_of("new", {"car.toml": text, "drives/a.csv": text}, name)(out)
        or SimpleNamespace(proposals={}, notes=[], left_out={})
    )
    lpvguard.fit.fitted_model.fit = lambda *_: SimpleNamespace(
        project=SimpleNamespace(name="g80"), findings=[], to_dict=dict
    )
    lpvguard.fit.fitted_model.save = lambda result, plain, where, out, files: folder_of(
        "fit", {"fit.json": text}
    )(out)
    replace_in_cli("_picture", lambda _: "")
    replace_in_cli("print_fit", lambda _: None)
    replace_in_cli("print_evidence", lambda *_: None)
    for name in ("decides_bounds", "decides_thresholds", "outlying", "silence", "unresolved"):
        setattr(lpvguard.identify.deciders, name, lambda _: [])
    lpvguard.identify.identification.identify = lambda *_, **__: (
        SimpleNamespace(
            bound_drives=[],
            calibration_drives=[],
            left_out={},
            energy=None,
            change=None,
            diagnosis=None,
            model_fit=[],
            others_fit=[],
            weights=SimpleNamespace(inflation=1.0),
            calibration=SimpleNamespace(to_dict=dict, carried=1.0, claim=lambda: ""),
        ),
        None,
    )
    lpvguard.identify.identification.save = lambda result, drives, out: folder_of(
        "identify", {"weights.json": text, "spectra.npz": text * 20}
    )(out)
    proved = SimpleNamespace(upper=0.5, lower=0.4, bracket=SimpleNamespace(peak_frequency=1.0))
    lpvguard.control.design.design = lambda *_: SimpleNamespace(
        certificates=[(10.0, proved)],
        worst=0.5,
        off_grid=(11.0, proved),
        moving={},
        beside=None,
        full_order=9,
        schedule=SimpleNamespace(order=4, speeds=[1, 2]),
    )
    lpvguard.control.design.save = lambda result, stored, out, more, largest: folder_of(
        "design", {"controller.json": text}
    )(out)
    cases = lpvguard.engine.synthesis.cases
    cases.read_case = cases.paper_case = lambda *_, **__: []
    lpvguard.control.design_files.case_files = lambda *_: {
        "table2.json": artefacts.to_json({"rows": [], "text": text})
    }
    lpvguard.control.frozen.FrozenProblem = lpvguard.control.stored_frames.StoredFrames = lambda *_: None
    lpvguard.report.design_pictures.drawn = lambda _: {}
    lpvguard.control.tradeoff.search = lambda *_: SimpleNamespace(
        outcomes=[],
        sentence="",
        setting=dict,
        best=SimpleNamespace(level=0.5),
        files=lambda: {"tradeoff.json": artefacts.to_json({"text": text})},
    )
    lpvguard.identify.export.export_vehicle = lambda stored, out, controller: folder_of(
        "vehicle", {"lpvguard_coeff.c": text, "SIGNALS.md": text}
    )(out)
    replayer = SimpleNamespace(
        summarise_file=summarise,
        threshold=1.0,
        energy_threshold=1.0,
        change_threshold=1.0,
        core=SimpleNamespace(folder="core"),
        model=None,
    )
    replace_in_cli("replayer_of", lambda *_: replayer)
    summarise.text = text
    lpvguard.extras.loop.sim.load_scenario = lambda name: SimpleNamespace(name=name, seed=1)
    lpvguard.extras.loop.sim.Simulator = lambda *_, **__: SimpleNamespace(
        run=run_sim, folder="core", controller="designed", project=stored.project
    )
    run_sim.text = text
    lpvguard.evaluate.evaluation.evaluate = lambda *_, **__: {"text": text}
    replace_in_cli("print_evaluation", lambda _: None)
    replace_in_cli("print_campaign", lambda _: None)
    lpvguard.extras.loop.campaign.chunked_runs.campaign = run_campaign
    lpvguard.report.page.write_report = lambda stored, drives, replayer, out, *_: artefacts.write_file(
        out, f'<html><meta name="generator" content="{artefacts.mark("report")}">{text}', "report"
    )
    lpvguard.extras.bench.run = lambda name, words: lpvguard.extras.bench.show(
        "", [{"text": text}], lpvguard.extras.bench.parser(name, None).parse_args(words).json_out
    )
    lpvguard.extras.loop.lcm_client.read_log = lambda log: [("LPVGUARD_BUS", text)] * 9
    lpvguard.extras.loop.lcm_client.log_line = lambda message: message
    lpvguard.extras.loop.generate.plant_tool = lambda: Path("plant_tool").absolute()


def summarise(log, channel, with_series):
    return {**REPLAYED, "text": summarise.text}, None


def run_sim(scenario, *, out, seed, **_):
    for ending in ("log", "telemetry.csv"):
        (out / f"{scenario.name}-{seed}.{ending}").write_text(run_sim.text)
    return {**ROW, "text": run_sim.text}


def run_campaign(stored, drives, folder, out, *, seed, **_):
    with artefacts.kept_folder(out, "campaign", seed=seed) as kept:
        for k in range(5):
            if not kept.has(f"chunks/{k}.parquet"):
                kept.write(f"chunks/{k}.parquet", f"chunk {k}\n".encode() * 300)
        kept.write("summary.json", b'{"missed": []}')
    return {"missed": []}


def inputs(root: Path) -> None:
    """What the commands read."""
    for variant in "ab":
        (root / variant).mkdir()
        values = "".join(f"{0.1 * k:.1f},{k % 7 + ord(variant)}\n" for k in range(100))
        (root / variant / "log.csv").write_text("t,v\n" + values)
        (root / variant / "problems.json").write_text(json.dumps([{"id": variant, "kind": "none"}] * 5))
    (root / "map.toml").write_text(MAP)
    (root / "case.toml").write_text("")
    (root / "out").mkdir()
    for folder in ("idn", "drives"):
        (root / folder).mkdir()
        (root / folder / "mine.txt").write_text("an input")
    folder_of("vehicle", {"lpvguard_coeff.c": "an input"})(root / "vehicle")
    tool = root / "plant_tool"
    tool.write_text('#!/bin/sh\nfor i in 1 2 3 4 5 6 7 8; do echo "$i,$i" >> "$3" || exit 3; done\n')
    tool.chmod(0o755)


def tree(root: Path) -> dict[str, str]:
    """Every file below ``root``, and ``root`` itself when it is one, with its hash."""
    if root.is_file():
        return {"": hashlib.sha256(root.read_bytes()).hexdigest()}
    return {
        p.relative_to(root).as_posix(): hashlib.sha256(p.read_bytes()).hexdigest()
        for p in sorted(root.rglob("*"))
        if p.is_file()
    }


class Steps:
    """Audit hook of a child: counts the steps that touch ``root``, tells of each, and does ``act`` before
    step ``at``."""

    EVENTS = frozenset(
        {
            "open",
            "os.mkdir",
            "os.rename",
            "os.remove",
            "os.rmdir",
            "os.unlink",
            "shutil.rmtree",
            "os.truncate",
            "fcntl.flock",
        }
    )

    def __init__(self, root: Path, at: int | None, act, tell: int | None):
        self.root, self.at, self.act, self.tell, self.count, self.busy = str(root), at, act, tell, 0, False

    def __call__(self, event: str, arguments: tuple) -> None:
        if (
            event in self.EVENTS
            and not self.busy
            and (event == "fcntl.flock" or self._writes(event, arguments))
        ):
            self.step()

    def _writes(self, event: str, arguments: tuple) -> bool:
        path = os.fsdecode(arguments[0]) if isinstance(arguments[0], (str, bytes, os.PathLike)) else ""
        reads = event == "open" and not (
            isinstance(arguments[2], int) and arguments[2] & (os.O_WRONLY | os.O_RDWR | os.O_CREAT)
        )
        return os.path.abspath(path).startswith(self.root) and not reads

    def step(self) -> None:
        self.busy = True
        self.count += 1
        if self.tell is not None:
            os.write(self.tell, b".")
        self.busy = False
        if self.count == self.at:
            self.act()


def full_disk() -> None:
    raise OSError(28, "No space left on device")


def start(
    root: Path, name: str, variant: str, *, at: int | None = None, act=None, exchange: bool = True
) -> tuple[int, int]:
    """A child that runs the command in ``root``; returns its process and the pipe that says of every step."""
    words, _ = commands(variant)[name]
    out, into = os.pipe()
    sys.stdout.flush()
    child = os.fork()
    if child:
        os.close(into)
        return child, out
    status = 70
    try:
        os.close(out)
        os.chdir(root)
        quiet = os.open(root.parent / f"{root.name}.messages", os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(quiet, 1), os.dup2(quiet, 2)
        replace_computing(variant)
        steps = Steps(root, at, act, into)
        sync, exchange_names = os.fsync, system.exchange

        def synced(handle):
            steps.step()
            sync(handle)

        def exchanged(a, b):
            if not exchange:
                return False
            steps.step()
            done = exchange_names(a, b)
            steps.step()
            return done

        os.fsync, system.exchange = synced, exchanged
        sys.addaudithook(steps)
        sys.argv = ["lpvguard", *words]
        try:
            cli.main()
            status = 0
        except SystemExit as end:
            status = end.code if isinstance(end.code, int) else 0 if end.code is None else 1
    except BaseException:
        import traceback

        traceback.print_exc()
    finally:
        # A signal after the command's end must not unwind this copy of the parent, and with it the parent's
        # scratch folder.
        try:
            signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTERM})
            sys.stdout.flush(), sys.stderr.flush()
        finally:
            os._exit(status)


def finish(child: int, pipe: int) -> tuple[int, int]:
    """Exit status (less than 0: the signal) and steps of a child."""
    count = 0
    while got := os.read(pipe, 65536):
        count += len(got)
    os.close(pipe)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), count


class Trial:
    """The folder of one command, with its old result, and what the new one is."""

    def __init__(self, base: Path, name: str):
        self.name, self.target = name, commands("a")[name][1]
        self.clean, self.root = (
            base / f"{name.replace(' ', '_')}-clean",
            base / f"{name.replace(' ', '_')}-work",
        )
        self.clean.mkdir()
        inputs(self.clean)
        replaced = name not in (*RESUMED, *NEVER_REPLACED)
        if replaced:
            self._must_run(self.clean, "a")
        self.before = tree(self.clean)
        self.old = tree(self.clean / self.target)
        self.reset()
        self.steps = self._must_run(self.root, "b")
        self.new, self.after = tree(self.root / self.target), tree(self.root)
        assert self.new and self.new != self.old, name

    def _must_run(self, root: Path, variant: str) -> int:
        status, count = finish(*start(root, self.name, variant))
        if status:
            raise RuntimeError(
                f"{self.name}: exit {status}: " + (root.parent / f"{root.name}.messages").read_text()[-2000:]
            )
        return count

    def reset(self) -> None:
        shutil.rmtree(self.root, ignore_errors=True)
        shutil.copytree(self.clean, self.root)

    def torn(self, status: int, how: str, exchange: bool = True) -> str | None:
        """Why what is left is torn, or None; then the command runs again, and must end as if nothing had
        been."""
        if not exchange:
            artefacts.recover(self.root / self.target)
        files = tree(self.root / self.target)
        whole = files in (self.old, self.new) or (self.name in RESUMED and self._part(files))
        if not whole:
            return f"{self.name}, {how}: the target holds neither the old result nor the new one"
        left = {n for n in tree(self.root) if ".lpvguard/" in n}
        if left and how.startswith("SIGTERM"):  # a full disk, as made here, may refuse to remove too
            return f"{self.name}, {how}: left {sorted(left)}"
        if (how.startswith("full") and status not in (0, 1, 2)) or (
            how.startswith("SIGTERM") and status not in (0, 1, 143)
        ):
            return (
                f"{self.name}, {how}: exit {status}: "
                + (self.root.parent / f"{self.root.name}.messages").read_text()[-600:]
            )
        if self.name in NEVER_REPLACED and files == self.new and not left:
            return None
        again, _ = finish(*start(self.root, self.name, "b"))
        if self.name in NEVER_REPLACED and files == self.new:
            return None  # refused, or the same bytes
        if again or tree(self.root) != self.after:
            return (
                f"{self.name}, {how}: the next run exits {again} and leaves "
                f"{sorted(tree(self.root).items() ^ self.after.items())[:4]}"
            )
        return None

    def _part(self, files: dict[str, str]) -> bool:
        return all(self.new.get(n) == h for n, h in files.items() if n != artefacts.MANIFEST)


def at_every_step(base: Path, every: int, names: list[str]) -> dict:
    runs, torn, reached = 0, [], {}
    acts = {
        "SIGKILL": lambda: os.kill(os.getpid(), signal.SIGKILL),
        "SIGTERM": lambda: os.kill(os.getpid(), signal.SIGTERM),
        "full disk": full_disk,
    }
    for name in names:
        trial = Trial(base, name)
        for exchange in (True, False):
            for first, (how, act) in enumerate(acts.items()):
                last = trial.steps - (1 if exchange else 0)
                for at in range(1 + first % every, last + 1, every):
                    reached.setdefault(name, set()).add(at)
                    trial.reset()
                    status, _ = finish(*start(trial.root, name, "b", at=at, act=act, exchange=exchange))
                    runs += 1
                    why = trial.torn(
                        status,
                        f"{how} before step {at} of {trial.steps}"
                        + ("" if exchange else " without exchange"),
                        exchange,
                    )
                    torn += [why] if why else []
            if trial.root.joinpath(trial.target).is_file():
                break  # a file is renamed, never exchanged
    missed = [f"{n}: {at}" for n, steps in reached.items() for at in set(range(1, max(steps))) - steps]
    return {"runs": runs, "torn": torn, "missed": missed}


def at_random_instants(base: Path, seed: int, count: int) -> dict:
    draw, torn, fell = random.Random(seed), [], Counter()
    trials = [Trial(base, name) for name in commands("a")]
    for k in range(count):
        trial = trials[k % len(trials)]
        number = (signal.SIGTERM, signal.SIGKILL)[(k + k // len(trials)) % 2]
        trial.reset()
        # The instant: after a random step has begun, by a random part of the time between two steps.
        wanted, wait = draw.randint(1, trial.steps), draw.uniform(0, 5e-4)
        child, pipe = start(trial.root, trial.name, "b")
        seen = 0
        while seen < wanted and select.select([pipe], [], [], 60)[0] and (got := os.read(pipe, 1)):
            seen += len(got)
        time.sleep(wait)
        os.kill(child, number)
        status, _ = finish(child, pipe)
        fell["while it wrote" if status in (-number, 128 + number) else "after its end"] += 1
        why = trial.torn(status, f"{number.name} after step {wanted} of {trial.steps}")
        torn += [why] if why else []
    return {"runs": count, "torn": torn, "fell": dict(fell)}


if __name__ == "__main__":
    what, *rest = sys.argv[1:]
    typer.main.get_command = cache(typer.main.get_command)
    typer.main.get_command(cli.app)
    with tempfile.TemporaryDirectory() as scratch:
        base = Path(scratch).resolve()
        result = (
            at_every_step(base, int(rest[0]), rest[1:] or list(commands("a")))
            if what == "steps"
            else at_random_instants(base, *map(int, rest))
        )
    print(json.dumps(result, indent=1))
