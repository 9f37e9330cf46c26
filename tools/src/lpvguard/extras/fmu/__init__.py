"""Functional mock-up units: a vehicle's monitor for simulation tools.

In: a project and its folder. Out: an FMU with the compiled core inside.
"""

MAY_IMPORT = ("vehicle", "core")
