"""An H-infinity controller of a lag with a weight on its error, and the proof of its level.

python hinf_controller.py PICTURE.svg
"""

import sys

import matplotlib
import matplotlib.pyplot as plt
import numpy as np

from lpvguard.engine.synthesis.hinf import hinf_synthesis
from lpvguard.engine.synthesis.statespace import StateSpace, lft

matplotlib.rcParams.update({"svg.fonttype": "none", "svg.hashsalt": "lpvguard"})

# States: the plant 1/(s + 1) and the weight 10/(s + 0.1) of its error. The error is w - y - 0.1 n.
A = [[-1.0, 0.0], [-10.0, -0.1]]
B = [[0.0, 0.0, 1.0], [10.0, -1.0, 0.0]]  # reference w, noise n, control u
C = [[0.0, 1.0], [0.0, 0.0], [-1.0, 0.0]]  # weighted error, control, measured error
D = [[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [1.0, -0.1, 0.0]]
plant = StateSpace(A, B, C, D)
result = hinf_synthesis(plant, n_control=1, n_measurement=1)
print(f"level {result.gamma_achieved:.4f}, controller of order {result.controller.order}")

omega = np.geomspace(1e-3, 1e3, 400)
closed = lft(plant, result.controller).response(omega)
gains = np.linalg.svd(closed, compute_uv=False)[:, 0]
print(f"largest gain on the grid {gains.max():.4f}")

figure, axes = plt.subplots(figsize=(6, 3.2), layout="constrained")
axes.semilogx(omega, gains, label="largest gain of the loop")
axes.axhline(result.gamma_achieved, color="k", linestyle="--", label="proved level")
axes.set(xlabel="frequency [rad/s]", ylabel="gain", ylim=(0, None))
axes.legend()
figure.savefig(sys.argv[1], metadata={"Date": None})
