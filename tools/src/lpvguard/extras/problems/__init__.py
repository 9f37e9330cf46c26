"""The engine as a service. In: problems as plain JSON (complex numbers as [re, im]). Out: answers, and how
they compare with those that a problem carries. Which rooms it may import: MAY_IMPORT."""

MAY_IMPORT = ("base", "vehicle", "engine")
