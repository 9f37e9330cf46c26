"""Solve problems with the engine as a service.

The input is problems in plain JSON, with complex numbers as [re, im]. The output is answers, and their
comparison with the reference answers in the problems.
"""

MAY_IMPORT = ("base", "vehicle", "engine")
