"""Robust control with objects of python-control; it needs no drives, vehicles or files (lib/THEORY.md 6).

====================  ===========================================================================
``hinfsyn``           H-infinity controller with its certified level
``musyn``             D-K iteration with its certified level of mu
``mu``                upper and lower bound of the structured singular value
``worst_gain``        largest gain over every Delta of size 1
``disk_margin``       gain, phase, delay and disk margins of one loop
``nu_gap``            distance of two plants for feedback
``overbound``         stable minimum-phase weight of low order, proved to lie above samples
``uncertainty_set``   smallest set of one form that contains measured frequency responses
====================  ===========================================================================

MAY_IMPORT lists the packages that it may import.
"""

from ..engine.blocks import Block
from .analysis import disk_margin, mu, nu_gap, worst_gain
from .synthesis import Synthesis, hinfsyn, musyn
from .uncertainty import FORMS, UncertaintySet, overbound, uncertainty_set

MAY_IMPORT = ("base", "engine")

__all__ = [
    "FORMS",
    "Block",
    "Synthesis",
    "UncertaintySet",
    "disk_margin",
    "hinfsyn",
    "mu",
    "musyn",
    "nu_gap",
    "overbound",
    "uncertainty_set",
    "worst_gain",
]
