"""Frequency-domain model validation (section II of the paper) for the classes of THEORY 4.

``s1``     one complex scalar common to all outputs: closed forms on arrays of points, and the on-line margin
``s2``     input-multiplicative scalar and a full block on the state: certified global optimum, compiled
``lft``    section II in general: any P, any mix of full and repeated blocks; exact or a two-sided interval
``delta``  the perturbation that explains the data, built from (xi, eta) and verified

``lft`` is built, lowest first, on

``lmi``           small Hermitian feasibility problems, the source of every certificate
``problem``       one frequency point, and all signals that satisfy its second equation
``well_posed``    whether the LFT stays regular for every Delta of a size
``quadratic``     the remaining quadratic problem, its cost and its feasible points
``local_search``  local improvement of a point, and first points for repeated blocks
``relaxation``    certified lower bounds over cones of sizes and boxes of scalars
``branch``        the branch and bound that closes the two sides
``scaled_problem`` a point in well-scaled coordinates, and the way back to signals and Delta
"""
