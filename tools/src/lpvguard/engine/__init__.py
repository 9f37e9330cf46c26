"""The mathematical methods, independent of drives and files.

In: arrays of E, Z, matrices, weights and plants. Out: unfalsified bounds of a frame (`validation`),
overbounding weights (`overbound`), controllers, norms and mu with certificates (`synthesis`).
"""

MAY_IMPORT = ("base", "vehicle")
