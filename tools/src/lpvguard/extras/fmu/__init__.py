"""Functional mock-up units for simulation tools: a vehicle's monitor, or its ECU with a CAN terminal.

In: a project and its folder. Out: an FMU with the compiled core inside.
"""

MAY_IMPORT = ("base", "vehicle", "can", "core")
