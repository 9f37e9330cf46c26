"""Stage 3, unfalsified bounds: B1, B2, gamma_w, nu and B_w in each bin over all frames (paper, steps 2-6).

Every pass reads the drives one after the other. It reduces a drive to maxima in each bin (``reduce_...``) and
joins the maxima of all drives (``fold``). Neither the memory nor the result depends on the number or the
order of the drives. Bin 0 is DC. E, Z, B1, B2, gamma_w and B_w have the outputs' units.

Rule of step 4 (T8): a ceiling nu_bar(omega) on the uncertainty is known in advance. It is a setting or comes
from the band of the model error. The disturbance bound covers the remaining error of the frames,

    gamma_w(omega_k) = max over frames of sqrt(B1^2 + |Z|^2 max(0, |delta0| - nu_bar)^2),   gamma_w(0) = B2(0)

and an overbounding weight smooths it upward. Then nu = min |delta| subject to |E - delta Z| <= gamma_w (step
5). W_delta lies above nu and above the model error model's bound (model_error.py). B_w is the largest
remainder of a frame that no |delta| <= W_delta explains. A bin without a counted frame is NaN, "no
information", and never 0.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property, reduce

import numpy as np

from ..base.errors import InputError
from ..drives import dft as plain_dft
from ..drives.frames import Estimator
from ..drives.tables import Drive
from ..engine.validation import s1
from ..vehicle.nominal import NominalModel
from .resolution import Resolution

FRONT_POINTS = 25
"""Number of values of gamma_w in each bin of the Pareto front, from B1 to B2. They are B1 + (B2 - B1) t^2
with uniform t, so they are denser near B1."""


FIRST_LARGEST = 8
"""Number of pairs with the largest sums that remove dominated pairs before the sort."""
FRONT_BLOCK = 64
"""Number of successive frames in a block, which the search for the front bounds together."""


@dataclass(frozen=True)
class FrameSet:
    """Counted frames of one drive in one bin.

    Attributes
    ----------
    bin : int
    E : ndarray (F, n_y) of complex, nominal error [output units]
    Z : ndarray (F, n_y) of complex, nominal output [output units]
    starts : ndarray (F,) of int, first sample of each frame
    experiment : str, name of the drive in messages
    """

    bin: int
    E: np.ndarray
    Z: np.ndarray
    starts: np.ndarray
    experiment: str = ""

    @cached_property
    def sizes(self) -> tuple[np.ndarray, np.ndarray]:
        """|E_j| and |Z_j| (F, n_y)."""
        return np.abs(self.E), np.abs(self.Z)

    def require(
        self, good: np.ndarray, estimator: Estimator, what: Callable[[int], str], expected: str
    ) -> None:
        """Raise InputError unless all frames are ``good`` (F,).

        The error names the experiment, the bin and the first sample of the first bad frame.
        """
        if not np.all(good):
            first = int(np.argmin(good))
            raise InputError(
                self.experiment or "frames",
                f"bin {self.bin} ({estimator.omega[self.bin]:.6g} rad/s), "
                f"frame from sample {self.starts[first]}",
                what(first),
                expected,
            )


def nominal_error(drive: Drive, model: NominalModel) -> tuple[np.ndarray, np.ndarray]:
    """Compute the nominal error e = y - yhat and the nominal output along a drive.

    Parameters
    ----------
    drive : Drive
    model : NominalModel

    Returns
    -------
    tuple of ndarray (N, n_y), e and yhat [output units]

    References
    ----------
    Paper, (2): e = y_n - P23 u.
    """
    yhat = model.simulate(drive.v, drive.u, drive.y[0])
    return drive.y - yhat, yhat


def counted_frames(
    drive: Drive,
    e: np.ndarray,
    yhat: np.ndarray,
    model: NominalModel,
    estimator: Estimator,
    stretches: list[np.ndarray] | None = None,
) -> Iterator[FrameSet]:
    """Compute the counted frames of a drive, one set for each bin.

    A frame starts at every counted start, in rising order. The plain DFT has only the first counted frame.

    Parameters
    ----------
    drive : Drive
    e, yhat : ndarray (N, n_y), output units, e = y - yhat
    model : NominalModel
    estimator : Estimator
    stretches : list of ndarray (R, 2), optional, known runs of the counted starts, by bin

    Yields
    ------
    FrameSet

    References
    ----------
    THEORY 3.2.
    """
    if estimator.window == "rectangular":
        starts = np.flatnonzero(estimator.counted(drive.v, 0))[:1]
        frames = [plain_dft.spectra(drive, s, model, estimator) for s in starts]
        for k in range(estimator.n_bins):
            E, Z = (np.array([f[i][k] for f in frames], complex).reshape(-1, e.shape[1]) for i in (0, 1))
            yield FrameSet(k, E, Z, starts, drive.name)
        return
    both = np.hstack([e, yhat])
    n_y = e.shape[1]
    for k, runs in enumerate(estimator.stretches(drive.v) if stretches is None else stretches):
        starts = np.concatenate([np.zeros(0, int), *(np.arange(*run) for run in runs)])
        spectra = estimator.transform(both, k, starts)
        yield FrameSet(k, spectra[:, :n_y], spectra[:, n_y:], starts, drive.name)


@dataclass(frozen=True)
class Bounds:
    """Bounds per bin (K,), nu (K, n_delta), B_w and B_w_floor (K, n_y).

    ``frames`` is the number of counted frames. ``excitation`` is max |Z|. B_w bounds the remainder that no
    |delta| <= W_delta explains (``remainder``). It is at least B_w_floor, the limit of the sensors'
    ``resolution``. The front (K, FRONT_POINTS) gives the least nu that explains every frame as a function of
    gamma_w. Its points are ``front_gamma_w`` and ``front_nu``. They are NaN at DC and in bins without frames.
    """

    omega: np.ndarray
    frames: np.ndarray
    excitation: np.ndarray
    B1: np.ndarray
    B2: np.ndarray
    gamma_rule: np.ndarray
    gamma_w: np.ndarray
    nu: np.ndarray
    B_w: np.ndarray
    B_w_floor: np.ndarray
    resolution: Resolution
    front_gamma_w: np.ndarray
    front_nu: np.ndarray


Part = dict[str, np.ndarray]
"""Result of one or more drives. ``frames`` is a sum of whole numbers, all other fields are maxima (NaN
without a frame)."""


def fold(parts: Iterable[Part]) -> Part:
    """Join the parts of drives in any order."""
    total: Part = {}
    for part in parts:
        for key, value in part.items():
            if key not in total:
                total[key] = value.copy()
            else:
                total[key] = total[key] + value if key == "frames" else np.fmax(total[key], value)
    return total


class Deciders:
    """Frames that decide a bound ``key`` (K, m).

    For each entry of the bound this holds the drive and the first sample of the deciding frame. It also holds
    the bound without this frame and those that overlap it. The memory does not depend on the number of
    drives.
    """

    def __init__(self, key: str, shape: tuple[int, int]):
        self.key = key
        self.largest, self.rest, self.others = (np.full(shape, np.nan) for _ in range(3))
        self.first, self.drive = np.zeros(shape, int), np.full(shape, "", dtype=object)

    def watched(self, names: Iterable[str], parts: Iterable[Part]) -> Iterator[Part]:
        """Record the deciding frames of ``parts``, one for each drive of ``names``.

        Yields the parts without the data for this class.
        """
        for name, part in zip(names, parts, strict=False):
            value, first, rest = (part.pop(f"{self.key}{suffix}") for suffix in ("", FIRST, REST))
            beaten = ~(value <= self.largest) & ~np.isnan(value)
            self.others = np.fmax(self.others, np.where(beaten, self.largest, value))
            for record, new in ((self.largest, value), (self.first, first), (self.rest, rest)):
                record[beaten] = new[beaten]
            self.drive[beaten] = name
            yield part | {self.key: value}

    @property
    def without(self) -> np.ndarray:
        """Bound (K, m) without the deciding frame, 0 without other frames.

        It comes from the other frames of its drive and from all other drives.
        """
        return np.nan_to_num(np.fmax(self.rest, self.others))


FIRST, REST = "_first", "_rest"
"""Suffixes of the fields of a part that only Deciders reads."""


def _decided(key: str, values: np.ndarray, s: FrameSet, estimator: Estimator, out: Part) -> None:
    """Store the largest of ``values`` (F, m) >= 0 of the frames ``s`` in the part ``out``.

    The part also gets the data for Deciders. The starts of the frames must rise.
    """
    if not len(values):
        return
    columns = np.arange(values.shape[1])
    k = values.argmax(axis=0)
    out[key][s.bin], out[key + FIRST][s.bin] = values[k, columns], s.starts[k]
    before = np.searchsorted(s.starts, s.starts[k] - estimator.length[s.bin], side="right")
    after = np.searchsorted(s.starts, s.starts[k] + estimator.length[s.bin])
    out[key + REST][s.bin] = [
        max(values[:b, j].max(initial=0.0), values[a:, j].max(initial=0.0))
        for j, (b, a) in enumerate(zip(before, after, strict=True))
    ]


def _undecided(key: str, shape: tuple[int, int]) -> Part:
    return {
        key: np.full(shape, np.nan),
        key + FIRST: np.zeros(shape, int),
        key + REST: np.full(shape, np.nan),
    }


def _maximum(values: np.ndarray) -> np.ndarray | float:
    """Maxima over the first axis. The loop over a few columns is sixty times as fast as numpy's maximum."""
    if not len(values):
        return np.nan
    return values.max() if values.ndim == 1 else np.array([column.max() for column in values.T])


