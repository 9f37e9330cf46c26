"""Pictures of the page, a module a kind: over the bins, over time, of the design, of detectors.

In: arrays and plain JSON values. Out: inline SVG whose bytes depend on the data only.
"""
