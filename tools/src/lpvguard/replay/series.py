"""Time series of a replay, a row a sample, for plots.

t             s after the first sample
NAME          speed, inputs and outputs by the names of the signal table, in its units; null without a sample
yhat/NAME     nominal output, started at the first measured one and never again
e/NAME        NAME less yhat/NAME
margin/RAD_S  t* of the bin with that frequency [rad/s]; null but where the core judged a counted frame of it
energy_ratio  the energy test's ratio; null where it does not judge
change_ratio  the change test's newest; null before its first
verdict       text, and verdict_code: its number in monitor.h

A column with a unit says it in its metadata, as "unit".
"""

from __future__ import annotations

import numpy as np
import pyarrow as pa

from ..core.compiled import VERDICTS, Run
from ..drives.tables import Drive
from ..vehicle.nominal import NominalModel
from ..vehicle.project import Project

MARGIN = "margin/"
"""How the names of columns of margins begin."""


def margin_column(omega: float) -> str:
    """Name of the column of the bin with frequency ``omega`` [rad/s]."""
    return f"{MARGIN}{omega:.4g}"


def table_of(project: Project, model: NominalModel, omega: np.ndarray, drive: Drive, run: Run) -> pa.Table:
    """The series of a drive of N samples as a table of N rows; see the module's docstring for the columns.

    ``omega`` (K,) [rad/s]: frequencies of the bins.
    """
    absent = np.zeros(len(drive.t), bool) if drive.missing is None else drive.missing
    yhat = model.simulate(drive.v, drive.u, drive.y[0])
    columns: dict[str, pa.Array] = {"t": pa.array(drive.t - drive.t[0])}
    names = [s.name for s in (project.speed, *project.inputs, *project.outputs)]
    for name, values in zip(names, np.column_stack([drive.v, drive.u, drive.y]).T, strict=True):
        columns[name] = pa.array(values, mask=absent)
    for j, output in enumerate(project.outputs):
        columns[f"yhat/{output.name}"] = pa.array(yhat[:, j], mask=absent)
        columns[f"e/{output.name}"] = pa.array(drive.y[:, j] - yhat[:, j], mask=absent)
    margins = np.full((len(omega), len(drive.t)), np.nan)
    counted = run.frames.counted
    row = np.round((run.frames.t_judged_s[counted] - drive.t[0]) / project.Ts_s).astype(int)
    margins[run.frames.bin[counted], row] = run.frames.margin[counted]
    for k, values in enumerate(margins):
        columns[margin_column(omega[k])] = pa.array(values, mask=np.isnan(values))
    columns["energy_ratio"] = pa.array(run.energy, mask=run.energy == 0)
    columns["change_ratio"] = pa.array(run.change, mask=run.change == 0)
    columns["verdict"] = pa.array([VERDICTS[code] for code in run.verdict])
    columns["verdict_code"] = pa.array(run.verdict)
    units = {s.name: s.unit for s in (project.speed, *project.inputs, *project.outputs)} | {"t": "s"}
    fields = []
    for name, values in columns.items():
        unit = units.get(name.rpartition("/")[2] if not name.startswith(MARGIN) else "", "")
        fields.append(pa.field(name, values.type, metadata={"unit": unit} if unit else None))
    return pa.table(list(columns.values()), schema=pa.schema(fields))
