"""Functional mock-up units: a vehicle's monitor for simulation tools.

In: a project and its folder. Out: an FMU with the compiled core inside. MAY_IMPORT lists what a room
may import.
"""

MAY_IMPORT = ("vehicle", "core")
