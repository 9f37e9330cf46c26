"""The estimator against its defining sums, and the conditions under which a frame counts."""

import ctypes
import mmap
import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import oaconvolve

from lpvguard.base.errors import InputError
from lpvguard.base.layout import constant
from lpvguard.drives.frames import Estimator, _Extremes, require_core, settled
from lpvguard.vehicle.nominal import NominalModel
from made import ROOT


@pytest.fixture(scope="module")
def estimator(g80, g80_model):
    return Estimator.from_project(g80, g80_model)


def test_a_sinusoid_in_the_bin_reads_its_amplitude_and_others_do_not_see_dc(estimator):
    n = np.arange(4000)
    for k in range(estimator.n_bins):
        x = np.column_stack([0.7 * np.cos(estimator.omega[k] * estimator.Ts * n + 0.3), np.full(len(n), 5.0)])
        X = estimator.transform(x, k, np.array([0, 11]))
        expected = 0.7 * np.cos(0.3) if k == 0 else 0.7
        np.testing.assert_allclose(np.abs(X[0, 0]), expected, rtol=1e-9)
        np.testing.assert_allclose(np.abs(X[:, 1]), 5.0 if k == 0 else 0.0, atol=1e-9)


@pytest.mark.parametrize("window", ["hann", "rectangular"])
def test_transform_is_the_defining_sum(estimator, window):
    estimator = replace(estimator, window=window)
    x = np.random.default_rng(3).standard_normal((2000, 2))
    for k in (0, 4, estimator.n_bins - 1):
        N = estimator.length[k]
        starts = np.array([0, 5, 2000 - N])
        w = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(N) / N) if window == "hann" else np.ones(N)
        scale = (2 if estimator.cycles[k] else 1) / w.sum()
        rotation = np.exp(-2j * np.pi * estimator.cycles[k] * np.arange(N) / N)
        direct = [[scale * np.sum(w * rotation * x[s : s + N, j]) for j in range(2)] for s in starts]
        np.testing.assert_allclose(estimator.transform(x, k, starts), direct, atol=1e-13)


@pytest.mark.parametrize("signals", [1, 4, 7])
def test_sliding_sums_are_the_convolution_on_long_drives_with_gaps(estimator, signals):
    """A thousand times longer than a frame, with offsets: what rounding gathers must not show."""
    random = np.random.default_rng(signals)
    k, samples = estimator.n_bins - 1, 60_000
    N = int(estimator.length[k])
    x = 10 + np.cumsum(random.standard_normal((samples, signals)), axis=0)
    starts = np.arange(samples - N + 1)
    kept = np.concatenate([starts[:1], starts[3 * N : 3 * N + 2], starts[9 * N :: 3]])
    slid, all_slid = estimator.transform(x, k, kept), estimator.transform(x, k, starts)
    convolved = oaconvolve(x, estimator.kernel(k)[::-1, None], mode="valid", axes=0)
    np.testing.assert_allclose(all_slid, convolved, rtol=0, atol=1e-13 * np.abs(x).max())
    np.testing.assert_allclose(slid, convolved[kept], rtol=0, atol=1e-13 * np.abs(x).max())


def test_a_sum_slides_over_starts_a_frame_apart_and_begins_anew_beyond(estimator):
    """Starts in single file, one frame apart, and one sample more."""
    for k in (0, 4, estimator.n_bins - 1):
        N = int(estimator.length[k])
        x = np.random.default_rng(5).standard_normal((8 * N, 3))
        starts = np.cumsum([7, 1, 1, N, N + 1, 1, 2 * N, N - 1, 3])
        every = estimator.transform(x, k, np.arange(len(x) - N + 1))
        np.testing.assert_allclose(estimator.transform(x, k, starts), every[starts], rtol=0, atol=1e-13)


def test_a_frame_reads_its_own_samples_alone(estimator):
    """What lies between two frames may be anything: no number, and one so large that a Fourier transform of
    all would lose the frames in its rounding."""
    for k in (0, 4, estimator.n_bins - 1):
        N = int(estimator.length[k])
        x = np.random.default_rng(6).standard_normal((2 * N + 1, 2))
        expected = np.stack([estimator.kernel(k) @ x[start : start + N] for start in (0, N + 1)])
        for between in (np.nan, 1e12):
            x[N] = between
            spectra = estimator.transform(x, k, np.array([0, N + 1]))
            np.testing.assert_allclose(spectra, expected, rtol=0, atol=1e-13)


