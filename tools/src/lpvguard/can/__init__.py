"""The table of CAN messages, `catalogue.toml`, and everything made from it.

In: the catalogue, raw CAN logs. Out: our DBC, the C codec, decoded frames, and frames played onto a bus.
"""

MAY_IMPORT = ("base", "vehicle")
