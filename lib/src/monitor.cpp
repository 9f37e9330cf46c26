// monitor.cpp -- see monitor.h.
//
// Two frames of a bin overlap by half. Over one half, with p_n the exponential and w_n the rising half of the window,
// sum(x p) and sum(x w p) are accumulated; since the falling half of a Hann window is 1 - w_n, the frame that ends with
// this half is (rising sum of the previous half) + (-1)^cycles (plain - rising sum of this half). The sums restart every
// half frame, so that rounding cannot accumulate over a drive.
#include "lpvguard/monitor.h"

#include <cmath>

#include "margin.hpp"

namespace {

using Real = lpvg_real_t;
using Complex = lpvg::Complex2<Real>;
constexpr std::size_t ny = LPVG_NY;
constexpr std::size_t n_signals = 2U * LPVG_NY;  // e, then yhat
constexpr uint32_t settled_max = 0xFFFFFFFFU;
constexpr uint64_t stale_periods = 5;

uint64_t hold_us(const lpvg_coeff_t& coeff) {
    return static_cast<uint64_t>(coeff.words.frame_length[0]) * coeff.words.sample_period_us;
}

// later - earlier >= 0, exact over the whole range of the clock.
uint64_t elapsed_us(int64_t later, int64_t earlier) {
    return static_cast<uint64_t>(later) - static_cast<uint64_t>(earlier);
}

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

void begin_half(lpvg_bin_t& bin) {
    bin.n = 0U;
    bin.phasor[0] = bin.window[0] = Real(1);
    bin.phasor[1] = bin.window[1] = Real(0);
    bin.sum = lpvg_sum_t{};
}

// Turns a unit vector; with cos - 1 stored, a small angle keeps its relative precision in float.
void turn(Real* vector, const Real* step) {
    const Real re = vector[0], im = vector[1];
    vector[0] = re + (re * step[0] - im * step[1]);
    vector[1] = im + (im * step[0] + re * step[1]);
}

lpvg_reason_t sample_reason(const lpvg_monitor_t& self, bool in_range) {
    if (!in_range) {
        return lpvg_reason_out_of_range;
    }
    return self.settled > self.coeff->words.settle_samples ? lpvg_reason_none : lpvg_reason_settling;
}

void extend(lpvg_span_t& span, bool first, Real speed, lpvg_reason_t reason) {
    if (first) {
        span = lpvg_span_t{speed, speed, speed, reason};
        return;
    }
    span.speed_low = speed < span.speed_low ? speed : span.speed_low;
    span.speed_high = speed > span.speed_high ? speed : span.speed_high;
    span.speed_sum += speed;
    // Out of range outlives settling: it names the cause.
    if (reason != lpvg_reason_none && span.reason != lpvg_reason_out_of_range) {
        span.reason = reason;
    }
}

lpvg_span_t joined(const lpvg_span_t& a, const lpvg_span_t& b) {
    lpvg_span_t both = a;
    both.speed_low = b.speed_low < a.speed_low ? b.speed_low : a.speed_low;
    both.speed_high = b.speed_high > a.speed_high ? b.speed_high : a.speed_high;
    both.speed_sum = a.speed_sum + b.speed_sum;
    if (b.reason != lpvg_reason_none && a.reason != lpvg_reason_out_of_range) {
        both.reason = b.reason;
    }
    return both;
}

void end_half(lpvg_bin_t& bin, uint32_t cycles, Real scale, int64_t t_us) {
    if (bin.has_before) {
        const Real sign = (cycles % 2U) != 0U ? Real(-1) : Real(1);
        for (std::size_t i = 0; i < n_signals; ++i) {
            for (std::size_t part = 0; part < 2U; ++part) {
                const Real falling = bin.sum.plain[i][part] - bin.sum.rising[i][part];
                bin.frame[i][part] = scale * (bin.rising[i][part] + sign * falling);
            }
        }
        bin.frame_span = joined(bin.span_before, bin.span);
        bin.frame_end_us = t_us;
        bin.waiting = true;
    }
    for (std::size_t i = 0; i < n_signals; ++i) {
        bin.rising[i][0] = bin.sum.rising[i][0];
        bin.rising[i][1] = bin.sum.rising[i][1];
    }
    bin.span_before = bin.span;
    bin.has_before = true;
    begin_half(bin);
}

void accumulate(lpvg_bin_t& bin, const lpvg_coeff_t& coeff, std::size_t b, const Real* signal) {
    const Real w = Real(0.5) - Real(0.5) * bin.window[0];
    const Real c = bin.phasor[0], s = -bin.phasor[1];  // exp(-j phase)
    const Real wc = w * c, ws = w * s;
    for (std::size_t i = 0; i < n_signals; ++i) {
        bin.sum.plain[i][0] += signal[i] * c;
        bin.sum.plain[i][1] += signal[i] * s;
        bin.sum.rising[i][0] += signal[i] * wc;
        bin.sum.rising[i][1] += signal[i] * ws;
    }
    turn(bin.phasor, coeff.reals.turn[b]);
    turn(bin.window, coeff.reals.taper[b]);
    ++bin.n;
}

// k-th largest of the newest margins; 0 while there are fewer than k.
Real statistic(const lpvg_bin_t& bin, uint32_t confirm) {
    Real kth = Real(0);
    for (uint32_t i = 0; i < bin.n_history; ++i) {
        uint32_t larger_or_equal = 0U;
        for (uint32_t j = 0; j < bin.n_history; ++j) {
            larger_or_equal += bin.history[j] >= bin.history[i] ? 1U : 0U;
        }
        if (larger_or_equal >= confirm && bin.history[i] > kth) {
            kth = bin.history[i];
        }
    }
    return kth;
}

void record(lpvg_monitor_t& self, const lpvg_frame_t& frame) {
    if (self.n_records < LPVG_NRECORDS) {
        self.record[self.n_records] = frame;
        ++self.n_records;
    } else {
        ++self.records_lost;
    }
}

void judge(lpvg_monitor_t& self, std::size_t b) {
    const lpvg_coeff_t& coeff = *self.coeff;
    const lpvg_coeff_reals_t& r = coeff.reals;
    lpvg_bin_t& bin = self.bin[b];
    lpvg_frame_t frame{};
    frame.sequence = self.frame.sequence + 1U;
    frame.bin = static_cast<uint32_t>(b);
    frame.t_end_us = bin.frame_end_us;
    const lpvg_span_t& span = bin.frame_span;
    const Real mean = span.speed_sum / static_cast<Real>(coeff.words.frame_length[b]);
    const bool steady = span.speed_low >= (Real(1) - r.speed_tolerance) * mean &&
                        span.speed_high <= (Real(1) + r.speed_tolerance) * mean;
    frame.reason = span.reason != lpvg_reason_none ? span.reason : (steady ? lpvg_reason_none : lpvg_reason_speed_moved);
    if (frame.reason == lpvg_reason_none) {
        Complex E[ny], Z[ny], dead[ny];
        for (std::size_t j = 0; j < ny; ++j) {
            E[j] = {bin.frame[j][0], bin.frame[j][1]};
            Z[j] = {bin.frame[ny + j][0], bin.frame[ny + j][1]};
            dead[j] = {-Z[j].re, -Z[j].im};
            frame.E[j][0] = E[j].re;
            frame.E[j][1] = E[j].im;
            frame.Z[j][0] = Z[j].re;
            frame.Z[j][1] = Z[j].im;
        }
        frame.speed = mean;
        frame.margin = lpvg::Margin<Real, ny>(E, Z, r.W_delta[b], r.B_w[b])();
        frame.evidence = lpvg::Margin<Real, ny>(dead, Z, r.W_delta[b], r.B_w[b])();
        bin.history[bin.next_history] = frame.margin;
        bin.next_history = (bin.next_history + 1U) % coeff.words.of_last;
        bin.n_history += bin.n_history < coeff.words.of_last ? 1U : 0U;
        frame.statistic = statistic(bin, coeff.words.confirm);
        frame.falsified = !(frame.statistic <= r.threshold);
        if (frame.falsified) {
            self.has_falsified = true;
            self.t_falsified_us = frame.t_end_us;
            record(self, frame);
        }
        if (frame.evidence > r.threshold) {
            self.has_evidence = true;
            self.t_evidence_us = frame.t_end_us;
        } else {
            frame.reason = lpvg_reason_not_excited;
        }
    }
    self.frame = frame;
    bin.waiting = false;
}

// Judges at most one waiting frame, in turn, so that no push costs more than one judgement.
void judge_next(lpvg_monitor_t& self) {
    for (std::size_t i = 0; i < LPVG_NBINS; ++i) {
        const std::size_t b = (self.next_bin + i) % LPVG_NBINS;
        if (self.bin[b].waiting) {
            judge(self, b);
            self.next_bin = static_cast<uint32_t>((b + 1U) % LPVG_NBINS);
            return;
        }
    }
}

void start(lpvg_monitor_t& self, const lpvg_sample_t& sample) {
    lpvg_model_start(&self.model, self.coeff, sample.u, sample.y);
    for (lpvg_bin_t& bin : self.bin) {
        begin_half(bin);
        bin.has_before = false;
    }
    self.settled = 0U;
    self.running = true;
    ++self.restarts;
}

bool in_step(const lpvg_monitor_t& self, int64_t t_us) {
    const uint64_t period = self.coeff->words.sample_period_us;
    const uint64_t step = elapsed_us(t_us, self.t_us);
    return step <= 2U * period && 2U * step >= period && 2U * step <= 3U * period;  // the first keeps 2 step from wrapping
}

}  // namespace

