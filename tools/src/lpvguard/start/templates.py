"""Templates of nominal models: each a piece of a project file with its physics in three lines."""

from dataclasses import dataclass

from ..vehicle.physics import KindName


@dataclass(frozen=True)
class Scale:
    """Basis of first guesses: wheelbase [m], its range [m], typical and largest speed [m/s], kind of
    vehicle."""

    wheelbase_m: float
    range_m: tuple[float, float]
    typical_mps: float
    largest_mps: float
    kind: KindName


def yaw_first_order(scale: Scale) -> str:
    """One state: the yaw rate follows the steady turn of an understeering car, with one lag."""
    k = scale.wheelbase_m / scale.largest_mps**2
    t = scale.typical_mps
    return f"""\
# A steady turn of radius R needs delta = L/R + K a_y, with a_y = v r: so r = v delta / (L + K v^2).
# L: wheelbase; K > 0: understeer. The tyres build up their force over a length, so the lag shrinks with G:
# T1 v is the lag at walking pace. Side slip is not a state; beyond the tyres' linear range it does not hold.
A = [["-1/T"]]
B = [["G/T"]]
C = [[1.0]]

[model.parameters]
L = {scale.wheelbase_m:.4g}      # m, effective wheelbase
K = {0.1 * k:.3g}      # s^2/m, understeer
T1 = {0.1 / t:.3g}      # s/(m/s), lag per speed at low speed

[model.let]
G = "v/(L + K*v**2)"           # 1/s
T = "T1*v*L/(L + K*v**2)"      # s

# Where fit looks. A wide range for L hides wrong units: 3.6 times would be km/h, 57 times degrees.
[fit.parameters]
L = [{scale.range_m[0]:.4g}, {scale.range_m[1]:.4g}]
K = [{-0.3 * k:.3g}, {3 * k:.3g}]
T1 = [{0.005 / t:.3g}, {1 / t:.3g}]
"""


def bicycle(scale: Scale) -> str:
    """Two states, side speed and yaw rate: the linear single-track model."""
    half = 0.5 * scale.wheelbase_m
    c = 5.0 * scale.typical_mps + 20.0
    return f"""\
# Linear single-track model (Riekert and Schunck): states side speed [m/s] and yaw rate [rad/s].
# cf, cr: cornering stiffness of an axle over the mass [m/s^2 per rad]; a, b: centre of gravity to the axles.
# The yaw inertia is taken as m a b. It holds while tyre forces are linear in the slip angle.
A = [["-(cf + cr)/v", "-v - (cf*a - cr*b)/v"],
     ["-(cf*a - cr*b)/(a*b*v)", "-(cf*a**2 + cr*b**2)/(a*b*v)"]]
B = [["cf"], ["cf/b"]]
C = [[0.0, 1.0]]

[model.parameters]
cf = {c:.3g}
cr = {1.2 * c:.3g}
a = {half:.4g}      # m, not fitted
b = {half:.4g}      # m, not fitted

[fit.parameters]
cf = [{c / 20:.3g}, {c * 20:.3g}]
cr = [{c / 20:.3g}, {c * 20:.3g}]
"""


def table_1(scale: Scale) -> str:
    """One state, the yaw rate: the first row of the paper's Table I, in its parameters."""
    length, k = scale.wheelbase_m, scale.wheelbase_m / scale.largest_mps**2
    p1 = 10.0 * scale.typical_mps / length
    return f"""\
# Table I of Roedoenyi and Bokor, first row: r' = p1 (delta - l r/v) + p2 v r, with the steering measured.
# p1: yaw acceleration per angle; p2 < 0: understeer. It is yaw-first-order with L = l,
# K = -p2/p1, T1 = 1/(p1 l). The other rows, brakes that steer, need a pressure: start from truck.toml.
A = [["-p1*l/v + p2*v"]]
B = [["p1"]]
C = [[1.0]]

[model.parameters]
l = {length:.4g}      # m, wheelbase
p1 = {p1:.3g}      # 1/s^2
p2 = {-0.1 * k * p1:.3g}      # 1/m

# Where fit looks; the model is stable in all of it.
[fit.parameters]
l = [{scale.range_m[0]:.4g}, {scale.range_m[1]:.4g}]
p1 = [{0.1 * p1:.3g}, {20 * p1:.3g}]
p2 = [{-3 * k * p1:.3g}, {0.05 * k * p1:.3g}]
"""


def own(scale: Scale) -> str:
    """A first-order lag of constant gain per speed, to be replaced."""
    return f"""\
# Yours: write A, B, C as numbers or expressions of v and the parameters; this is a lag of gain k v.
# States, inputs (1 to 2) and outputs (1 to 4) as many as you need; the model must be stable over its speeds.
# Name what fit shall look for in [fit.parameters], with ranges.
A = [["-1/T"]]
B = [["k*v/T"]]
C = [[1.0]]

[model.parameters]
k = {1 / scale.wheelbase_m:.4g}      # 1/m
T = 0.1      # s

[fit.parameters]
k = [{0.3 / scale.wheelbase_m:.4g}, {3 / scale.wheelbase_m:.4g}]
T = [0.01, 1.0]
"""


TEMPLATES = {"yaw-first-order": yaw_first_order, "bicycle": bicycle, "table-1": table_1, "own": own}
VEHICLE_PARAMETERS = {
    "yaw-first-order": ("K", "T1"),
    "bicycle": ("cf", "cr"),
    "table-1": ("p1", "p2"),
    "own": ("k", "T"),
}
"""By template: the parameters that tyres and load change."""
