"""Weights of low order that are proved to lie above bounds (section III of the paper, steps 6 and 7).

``weight``       a real rational weight, its magnitude and its state-space realisation
``bound``        the checked samples of a bound
``fit``          the lowest-order stable minimum-phase weight above a bound
``minimax``      the linear programs behind the fit
``certificate``  the proof that a weight lies above a bound, from its coefficients alone
``noise``        subtracts the sensors' noise from the disturbance
"""