def reduce_disturbance(
    sets: Iterable[FrameSet], estimator: Estimator, nu_ceiling: np.ndarray, n_y: int, controlled: int = 0
) -> Part:
    """Reduce the frames of a drive to the maxima of steps 2-4, before smoothing.

    ``E`` (K, n_y) is the largest |E_j|. In drives without input it bounds the noise of the sensors (W_n). In
    other drives it bounds the disturbance of class S0. ``Y`` (K,) is the largest |E + Z| of the controlled
    output. It bounds the commands in the drives (W_C; paper, section V).

    Parameters
    ----------
    sets : Iterable of FrameSet
    estimator : Estimator
    nu_ceiling : ndarray (K,), ceiling on nu, 0 at DC
    n_y : int, number of outputs
    controlled : int, index of the controlled output, default 0

    Returns
    -------
    Part

    References
    ----------
    THEORY 5, (T8); paper, steps 2-4.
    """
    K = estimator.n_bins
    out = {key: np.full(K, np.nan) for key in ("excitation", "B1", "B2", "gamma_rule", "Y")}
    out |= {"frames": np.zeros(K, int), "E": np.full((K, n_y), np.nan)}
    for s in sets:
        size, z, b1, delta = s1.least(s.E, s.Z)
        s.require(np.isfinite(size), estimator, lambda _: "E or Z is not finite", "finite spectra")
        out["frames"][s.bin] = len(s.E)
        excess = np.maximum(0.0, delta - nu_ceiling[s.bin])
        rule = size if estimator.cycles[s.bin] == 0 else np.hypot(b1, z * excess)
        for key, values in (
            ("excitation", z),
            ("B1", b1),
            ("B2", size),
            ("gamma_rule", rule),
            ("E", np.abs(s.E)),
            ("Y", np.abs(s.E[:, controlled] + s.Z[:, controlled])),
        ):
            out[key][s.bin] = _maximum(values)
    return out


