"""H∞ and μ: certified synthesis and analysis of linear controllers (THEORY 6).

| module | does |
|---|---|
| ``statespace`` | small immutable systems: series, append, feedback, balancing, Tustin, zero-order hold |
| ``norms`` | the H∞ norm as a bracket, all frequencies included |
| ``hinf`` | γ-optimal controllers with a certificate: regular and singular, continuous and discrete |
| ``partition``, ``coordinates`` | the plant in the form of the Riccati equations |
| ``riccati``, ``central`` | the two Riccati equations at a level γ, and the central controller |
| ``gamma_search`` | the search for the optimum γ |
| ``direct_terms``, ``zeros``, ``singular`` | lower bounds of singular problems; their reduction |
| ``hinf_lower`` | lower bounds of every controller's level, by a dual certificate and at single frequencies |
| ``mu`` | structured singular value of a matrix or loop, from both sides: ``mu_upper``, ``mu_lower`` |
| ``frequency_cells`` | bounds proved on whole intervals of frequencies, by cells |
| ``real_mu`` | μ with real parameters: a level proved slightly above a checked Δ |
| ``real_boxes``, ``real_crossings`` | its proof on boxes of the parameters; its smallest real Δ |
| ``worst_gain`` | the worst-case gain over every Δ of size 1, proved between frequencies |
| ``nu_gap`` | the ν-gap between two plants, and its margin |
| ``interconnection`` | Fig. 1's generalised plant from weights, three uncertainty structures |
| ``dk`` | D-K iteration, order reduction, ``certify`` for any controller |
| ``margins`` | gain, phase, delay and disk margins of one loop, and those promised for a set of loops |
| ``limits`` | lower bound of μ over controllers of any order |
| ``worst_case`` | the worst Δ of size 1 as a stable system |
| ``table``, ``cases`` | cells of Table II; the paper case with the paper's and the reference's numbers |
"""
