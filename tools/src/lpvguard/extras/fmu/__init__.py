"""Functional mock-up units: a vehicle's monitor for simulation tools. In: a project and its folder. Out:
an FMU with the compiled core inside. Which rooms it may import: MAY_IMPORT."""

MAY_IMPORT = ("base", "vehicle", "core")
