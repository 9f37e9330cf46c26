"""The engine as a service.

In: problems as plain JSON (complex numbers as [re, im]). Out: answers, and their comparison with those in the
problem.
"""

MAY_IMPORT = ("base", "vehicle", "engine")
