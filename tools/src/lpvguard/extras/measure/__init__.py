"""What a measurement tool needs to read a vehicle's core in its ECU. In: the headers of the core, the
integrator's image with its debug information, and the project. Out: a description in ASAP2 (A2L) with name,
place, unit, range and text of every field. Which rooms it may import: MAY_IMPORT."""

MAY_IMPORT = ("base", "vehicle", "core")
