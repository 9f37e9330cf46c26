"""The closed loop on a PC.

In: a generated folder with a controller, scenarios. Out: runs of simulated truck, CAN frames and compiled ECU
loop. Also out: required reactions of the supervision, campaigns over seeds, the LCM client, and drives of the
simulated truck.
"""

MAY_IMPORT = (
    "base",
    "vehicle",
    "engine",
    "can",
    "drives",
    "core",
    "identify",
    "control",
    "replay",
    "evaluate",
    "fmu",
)
