"""A vehicle with short frames, drives of it, and its report: what the tests of the page read."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lpvguard.identify import identification as stage
from lpvguard.replay.replayer import Replayer
from lpvguard.report.page import write_report
from lpvguard.vehicle.nominal import NominalModel
from lpvguard.vehicle.project import load_project, parse_project

LEFT_OUT = "creeping"
# name, split, mean speed [m/s], duration [s]; the fault of "weak" makes alarms.
DRIVES = [
    ("slow", "train", 6.0, 120.0),
    ("fast", "train", 16.0, 120.0),
    ("check", "valid", 15.0, 30.0),
    ("weak", "valid", 6.0, 30.0),
    (LEFT_OUT, "valid", 2.0, 10.0),
]


def vehicle(n_y: int):
    """The g80 with short frames, and with lateral acceleration as second output when asked."""
    document = load_project("g80").model_dump(by_alias=True)
    document["frames"] |= {"omega_min_radps": 3.1415927, "omega_max_radps": 15.707963, "bins_per_decade": 5}
    document["bounds"]["nu_ceiling"] = {"f_hz": [1.0], "nu": [0.05]}
    document["weights"] |= {"max_order": 2}
    if n_y == 2:
        document["name"] = "two_outputs"
        second = {
            "name": "lateral_acceleration",
            "role": "output",
            "column": "ay",
            "unit": "m/s^2",
            "positive": "left turn",
            "min": -20.0,
            "max": 20.0,
        }
        document["signals"] = [*document["signals"], second]
        document["model"] |= {"C": [[1.0], [10.0]], "output_offset": [0.0, 0.0]}
    return parse_project(document, "test")


def write_drives(project, folder: Path) -> None:
    """Drives of a vehicle that differs from the nominal model by 10 % of gain and noise; "weak" has half the
    gain from 10 s on."""
    model, folder_index = NominalModel(project), ["experiment,split,driver"]
    folder.mkdir()
    for index, (name, split, speed, duration) in enumerate(DRIVES):
        random = np.random.default_rng(index)
        t = np.arange(int(duration / project.Ts_s)) * project.Ts_s
        v = speed * (1 + 0.03 * np.sin(0.2 * t))
        u = sum(0.02 * np.sin(w * t + random.uniform(0, 6)) for w in (1.0, 1.9, 3.1, 5.3, 9.7))[:, None]
        # Broad enough for the drives to tell at every bin: where they are silent W_delta is 2.
        u = u + 0.05 * random.standard_normal(u.shape)
        y = model.simulate(v, u, np.zeros(project.n_y))
        gain = np.where((name == "weak") & (t > 10.0), 0.5, 0.9)[:, None]
        y = gain * y + 2e-2 * np.abs(y).max(axis=0) * random.standard_normal(y.shape)
        columns = [project.speed.column, *(s.column for s in [*project.inputs, *project.outputs])]
        np.savetxt(
            folder / f"{name}.csv",
            np.column_stack([t, v, u, y]),
            delimiter=",",
            header=",".join(["t", *columns]),
            comments="",
            fmt="%.9g",
        )
        folder_index.append(f"{name},{split},robot")
    (folder / "experiments.csv").write_text("\n".join(folder_index) + "\n")


@dataclass(frozen=True)
class Case:
    stored: stage.StoredIdentification
    drives: stage.DriveSet
    replayer: Replayer

    def page(self, out: Path, evaluation: dict | None = None) -> bytes:
        write_report(self.stored, self.drives, self.replayer, out, evaluation, lambda _: None)
        return out.read_bytes()
