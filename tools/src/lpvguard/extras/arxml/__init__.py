"""AUTOSAR components: a vehicle's monitor for an RTE generator.

In: a project and its generated folder. Out: an ARXML and the component's C source. MAY_IMPORT lists what a
room may import.
"""

MAY_IMPORT = ("base", "vehicle", "core", "fmu")
