"""The one table of messages, `catalogue.toml`, and what is made of it. In: the catalogue, raw CAN logs. Out:
our DBC, the C codec, frames decoded, and frames played onto a bus. Which rooms it may import: MAY_IMPORT."""

MAY_IMPORT = ("base", "vehicle")
