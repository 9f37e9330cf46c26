"""Time series of a replay, one row per sample, for plots.

t             s after the first sample; for a series in pieces, the time of the source
NAME          speed, inputs and outputs by the names of the signal table, in its units; null without a sample
yhat/NAME     nominal output, started at the first measured one
e/NAME        NAME minus yhat/NAME
margin/RAD_S  t* of the bin with that frequency [rad/s]; null unless the core judged a counted frame of it
energy_ratio  the energy test's ratio; null where it does not judge
change_ratio  the change test's newest; null before its first
test_ratio/TEST  statistic of the frame (pools included), energy or change test over its threshold: below 0.5
              normal, above 1 an alarm, as MAVLink's test ratios; null where the test does not judge
verdict       text, and verdict_code: its number in monitor.h

A column's metadata hold its unit as "unit".
"""

import numpy as np
import pyarrow as pa

from ..core.compiled import VERDICTS, Run
from ..drives.tables import Drive
from ..vehicle.project import Project

MARGIN = "margin/"
"""Prefix of the names of margin columns."""


TEST_RATIO = "test_ratio/"
"""Prefix of the names of columns with the ratio of a test's statistic to its threshold."""


def margin_column(omega: float) -> str:
    """Name of the column of the bin with frequency ``omega`` [rad/s]."""
    return f"{MARGIN}{omega:.4g}"


def numbers(column: pa.ChunkedArray) -> np.ndarray:
    """A column's numbers (N,), NaN where it is null."""
    return column.cast(pa.float64()).to_numpy(zero_copy_only=False)


def table_of(
    project: Project,
    yhat: np.ndarray,
    omega: np.ndarray,
    thresholds: dict[str, float],
    drive: Drive,
    run: Run,
    t0: float,
) -> pa.Table:
    """Series of a drive as a table of N rows; the module's docstring lists the columns.

    ``yhat`` (N, n_y) are nominal outputs, ``omega`` (K,) [rad/s] the bins' frequencies, ``thresholds`` those
    of the tests. Column t counts from ``t0`` [s].
    """
    absent = np.zeros(len(drive.t), bool) if drive.missing is None else drive.missing
    columns: dict[str, pa.Array] = {"t": pa.array(drive.t - t0)}
    names = [s.name for s in (project.speed, *project.inputs, *project.outputs)]
    for name, values in zip(names, np.column_stack([drive.v, drive.u, drive.y]).T, strict=True):
        columns[name] = pa.array(values, mask=absent)
    for j, output in enumerate(project.outputs):
        columns[f"yhat/{output.name}"] = pa.array(yhat[:, j], mask=absent)
        columns[f"e/{output.name}"] = pa.array(drive.y[:, j] - yhat[:, j], mask=absent)
    margins = np.full((len(omega), len(drive.t)), np.nan)
    counted = run.frames.counted
    begin = drive.t[0] if len(drive.t) else t0
    row = np.round((run.frames.t_judged_s[counted] - begin) / project.Ts_s).astype(int)
    margins[run.frames.bin[counted], row] = run.frames.margin[counted]
    for k, values in enumerate(margins):
        columns[margin_column(omega[k])] = pa.array(values, mask=np.isnan(values))
    columns["energy_ratio"] = pa.array(run.energy, mask=run.energy == 0)
    columns["change_ratio"] = pa.array(run.change, mask=run.change == 0)
    largest = np.zeros(len(drive.t))
    np.maximum.at(largest, row, np.maximum(run.frames.statistic, run.frames.pooled)[counted])
    for test, x in {"frame": largest, "energy": run.energy, "change": run.change}.items():
        columns[TEST_RATIO + test] = pa.array(x / thresholds[test], mask=x == 0)
    columns["verdict"] = pa.array([VERDICTS[code] for code in run.verdict])
    columns["verdict_code"] = pa.array(run.verdict)
    units = {s.name: s.unit for s in (project.speed, *project.inputs, *project.outputs)} | {"t": "s"}
    fields = []
    for name, values in columns.items():
        unit = units.get(name.rpartition("/")[2] if not name.startswith(MARGIN) else "", "")
        fields.append(pa.field(name, values.type, metadata={"unit": unit} if unit else None))
    return pa.table(list(columns.values()), schema=pa.schema(fields))
