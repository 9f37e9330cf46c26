"""Pictures of the page; each module draws one kind: over bins, over time, of the design, of detectors.

In: arrays and plain JSON values. Out: inline SVG whose bytes depend on the data only.
"""
