"""Frequency-domain model validation (section II of the paper) for the classes of THEORY 4.

``s1``     one complex scalar common to all outputs: closed forms on arrays of points, and the on-line margin
``s2``     input-multiplicative scalar and a full block on the state: certified global optimum, compiled
``lft``    section II in general: any P, any mix of full and repeated blocks; exact or a two-sided interval
``lmi``    the certificates that ``lft`` is built on: small Hermitian feasibility problems
``delta``  the perturbation that explains the data, built from (xi, eta) and verified
"""
