"""What the compiled core says of a vehicle while it drives, on a page. In: frames as they come, of a running
simulation, a CAN interface or a growing log. Out: a read-only page for browsers of this machine, messages for
Foxglove, and drive tables. Which rooms it may import: MAY_IMPORT."""

MAY_IMPORT = ("base", "vehicle", "can", "drives", "core", "replay", "loop")
