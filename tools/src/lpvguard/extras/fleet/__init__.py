"""Lifetime test of a vehicle: one number, the wealth, is updated with every recording.

The input is drives in order of time, calibration drives, and a generated folder. The output is the wealth of
each vehicle, detected changes and their size, a small state file, and the core's table.
"""

MAY_IMPORT = ("base", "drives", "core", "identify", "replay")
