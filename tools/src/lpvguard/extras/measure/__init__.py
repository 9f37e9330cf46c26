"""Write descriptions for measurement tools that read a vehicle's core in its ECU.

In: the headers of the core, the integrator's image with its debug information, and the project. Out: a
description in ASAP2 (A2L) with name, address, unit, range and text of every field.
"""

MAY_IMPORT = ("base", "vehicle", "core")
