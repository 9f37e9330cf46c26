"""The compiled monitor in a loop, with a fault on the way, and measured against nominal response.

    python monitor_in_a_loop.py VEHICLE CODE DRIVE
    python monitor_in_a_loop.py g80 out/example/code out/drives/synthetic_01.csv

CODE is a folder of `lpvguard export`, DRIVE a table. From the middle of the drive on every output is
1.5 times what was measured.
"""

import sys
from pathlib import Path

import numpy as np

import lpvguard
from lpvguard.drives.faults import Fault, inject
from lpvguard.drives.tables import read_drive
from lpvguard.vehicle.nominal import NominalModel
from lpvguard.vehicle.project import load_project

vehicle, code, path = sys.argv[1], Path(sys.argv[2]), Path(sys.argv[3])
project = load_project(vehicle)
drive = read_drive(path, project)
middle_s = drive.duration_s / 2
faulty = inject(drive, Fault("gain", 1.5), middle_s, project.Ts_s)

# What the nominal model says beside what was measured, before and after the fault.
model = NominalModel(project)
nominal = model.simulate(drive.v, drive.u, drive.y[0])
settled = np.arange(len(drive.t)) > model.settle_samples
after = drive.t - drive.t[0] >= middle_s
for what, rows in (("healthy", settled & ~after), ("faulty", settled & after)):
    error = (faulty.y - nominal)[rows]
    share = 1 - error.var(axis=0) / faulty.y[rows].var(axis=0)
    print(f"{what}: rms error {np.sqrt((error**2).mean(axis=0))}, variance accounted for {share}")

# The loop of an application: one sample in, one verdict out.
monitor = lpvguard.Monitor(vehicle, code)
before = ""
for t, v, u, y in zip(faulty.t - faulty.t[0], faulty.v, faulty.u, faulty.y, strict=True):
    said = monitor.push(t, v, u, y)
    if said.verdict != before:
        print(f"{t:8.2f} s  {v:5.1f} m/s  {said.verdict}")
        before = said.verdict
    if said.frame and said.frame.falsified:
        f = said.frame
        print(
            f"{t:8.2f} s  alarm: t* = {f.margin:.2f} at {f.omega_rad_s:.3g} rad/s; fault at {middle_s:.2f} s"
        )
        break
else:
    raise SystemExit("the fault was not found")
