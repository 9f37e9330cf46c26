"""A stable weight of low order above samples of a bound, with a proof between the samples.

python weight_above_samples.py PICTURE.svg
"""

import sys

import matplotlib
import matplotlib.pyplot as plt
import numpy as np

from lpvguard.engine.overbound.fit import fit_overbound

matplotlib.rcParams.update({"svg.fonttype": "none", "svg.hashsalt": "lpvguard"})
omega = np.geomspace(0.5, 20, 12)  # rad/s
bound = 0.1 + 0.4 * omega / (omega + 5) + 0.05 * np.sin(3 * np.log(omega))
fit = fit_overbound(omega, bound)
print(f"order {fit.order}, at most {fit.worst_ratio_db:.2f} dB above the samples")
print(f"proved: {fit.certificate['ok']}")

fine = np.geomspace(0.1, 100, 400)
figure, axes = plt.subplots(figsize=(6, 3.2), layout="constrained")
axes.loglog(fine, fit.weight.magnitude(fine), label="weight")
axes.loglog(omega, bound, "o", label="samples of the bound")
axes.set(xlabel="frequency [rad/s]", ylabel="size", ylim=(0.08, 0.8))
axes.legend()
figure.savefig(sys.argv[1], metadata={"Date": None})
