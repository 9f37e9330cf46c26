"""Evaluation of the tests.

In: an identification, drives, faults injected into them. Out: false alarms and detection, leave-one-drive-out
or on held-out drives, in comparison with baselines.
"""

MAY_IMPORT = ("base", "vehicle", "drives", "core", "identify", "replay")
