"""Frequency-domain model validation (section II of the paper) for the classes of THEORY 4.

``s1``     one complex scalar common to all outputs: closed-form solutions on arrays of points, and the on-
           line margin
``s2``     input-multiplicative scalar and a full block on the state: certified global optimum, compiled
``lft``    section II for any P and any mix of full and repeated blocks; exact, or a lower and an upper bound
``delta``  the perturbation that explains the data, built from (xi, eta) and verified

``lft`` uses these modules, the basic ones first:

``lmi``           small Hermitian feasibility problems, the source of every certificate
``problem``       one frequency point, and all signals that satisfy the second equation of (1)
``well_posed``    whether the LFT stays regular for every Delta of a size
``quadratic``     the remaining quadratic problem, its cost and its feasible points
``local_search``  local improvement of a point, and first points for repeated blocks
``relaxation``    certified lower bounds over cones of sizes and boxes of scalars
``branch``        the branch and bound that makes the two bounds meet
``scaled_problem`` a point in well-scaled coordinates, and the conversion back to signals and Delta
"""
