"""From drives to bounds, margins and a picture of both.

    python bounds_and_margins.py VEHICLE DRIVES OUT
    python bounds_and_margins.py g80 out/drives out/example

VEHICLE is a shipped vehicle or a project file, DRIVES a folder with experiments.csv: for the second line,
of `lpvguard generate --vehicle g80 -o out/drives`. OUT gets identify/, code/ and bounds.svg.
"""

import sys
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

import lpvguard
from lpvguard.drives.tables import list_experiments

vehicle, drives, out = sys.argv[1], Path(sys.argv[2]), Path(sys.argv[3])

# How wrong can the model be, and what is left to disturbances? One row a frequency.
identification = lpvguard.identify_drives(vehicle, drives).save(out / "identify")
print(identification.bounds.to_string(float_format="%.3g"))
print(f"threshold {identification.threshold:.3f}: {identification.claim}")

# The same core as on the ECU judges a drive: t* above 1 is more than any bound-setting drive asked for.
code = identification.export(out / "code")
name = list_experiments(drives)[-1]
run = lpvguard.replay_drive(vehicle, name.path, coefficients=code)
judged = run.frames[run.frames["reason"] == "none"]
print(
    judged.groupby("omega_rad_s")["margin"].describe()[["count", "50%", "max"]].to_string(float_format="%.3g")
)

figure, (above, below) = plt.subplots(2, 1, sharex=True, figsize=(7, 6), layout="constrained")
above.loglog(identification.weights.filter(like="W_delta"), label="W_delta, the weight")
above.loglog(identification.bounds.filter(like="nu"), "o", label="nu, what the drives ask for")
above.set(ylabel="relative error of the model", title=identification.project.title)
above.legend()
below.semilogx(judged["omega_rad_s"], judged["margin"], ".", label=f"t* of the frames of {name.name}")
below.axhline(identification.threshold, color="k", label="threshold")
below.set(xlabel="rad/s", ylabel="t*")
below.legend()
figure.savefig(out / "bounds.svg")
print(f"written: {out / 'bounds.svg'}")
