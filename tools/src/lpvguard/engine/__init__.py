"""The mathematics, with no notion of a drive or a file. In: arrays of E, Z, matrices, weights and plants.
Out: unfalsified bounds of a frame (`validation`), overbounding weights (`overbound`), controllers, norms and
mu with certificates (`synthesis`). Which rooms it may import: MAY_IMPORT."""

MAY_IMPORT = ("base", "vehicle")
