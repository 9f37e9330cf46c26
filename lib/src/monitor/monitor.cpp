// monitor.cpp -- see monitor.h.
//
// Two frames of a bin overlap by half. Over one half the sums `plain` = sum(x p) and `rising` = sum(x w p) are accumulated. Here
// p_n is the exponential and w_n the rising half of the window. The falling half of a Hann window is 1 - w_n. The frame that ends
// with this half is therefore (rising of the previous half) + (-1)^cycles (plain - rising of this half). The sums restart
// every half frame, so rounding cannot accumulate over a drive.
//
// Each push stores its sample in a block. Every bin processes a whole block at once. Bin b does so in each push whose number is
// b modulo the block length. The sums of the bin then stay in registers during a block. At most a quarter of the bins can end
// a half frame in one push.
#include "lpvguard/monitor.h"

#include <cmath>
#include <limits>

#include "acceptance.hpp"
#include "begin.hpp"
#include "eigen.hpp"
#include "margin.hpp"

namespace {

using Real = lpvg_real_t;
using Complex = lpvg::Complex2<Real>;
constexpr std::size_t ny = LPVG_NY;
constexpr std::size_t n_signals = 2U * LPVG_NY;  // e, then yhat
constexpr uint32_t settled_max = 0xFFFFFFFFU;
constexpr uint64_t stale_periods = 5;
constexpr uint32_t n_block = LPVG_NBLOCK;
static_assert((n_block & (n_block - 1U)) == 0U, "the ring is indexed by a mask");

using Signals = Eigen::Array<Real, static_cast<int>(n_signals), 1>;
Eigen::Map<Signals> signals(Real* values) { return Eigen::Map<Signals>(values); }
Eigen::Map<const Signals> signals(const Real* values) { return Eigen::Map<const Signals>(values); }

uint64_t hold_us(const lpvg_coeff_t& coeff) { return static_cast<uint64_t>(coeff.words.frame_length[0]) * coeff.words.sample_period_us; }

// Returns later - earlier >= 0, exact over the whole range of the clock.
uint64_t elapsed_us(int64_t later, int64_t earlier) { return static_cast<uint64_t>(later) - static_cast<uint64_t>(earlier); }

bool within(Real value, const Real* range) {
    return value >= range[0] && value <= range[1];  // false for NaN
}

bool sample_good(const lpvg_coeff_reals_t& r, const lpvg_sample_t& s) {
    bool good = within(s.speed, r.speed_valid);
    for (std::size_t i = 0; i < LPVG_NU; ++i) {
        good = good && within(s.u[i], r.input_valid[i]);
    }
    for (std::size_t j = 0; j < ny; ++j) {
        good = good && within(s.y[j], r.output_valid[j]);
    }
    return good;
}

lpvg_reason_t sample_reason(const lpvg_monitor_t& self, bool in_range) {
    if (!in_range) {
        return lpvg_reason_out_of_range;
    }
    return self.settled > self.coeff->words.settle_samples ? lpvg_reason_none : lpvg_reason_settling;
}

// Adds `more` to `span`. The reason out_of_range replaces settling, because it is the cause.
void extend(lpvg_span_t& span, const lpvg_span_t& more) {
    span.speed_low = more.speed_low < span.speed_low ? more.speed_low : span.speed_low;
    span.speed_high = more.speed_high > span.speed_high ? more.speed_high : span.speed_high;
    span.speed_sum += more.speed_sum;
    if (more.reason != lpvg_reason_none && span.reason != lpvg_reason_out_of_range) {
        span.reason = more.reason;
    }
}

// Returns sample i of the block; sample 0 is the oldest.
const lpvg_taken_t& taken(const lpvg_monitor_t& self, uint32_t i) { return self.block[(self.newest + 1U + i) & (n_block - 1U)]; }

// Returns e, then yhat, of sample i of the block, followed by those of the next samples.
const Real* taken_signal(const lpvg_monitor_t& self, uint32_t i) { return self.signal[((self.newest + 1U) & (n_block - 1U)) + i]; }

lpvg_span_t span_of(const lpvg_monitor_t& self, uint32_t first, uint32_t end) {
    lpvg_span_t span = taken(self, first).span;
    for (uint32_t i = first + 1U; i < end; ++i) {
        extend(span, taken(self, i).span);
    }
    return span;
}

// Adds n samples to the sums of a bin; x points to the signals of the first sample. The samples are added to each other first,
// because they are small compared with the long sums. The long sums are then rounded only once per block. The phasors are
// rotated by small angles, stored as cos - 1 and sin, which keeps their relative precision in float.
void accumulate(lpvg_bin_t& bin, const Real* turn, const Real* taper, const Real* x, uint32_t n) {
    const bool begins = bin.n == 0U;
    if (begins) {  // no assignment of a cleared struct, because small C libraries clear it byte by byte
        signals(bin.sum.plain_re).setZero();
        signals(bin.sum.plain_im).setZero();
        signals(bin.sum.rising_re).setZero();
        signals(bin.sum.rising_im).setZero();
        bin.phasor[0] = Real(1);
        bin.window[0] = Real(0.5);
        bin.phasor[1] = bin.window[1] = Real(0);
    }
    Signals plain_re = Signals::Zero(), plain_im = plain_re, rising_re = plain_re, rising_im = plain_re;
    const Real turn_re = turn[0], turn_im = turn[1], taper_re = taper[0], taper_im = taper[1];
    Real re = bin.phasor[0], im = bin.phasor[1], window_re = bin.window[0], window_im = bin.window[1];
    for (uint32_t i = 0; i < n; ++i, x += n_signals) {
        const Signals sample = signals(x);
        const Real w = Real(0.5) - window_re;
        plain_re += sample * re;
        plain_im -= sample * im;
        rising_re += sample * (w * re);
        rising_im -= sample * (w * im);
        const Real re_before = re, window_re_before = window_re;
        re += re * turn_re - im * turn_im;
        im += im * turn_re + re_before * turn_im;
        window_re += window_re * taper_re - window_im * taper_im;
        window_im += window_im * taper_re + window_re_before * taper_im;
    }
    signals(bin.sum.plain_re) += plain_re;
    signals(bin.sum.plain_im) += plain_im;
    signals(bin.sum.rising_re) += rising_re;
    signals(bin.sum.rising_im) += rising_im;
    bin.phasor[0] = re;
    bin.phasor[1] = im;
    bin.window[0] = window_re;
    bin.window[1] = window_im;
    bin.n += n;
}

// Closes the frame of two halves, if there are two, and queues it.
void end_half(lpvg_monitor_t& self, std::size_t b, int64_t t_us) {
    lpvg_bin_t& bin = self.bin[b];
    const lpvg_coeff_t& coeff = *self.coeff;
    if (bin.has_before && self.n_queue < LPVG_NBINS) {  // damaged coefficients could close more frames than can be judged
        const Real scale = coeff.reals.scale[b];
        const Real falling = coeff.words.cycles[b] % 2U != 0U ? -scale : scale;
        for (std::size_t i = 0; i < n_signals; ++i) {
            bin.frame_re[i] = scale * bin.rising_re[i] + falling * (bin.sum.plain_re[i] - bin.sum.rising_re[i]);
            bin.frame_im[i] = scale * bin.rising_im[i] + falling * (bin.sum.plain_im[i] - bin.sum.rising_im[i]);
        }
        bin.frame_span = bin.span_before;
        extend(bin.frame_span, bin.span);
        bin.frame_end_us = t_us;
        const uint32_t last = self.queue_first + self.n_queue;
        self.queue[last < LPVG_NBINS ? last : last - LPVG_NBINS] = static_cast<uint32_t>(b);
        ++self.n_queue;
    }
    signals(bin.rising_re) = signals(bin.sum.rising_re);
    signals(bin.rising_im) = signals(bin.sum.rising_im);
    bin.span_before = bin.span;
    bin.has_before = true;
    bin.n = 0U;
}

void take_up(lpvg_monitor_t& self, std::size_t b, uint32_t first, uint32_t end, const lpvg_span_t& span) {
    lpvg_bin_t& bin = self.bin[b];
    if (bin.n == 0U) {
        bin.span = span;
    } else {
        extend(bin.span, span);
    }
    const lpvg_coeff_reals_t& r = self.coeff->reals;
    accumulate(bin, r.turn[b], r.taper[b], taken_signal(self, first), end - first);
}

// Processes the new samples of bin b; `whole` is their span. A half frame is longer than a block (lpvg_coeff_check).
// Therefore at most one half frame ends in a block. Returns whether a half frame ended.
bool catch_up(lpvg_monitor_t& self, std::size_t b, const lpvg_span_t& whole) {
    const lpvg_bin_t& bin = self.bin[b];
    const uint32_t left = self.coeff->words.frame_length[b] / 2U - bin.n;
    if (left > self.n_block) {
        take_up(self, b, n_block - self.n_block, n_block, whole);
        return false;
    }
    take_up(self, b, 0U, left, span_of(self, 0U, left));  // the first half after a start is longer than a block, so the block is whole
    end_half(self, b, taken(self, left - 1U).t_us);
    if (left < n_block) {
        take_up(self, b, left, n_block, span_of(self, left, n_block));
    }
    return true;
}

// Returns the k-th largest of the n newest margins; 0 while there are fewer than k, because missing margins are 0.
Real statistic(const lpvg_bin_t& bin, uint32_t confirm, uint32_t n) {
    Real kth = Real(0);
    for (uint32_t i = 0; i < n; ++i) {
        uint32_t larger_or_equal = 0U;
        for (uint32_t j = 0; j < n; ++j) {
            larger_or_equal += bin.history[j] >= bin.history[i] ? 1U : 0U;
        }
        if (larger_or_equal >= confirm && bin.history[i] > kth) {
            kth = bin.history[i];
        }
    }
    return kth;
}

// Empties the pool of a bin.
void empty_pool(lpvg_bin_t& bin) {
    for (lpvg_pool_t& part : bin.pool) {
        part = lpvg_pool_t{};
    }
    bin.part = bin.in_part = 0U;
}

// Returns the part of the pool that gets the next frame of bin b; begins a new part if the newest one is full.
lpvg_pool_t& part_of_next(lpvg_bin_t& bin, const lpvg_coeff_words_t& words, std::size_t b) {
    if (bin.in_part >= words.pool_frames[b]) {
        bin.part = bin.part + 1U < words.pool_parts[b] && bin.part + 1U < LPVG_NPOOL ? bin.part + 1U : 0U;
        bin.pool[bin.part] = lpvg_pool_t{};
        bin.in_part = 0U;
    }
    ++bin.in_part;
    return bin.pool[bin.part];
}

struct Pooled {
    Real ratio, dead;  // ratio (T51), and the ratio of a vehicle without response
};

// 1 / bounds of the pools of bin b at a frame's mean speed: of the error, then of its share of |yhat|.
const Real (&pool_scale(const lpvg_coeff_reals_t& r, std::size_t b, Real mean))[2][ny] {
    const Real part = (r.speed_max - r.speed_min) / Real(LPVG_NSPEEDS);
    std::size_t at = 0;
    for (std::size_t i = 1; i < LPVG_NSPEEDS; ++i) {
        at += mean - r.speed_min >= static_cast<Real>(i) * part ? 1U : 0U;
    }
    return r.pool_scale[at][b];
}

// Takes the frame E, Z into its part of the bin's pool. Largest ratios of the outputs.
Pooled pooled(lpvg_bin_t& bin, lpvg_pool_t& part, const Real (&scale)[2][ny], const Complex* E, const Complex* Z) {
    Pooled found{Real(0), Real(0)};
    for (std::size_t j = 0; j < ny; ++j) {
        part.re[j] += Z[j].re * E[j].re + Z[j].im * E[j].im;
        part.im[j] += Z[j].re * E[j].im - Z[j].im * E[j].re;
        part.power[j] += Z[j].re * Z[j].re + Z[j].im * Z[j].im;
        Real re = Real(0), im = Real(0), power = Real(0);
        for (const lpvg_pool_t& of : bin.pool) {
            re += of.re[j];
            im += of.im[j];
            power += of.power[j];
        }
        if (power > Real(0)) {
            const Real size = std::sqrt(power);
            const Real allowed = scale[1][j] < scale[0][j] * size ? scale[1][j] / size : scale[0][j];
            const Real ratio = std::sqrt((re / size) * (re / size) + (im / size) * (im / size)) * allowed;
            const Real dead = size * allowed;
            found.ratio = ratio > found.ratio ? ratio : found.ratio;
            found.dead = dead > found.dead ? dead : found.dead;
        }
    }
    return found;
}

void record(lpvg_monitor_t& self, const lpvg_frame_t& frame) {
    if (self.n_records < LPVG_NRECORDS) {
        lpvg_frame_t& place = self.record[self.n_records];
        place.sequence = frame.sequence;  // field by field, because small C libraries move a struct byte by byte
        place.test = frame.test;
        place.bin = frame.bin;
        place.t_end_us = frame.t_end_us;
        place.reason = frame.reason;
        place.falsified = true;
        place.refuted = frame.refuted;
        place.speed = frame.speed;
        place.margin = frame.margin;
        place.statistic = frame.statistic;
        place.evidence = frame.evidence;
        place.pooled = frame.pooled;
        signals(place.E[0]) = signals(frame.E[0]);
        signals(place.Z[0]) = signals(frame.Z[0]);
        ++self.n_records;
    } else {
        ++self.records_lost;
    }
}

// Tells if a frame of bin b, or the k frames that confirm its statistic, refute the certificate (T53). Either a single output does,
// or the statistic exceeds every ratio of the certificate's bounds to the healthy set's bounds.
bool refutes(const lpvg_coeff_reals_t& r, std::size_t b, const Complex* E, const Complex* Z, Real statistic) {
    bool alone = false, scaled = true;
    for (std::size_t j = 0; j < ny; ++j) {
        const std::size_t d = LPVG_NDELTA > 1 ? j : 0U;
        const Real unit = Real(1) / r.B_certificate[b][j];
        const Real e = std::sqrt(lpvg::squared(unit * E[j])), z = std::sqrt(lpvg::squared(unit * Z[j]));
        const Real limit = Real(1) + r.W_certificate[b][d] * z;
        alone = alone || !((Real(1) - lpvg::margin_rounding<Real>)*e <= limit);
        scaled = scaled && statistic * r.W_delta[b][d] > r.W_certificate[b][d] && statistic * r.B_w[b][j] > r.B_certificate[b][j];
    }
    return alone || scaled;
}

// Tells if only the last part of the work on a margin remains. Otherwise does the first part.
template <class Margin>
bool begun(lpvg_monitor_t& self, Margin& margin) {
    if constexpr (LPVG_NPARTS > 1) {
        self.parts = 1U - self.parts;
        if (self.parts > 0U) {
            self.by_pairs = margin.with_pairs();
            return false;
        }
    }
    return true;
}

// Returns the margin. With two parts, it uses the result of the first part.
template <class Margin>
Real finished(const lpvg_monitor_t& self, Margin& margin) {
    if constexpr (LPVG_NPARTS > 1) {
        return margin.with_triples(self.by_pairs);
    } else {
        return margin();
    }
}

// Does the next part of the judgement of bin b's frame. Returns whether this was the last part.
bool judge(lpvg_monitor_t& self, std::size_t b) {
    const lpvg_coeff_t& coeff = *self.coeff;
    const lpvg_coeff_reals_t& r = coeff.reals;
    lpvg_bin_t& bin = self.bin[b];
    const lpvg_span_t& span = bin.frame_span;
    const Real mean = span.speed_sum / static_cast<Real>(coeff.words.frame_length[b]);
    const bool steady = span.speed_low >= (Real(1) - r.speed_tolerance) * mean && span.speed_high <= (Real(1) + r.speed_tolerance) * mean;
    const lpvg_reason_t reason = span.reason != lpvg_reason_none ? span.reason : (steady ? lpvg_reason_none : lpvg_reason_speed_moved);
    Complex E[ny], Z[ny];
    for (std::size_t j = 0; j < ny; ++j) {
        E[j] = {bin.frame_re[j], bin.frame_im[j]};
        Z[j] = {bin.frame_re[ny + j], bin.frame_im[ny + j]};
    }
    lpvg::Margin<Real, ny, LPVG_NDELTA> margin(E, Z, r.W_delta[b], r.B_w[b]);
    if (!begun(self, margin)) {
        return false;
    }
    lpvg_frame_t& frame = self.frame;
    const uint32_t sequence = frame.sequence + 1U;
    if (reason != lpvg_reason_none) {
        frame = lpvg_frame_t{};  // otherwise the code below writes every field
    }
    frame.sequence = sequence;
    frame.bin = static_cast<uint32_t>(b);
    frame.t_end_us = bin.frame_end_us;
    frame.reason = reason;
    lpvg_pool_t& part = part_of_next(bin, coeff.words, b);
    if (reason == lpvg_reason_none) {
        const Pooled pool = pooled(bin, part, pool_scale(r, b, mean), E, Z);
        for (std::size_t j = 0; j < ny; ++j) {
            frame.E[j][0] = E[j].re;
            frame.E[j][1] = E[j].im;
            frame.Z[j][0] = Z[j].re;
            frame.Z[j][1] = Z[j].im;
        }
        frame.speed = mean;
        frame.margin = finished(self, margin);
        frame.pooled = pool.ratio;
        const Real dead = margin.dead();
        frame.evidence = pool.dead > dead ? pool.dead : dead;
        const uint32_t of_last = coeff.words.of_last < LPVG_NHISTORY ? coeff.words.of_last : LPVG_NHISTORY;
        bin.history[bin.next_history % LPVG_NHISTORY] = frame.margin;
        bin.next_history = bin.next_history + 1U < of_last ? bin.next_history + 1U : 0U;
        frame.statistic = statistic(bin, coeff.words.confirm, of_last);
        const bool confirmed = !(frame.statistic <= r.threshold);
        frame.falsified = confirmed || frame.pooled > r.threshold;
        frame.refuted = confirmed && refutes(r, b, E, Z, frame.statistic);
        if (!(frame.evidence > r.threshold)) {
            frame.reason = lpvg_reason_not_excited;
        } else if (frame.t_end_us > self.t_void_us) {
            self.has_evidence = true;
            self.t_evidence_us = frame.t_end_us;
        }
        if (frame.falsified) {
            int64_t& newest = frame.refuted ? self.t_falsified_us : self.t_changed_us;
            bool& any = frame.refuted ? self.has_falsified : self.has_changed;
            newest = any && newest > frame.t_end_us ? newest : frame.t_end_us;  // the energy test may have alarmed after the frame's end
            any = true;
            record(self, frame);
        }
    }
    return true;
}

// Continues to judge the frame that has waited longest.
void judge_next(lpvg_monitor_t& self) {
    const uint32_t b = self.queue[self.queue_first];
    if (judge(self, b < LPVG_NBINS ? b : 0U)) {
        self.queue_first = self.queue_first + 1U < LPVG_NBINS ? self.queue_first + 1U : 0U;
        --self.n_queue;
    }
}

// Returns the norm ||x_j|| from the sums of the energy test.
Real output_norm(const Real* gram, std::size_t j) {
    const std::size_t diagonal = j * (2U * ny + 1U - j) / 2U;
    return std::sqrt(gram[diagonal]);
}

void record_energy(lpvg_monitor_t& self, const lpvg_sample_t& sample, bool refuted) {
    lpvg_frame_t alarm{};
    alarm.test = lpvg_test_energy;
    alarm.sequence = self.frame.sequence;
    alarm.bin = (self.energy.strongest * LPVG_NDIRECTIONS) + self.energy.direction;
    alarm.t_end_us = sample.t_us;
    alarm.refuted = refuted;
    alarm.speed = sample.speed;
    alarm.margin = alarm.statistic = self.energy.ratio;
    alarm.evidence = lpvg_energy_evidence(&self.energy, self.coeff);
    for (std::size_t j = 0; j < ny; ++j) {
        alarm.E[j][0] = output_norm(self.energy.band[self.energy.strongest].left, j);
        alarm.Z[j][0] = output_norm(self.energy.band[self.energy.strongest].right, j);
    }
    record(self, alarm);
}

void judge_energy(lpvg_monitor_t& self, const lpvg_sample_t& sample) {
    const lpvg_coeff_t& coeff = *self.coeff;
    if (lpvg_energy_judge(&self.energy, &coeff) <= coeff.reals.energy_threshold) {
        self.energy_quiet += self.energy_quiet < coeff.words.energy_rearm ? 1U : 0U;
        return;
    }
    const bool refuted = !(self.energy.ratio <= coeff.reals.energy_certificate);
    if (self.energy_quiet == coeff.words.energy_rearm || (refuted && !self.has_falsified)) {
        record_energy(self, sample, refuted);
    }
    self.energy_quiet = 0U;
    (refuted ? self.t_falsified_us : self.t_changed_us) = sample.t_us;
    (refuted ? self.has_falsified : self.has_changed) = true;
    if (!(self.energy.ratio < std::numeric_limits<Real>::infinity())) {
        lpvg_energy_start(&self.energy);
        self.settled = 0U;
    }
}

void record_change(lpvg_monitor_t& self, const lpvg_sample_t& sample) {
    const lpvg_coeff_reals_t& r = self.coeff->reals;
    const std::size_t j = self.change.strongest / 3U;
    lpvg_frame_t alarm{};
    alarm.test = lpvg_test_change;
    alarm.sequence = self.frame.sequence;
    alarm.bin = self.change.strongest;
    alarm.t_end_us = sample.t_us;
    alarm.speed = sample.speed;
    alarm.margin = alarm.statistic = self.change.ratio;
    alarm.evidence = r.change_scale[j][0] / r.change_unit[j][0];
    alarm.E[0][0] = self.change.estimate[0];
    alarm.E[0][1] = self.change.estimate[1];
    alarm.Z[0][0] = self.change.estimate[2];
    record(self, alarm);
}

// Judges the next output that waits for the newest block.
void judge_change(lpvg_monitor_t& self, const lpvg_sample_t& sample) {
    const lpvg_coeff_t& coeff = *self.coeff;
    if (lpvg_change_judge(&self.change, &coeff) <= coeff.reals.change_threshold) {
        self.change_quiet += self.change_quiet < coeff.words.change_rearm ? 1U : 0U;
        return;
    }
    if (self.change_quiet == coeff.words.change_rearm) {
        record_change(self, sample);
    }
    self.change_quiet = 0U;
    self.t_changed_us = sample.t_us;
    self.has_changed = true;
    if (!(self.change.ratio < std::numeric_limits<Real>::infinity())) {
        lpvg_change_start(&self.change);
    }
}

// Gives the block that the newest sample ends to the change test, or restarts the test if a sample of it came before settling.
void take_block(lpvg_monitor_t& self) {
    if (self.settled >= n_block && self.settled - n_block >= self.coeff->words.settle_samples) {
        lpvg_change_take(&self.change, taken_signal(self, 0U));
    } else {
        lpvg_change_start(&self.change);
    }
}

// Voids the evidence: every bin begins a new frame, and earlier frames no longer support the model.
void void_evidence(lpvg_monitor_t& self, int64_t t_us) {
    for (lpvg_bin_t& bin : self.bin) {
        bin.n = 0U;
        bin.has_before = false;
        empty_pool(bin);
    }
    self.n_block = 0U;  // samples that no bin has taken up belong to no frame any more
    self.has_evidence = false;
    self.t_void_us = t_us;
}

void start(lpvg_monitor_t& self, const lpvg_sample_t& sample) {
    lpvg_model_start(&self.model, self.coeff, sample.u, sample.y);
    lpvg_energy_start(&self.energy);
    lpvg_change_start(&self.change);
    void_evidence(self, sample.t_us);
    self.settled = 0U;
    self.running = true;
    ++self.restarts;
}

// Check sum of the energy test's filters and right sums. A flipped bit there could blind the test for many memory times, because a
// large bound decays slowly. A flipped bit in a left sum raises an alarm, or it is forgotten within the memory.
uint32_t sum_of(const lpvg_energy_t& energy) {
    uint32_t sum = lpvguard::sum_of_words(energy.F) + lpvguard::sum_of_words(energy.W) + lpvguard::sum_of_words(energy.fading);
    for (const lpvg_energy_band_t& band : energy.band) {
        sum += lpvguard::sum_of_words(band.right);
    }
    return sum;
}

// Tells if all indices are in range (of one bin per call), and if energy test and model entries are unchanged since the newest sample.
bool state_well(lpvg_monitor_t& self) {
    self.turn = self.turn + 1U < LPVG_NBINS ? self.turn + 1U : 0U;
    const lpvg_bin_t& bin = self.bin[self.turn];
    return self.newest < n_block && self.n_block <= n_block && self.queue_first < LPVG_NBINS && self.n_queue <= LPVG_NBINS &&
           self.queue[self.turn] < LPVG_NBINS && self.parts < LPVG_NPARTS && self.n_records <= LPVG_NRECORDS &&
           self.energy.next_direction < LPVG_NDIRECTIONS && self.energy.strongest < LPVG_NBANDS &&
           bin.n < self.coeff->words.frame_length[self.turn] / 2U && bin.next_history < LPVG_NHISTORY && bin.part < LPVG_NPOOL &&
           (!self.has_evidence || self.t_evidence_us <= self.t_us) && (!self.has_falsified || self.t_falsified_us <= self.t_us) &&
           (!self.has_changed || self.t_changed_us <= self.t_us) && sum_of(self.energy) == self.energy_sum &&
           lpvguard::sum_of_words(self.model.entry) == self.model.sum;
}

// Repairs a damaged state: restarts as after init, and refuses the sample.
void repair(lpvg_monitor_t& self, int64_t t_us) {
    const lpvg_coeff_t* const coeff = self.coeff;
    const uint32_t repairs = self.repairs + (self.repairs < UINT32_MAX ? 1U : 0U);
    lpvg_monitor_begin(&self, coeff);
    self.repairs = repairs;
    self.refused = true;
    self.t_us = t_us;
}

bool in_step(const lpvg_monitor_t& self, int64_t t_us) {
    const uint64_t period = self.coeff->words.sample_period_us;
    const uint64_t step = elapsed_us(t_us, self.t_us);
    return step <= 2U * period && 2U * step >= period && 2U * step <= 3U * period;  // the first condition prevents an overflow of 2 step
}

}  // namespace

