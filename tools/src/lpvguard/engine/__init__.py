"""The mathematical methods, independent of drives and files.

The inputs are arrays of E and Z, matrices, weights and plants. The results are unfalsified bounds of a frame
(`validation`), overbounding weights (`overbound`), and controllers, norms and mu with certificates
(`synthesis`).
"""

MAY_IMPORT = ("base", "vehicle")
