"""A vehicle's life: one number, the wealth, updated with every recording.

In: drives in order, drives that calibrate, a generated folder. Out: wealth of each vehicle, its changes and
their size, a small state file and the core's table.
"""

MAY_IMPORT = ("base", "drives", "core", "identify", "replay")