extern "C" lpvg_status_t lpvg_monitor_init(lpvg_monitor_t* self, const lpvg_coeff_t* coeff) {
    if (self == nullptr) {
        return lpvg_status_bad_argument;
    }
    const lpvg_status_t status = lpvg_coeff_check(coeff);
    if (status == lpvg_status_ok) {
        lpvg_monitor_begin(self, coeff);
    }
    return status;
}

extern "C" void lpvg_monitor_begin(lpvg_monitor_t* self, const lpvg_coeff_t* coeff) {
    *self = lpvg_monitor_t{};
    self->coeff = coeff;
    self->energy_quiet = coeff->words.energy_rearm;
    self->change_quiet = coeff->words.change_rearm;
}

// This function is long because it follows one sample through all steps. Each branch ends or restarts the following steps.
extern "C" lpvg_status_t lpvg_monitor_push(lpvg_monitor_t* self, const lpvg_sample_t* sample) {
    if (self == nullptr || sample == nullptr) {
        return lpvg_status_bad_argument;
    }
    if (self->coeff == nullptr) {
        return lpvg_status_not_ready;
    }
    const lpvg_coeff_t& coeff = *self->coeff;
    const bool any_before = self->restarts > 0U || self->refused;
    if (any_before && sample->t_us <= self->t_us) {
        ++self->out_of_order;
        return lpvg_status_out_of_order;
    }
    if (!state_well(*self)) {
        repair(*self, sample->t_us);
        return lpvg_status_bad_sample;
    }
    if (!sample_good(coeff.reals, *sample)) {
        ++self->bad_samples;
        self->refused = true;
        self->running = false;
        self->t_us = sample->t_us;
        return lpvg_status_bad_sample;
    }
    if (!self->running || !in_step(*self, sample->t_us)) {
        start(*self, *sample);
    }
    self->refused = false;
    self->t_us = sample->t_us;

    const bool in_range = sample->speed >= coeff.reals.speed_min && sample->speed <= coeff.reals.speed_max;
    if (!in_range && self->settled > 0U) {
        lpvg_energy_start(&self->energy);
    }
    self->settled = in_range ? (self->settled < settled_max ? self->settled + 1U : settled_max) : 0U;
    const lpvg_reason_t reason = sample_reason(*self, in_range);

    Real yhat[ny];
    lpvg_model_output(&self->model, &coeff, yhat);
    lpvg_model_advance(&self->model, &coeff, sample->speed, sample->u);

    self->newest = (self->newest + 1U) & (n_block - 1U);
    self->n_block += self->n_block < n_block ? 1U : 0U;
    lpvg_taken_t& newest = self->block[self->newest];
    Real* const signal = self->signal[self->newest];
    for (std::size_t j = 0; j < ny; ++j) {
        signal[j] = sample->y[j] - yhat[j];
        signal[ny + j] = yhat[j];
    }
    signals(self->signal[self->newest + n_block]) = signals(signal);
    newest.t_us = sample->t_us;
    newest.span = {sample->speed, sample->speed, sample->speed, reason};

    if (in_range) {
        lpvg_energy_advance(&self->energy, &coeff, signal, self->settled > coeff.words.energy_settle);
    }
    const lpvg_span_t whole = span_of(*self, n_block - self->n_block, n_block);
    uint32_t ended = 0U;
    for (std::size_t b = self->newest; b < LPVG_NBINS; b += n_block) {
        ended += catch_up(*self, b, whole) ? 1U : 0U;
    }
    const bool judges = self->n_queue > 0U && ended < 2U;
    if (judges) {
        judge_next(*self);
    } else {
        judge_energy(*self, *sample);
    }
    if (self->newest == n_block - 1U) {
        take_block(*self);
    } else if (self->change.pending > 0U && !judges && ended == 0U) {
        judge_change(*self, *sample);
    }
    self->energy_sum = sum_of(self->energy);
    return lpvg_status_ok;
}

