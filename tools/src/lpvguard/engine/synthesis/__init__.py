"""H∞ and μ: certified synthesis and analysis of linear controllers (THEORY 6).

| module | does |
|---|---|
| ``statespace`` | small immutable systems: series, append, feedback, balancing, Tustin, zero-order hold |
| ``norms`` | a lower and an upper bound of the H∞ norm over all frequencies |
| ``hinf`` | certified γ-optimal controllers for regular and singular, continuous and discrete plants |
| ``partition``, ``coordinates`` | the plant in the form of the Riccati equations |
| ``riccati``, ``central`` | the two Riccati equations at a level γ, and the central controller |
| ``gamma_search`` | the search for the optimum γ |
| ``direct_terms``, ``zeros``, ``singular`` | bounds of γ for singular problems; reduction to regular ones |
| ``hinf_lower`` | lower bounds of γ for every controller, by a dual certificate and at single frequencies |
| ``mu`` | structured singular value of a matrix or loop, from both sides: ``mu_upper``, ``mu_lower`` |
| ``frequency_cells`` | bounds proved on whole intervals of frequencies, cell by cell |
| ``real_mu`` | μ with real parameters: a proved upper bound slightly above the lower bound of a checked Δ |
| ``real_boxes``, ``real_crossings`` | proof of ``real_mu`` on parameter boxes; search for the smallest Δ |
| ``worst_gain`` | the worst-case gain over every Δ of size 1, proved between frequencies |
| ``nu_gap`` | the ν-gap between two plants, and its margin |
| ``interconnection`` | generalised plant of Fig. 1, from weights and an uncertainty structure |
| ``dk`` | D-K iteration, order reduction, ``certify`` for any controller |
| ``margins`` | gain, phase, delay and disk margins of one loop, and margins that hold for a set of loops |
| ``limits`` | lower bound of μ over controllers of any order |
| ``worst_case`` | the worst Δ of size 1 as a stable system |
| ``table``, ``cases`` | cells of Table II; comparison with the numbers of the paper and of the reference |
"""