def explain(
    s: FrameSet, estimator: Estimator, gamma_w: np.ndarray, structure: str
) -> tuple[np.ndarray, np.ndarray]:
    """Find the least uncertainty that explains every frame (step 5).

    Parameters
    ----------
    s : FrameSet
    estimator : Estimator
    gamma_w : ndarray (K,), bound on |w|, or on each |w_j| in class S1_diagonal [output units]
    structure : str, class of the uncertainty

    Returns
    -------
    tuple of two ndarrays: |delta| (F,), or (F, n_y) in class S1_diagonal, and complex w (F, n_y)

    Raises
    ------
    InputError
        If a frame is not finite, or no uncertainty of the class explains it within gamma_w.

    References
    ----------
    Paper, step 5.
    """
    if structure == "S0" or estimator.cycles[s.bin] == 0:
        return np.zeros(s.E.shape if structure == "S1_diagonal" else len(s.E)), s.E
    if structure == "S1_diagonal":
        (nu, excess), size = _needed_each(s, estimator, gamma_w), s.sizes[0]
        return nu, s.E * np.divide(size - excess, size, out=np.zeros(size.shape), where=size > 0)
    gamma = gamma_w[s.bin]
    result = s1.solve(s.E, s.Z, gamma)
    s.require(
        np.isfinite(result.nu),
        estimator,
        lambda i: f"B1 = {result.b1[i]:.6g} and gamma_w = {gamma:.6g}",
        "finite spectra and gamma_w >= B1",
    )
    return result.nu, result.w