def at_the_end_of_memory(x: np.ndarray) -> np.ndarray:
    """A copy of x behind which nothing can be read: the process would end."""
    page = mmap.PAGESIZE
    size = -(-x.nbytes // page) * page
    memory = mmap.mmap(-1, size + page)
    behind = ctypes.addressof(ctypes.c_char.from_buffer(memory, size))
    assert not ctypes.CDLL(None).mprotect(ctypes.c_void_p(behind), ctypes.c_size_t(page), 0)
    copy = np.frombuffer(memory, x.dtype, x.size, size - x.nbytes).reshape(x.shape)
    copy[:] = x
    return copy


def test_the_last_frame_reads_nothing_behind_the_drive(estimator):
    k = estimator.n_bins - 1
    N = int(estimator.length[k])
    x = np.random.default_rng(7).standard_normal((2 * N, 4))
    starts = np.arange(N + 1)
    np.testing.assert_array_equal(
        estimator.transform(at_the_end_of_memory(x), k, starts), estimator.transform(x, k, starts)
    )


@pytest.mark.parametrize("ends", ["both", "first", "last", "none"])
def test_stretches_are_the_runs_of_starts_that_count(estimator, ends):
    v = np.full(3000, 10.0)
    v[1200:1300] = 40.0  # out of the range of every vehicle
    v[2100] = 12.0
    if ends in ("none", "last"):
        v[: estimator.settle + 1] = 0.0
    if ends in ("none", "first"):
        v[-1] = 0.0
    by_bin = estimator.stretches(v)
    assert len(by_bin) == estimator.n_bins
    for k, runs in enumerate(by_bin):
        counted = estimator.counted(v, k)
        starts = np.concatenate([np.zeros(0, int), *(np.arange(first, end) for first, end in runs)])
        np.testing.assert_array_equal(starts, np.flatnonzero(counted))
        assert (runs[1:, 0] > runs[:-1, 1]).all(), "no run could be one with the next"
        assert runs.shape[1] == 2 and (runs[:, 0] < runs[:, 1]).all()


def test_a_drive_where_every_start_counts_is_one_stretch(estimator):
    estimator = replace(estimator, settle=0)
    N = int(estimator.length[-1])
    [*_, runs] = estimator.stretches(np.full(N + 4, 10.0))
    assert runs.tolist() == [[0, 5]]


def brute_counted(estimator, v, k):
    N, out = int(estimator.length[k]), []
    good, run = [], 0
    for speed in v:
        run = run + 1 if estimator.speed_range[0] <= speed <= estimator.speed_range[1] else 0
        good.append(run > estimator.settle)
    for s in range(len(v) - N + 1):
        piece = v[s : s + N]
        steady = np.all(np.abs(piece / piece.mean() - 1) <= estimator.speed_tolerance)
        out.append(bool(steady and all(good[s : s + N])))
    return np.array(out, bool)


@pytest.mark.parametrize("seed", range(4))
def test_counted_frames_are_those_of_the_definition(estimator, seed):
    random = np.random.default_rng(seed)
    v = np.repeat(random.uniform(2.0, 20.0, 12), random.integers(20, 120, 12)) * (
        1 + 0.05 * random.standard_normal()
    )
    v = np.convolve(v, np.ones(15) / 15, mode="same")
    for k in (estimator.n_bins - 1, estimator.n_bins - 4):
        np.testing.assert_array_equal(estimator.counted(v, k), brute_counted(estimator, v, k))


@pytest.mark.parametrize("samples", [1, 2, 3, 5, 7, 8, 9, 60])
def test_extremes_are_those_of_every_window(samples):
    """Lengths beside powers of two, the whole signal, and shorter windows after longer ones."""
    x = np.random.default_rng(samples).normal(size=60)
    extremes = _Extremes(x)
    for length in (samples, max(1, samples // 2)):
        windows = np.lib.stride_tricks.sliding_window_view(x, length)
        low, high = extremes.of_windows(length)
        np.testing.assert_array_equal(low, windows.min(axis=1))
        np.testing.assert_array_equal(high, windows.max(axis=1))


def test_a_drive_shorter_than_the_frame_has_none(estimator):
    assert estimator.counted(np.full(40, 10.0), 0).shape == (0,)


def test_the_identifier_moves_with_every_part_of_the_definition(estimator):
    changed = [
        replace(estimator, Ts=0.01),
        replace(estimator, settle=estimator.settle + 1),
        replace(estimator, speed_tolerance=0.16),
        replace(estimator, speed_range=(3.5, 20.0)),
        replace(estimator, cycles=np.r_[0, estimator.cycles[1:] + 1]),
    ]
    identifiers = {e.identifier() for e in [estimator, *changed]}
    assert len(identifiers) == len(changed) + 1


def test_bins_too_high_for_the_core_name_the_highest_frequency(g80):
    """At 25 Hz a fifth of the rate is beyond what the core can spread over samples; the message says how far
    it goes, and that far it goes."""
    frames = g80.frames.model_copy(update={"f_min_hz": 0.5, "f_max_hz": 5.0, "periods": 3})
    slow = g80.model_copy(update={"Ts_s": 0.04, "frames": frames})
    with pytest.raises(
        InputError, match=r"lower omega_max_radps to [0-9.]+ or less, or take more periods"
    ) as refused:
        Estimator.from_project(slow, NominalModel(slow))
    highest = float(re.search(r"radps to ([0-9.]+)", str(refused.value))[1]) / (2 * np.pi)
    fits = slow.model_copy(update={"frames": frames.model_copy(update={"f_max_hz": highest})})
    assert Estimator.from_project(fits, NominalModel(fits)).n_bins > 4
    longer = slow.model_copy(update={"frames": frames.model_copy(update={"periods": 8})})
    assert Estimator.from_project(longer, NominalModel(longer)).omega[-1] > 0.9 * 2 * np.pi * 4.0


def test_bins_lie_where_the_settings_put_them_within_the_rounding_of_an_even_frame(g80, g80_model):
    frames = g80.frames
    own = Estimator.from_project(g80, g80_model)
    decades = np.log10(frames.f_max_hz / frames.f_min_hz)
    assert own.n_bins == int(decades * frames.bins_per_decade + 1e-6) + 2, "DC besides"
    assert own.cycles.tolist() == [0, *[frames.periods] * (own.n_bins - 1)]
    assert own.length[0] == own.length[1] and not (own.length % 2).any()
    for k in range(1, own.n_bins):
        wanted = frames.f_min_hz * 10 ** ((k - 1) / frames.bins_per_decade)
        exact = frames.periods / wanted / g80.Ts_s
        assert abs(own.length[k] - exact) <= 1.0 + 1e-9
        assert own.omega[k] == pytest.approx(2 * np.pi * frames.periods / (own.length[k] * g80.Ts_s))
    assert own.omega[0] == 0.0
    assert (own.Ts, own.settle, own.speed_range) == (
        g80.Ts_s,
        g80_model.settle_samples,
        g80_model.speed_range,
    )


def test_a_last_bin_exactly_at_the_upper_frequency_is_kept(g80):
    """Three bins a decade, from 0.34 to 3.4 Hz: 3.4 / 0.34 in floating point is below 10."""
    assert 3.4 / 0.34 < 10
    frames = g80.frames.model_copy(
        update={"f_min_hz": 0.34, "f_max_hz": 3.4, "bins_per_decade": 3, "periods": 3}
    )
    own = Estimator.from_project(g80.model_copy(update={"frames": frames}), NominalModel(g80))
    assert own.n_bins == 5 and own.omega[-1] / 2 / np.pi == pytest.approx(3.4, rel=0.02)
    less = frames.model_copy(update={"f_max_hz": 3.39})
    assert Estimator.from_project(g80.model_copy(update={"frames": less}), NominalModel(g80)).n_bins == 4


def test_frames_that_share_a_length_are_refused_with_the_bins_that_do(g80):
    frames = g80.frames.model_copy(update={"bins_per_decade": 400})
    with pytest.raises(InputError, match=r"at least .* and different lengths"):
        Estimator.from_project(g80.model_copy(update={"frames": frames}), NominalModel(g80))


@pytest.mark.parametrize(("f_max_hz", "length"), [(12.5, 160), (12.6, None)])
def test_a_period_takes_four_samples_and_no_fewer(g80, f_max_hz, length):
    """At 50 Hz four samples are a period of 12.5 Hz."""
    frames = g80.frames.model_copy(
        update={"f_min_hz": f_max_hz / 10, "f_max_hz": f_max_hz, "bins_per_decade": 1, "periods": 40}
    )
    project = g80.model_copy(update={"frames": frames})
    if length is not None:
        assert Estimator.from_project(project, NominalModel(project)).length.tolist() == [
            10 * length,
            10 * length,
            length,
        ]
    else:
        with pytest.raises(InputError, match=r"hold 158 samples a frame; expected at least 160"):
            Estimator.from_project(project, NominalModel(project))


def test_half_a_frame_is_longer_than_the_cores_latency_and_just_longer_is_enough(g80):
    """The latency is of all bins, DC among them; the message names the highest frequency that fits."""
    seen = set()
    for f_max_hz in np.geomspace(2.0, 11.0, 60):
        frames = g80.frames.model_copy(
            update={"f_min_hz": 1.0, "f_max_hz": float(f_max_hz), "bins_per_decade": 4, "periods": 4}
        )
        project = g80.model_copy(update={"frames": frames})
        n_bins = int(np.log10(f_max_hz) * 4) + 2
        latency = constant("NLATENCY", {"NBINS": n_bins, "NY": 1, "NDELTA": 1})
        half = round(4 / 10 ** ((n_bins - 2) / 4) / g80.Ts_s / 2)
        seen.add(half - latency)
        if half > latency:
            assert Estimator.from_project(project, NominalModel(project)).length[-1] == 2 * half
        else:
            with pytest.raises(InputError) as refused:
                Estimator.from_project(project, NominalModel(project))
            assert f"{n_bins} bins and half frames of {half};" in str(refused.value)
            assert f"longer than {latency} samples" in str(refused.value)
            highest = 4 / (2 * (latency + 1) * g80.Ts_s)
            assert f"lower omega_max_radps to {2 * np.pi * highest:.3g} or less" in str(refused.value)
    assert min(seen) <= 0 < max(seen)


def test_the_border_of_the_latency(g80, monkeypatch):
    """Of frames of 24 samples."""
    frames = g80.frames.model_copy(
        update={"f_min_hz": 1.0, "f_max_hz": 8.4, "bins_per_decade": 1, "periods": 4}
    )
    project = g80.model_copy(update={"frames": frames})
    half = Estimator.from_project(project, NominalModel(project)).length[-1] // 2
    for latency, fits in ((half - 1, True), (half, False), (half + 1, False)):
        monkeypatch.setattr("lpvguard.drives.frames.constant", lambda *_, said=latency: said)
        if fits:
            assert Estimator.from_project(project, NominalModel(project)).length[-1] == 2 * half
        else:
            with pytest.raises(InputError, match=f"half frames longer than {latency} samples"):
                Estimator.from_project(project, NominalModel(project))


def plain(g80, **settings):
    frames = g80.frames.model_copy(update={"estimator": "dft", "length_s": 10.0, **settings})
    return g80.model_copy(update={"frames": frames})


@pytest.mark.parametrize(("low", "high"), [(0.2, 2.5), (0.25, 2.49), (0.1, 60.0), (0.3, 0.7)])
def test_lines_of_the_plain_dft_are_those_between_the_limits_and_both_limits_count(g80, low, high):
    project = plain(g80, f_min_hz=low, f_max_hz=high)
    own = Estimator.from_project(project, NominalModel(project))
    n = round(10.0 / g80.Ts_s)
    tenths = [k for k in range(1, (n + 1) // 2) if low * 10 - 1e-6 <= k <= high * 10 + 1e-6]
    assert own.cycles.tolist() == [0, *tenths]
    assert set(own.length.tolist()) == {n} and own.window == "rectangular" and own.settle == 0
    np.testing.assert_allclose(own.omega, 2 * np.pi * np.r_[0, tenths] / 10.0, rtol=1e-12)
    assert own.hop.tolist() == own.length.tolist()
    np.testing.assert_allclose(np.abs(own.kernel(1)), 2.0 / n, rtol=1e-12)


def test_lines_of_the_plain_dft_outnumber_the_unknowns_of_the_transient(truck):
    """Two real numbers a line and output against eight states, DC aside: with two outputs three lines do."""
    model = SimpleNamespace(n=8, speed_range=(1.0, 2.0))
    for n_lines in (2, 3):
        project = plain(truck, f_min_hz=0.5, f_max_hz=0.5 + 0.1 * (n_lines - 1) + 0.01)
        if n_lines == 3:
            assert Estimator.from_project(project, model).cycles.tolist() == [0, 5, 6, 7]
        else:
            with pytest.raises(InputError, match=r"2 lines.*the 8 unknowns of the transient"):
                Estimator.from_project(project, model)


@pytest.mark.parametrize(
    ("length_s", "low", "high", "cycles"), [(0.7, 10.0, 15.0, [7, 8, 9, 10]), (1.4, 5.0, 6.0, [7, 8])]
)
def test_a_line_exactly_at_a_decimal_limit_counts_however_its_frequency_rounds(
    g80, length_s, low, high, cycles
):
    """35 samples of 0.02 s are a little more than 0.7 s in floating point: line 7 is a little below 10 Hz."""
    project = plain(g80, length_s=length_s, f_min_hz=low, f_max_hz=high)
    assert Estimator.from_project(project, NominalModel(project)).cycles.tolist() == [0, *cycles]


def test_the_core_takes_hann_frames_only(g80):
    require_core(g80)
    with pytest.raises(InputError, match="plain DFT, which the core does not compute"):
        require_core(plain(g80))


@pytest.fixture
def short(estimator):
    """Frames of two and four samples, half the mean allowed, from 2 to 6 m/s: numbers that are exact."""
    return replace(
        estimator,
        length=np.array([4, 2]),
        cycles=np.array([0, 1]),
        settle=1,
        speed_tolerance=0.5,
        speed_range=(2.0, 6.0),
    )


@pytest.mark.parametrize(
    ("v", "counts"),
    [
        ([2.0, 2.0, 6.0], [False, True]),  # the mean is 4, and both may be half of it away; settled after one
        ([2.0, 2.0, 6.5], [False, False]),  # out of range
        ([4.0, 4.0, 4.0], [False, True]),
        ([4.0, 4.0], [False]),
        ([4.0], []),
        ([7.0, 4.0, 4.0, 4.0], [False, False, True]),
        ([1.9, 2.0, 2.0, 6.0, 6.0], [False, False, True, True]),
    ],
)
def test_the_borders_of_speed_and_tolerance_belong_to_a_frame(short, v, counts):
    assert short.counted(np.array(v), 1).tolist() == counts


def test_one_speed_too_low_or_too_high_of_its_frame_alone_stops_it(short):
    base = replace(short, speed_range=(0.1, 100.0), settle=0)
    assert base.counted(np.array([2.0, 6.0]), 1).tolist() == [True]
    for v in ([1.0, 7.0, 4.0, 4.0], [7.0, 1.0, 4.0, 4.0]):
        assert base.counted(np.array(v), 0).tolist() == [False]
    assert base.counted(np.array([2.0, 4.0, 4.0, 6.0]), 0).tolist() == [True]
    assert base.counted(np.array([4.0, 4.0, 4.0, 12.1]), 0).tolist() == [False]
    assert base.counted(np.array([12.0, 12.0, 12.0, 4.9]), 0).tolist() == [False]


def test_settled_counts_from_the_last_sample_out_of_range():
    v = np.array([5.0, 5.0, 5.0, 9.0, 5.0, 5.0, 5.0, 1.0, 5.0])
    assert settled(v, (2.0, 8.0), 2).tolist() == [False, False, True, False, False, False, True, False, False]
    assert settled(np.array([2.0, 8.0, 8.1, 1.9]), (2.0, 8.0), 0).tolist() == [True, True, False, False]


def test_no_starts_have_no_transform_and_a_hann_frame_moves_by_half(estimator):
    assert estimator.transform(np.zeros((500, 3)), 1, np.array([], int)).shape == (0, 3)
    assert estimator.hop.tolist() == [n // 2 for n in estimator.length.tolist()]


def test_a_frame_longer_than_the_drive_reads_and_counts_nothing(estimator):
    for missing in (1, 2, 3, 40):
        assert estimator.counted(np.full(int(estimator.length[0]) - missing, 10.0), 0).shape == (0,)
    for n in (0, 3):
        assert estimator.transform(np.zeros((n, 2)), 0, np.array([], int)).shape == (0, 2)


def test_the_identifier_is_the_one_in_the_shipped_vehicles_code(g80, estimator):
    """Code that was exported before must agree with the estimator of today."""
    code = (ROOT / "lib" / "vehicles" / "g80" / "lpvguard_coeff.c").read_text()
    assert int(re.search(r"\.estimator_id = (\d+)U", code)[1]) == estimator.identifier()


def test_a_line_at_the_upper_limit_counts_though_its_frequency_rounds_above_it(g80):
    """30 samples of 0.06 s are a little less than 1.8 s in floating point: line 9 is a little above 5 Hz."""
    assert 9 / (30 * 0.06) > 5.0
    project = plain(g80, length_s=1.8, f_min_hz=1.0, f_max_hz=5.0).model_copy(update={"Ts_s": 0.06})
    own = Estimator.from_project(project, SimpleNamespace(n=1, speed_range=(1.0, 2.0)))
    assert own.cycles.tolist() == [0, *range(2, 10)]
