"""A vehicle's whole life: one number of wealth, updated once a recording. In: drives in order, drives that
calibrate, a generated folder. Out: wealth of each vehicle, what changed and by how much, a small state file
and the core's table. Which rooms it may import: MAY_IMPORT."""

MAY_IMPORT = ("base", "drives", "core", "identify", "replay")
