"""How good the tests are. In: an identification, drives, faults put into them. Out: false alarms and
detection, leave-one-drive-out or on held-out drives, beside baselines. Which rooms it may import:
MAY_IMPORT."""

MAY_IMPORT = ("base", "vehicle", "drives", "core", "identify", "replay")
