"""Solve problems with the engine as a service.

In: problems as plain JSON (complex numbers as [re, im]). Out: answers, and their comparison with the
reference answers in the problems.
"""

MAY_IMPORT = ("base", "vehicle", "engine")
