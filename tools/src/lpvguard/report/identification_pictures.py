"""Pictures of an identification and of a drive, for the page and for notebooks (api/plots.py)."""

from collections.abc import Callable
from functools import cached_property

import numpy as np

from ..drives.frames import Estimator
from ..drives.tables import Drive
from ..engine.overbound.weight import Weight
from ..engine.validation import s1
from ..identify.bounds import FrameSet, explain, remainder
from ..identify.identification import StoredIdentification
from ..identify.model_error import ASSUMED, beyond, last_telling
from ..identify.premise import weight_met
from ..identify.weights import fitting_grid
from ..replay.replayer import Replay, Replayer
from .markup import unit_of_norm
from .pictures.drawing import Picture
from .pictures.margin_map import margin_map
from .pictures.model_error import model_error
from .pictures.over_bins import Clouds, disturbance_design, excitation, pareto, weights_over_bounds


class IdentificationPictures:
    """Pictures of an identification; each takes a name that is unique on a page.

    Parameters
    ----------
    stored : StoredIdentification
    estimator : Estimator
    """

    def __init__(self, stored: StoredIdentification, estimator: Estimator):
        self.stored, self.estimator = stored, estimator
        self.grid = fitting_grid(estimator)
        """(K,) frequencies of the bins [rad/s]; DC is drawn at a small positive frequency."""
        self._fine = np.geomspace(self.grid[0], 2 * self.grid[-1], 400)

    @cached_property
    def clouds(self) -> Clouds:
        """Points of the bound-setting drives' frames, on the core's frame grid."""
        stored, estimator = self.stored, self.estimator
        with np.load(stored.folder / "spectra.npz") as spectra:
            names = spectra["names"].tolist()
            setting = np.isin(spectra["drive"], [names.index(n) for n in stored.manifest["drives"]["bounds"]])
            columns = {key: spectra[key][setting] for key in ("bin", "start", "E", "Z")}
        clouds, structure = Clouds([], [], [], []), stored.project.bounds.structure
        W_delta = stored.fitted.at(estimator.omega)[0] / stored.fitted.inflation
        for k in range(estimator.n_bins):
            of_bin = columns["bin"] == k
            frames = FrameSet(
                k,
                columns["E"][of_bin],
                columns["Z"][of_bin],
                columns["start"][of_bin],
                str(stored.folder / "spectra.npz"),
            )
            size = np.linalg.norm(frames.E, axis=1)
            nu, _ = explain(frames, estimator, stored.bounds["gamma_w"], structure)
            w = remainder(frames, estimator, W_delta, structure)
            clouds.E.append(size)
            clouds.B1.append(s1.solve(frames.E, frames.Z, size).b1)
            clouds.nu.append(nu.reshape(len(nu), stored.project.n_delta))
            clouds.w.append(np.abs(w))
        return clouds

    @property
    def _unit(self) -> str:
        return unit_of_norm(self.stored.project.outputs)

    def disturbance(self, name: str) -> Picture:
        """Fig. 2: the disturbance bound and its parts."""
        gamma_w = _magnitude(self.stored.weights["gamma_w"], self._fine)
        return disturbance_design(
            name, self.grid, self.clouds, self.stored.bounds, gamma_w, self._fine, self._unit
        )

    def weights(self, name: str) -> Picture:
        """Fig. 3: the weights over the bounds, inflation included."""
        weights, inflation = self.stored.weights, self.stored.weights["inflation"]
        W_w, W_n = (
            inflation * np.column_stack([_magnitude(w, self._fine) for w in weights[key]])
            if weights[key]
            else None
            for key in ("W_w", "W_n")
        )
        assert W_w is not None  # one for each output
        return weights_over_bounds(
            name,
            self.grid,
            self.clouds,
            self.stored.bounds,
            W_w,
            W_n,
            self._fine,
            self.stored.fitted.W_delta,
            inflation,
            self.stored.project.outputs,
        )

    def model_error(self, name: str) -> Picture:
        """Draw the model error model together with W_delta."""
        project, error = self.stored.project, self.stored.model_error
        grid, names = error.grid.omega, [s.name for s in project.outputs]
        wide = np.geomspace(grid[0], grid[-1], 400)
        reasons = {b.output: b.reason for b in project.model_error.beyond}
        return model_error(
            name,
            error,
            wide,
            np.broadcast_to(weight_met(self.stored, wide), (len(wide), len(names))),
            [None if k < 0 else float(grid[k]) for k in last_telling(error.setting)],
            beyond(project, error.grid),
            [reasons.get(name, ASSUMED) for name in names],
            names,
        )

    def front(self, name: str) -> Picture | None:
        """Draw the Pareto front of each bin; None for structure S0, which has no front."""
        front, bounds = self.stored.front, self.stored.bounds
        if not np.isfinite(front["nu"]).any():
            return None
        return pareto(
            name,
            self.estimator.omega,
            front["gamma_w"],
            front["nu"],
            bounds,
            bounds["nu_ceiling"],
            self._unit,
        )

    def excitation(self, name: str, bin_of: np.ndarray, Z: np.ndarray) -> Picture:
        """Draw |Z| per bin for counted frames with bins (F,) and nominal outputs Z (F, n_y)."""
        size, K = np.linalg.norm(Z, axis=1), self.estimator.n_bins

        def per_bin(statistic: Callable[[np.ndarray], float]) -> np.ndarray:
            of_bin = [size[bin_of == k] for k in range(K)]
            return np.array([statistic(s) if len(s) else np.nan for s in of_bin])

        return excitation(
            name,
            self.grid,
            np.bincount(bin_of, minlength=K),
            per_bin(np.max),
            per_bin(np.median),
            self.stored.bounds["excitation"],
            self.stored.bounds["gamma_w"],
            self._unit,
        )


def _magnitude(entry: dict, omega: np.ndarray) -> np.ndarray:
    """|W| (N,) at ``omega`` (N,) [rad/s] of an entry of weights.json, without inflation."""
    return Weight.from_dict(entry["weight"]).magnitude(omega)


def drive_map(name: str, replayer: Replayer, drive: Drive, replay: Replay) -> Picture:
    """Draw the margin of a replayed drive over time and bins, with speed, verdict and alarms.

    Parameters
    ----------
    name : str, unique on a page
    replayer : Replayer
    drive : Drive
    replay : Replay

    Returns
    -------
    Picture
    """
    return margin_map(
        name,
        replay,
        drive.t,
        drive.v,
        replayer.estimator.omega,
        replayer.estimator.length,
        replayer.threshold,
        replayer.model.speed_range,
    )