extern "C" lpvg_status_t lpvg_monitor_init(lpvg_monitor_t* self, const lpvg_coeff_t* coeff) {
    if (self == nullptr) {
        return lpvg_status_bad_argument;
    }
    const lpvg_status_t status = lpvg_coeff_check(coeff);
    if (status == lpvg_status_ok) {
        *self = lpvg_monitor_t{};
        self->coeff = coeff;
    }
    return status;
}

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
    self->settled = in_range ? (self->settled < settled_max ? self->settled + 1U : settled_max) : 0U;
    const lpvg_reason_t reason = sample_reason(*self, in_range);

    Real yhat[ny];
    lpvg_model_output(&self->model, &coeff, yhat);
    lpvg_model_advance(&self->model, &coeff, sample->speed, sample->u);
    Real signal[n_signals];
    for (std::size_t j = 0; j < ny; ++j) {
        signal[j] = sample->y[j] - yhat[j];
        signal[ny + j] = yhat[j];
    }
    for (std::size_t b = 0; b < LPVG_NBINS; ++b) {
        lpvg_bin_t& bin = self->bin[b];
        extend(bin.span, bin.n == 0U, sample->speed, reason);
        accumulate(bin, coeff, b, signal);
        if (2U * bin.n == coeff.words.frame_length[b]) {
            end_half(bin, coeff.words.cycles[b], coeff.reals.scale[b], sample->t_us);
        }
    }
    judge_next(*self);
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
    if (self->has_evidence && elapsed_us(now_us, self->t_evidence_us) <= hold) {
        return lpvg_verdict_valid;
    }
    return self->frame.sequence == 0U ? lpvg_verdict_unknown : lpvg_verdict_not_judged;
}

extern "C" lpvg_reason_t lpvg_monitor_reason(const lpvg_monitor_t* self) {
    return self == nullptr ? lpvg_reason_none : self->frame.reason;
}

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
