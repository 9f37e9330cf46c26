"""Mutants of the C sources must change what replay says: there is no second monitor that could agree with
itself."""

import shutil

import numpy as np
import pytest

from lpvguard.core.compiled import Core, library_root
from lpvguard.drives.faults import Fault, inject
from lpvguard.drives.tables import read_drive

MUTANTS = {
    "margin forgets the uncertainty": (
        "margin.hpp",
        "gain_[j] = std::sqrt(squared((W[j] * unit) * Z[j]));",
        "gain_[j] = std::sqrt(squared((Real(0.1) * W[j] * unit) * Z[j]));",
    ),
    "margin scales the disturbance": (
        "margin.hpp",
        "size_[j] = squared(unit * E[j]);",
        "size_[j] = squared(Real(0.9) * (unit * E[j]));",
    ),
    "second half of the window turned": (
        "monitor.cpp",
        "const Real falling = coeff.words.cycles[b] % 2U != 0U ? -scale : scale;",
        "const Real falling = scale;",
    ),
    "error of the wrong sign": (
        "monitor.cpp",
        "signal[j] = sample->y[j] - yhat[j];",
        "signal[j] = sample->y[j] + yhat[j];",
    ),
    "input one sample late": (
        "model_step.hpp",
        "const Matrix<nu, 1> u_old = ConstMap<nu, 1>(past[LPVG_DELAY]);",
        "const Matrix<nu, 1> u_old = ConstMap<nu, 1>(past[0]);",
    ),
    "model offset forgotten": ("model.cpp", "+ ConstMap<ny, 1>(r.output_offset);", ";"),
}


@pytest.fixture(scope="module")
def drive(g80, synthetic):
    return read_drive(synthetic / "synthetic_01.csv", g80)


@pytest.mark.requirement("REQ-MON-3")
@pytest.mark.parametrize("name", MUTANTS)
@pytest.mark.slow("2 s: the faulty source compiled, 8 s where it is a header")
def test_a_planted_fault_changes_the_margins(name, drive, core, vehicle, tmp_path):
    file, original, mutant = MUTANTS[name]
    shutil.copytree(library_root(), tmp_path / "lib")
    (source,) = (tmp_path / "lib" / "src").rglob(file)
    text = source.read_text()
    assert text.count(original) == 1
    source.write_text(text.replace(original, mutant))
    sound, mutated = (
        c.monitor().run_drive(drive).frames for c in (core, Core(vehicle, source_root=tmp_path / "lib"))
    )
    assert not np.allclose(sound.margin[sound.counted], mutated.margin[mutated.counted], rtol=1e-2)


ENERGY_MUTANTS = {
    "forgetting left out": "gram[k] += x[i] * x[j] - forget * gram[k];|gram[k] += x[i] * x[j];",
    "sigma left out": ".sum() + Real(1);|.sum() + Real(0.5);",
    "bands of yhat forgotten": "add(band.right, x + (2 * ny), fades);"
    "|add(band.right, whole.data() + (2 * ny), fades);",
    "weight forgotten": "section(r.energy_W[d][s], whole.data() + (2 * ny) + j, self->W[s][0] + j, "
    "self->W[s][1] + j);|(void)j;",
    "a band left out": "if (ratio > self->ratio) {|if (b < last && ratio > self->ratio) {",
}


@pytest.mark.parametrize("name", ENERGY_MUTANTS)
@pytest.mark.slow("2 s: the faulty source compiled, 8 s where it is a header")
def test_a_planted_fault_changes_the_energy_ratio(name, drive, core, g80, vehicle, tmp_path):
    """On a drive whose yaw rate is halved from 60 s on: there every band decides for a while."""
    original, mutant = ENERGY_MUTANTS[name].split("|")
    shutil.copytree(library_root(), tmp_path / "lib")
    halved = inject(drive, Fault("gain", 0.5), 60.0, g80.Ts_s)
    source = tmp_path / "lib" / "src" / "monitor" / "energy.cpp"
    text = source.read_text()
    assert text.count(original) == 1
    source.write_text(text.replace(original, mutant))
    sound, mutated = (
        c.monitor().run_drive(halved).energy for c in (core, Core(vehicle, source_root=tmp_path / "lib"))
    )
    assert sound.max() > 0 and not np.allclose(sound, mutated, rtol=1e-2)
