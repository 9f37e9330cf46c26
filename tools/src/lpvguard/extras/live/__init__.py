"""Show results of the compiled core on a page while a vehicle drives.

The input is a stream of frames from a running simulation, a CAN interface or a growing log. The output is a
read-only page for browsers of this machine, messages for Foxglove, and drive tables.
"""

MAY_IMPORT = ("base", "vehicle", "can", "drives", "core", "replay", "loop")
