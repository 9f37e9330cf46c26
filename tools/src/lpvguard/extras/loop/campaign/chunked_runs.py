"""Run a campaign: prepare the baselines and the trucks, make the runs in chunks, and summarise them.

A stopped campaign can be resumed and ends with the same bytes.
"""

import io
from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from ....base import artefacts
from ....base.errors import InputError
from ....base.parallel import Map
from ....base.progress import Counted, Progress
from ....control.controller_file import require_designed_for
from ....core.compiled import Core
from ....evaluate.baseline_study import BaselineStudy
from ....evaluate.baselines import KINDS as BASELINE_KINDS
from ....evaluate.detection import Injection
from ....identify.identification import DriveSet, StoredIdentification
from ....replay.replayer import Replayer
from ..sim import Simulator
from . import faults, trucks
from .one_run import Context, Detectors, run_planned
from .scenarios import DURATION_S, PlannedRun, Size, plan
from .summary import summarise
from .tracking import TrackingBound

CHUNK = 40
SAME_RTOL = 3e-3
"""Largest relative difference of bounds that count as equal. A fit of a weight has two solutions that differ
by 1.3e-3, and rounding errors choose one of them."""


def campaign(
    stored: StoredIdentification,
    drives: DriveSet,
    folder: Path,
    out: Path,
    *,
    seed: int,
    size: Size,
    controller: Path | None = None,
    workers: Map = map,
    progress: Progress = lambda _: None,
) -> dict[str, Any]:
    """Run or resume a campaign.

    Parameters
    ----------
    stored : StoredIdentification
    drives : DriveSet, the identification's drives
    folder : Path, generated folder with controller, of this identification
    out : Path, folder of the campaign
    seed : int
    size : Size
    controller : Path, optional, controller.json of `design`, for mu of the faulted loops
    workers : Map
    progress : Callable, reports progress

    Returns
    -------
    dict, its summary

    Raises
    ------
    InputError
        If ``out`` holds another campaign, or an input belongs to another identification.
    """
    core = Core(folder)
    replayer = Replayer(Simulator(folder).project, core)
    _require_same(stored, replayer)
    if controller is not None:
        require_designed_for(stored, controller)
    certified = trucks.CertifiedSet.from_identification(stored)
    with artefacts.kept_folder(
        out,
        "campaign",
        seed=seed,
        size=asdict(size),
        vehicle=artefacts.read_manifest(folder, "vehicle"),
        plan={k.name: [k.table, *k.values] for k in faults.KINDS},
        duration_s=DURATION_S,
    ) as kept_in:
        tuned = _kept(kept_in, "baselines.json", lambda: _tune(stored, drives, core, workers, progress))
        plants = _kept(kept_in, "plants.json", lambda: trucks.plants(certified, seed, workers, progress))
        levels = []
        if controller is not None:
            levels = _kept(kept_in, "loops.json", lambda: trucks.loop_levels(stored, controller, progress))
        chosen = [c for c in plants["candidates"] if c["ratio"] <= 1][: trucks.PLANTS]
        within = [(c["tables"], c["least_gain"]) for c in chosen]
        context = Context(
            Path(folder).absolute(),
            seed,
            Detectors.from_tuning(tuned),
            TrackingBound.from_identification(stored),
        )
        table = _run_all(kept_in, context, plan(size, within), workers, progress)
        kept_in.write("runs.parquet", _parquet(table))
        summary = summarise(table, stored, plants, levels, tuned)
        kept_in.write("summary.json", artefacts.to_json(summary).encode())
    return summary


def _kept(out: artefacts.KeptFolder, name: str, make: Callable[[], Any]) -> Any:
    """Read the JSON value of a file in the campaign's folder; compute and write it if it is missing."""
    if not out.has(name):
        out.write(name, artefacts.to_json(make()).encode())
    return artefacts.read_json(out.folder / name)


def _run_all(
    out: artefacts.KeptFolder, context: Context, runs: list[PlannedRun], workers: Map, progress: Progress
) -> pa.Table:
    """Return the rows of all runs: read the stored chunks of ``out``, then run and store the others."""
    chunks = [runs[i : i + CHUNK] for i in range(0, len(runs), CHUNK)]
    names = [f"chunks/{i:05d}.parquet" for i in range(len(chunks))]
    left = [(n, c) for n, c in zip(names, chunks, strict=True) if not out.has(n)]
    rows = iter(workers(partial(run_planned, context), [planned for _, chunk in left for planned in chunk]))
    done = len(runs) - sum(len(chunk) for _, chunk in left)
    for name, chunk in left:
        table = []
        for planned in chunk:
            table.append(next(rows))
            done += 1
            progress(Counted(f"run {done} of {len(runs)}, {planned.kind}", done, len(runs)))
        out.write(name, _parquet(pa.Table.from_pylist(table, schema=_schema(table[0]))))
    return pa.concat_tables([pq.read_table(out.folder / n) for n in names])


def _require_same(stored: StoredIdentification, replayer: Replayer) -> None:
    """Raise InputError unless the folder's bounds are those of the identification."""
    (W_delta, B_w), _ = stored.fitted.of_core(replayer.estimator.omega)
    pairs = (W_delta, replayer.W_delta), (B_w, replayer.B_w)
    if not all(np.allclose(mine, cores, rtol=SAME_RTOL) for mine, cores in pairs):
        raise InputError(
            replayer.core.folder,
            "bounds",
            "are not those of the identification",
            f"an export of {stored.folder}",
        )


def _tune(
    stored: StoredIdentification, drives: DriveSet, core: Core, workers: Map, progress: Progress
) -> dict[str, Any]:
    """Make the content of baselines.json: scales, alpha, and the best parameters of each kind.

    Each kind has its threshold and the sizes of its components.
    """
    study = BaselineStudy(
        stored,
        drives,
        core,
        left_out=(None,),
        injection=Injection.usual(),
        workers=workers,
        progress=progress,
    )
    chosen = [study.best(kind) for kind in BASELINE_KINDS]
    return {
        "scales": asdict(study.bank.scales),
        "alpha": chosen[0][1].alpha,
        "chosen": [
            {
                "label": b.label,
                "parameters": asdict(b),
                "threshold": c.threshold,
                "sizes": study.bank.sizes.get(b, ()),
            }
            for b, c in chosen
        ],
    }


def _schema(row: dict[str, Any]) -> pa.Schema:
    """Make the schema of the rows from names and values, because every number may be null."""
    types = {int: pa.int64(), str: pa.string(), bool: pa.bool_()}
    return pa.schema([(name, types.get(type(value), pa.float64())) for name, value in row.items()])


def _parquet(table: pa.Table) -> bytes:
    stream = io.BytesIO()
    pq.write_table(table, stream)
    return stream.getvalue()