def _needed_each(s: FrameSet, estimator: Estimator, gamma_w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Least |delta_j| (F, n_y) in class S1_diagonal, and the excess of |E_j| over gamma_w.

    It solves E_j = delta_j Z_j + w_j with |w_j| <= gamma_w for every output.
    """
    size, gain = s.sizes
    excess = np.maximum(0.0, size - gamma_w[s.bin])
    nu = np.divide(excess, gain, out=np.where(excess > 0, np.inf, 0.0), where=gain > 0)
    s.require(
        np.isfinite(reduce(np.maximum, nu.T)),
        estimator,
        lambda i: f"|E| = {size[i].max():.6g} where Z = 0, or not finite",
        "finite spectra and |E_j| <= gamma_w where Z_j = 0",
    )
    return nu, excess


def front_grid(B1: np.ndarray, B2: np.ndarray, estimator: Estimator, structure: str) -> np.ndarray:
    """Values gamma_w (K, FRONT_POINTS) of the Pareto front.

    They are NaN at DC, in class S0 and in bins without frames.
    """
    t = np.linspace(0.0, 1.0, FRONT_POINTS) ** 2
    grid = B1[:, None] + (B2 - B1)[:, None] * t
    grid[:, -1] = B2
    return np.where((estimator.cycles > 0)[:, None] & (structure != "S0"), grid, np.nan)


def front(E: np.ndarray, Z: np.ndarray, gamma_w: np.ndarray) -> np.ndarray:
    """Exact max over the frames E, Z (F, n_y) of nu(gamma_w) at each gamma_w (P,). NaN stays NaN.

    Every gamma_w must be at least the largest B1. The approximation nu = |delta0| - sqrt(gamma_w^2 - B1^2) /
    |Z| with its rounding error selects the frames that can have the largest nu. Only these frames are solved
    without cancellation. Successive frames are similar. The largest |delta0|, B1 and |Z| of FRONT_BLOCK
    frames therefore bound the nu of a block. The first frames of all blocks exclude most blocks.
    """
    out, valid = np.full(len(gamma_w), np.nan), np.flatnonzero(~np.isnan(gamma_w))
    if not len(E) or not len(valid):
        return out
    least, gamma = s1.least(E, Z), gamma_w[valid]
    firsts = np.arange(0, len(E), FRONT_BLOCK)
    size, z, b1, centre = (np.maximum.reduceat(x, firsts) for x in least)
    least_z = np.minimum.reduceat(np.where(least.z > 0, least.z, np.inf), firsts)
    low, _ = _about(s1.LeastSquares(*(x[firsts] for x in least)), gamma[:, None])
    with np.errstate(divide="ignore", invalid="ignore"):
        room = np.sqrt(np.maximum(gamma[:, None] ** 2 - b1**2, 0.0))
        high = centre - room / z + _slack(centre, least_z, gamma[:, None])
    open_blocks = (size > gamma[:, None]) & (z > 0) & (high >= low.max(axis=1, keepdims=True))
    # Handle several gamma_w together, so that their open blocks hold about as many frames as E.
    turns = np.cumsum(open_blocks.sum(axis=1)) // len(firsts)
    for turn in np.unique(turns):
        some = np.flatnonzero(turns == turn)
        out[valid[some]] = _front_within(E, Z, least, gamma[some], open_blocks[some], firsts)
    return out


def _front_within(
    E: np.ndarray,
    Z: np.ndarray,
    least: s1.LeastSquares,
    gamma_w: np.ndarray,
    open_blocks: np.ndarray,
    firsts: np.ndarray,
) -> np.ndarray:
    """Front (P,) at ``gamma_w`` (P,) from the frames of the open blocks (P, blocks), else 0."""
    point, block = np.nonzero(open_blocks)
    inside = (firsts[block, None] + np.arange(FRONT_BLOCK)).ravel()
    point = np.repeat(point, FRONT_BLOCK)[inside < len(E)]
    inside = inside[inside < len(E)]
    at, gamma = s1.LeastSquares(*(x[inside] for x in least)), gamma_w[point]
    low, high = _about(at, gamma)
    worst = np.full(len(gamma_w), -np.inf)
    np.maximum.at(worst, point, low)
    largest = (at.e > gamma) & (at.z > 0) & (high >= worst[point])
    inside, point = inside[largest], point[largest]
    out = np.zeros(len(gamma_w))
    np.maximum.at(out, point, s1.solve(E[inside], Z[inside], gamma[largest]).nu)
    return out


def _slack(centre: np.ndarray, z: np.ndarray, gamma: np.ndarray) -> np.ndarray:
    """Error bound of |delta0| - sqrt(gamma_w^2 - B1^2) / |Z|, whose root loses half the digits near B1."""
    return 1e-6 * (centre + gamma / z)


def _about(least: s1.LeastSquares, gamma: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper bounds of nu of frames (F,), broadcast with gamma. They are -inf where nu is 0."""
    with np.errstate(divide="ignore", invalid="ignore"):
        about = least.delta - np.sqrt(np.maximum(gamma**2 - least.b1**2, 0.0)) / least.z
        slack = _slack(least.delta, least.z, gamma)
    needing = (least.e > gamma) & (least.z > 0)
    return np.where(needing, about - slack, -np.inf), np.where(needing, about + slack, -np.inf)


def reduce_uncertainty(
    sets: Iterable[FrameSet],
    estimator: Estimator,
    gamma_w: np.ndarray,
    grid: np.ndarray,
    n_y: int,
    structure: str,
) -> Part:
    """Reduce the frames of a drive to nu (K, n_delta) of step 5 at ``gamma_w`` (K,), and to its front.

    The front has the values of gamma_w in ``grid`` (K, FRONT_POINTS).
    """
    out = _undecided("nu", (estimator.n_bins, n_y if structure == "S1_diagonal" else 1))
    out["front"] = np.full(grid.shape, np.nan)
    for s in sets:
        if structure == "S1_diagonal" and estimator.cycles[s.bin] > 0:
            nu = _needed_each(s, estimator, gamma_w)[0]
        else:
            nu = explain(s, estimator, gamma_w, structure)[0]
        _decided("nu", nu.reshape(len(nu), out["nu"].shape[1]), s, estimator, out)
        out["front"][s.bin] = front(s.E, s.Z, grid[s.bin])
    return out


def remainder(s: FrameSet, estimator: Estimator, W_delta: np.ndarray, structure: str) -> np.ndarray:
    """Compute the least disturbance w of each frame with |delta| <= W_delta.

    The optimal delta is delta0, shortened to the length W_delta. At DC and in class S0 delta is 0.

    Parameters
    ----------
    s : FrameSet
    estimator : Estimator
    W_delta : ndarray (K, n_delta)
    structure : str, class of the uncertainty

    Returns
    -------
    ndarray (F, n_y) of complex, output units

    References
    ----------
    Paper, step 6.
    """
    if structure == "S0" or estimator.cycles[s.bin] == 0:
        return s.E
    if structure == "S1_diagonal":
        gain = np.abs(s.Z) ** 2
        delta = np.divide(s.Z.conj() * s.E, gain, out=np.zeros(s.E.shape, complex), where=gain > 0)
    else:
        delta = s1.least_squares_delta(s.E, s.Z)[:, None]
    size = np.abs(delta)
    share = np.minimum(1.0, W_delta[s.bin] / np.maximum(size, np.finfo(float).tiny))
    return s.E - share * delta * s.Z


def remainder_sizes(s: FrameSet, estimator: Estimator, W_delta: np.ndarray, structure: str) -> np.ndarray:
    """|w_j| (F, n_y) of `remainder`."""
    if structure != "S1_diagonal" or estimator.cycles[s.bin] == 0:
        return np.abs(remainder(s, estimator, W_delta, structure))
    size, gain = s.sizes
    return np.maximum(0.0, size - W_delta[s.bin] * gain)


def reduce_remainder(
    sets: Iterable[FrameSet],
    estimator: Estimator,
    W_delta: np.ndarray,
    n_y: int,
    structure: str,
    joint: bool = False,
) -> tuple[Part, list[np.ndarray]]:
    """Reduce the frames of a drive to the largest |w_j| (K, n_y) of step 6.

    w is their `remainder` for W_delta (K, n_delta). With ``joint`` the second result holds the `undominated`
    rows of |w_j| of every bin, for `covering`.
    """
    out, fronts = _undecided("B_w", (estimator.n_bins, n_y)), [np.zeros((0, n_y))] * estimator.n_bins
    for s in sets:
        sizes = remainder_sizes(s, estimator, W_delta, structure)
        _decided("B_w", sizes, s, estimator, out)
        if joint:
            fronts[s.bin] = undominated(sizes)
    return out, fronts


def undominated(sizes: np.ndarray) -> np.ndarray:
    """Rows of ``sizes`` (F, m) >= 0 that no other row dominates, each once.

    A row dominates another one if it is at least as large in every column. The largest value of any function
    that rises with every column is attained at one of the rows.
    """
    rows = [np.zeros((0, sizes.shape[1]))]
    share = 1 / np.maximum(_maximum(sizes), np.finfo(float).tiny)
    while len(sizes) and (sizes.shape[1] != 2 or len(rows) <= FIRST_LARGEST):
        largest = sizes[(sizes @ share).argmax()]
        rows.append(largest[None])
        sizes = sizes[reduce(np.logical_or, (sizes > largest).T)]
    if len(sizes):  # two columns: sort by the first, falling, and keep each new maximum of the second
        sizes = sizes[np.lexsort(-sizes.T[::-1])]
        before = np.maximum.accumulate(np.append(-1.0, sizes[:-1, 1]))
        rows.append(sizes[sizes[:, 1] > before])
    return np.concatenate(rows)


def covering(fronts: list[np.ndarray], B_w: np.ndarray) -> np.ndarray:
    """Factor (K,) with which B_w (K, n_y) covers every w jointly, the largest sqrt(sum_j |w_j / B_w,j|^2).

    ``fronts`` holds the `undominated` rows of |w_j| of every bin. The factor is NaN in a bin without a frame.
    """
    scale = np.full(len(fronts), np.nan)
    for k, (w, bound) in enumerate(zip(fronts, B_w, strict=True)):
        relative = np.divide(w, bound, out=np.zeros(w.shape), where=bound > 0)
        scale[k] = np.sqrt(_maximum(np.einsum("fj,fj->f", relative, relative)))
    return scale
