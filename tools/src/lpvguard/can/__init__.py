"""The table of CAN messages, `catalogue.toml`, and everything that is generated from it.

The input is the catalogue and raw CAN logs. The output is our DBC, the C codec, decoded frames, and frames
that are sent on a bus.
"""

MAY_IMPORT = ("base", "vehicle")
