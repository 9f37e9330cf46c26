"""The closed loop on a PC. In: a generated folder with a controller, scenarios. Out: runs of simulated truck,
CAN frames and compiled ECU loop; what supervision had to do; campaigns over seeds; the LCM client; drives of
the simulated truck. Which rooms it may import: MAY_IMPORT."""

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
)
