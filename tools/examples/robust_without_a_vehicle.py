"""Responses of nine motors -> uncertainty set -> weight -> controller with a proved level.

python robust_without_a_vehicle.py
"""

import control as ct
import numpy as np

from lpvguard import robust

omega = np.geomspace(0.1, 1000, 60)
motors = [ct.tf([k], [tau, 1]) for k in (0.9, 1.0, 1.1) for tau in (0.08, 0.1, 0.12)]
nominal = ct.tf([1], [0.1, 1])
responses = np.array([motor(1j * omega) for motor in motors])[..., None, None]
W_delta, ratio = robust.uncertainty_set(omega, nominal, responses, "multiplicative_output").weight(2)
print(f"W_delta has order {len(W_delta.poles())}, at most {100 * (ratio - 1):.1f} % above the radius")

# Mixed sensitivity: Delta's output and the disturbance act on the motor's output, weighted by W_P.
W_P = ct.tf([0.5, 5], [1, 0.005])
plant = ct.interconnect(
    [
        ct.ss(nominal, inputs="u", outputs="g", name="nominal"),
        ct.ss(W_delta, inputs="g", outputs="eta", name="W_delta"),
        ct.ss(W_P, inputs="e", outputs="z", name="W_P"),
        ct.summing_junction(["g", "xi", "w"], "e"),
        ct.summing_junction(["-e"], "y"),
    ],
    inplist=["xi", "w", "u"],
    outlist=["eta", "z", "y"],
)
synthesis = robust.musyn(plant, 1, 1, [robust.Block("full", 1, 1)])
print(f"mu is proved to be at most {synthesis.level:.3f}; no less than {synthesis.lower:.3f} was found")