extern "C" lpvg_verdict_t lpvg_monitor_verdict(const lpvg_monitor_t* self, int64_t now_us) {
    if (self == nullptr || self->coeff == nullptr) {
        return lpvg_verdict_fault;
    }
    if (self->restarts == 0U && !self->refused) {
        return lpvg_verdict_unknown;
    }
    if (now_us < self->t_us || self->refused) {
        return lpvg_verdict_fault;
    }
    if (elapsed_us(now_us, self->t_us) > stale_periods * self->coeff->words.sample_period_us) {
        return lpvg_verdict_stale;
    }
    const uint64_t hold = hold_us(*self->coeff);
    if (self->has_falsified && elapsed_us(now_us, self->t_falsified_us) <= hold) {
        return lpvg_verdict_invalid;
    }
    if (self->has_changed && elapsed_us(now_us, self->t_changed_us) <= hold) {
        return lpvg_verdict_degraded;
    }
    if (self->has_evidence && elapsed_us(now_us, self->t_evidence_us) <= hold) {
        return lpvg_verdict_valid;
    }
    return self->frame.sequence == 0U ? lpvg_verdict_unknown : lpvg_verdict_not_judged;
}

extern "C" void lpvg_monitor_void(lpvg_monitor_t* self) {
    if (self != nullptr && self->coeff != nullptr) {
        void_evidence(*self, self->t_us);
    }
}

extern "C" lpvg_reason_t lpvg_monitor_reason(const lpvg_monitor_t* self) { return self == nullptr ? lpvg_reason_none : self->frame.reason; }

extern "C" const lpvg_frame_t* lpvg_monitor_frame(const lpvg_monitor_t* self) {
    return (self == nullptr || self->coeff == nullptr) ? nullptr : &self->frame;
}

extern "C" bool lpvg_monitor_take_record(lpvg_monitor_t* self, lpvg_frame_t* record) {
    if (self == nullptr || record == nullptr || self->n_records == 0U) {
        return false;
    }
    *record = self->record[0];
    --self->n_records;
    for (uint32_t i = 0; i < self->n_records; ++i) {
        self->record[i] = self->record[i + 1U];
    }
    return true;
}
