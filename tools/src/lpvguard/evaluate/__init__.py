"""Evaluation of the tests on drives with injected faults.

In: an identification, its drives or held-out drives, and the faults to inject. Out: false alarms and
detection of the monitor and of the baselines.
"""

MAY_IMPORT = ("base", "vehicle", "drives", "core", "identify", "replay")
