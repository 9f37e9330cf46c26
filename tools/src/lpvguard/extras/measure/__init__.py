"""Write descriptions for measurement tools that read a vehicle's core in its ECU.

They are made from the core's headers, the integrator's image with its debug information, and the project.
The description in ASAP2 (A2L) has name, place, unit, range and text of every field.
"""

MAY_IMPORT = ("base", "vehicle", "core")
