"""Frequency-domain model validation (section II of the paper) for the classes of THEORY 4.

``s1``     one complex scalar common to all outputs: closed-form solutions on arrays of points, and the on-
           line margin
``s2``     input-multiplicative scalar and a full block on the state: certified global optimum, compiled
``lft``    section II for any P and any mix of full and repeated blocks: the optimum, or bounds on both sides
``delta``  construction of the perturbation that explains the data, from (xi, eta), and its check

``lft`` uses these modules. The basic ones come first:

``lmi``           small Hermitian feasibility problems, the source of every certificate
``problem``       data at one frequency, and all signals that satisfy the second equation of (1)
``well_posed``    test that the LFT is regular for every Delta of a size
``quadratic``     the remaining quadratic problem, its cost and its feasible points
``local_search``  local improvement of a point, and first points for repeated blocks
``relaxation``    certified lower bounds over cones of sizes and boxes of scalars
``branch``        branch and bound that closes the gap between both bounds
``scaled_problem`` a problem in well-scaled coordinates, and the conversion back to signals and Delta
"""
