"""lpvguard: unfalsified LPV vehicle models, robust controllers and an on-line nominal-error monitor.

One module per stage of the chain; ``tools/README.md`` lists them in the order in which data pass through.
"""

__version__ = "0.1.0"
