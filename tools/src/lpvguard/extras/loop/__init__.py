"""The closed loop on a PC.

The input is a generated folder with a controller, and scenarios. The output is runs of the simulated truck
with CAN frames and the compiled ECU loop. The package also has the required reactions of the supervision,
campaigns over seeds, the LCM client, and drives of the simulated truck.
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
