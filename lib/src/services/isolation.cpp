// isolation.cpp -- see isolation.h.
//
// Block b and its lags need halves 2b - 10 to 2b + 5, which are those kept when half 2b + 5 has ended.
#include "lpvguard/isolation.h"

#include <cmath>
#include <limits>

#include "isolation_checks.hpp"
#include "monitor/model_step.hpp"

namespace {

using Real = lpvg_real_t;
constexpr std::size_t nx = LPVG_NX, nu = LPVG_NU, ny = LPVG_NY, signals = ny + nu, m = LPVG_ISOLATION_COLUMNS, lags = 3U;
constexpr std::size_t most_parts = ny + nu + 2U, pairs_begin = most_parts + 2U, healthy = most_parts, freed = most_parts + 1U;
constexpr std::size_t sizes = 3U * signals + 1U + LPVG_ISOLATION_PARAMETERS;
constexpr uint32_t halves = LPVG_ISOLATION_HALVES, blocks = LPVG_ISOLATION_BLOCKS, ahead = 2U;  // blocks before and after one that it needs
constexpr std::size_t speed_response = 2U * nu - 1U, first_parameter = speed_response + 1U;
constexpr Real changed_by = Real(0.02);  // factor of the changed speed and parameters, minus 1
constexpr Real sure = Real(0.95);  // probability that the named parts have together
constexpr Real alike = Real(5.88887795833288);  // 2 log(sure / (1 - sure)): a criterion below it excludes no part
constexpr Real odds = Real(6.907755278982137);  // log 1000, against a second fault
constexpr Real needed = Real(19), unexplained = Real(0.05), interval = Real(1.96);
constexpr Real urgent = Real(0.3);  // of a usual fault: needs service now
constexpr Real log_2 = Real(0.693147180559945309);

static_assert(LPVG_ISOLATION_RESPONSES == first_parameter + LPVG_ISOLATION_PARAMETERS, "one a response");
static_assert(sizeof(lpvg_isolation_reals_t::mean) == m * sizeof(Real), "one a column");

// Values of all outputs.
struct Outputs {
    Real y[ny];
};

using Sizes = Real[m];

Real larger(Real a, Real b) { return a > b ? a : b; }

// log x, x >= 1, and exp x, x <= 0, from sums and products: the core imports neither.
Real log_of(Real x) {
    Real whole = Real(0);
    for (int k = 0; k < 1024 && x > Real(1.5); ++k) {
        x *= Real(0.5);
        whole += log_2;
    }
    const Real t = (x - Real(1)) / (x + Real(1)), square = t * t;
    Real sum = Real(0);
    for (int k = 21; k > 0; k -= 2) {
        sum = sum * square + Real(2) / static_cast<Real>(k);
    }
    return whole + t * sum;
}

Real exp_of(Real x) {
    if (!(x > Real(-80))) {
        return Real(0);
    }
    const Real part = x / Real(128);
    Real sum = Real(1);
    for (int k = 8; k > 0; --k) {
        sum = Real(1) + sum * part / static_cast<Real>(k);
    }
    for (int k = 0; k < 7; ++k) {
        sum *= sum;
    }
    return sum;
}

// Index of the product of items a and b of (error, columns); a is not above b.
std::size_t at(std::size_t a, std::size_t b) { return a * (2U * m + 1U - a) / 2U + b; }

Real gram_of(const lpvg_isolation_t& self, std::size_t i, std::size_t k) {
    return i < k ? self.gram[at(i + 1U, k + 1U)] : self.gram[at(k + 1U, i + 1U)];
}

// Which item of words.part a column belongs to: an output, an input, the speed or a parameter.
std::size_t place_of(std::size_t column) { return column < 5U * signals ? column / 5U : column - 4U * signals; }

std::size_t part_of(const lpvg_isolation_t& self, std::size_t column) { return self.table->words.part[place_of(column)]; }

// A size of a part: of each signal gain, delay and bias, then the factors.
bool is_of_size(std::size_t column, std::size_t size) {
    if (column >= 5U * signals) {
        return size == 3U * signals + column - 5U * signals;
    }
    const std::size_t kind = column % 5U;
    return size == 3U * (column / 5U) + (kind == 0U ? 0U : kind == 4U ? 2U : 1U);
}

// --- models ---

void start(lpvg_response_t& of, const lpvg_model_t& like) {
    for (std::size_t i = 0; i < nx; ++i) {
        of.x[i] = like.x[i];
    }
    for (std::size_t d = 0; d <= LPVG_DELAY; ++d) {
        for (std::size_t i = 0; i < nu; ++i) {
            of.past[d][i] = like.past[d][i];
        }
    }
}

// Input i alone.
void start_alone(lpvg_response_t& of, std::size_t i, Real past) {
    of = lpvg_response_t{};
    for (auto& inputs : of.past) {
        inputs[i] = past;
    }
}

Outputs output_of(const lpvg_response_t& of, const lpvg_coeff_t& coeff) {
    Outputs y{};
    for (std::size_t j = 0; j < ny; ++j) {
        for (std::size_t i = 0; i < nx; ++i) {
            y.y[j] += coeff.reals.C[j][i] * of.x[i];
        }
    }
    return y;
}

// Entries of a model at a speed.
void entries_at(const lpvg_coeff_t& coeff, const Real* base, const Real (*cell)[LPVG_NVARYING][4], Real speed, Real* entry) {
    for (std::size_t i = 0; i < LPVG_NENTRIES; ++i) {
        entry[i] = base[i];
    }
    lpvguard::set_varying(coeff, cell, speed, entry);
}

// --- blocks ---

// Mean of a ring over block b, `shift` halves later.
Outputs mean_of(const lpvg_isolation_t& self, uint32_t b, int shift, std::size_t row) {
    const uint32_t first = 2U * b + static_cast<uint32_t>(shift);
    Outputs mean{};
    for (std::size_t j = 0; j < ny; ++j) {
        mean.y[j] = Real(0.5) * (self.half[first % halves][row][j] + self.half[(first + 1U) % halves][row][j]);
    }
    return mean;
}

// The response to input i alone. The first one's is what the others leave of yhat.
Outputs alone(const lpvg_isolation_t& self, const lpvg_coeff_t& coeff, uint32_t b, int shift, std::size_t i) {
    Outputs own = mean_of(self, b, shift, i);
    for (std::size_t j = 0; i == 0U && j < ny; ++j) {
        own.y[j] -= coeff.reals.output_offset[j];
        for (std::size_t k = 1U; k < nu; ++k) {
            own.y[j] -= mean_of(self, b, shift, k).y[j];
        }
    }
    return own;
}

// Errors in block b, or their change by a unit size of a column.
Outputs errors_in(const lpvg_isolation_t& self, uint32_t b) {
    Outputs e{};
    for (std::size_t j = 0; j < ny; ++j) {
        e.y[j] = self.block[b % blocks][0][j];
    }
    return e;
}

Outputs change_in(const lpvg_isolation_t& self, const lpvg_coeff_t& coeff, uint32_t b, std::size_t column) {
    const lpvg_isolation_words_t& w = self.table->words;
    const std::size_t signal = column / 5U, kind = column % 5U;
    const int shift = kind == 1U ? 1 : kind == 2U ? 2 : 4;
    const Real delay = static_cast<Real>(shift) * static_cast<Real>(w.half) * self.table->reals.period_s;
    const auto& kept = self.block[b % blocks];
    Outputs change{};
    if (signal < ny) {
        const Real now = mean_of(self, b, 0, 0U).y[signal];
        const Real late = kind == 0U ? now : (mean_of(self, b, -shift, 0U).y[signal] - now) / delay;
        change.y[signal] = kind == 4U ? Real(1) : late;
    } else if (signal < signals) {
        const std::size_t i = signal - ny;
        const Outputs own = alone(self, coeff, b, 0, i), early = alone(self, coeff, b, shift, i);
        for (std::size_t j = 0; j < ny; ++j) {
            change.y[j] = kind == 0U ? -own.y[j] : kind == 4U ? -kept[1U + i][j] : (early.y[j] - own.y[j]) / delay;
        }
    } else {
        const std::size_t k = column - 5U * signals;
        for (std::size_t j = 0; j < ny; ++j) {
            change.y[j] = kept[1U + nu + k][j] + (k == 0U ? self.table->reals.power[j] * mean_of(self, b, 0, 0U).y[j] : Real(0));
        }
    }
    return change;
}

// Error (item 0) and columns of block b without what the blocks before it predict, and with unit covariance.
Outputs whitened(const lpvg_isolation_t& self, const lpvg_coeff_t& coeff, uint32_t b, std::size_t item) {
    const lpvg_isolation_reals_t& r = self.table->reals;
    const auto raw = [&](uint32_t block) { return item == 0U ? errors_in(self, block) : change_in(self, coeff, block, item - 1U); };
    Outputs left = raw(b), white{};
    for (uint32_t k = 0U; k < lags; ++k) {
        const Outputs before = raw(b - k - 1U);
        for (std::size_t i = 0; i < ny; ++i) {
            for (std::size_t j = 0; j < ny; ++j) {
                left.y[i] -= r.lags[k][i][j] * before.y[j];
            }
        }
    }
    for (std::size_t i = 0; i < ny; ++i) {
        for (std::size_t j = 0; j < ny; ++j) {
            white.y[i] += r.white[i][j] * left.y[j];
        }
    }
    return white;
}

void empty_window(lpvg_isolation_t& self) {
    for (Real& x : self.gram) {
        x = Real(0);
    }
    self.sum = lpvguard::sum_of_words(self.gram);
    self.count = 0U;
    self.stretch = 0U;
}

void add(lpvg_isolation_t& self, const lpvg_coeff_t& coeff, uint32_t b) {
    Outputs white[m + 1U];
    for (std::size_t a = 0; a <= m; ++a) {
        white[a] = whitened(self, coeff, b, a);
    }
    for (std::size_t a = 0; a <= m; ++a) {
        for (std::size_t k = a; k <= m; ++k) {
            Real sum = Real(0);
            for (std::size_t j = 0; j < ny; ++j) {
                sum += white[a].y[j] * white[k].y[j];
            }
            self.gram[at(a, k)] += sum;
        }
    }
    ++self.count;
    self.sum = lpvguard::sum_of_words(self.gram);
}

// --- judgement ---

// I + D G D / scale of spreads D, by Cholesky. Its pivots are 1 or larger.
class Factor {
public:
    Factor(const lpvg_isolation_t& self, const Sizes& spread, Real scale) {
        for (std::size_t i = 0; i < m; ++i) {
            for (std::size_t k = 0; k <= i; ++k) {
                Real x = spread[i] * gram_of(self, k, i) * spread[k] / scale;
                for (std::size_t j = 0; j < k; ++j) {
                    x -= root(i, j) * root(k, j);
                }
                root(i, k) = k < i ? x / root(k, k) : std::sqrt(larger(x + Real(1), Real(1)));
            }
        }
    }
    // Solves with the root for b; returns the square of the result.
    Real lowered(Sizes& b) const {
        Real square = Real(0);
        for (std::size_t i = 0; i < m; ++i) {
            for (std::size_t j = 0; j < i; ++j) {
                b[i] -= root(i, j) * b[j];
            }
            b[i] /= root(i, i);
            square += b[i] * b[i];
        }
        return square;
    }
    // Solves with the root's transpose for b.
    void raised(Sizes& b) const {
        for (std::size_t i = m; i-- > 0U;) {
            b[i] /= root(i, i);
            for (std::size_t j = 0; j < i; ++j) {
                b[j] -= root(i, j) * b[i];
            }
        }
    }
    Real log_determinant() const {
        Real sum = Real(0);
        for (std::size_t i = 0; i < m; ++i) {
            sum += Real(2) * log_of(root(i, i));
        }
        return sum;
    }

private:
    Real& root(std::size_t i, std::size_t k) { return root_[i * (i + 1U) / 2U + k]; }
    Real root(std::size_t i, std::size_t k) const { return root_[i * (i + 1U) / 2U + k]; }
    Real root_[m * (m + 1U) / 2U];
};

// Spreads of which those of the parts in `faulty` are faulty.
void spreads(const lpvg_isolation_t& self, uint32_t faulty, Sizes& spread) {
    const lpvg_isolation_reals_t& r = self.table->reals;
    for (std::size_t i = 0; i < m; ++i) {
        const Real own = r.spread[i], fault = r.fault[i];
        spread[i] = ((faulty >> part_of(self, i)) & 1U) != 0U ? std::sqrt(own * own + fault * fault) : own;
    }
}

// Sums with the error without those of the healthy mean, by spreads.
void change_of(const lpvg_isolation_t& self, const Sizes& spread, Sizes& b) {
    for (std::size_t i = 0; i < m; ++i) {
        b[i] = self.gram[at(0U, i + 1U)];
        for (std::size_t k = 0; k < m; ++k) {
            b[i] -= gram_of(self, i, k) * self.table->reals.mean[k];
        }
        b[i] *= spread[i];
    }
}

struct Fit {
    Real log_likelihood, misfit;
};

Fit fit_of(const lpvg_isolation_t& self, uint32_t faulty) {
    Sizes spread, b;
    spreads(self, faulty, spread);
    change_of(self, spread, b);
    const Factor factored(self, spread, Real(1));
    const Real explained = factored.lowered(b), scale = self.table->reals.scale;
    return {Real(0.5) * (explained - factored.log_determinant()) / scale, -explained / scale};
}

std::size_t likeliest(const lpvg_isolation_t& self) {
    std::size_t best = 0U;
    for (std::size_t p = 1U; p < self.table->words.parts; ++p) {
        best = self.fit[p] > self.fit[best] ? p : best;
    }
    return best;
}

// True if the window does not agree with a healthy vehicle.
bool differs(const lpvg_isolation_t& self) {
    return self.count > 0U && self.fit[likeliest(self)] - self.fit[healthy] > (self.alarmed ? Real(0) : self.table->reals.least);
}

// True if a single part explains the window.
bool explained(const lpvg_isolation_t& self) {
    const std::size_t best = likeliest(self);
    const Real against = self.fit[best] - self.fit[healthy];
    return self.misfit[best] - self.misfit[freed] <= Real(2) * self.table->reals.lack + needed + Real(2) * unexplained * against;
}

// Akaike's information criterion of a faulty part, up to a constant.
Real criterion(const lpvg_isolation_t& self, std::size_t part) {
    Real sum = self.misfit[part];
    for (std::size_t i = 0; i < m; ++i) {
        sum += part_of(self, i) == part && self.table->reals.fault[i] > Real(0) ? Real(2) : Real(0);
    }
    return sum;
}

// One bit for each of the fewest parts that are sure together, and of those that fit as well as the likeliest.
uint32_t named(const lpvg_isolation_t& self) {
    const std::size_t parts = self.table->words.parts, best = likeliest(self);
    Real weight[most_parts], whole = Real(0);
    for (std::size_t p = 0; p < parts; ++p) {
        weight[p] = exp_of(self.fit[p] - self.fit[best]);
        whole += weight[p];
    }
    uint32_t bits = 0U;
    for (Real together = Real(0); together < sure * whole;) {
        std::size_t next = best;
        for (std::size_t p = 0; p < parts; ++p) {
            next = weight[p] > weight[next] ? p : next;
        }
        together += weight[next];
        weight[next] = Real(-1);
        bits |= 1U << next;
    }
    for (std::size_t p = 0; p < parts; ++p) {
        bits |= criterion(self, p) - criterion(self, best) < alike ? 1U << p : 0U;
    }
    return bits;
}

// The size of the likeliest part that is surest, and its interval.
void estimate(lpvg_isolation_t& self) {
    const lpvg_isolation_reals_t& r = self.table->reals;
    const std::size_t part = likeliest(self);
    Sizes spread, b;
    spreads(self, 1U << part, spread);
    change_of(self, spread, b);
    const Factor factored(self, spread, r.scale);
    factored.lowered(b);
    factored.raised(b);
    Real surest = Real(-1);
    for (std::size_t size = 0; size < sizes; ++size) {
        Sizes chosen;
        Real value = Real(0), variance = Real(0), usual = Real(0);
        for (std::size_t i = 0; i < m; ++i) {
            const bool own = part_of(self, i) == part && is_of_size(i, size) && r.fault[i] > Real(0);
            usual = own ? r.fault[i] : usual;
            chosen[i] = own ? spread[i] : Real(0);
            value += chosen[i] * b[i] / r.scale;
            variance += own ? r.spread[i] * r.spread[i] : Real(0);
        }
        if (!(usual > Real(0))) {
            continue;
        }
        const Real half_width = interval * std::sqrt(factored.lowered(chosen) + variance);
        if (std::abs(value) > surest * half_width) {
            surest = std::abs(value) / half_width;
            self.newest.size = static_cast<uint32_t>(size);
            self.newest.value = value;
            self.newest.now = std::abs(value) > urgent * usual;
            self.newest.low = value - half_width;
            self.newest.high = value + half_width;
        }
    }
}

void open_next(lpvg_isolation_t& self) {
    empty_window(self);
    self.judging = false;
    self.closing = false;
    self.from_us = self.next_us;
    self.from_block = self.next_block;
    self.alarmed = self.next_alarmed;
}

void end_judgement(lpvg_isolation_t& self, uint32_t parts) {
    lpvg_parts_t& newest = self.newest;
    newest.differs = differs(self);
    newest.alarmed = self.alarmed;
    newest.parts = parts;
    newest.likeliest = static_cast<uint32_t>(likeliest(self));
    newest.from_us = self.from_us;
    newest.until_us = self.until_us;
    ++self.windows;
    open_next(self);
}

// The next hypothesis: each part, the healthy vehicle, all parts at once; then two parts beside the likeliest.
void judge(lpvg_isolation_t& self) {
    const uint32_t parts = self.table->words.parts, every_part = (1U << parts) - 1U, step = self.step;
    ++self.step;
    if (step < pairs_begin) {
        if (step < parts || step >= most_parts) {
            const Fit fit = fit_of(self, step < parts ? 1U << step : step == healthy ? 0U : every_part);
            self.fit[step] = fit.log_likelihood;
            self.misfit[step] = fit.misfit;
        }
        return;
    }
    if (step == pairs_begin) {
        self.newest = lpvg_parts_t{};
        self.pair_parts = 0U;
    }
    if (!differs(self) || !explained(self)) {
        end_judgement(self, 0U);
        return;
    }
    const std::size_t best = likeliest(self);
    const uint32_t pair = step - static_cast<uint32_t>(pairs_begin), first = pair / parts, second = pair % parts;
    if (pair < parts * parts) {
        if (first < second && first != best && second != best) {
            const Real fit = fit_of(self, (1U << first) | (1U << second)).log_likelihood;
            if (self.pair_parts == 0U || fit > self.pair) {
                self.pair = fit;
                self.pair_parts = (1U << first) | (1U << second);
            }
        }
        return;
    }
    estimate(self);
    const bool likelier = self.pair_parts != 0U && self.pair > self.fit[best] + odds - alike / Real(2);
    end_judgement(self, named(self) | (likelier ? self.pair_parts : 0U));
}

// --- words ---

constexpr char digit[] = "0123456789";

// Text that ends where its room does.
class Line {
public:
    Line(char* text, std::size_t room) : text_(text), room_(room) {}
    std::size_t size() const { return size_; }
    void add(char letter) {
        if (size_ + 1U < room_) {
            text_[size_] = letter;
            ++size_;
        }
        text_[size_] = char{};
    }
    void add(const char* words) {
        for (; *words != char{}; ++words) {
            add(*words);
        }
    }
    void add_whole(int32_t x) {
        add(x < 0 ? "-" : "");
        uint32_t size = x < 0 ? 0U - static_cast<uint32_t>(x) : static_cast<uint32_t>(x), power = 1U;
        while (size / power >= 10U) {
            power *= 10U;
        }
        for (; power > 0U; power /= 10U) {
            add(digit[size / power % 10U]);
        }
    }
    // Three digits at most, as "%+.3g" of C.
    void add_number(Real x) {
        add(x < Real(0) ? "-" : "+");
        x = std::abs(x);
        if (!(x > Real(0) && x <= std::numeric_limits<Real>::max())) {
            add("0");
            return;
        }
        int exponent = 0, last = 2;
        for (; x >= Real(10); ++exponent) {
            x /= Real(10);
        }
        for (; x < Real(1); --exponent) {
            x *= Real(10);
        }
        int digits = static_cast<int>(x * Real(100) + Real(0.5));
        if (digits == 1000) {
            digits = 100;
            ++exponent;
        }
        const bool is_plain = exponent > -5 && exponent < 3;
        const int point = is_plain ? exponent : 0;
        for (; last > 0 && last > point && digits % 10 == 0; --last) {
            digits /= 10;
        }
        for (int k = point < 0 ? point : 0; k <= last; ++k) {
            const int power = last - k == 2 ? 100 : last - k == 1 ? 10 : 1;
            add(digit[k < 0 ? 0 : digits / power % 10]);
            if (k == point && k < last) {
                add(".");
            }
        }
        if (!is_plain) {
            add("e");
            add(exponent < 0 ? "-" : "+");
            const int size = exponent < 0 ? -exponent : exponent;
            if (size < 10) {
                add("0");
            }
            add_whole(size);
        }
    }

private:
    char* text_;
    std::size_t room_, size_ = 0U;
};

// Failure mode (J1939-73) of a part that is named alone.
uint8_t failure_of(const lpvg_parts_t& parts) {
    if (parts.size >= 3U * signals || parts.size % 3U == 0U) {
        return LPVG_CAN_FMI_CALIBRATION;
    }
    if (parts.size % 3U == 1U) {
        return LPVG_CAN_FMI_UPDATE_RATE;
    }
    return parts.value > Real(0) ? LPVG_CAN_FMI_DRIFTED_HIGH : LPVG_CAN_FMI_DRIFTED_LOW;
}

// --- windows ---

// The window ends: it is judged if it is long enough, or an alarm began it.
void close(lpvg_isolation_t& self) {
    const bool is_long = 2 * (self.until_us - self.from_us) > static_cast<int64_t>(self.table->words.window_us);
    if (self.alarmed || is_long) {
        self.judging = true;
        self.step = 0U;
    } else {
        open_next(self);
    }
}

// A window begins with the newest sample, which is the first of a block or not.
void begin_window(lpvg_isolation_t& self, bool alarm, uint32_t block) {
    const bool first = !self.running;
    self.next_us = self.t_us;
    self.next_block = block;
    self.next_alarmed = alarm;
    self.running = true;
    if (first) {
        open_next(self);
    } else if (!self.closing) {
        self.closing = true;
        self.until_us = self.t_us;
        self.to_block = self.halves / 2U;
    }
}

// Begin of the newest window, judged ones aside.
int64_t newest_begin(const lpvg_isolation_t& self) { return self.closing ? self.next_us : self.from_us; }

void follow_windows(lpvg_isolation_t& self, bool begins) {
    const uint32_t next = (self.halves + 1U) / 2U + ((self.halves % 2U) == 0U && self.in_half > 0U ? 1U : 0U);
    const bool alarmed = self.closing ? self.next_alarmed : self.alarmed;
    const bool over = self.running && self.t_us - newest_begin(self) >= static_cast<int64_t>(self.table->words.window_us);
    if (!self.running || over || (begins && !alarmed)) {
        begin_window(self, begins, next);
    }
}

// The monitor began anew: blocks do, and models.
void restart(lpvg_isolation_t& self) {
    self.in_half = self.halves = self.good_blocks = 0U;
    self.pending = false;
    self.stretch = 0U;
    self.from_block = self.next_block = 0U;
    for (auto& row : self.half_sum) {
        for (Real& x : row) {
            x = Real(0);
        }
    }
    if (self.closing && !self.judging) {
        close(self);
    }
}

void start_models(lpvg_isolation_t& self, const lpvg_coeff_t& coeff, const lpvg_sample_t& sample) {
    lpvg_model_t like;
    lpvg_model_start(&like, &coeff, sample.u, sample.y);
    for (std::size_t i = 0; i < nu; ++i) {
        start_alone(self.response[i], i, Real(1));
        if (i > 0U) {
            start_alone(self.response[nu + i - 1U], i, like.past[0][i]);
        }
    }
    for (std::size_t k = speed_response; k < LPVG_ISOLATION_RESPONSES; ++k) {
        start(self.response[k], like);
    }
}

// Adds a sample's values to the sums of its block, and advances the models.
void take_sample(lpvg_isolation_t& self, const lpvg_monitor_t& monitor, const lpvg_sample_t& sample) {
    const lpvg_coeff_t& coeff = *monitor.coeff;
    const lpvg_isolation_reals_t& r = self.table->reals;
    const Real* const signal = monitor.signal[monitor.newest];
    for (std::size_t j = 0; j < ny; ++j) {
        self.half_sum[0][j] += signal[ny + j];
        self.block_sum[0][j] += signal[j];
    }
    Real deviation[nu], one[nu], own[nu], entry[LPVG_NENTRIES];
    for (std::size_t i = 0; i < nu; ++i) {
        deviation[i] = sample.u[i] - coeff.reals.input_offset[i];
    }
    for (std::size_t k = 0; k < first_parameter + self.table->words.parameters; ++k) {
        lpvg_response_t& of = self.response[k];
        const Outputs y = output_of(of, coeff);
        const bool changed = k >= speed_response, alone_here = !changed && k >= nu;
        for (std::size_t j = 0; j < ny; ++j) {
            Real& sum = alone_here ? self.half_sum[k - nu + 1U][j] : self.block_sum[1U + (changed ? k - speed_response + nu : k)][j];
            sum += changed ? (y.y[j] + coeff.reals.output_offset[j] - signal[ny + j]) / changed_by : y.y[j];
        }
        const std::size_t input = alone_here ? k - nu + 1U : k;
        for (std::size_t i = 0; i < nu; ++i) {
            one[i] = i == input ? Real(1) : Real(0);
            own[i] = i == input ? deviation[i] : Real(0);
        }
        if (k == speed_response) {
            entries_at(coeff, coeff.reals.base, coeff.reals.cell, sample.speed / (Real(1) + changed_by), entry);
        } else if (changed) {
            const std::size_t p = k - first_parameter;
            entries_at(coeff, r.base[p], r.cell[p], sample.speed, entry);
        }
        lpvguard::step_model(changed ? entry : monitor.model.entry, of.x, of.past, changed ? deviation : alone_here ? own : one);
    }
}

// The sample was the last of a half: its means are kept, and a block may be ready.
void end_half(lpvg_isolation_t& self) {
    const Real share = Real(1) / static_cast<Real>(self.table->words.half);
    for (std::size_t row = 0; row < nu; ++row) {
        for (std::size_t j = 0; j < ny; ++j) {
            self.half[self.halves % halves][row][j] = self.half_sum[row][j] * share;
            self.half_sum[row][j] = Real(0);
        }
    }
    self.stretch = self.pending ? 0U : self.stretch;
    self.pending = false;
    ++self.halves;
    self.in_half = 0U;
    if ((self.halves % 2U) == 0U) {
        const uint32_t b = self.halves / 2U - 1U;
        for (std::size_t row = 0; row < nu + 4U; ++row) {
            for (std::size_t j = 0; j < ny; ++j) {
                self.block[b % blocks][row][j] = self.block_sum[row][j] * share * Real(0.5);
            }
        }
        self.good_blocks = (self.good_blocks << 1U) | (self.good ? 1U : 0U);
        self.pending = b >= 2U * ahead;
    }
}

// Block b may be added: to the window's sums, if it is in the window and has settled blocks before it.
void take_block(lpvg_isolation_t& self, const lpvg_coeff_t& coeff) {
    const uint32_t b = self.halves / 2U - 1U - ahead;
    const bool inside = b >= self.from_block && !(self.closing && b >= self.to_block);
    const bool good = inside && ((self.good_blocks >> ahead) & 1U) != 0U;
    self.stretch = good && self.stretch <= lags ? self.stretch + 1U : good ? self.stretch : 0U;
    if (self.stretch > lags) {
        add(self, coeff, b);
    }
    if (self.closing && b + 1U >= self.to_block) {
        close(self);
    }
}

}  // namespace

extern "C" uint32_t lpvg_isolation_table_crc32(const lpvg_isolation_table_t* table) {
    return table == nullptr ? 0U : lpvguard::coefficients_crc32(*table);
}

extern "C" lpvg_status_t lpvg_isolation_table_check(const lpvg_isolation_table_t* table) {
    if (table == nullptr) {
        return lpvg_status_bad_argument;
    }
    const lpvg_isolation_words_t& w = table->words;
    if (w.magic != LPVG_ISOLATION_MAGIC) {
        return lpvg_status_bad_magic;
    }
    if (w.schema != LPVG_ISOLATION_SCHEMA) {
        return lpvg_status_bad_schema;
    }
    if (w.real_bytes != sizeof(Real) || !lpvguard::sizes_match(w)) {
        return lpvg_status_bad_size;
    }
    if (w.crc32 != lpvg_isolation_table_crc32(table)) {
        return lpvg_status_bad_crc;
    }
    if (!lpvguard::all_finite(table->reals)) {
        return lpvg_status_not_finite;
    }
    return lpvguard::items_in_range(w) && lpvguard::items_in_range(table->reals) ? lpvg_status_ok : lpvg_status_bad_value;
}

extern "C" lpvg_status_t lpvg_isolation_init(lpvg_isolation_t* self, const lpvg_isolation_table_t* table) {
    const lpvg_status_t status = lpvg_isolation_table_check(table);
    if (self == nullptr || status != lpvg_status_ok) {
        return self == nullptr ? lpvg_status_bad_argument : status;
    }
    *self = lpvg_isolation_t{};
    self->table = table;
    return lpvg_status_ok;
}

extern "C" lpvg_status_t lpvg_isolation_take(lpvg_isolation_t* self, const lpvg_monitor_t* monitor, const lpvg_sample_t* sample) {
    if (self == nullptr || monitor == nullptr || sample == nullptr) {
        return lpvg_status_bad_argument;
    }
    if (self->table == nullptr || monitor->coeff == nullptr) {
        return lpvg_status_not_ready;
    }
    if (monitor->refused || sample->t_us != monitor->t_us || (self->running && sample->t_us == self->t_us)) {
        return lpvg_status_ok;
    }
    self->t_us = sample->t_us;
    if (monitor->restarts != self->restarts || monitor->repairs != self->repairs) {
        self->restarts = monitor->restarts;
        self->repairs = monitor->repairs;
        restart(*self);
        start_models(*self, *monitor->coeff, *sample);
    }
    const lpvg_verdict_t verdict = lpvg_monitor_verdict(monitor, monitor->t_us);
    const bool alarming = verdict == lpvg_verdict_invalid || verdict == lpvg_verdict_degraded;
    follow_windows(*self, alarming && !self->alarming);
    self->alarming = alarming;
    if (self->in_half == 0U && (self->halves % 2U) == 0U) {
        self->good = true;
        for (auto& row : self->block_sum) {
            for (Real& x : row) {
                x = Real(0);
            }
        }
    }
    self->good = self->good && monitor->block[monitor->newest].span.reason == lpvg_reason_none;
    take_sample(*self, *monitor, *sample);
    ++self->in_half;
    if (self->in_half >= self->table->words.half) {
        end_half(*self);
    }
    return lpvg_status_ok;
}

extern "C" bool lpvg_isolation_work(lpvg_isolation_t* self, const lpvg_monitor_t* monitor) {
    if (self == nullptr || monitor == nullptr || self->table == nullptr || monitor->coeff == nullptr) {
        return false;
    }
    if (self->judging || self->pending) {
        if (self->sum != lpvguard::sum_of_words(self->gram)) {
            empty_window(*self);
        }
        if (self->judging) {
            judge(*self);
        } else {
            self->pending = false;
            take_block(*self, *monitor->coeff);
        }
    }
    return self->judging || self->pending;
}

extern "C" size_t lpvg_isolation_line(const lpvg_parts_t* parts, const lpvg_part_words_t* part_words, const lpvg_size_words_t* size_words,
                                      char* text, size_t room) {
    if (parts == nullptr || part_words == nullptr || size_words == nullptr || text == nullptr || room == 0U) {
        return 0U;
    }
    Line line(text, room);
    if (!parts->differs) {
        line.add("no part differs");
        return line.size();
    }
    // The likeliest part comes first.
    uint32_t order[most_parts];
    std::size_t count = 0U;
    for (uint32_t k = 0U; k <= most_parts; ++k) {
        const uint32_t p = k == 0U ? parts->likeliest : k - 1U;
        if (((parts->parts >> p) & 1U) != 0U && (k == 0U || p != parts->likeliest)) {
            order[count] = p;
            ++count;
        }
    }
    line.add(count == 0U ? "no single part explains it" : count == 1U ? "" : "one of ");
    for (std::size_t k = 0U; k < count; ++k) {
        line.add(k == 0U ? "" : ", ");
        line.add(part_words[order[k]].name);
    }
    if (count == 1U) {
        const lpvg_size_words_t& size = size_words[parts->size];
        line.add(": ");
        line.add(size.name);
        line.add(" ");
        line.add_number(parts->value);
        line.add(size.unit);
        line.add(" (");
        line.add_number(parts->low);
        line.add(" to ");
        line.add_number(parts->high);
        line.add(")");
    }
    line.add(", since about ");
    const float seconds = 1e-6F * static_cast<float>(parts->from_us);
    const float limited = seconds < -2e9F ? -2e9F : seconds > 2e9F ? 2e9F : seconds;
    line.add_whole(static_cast<int32_t>(limited + (limited < 0.0F ? -0.5F : 0.5F)));
    line.add(" s");
    for (std::size_t k = 0U; k < count; ++k) {
        line.add("; check ");
        line.add(part_words[order[k]].check);
    }
    if (count == 1U) {
        line.add(parts->now ? "; service now" : "; service later");
    }
    return line.size();
}

extern "C" void lpvg_isolation_findings(const lpvg_parts_t* parts, lpvg_j1939_findings_t* findings) {
    if (parts == nullptr || findings == nullptr || !parts->differs) {
        return;
    }
    const bool is_single = parts->parts != 0U && (parts->parts & (parts->parts - 1U)) == 0U;
    const uint8_t mode = is_single ? failure_of(*parts) : parts->parts == 0U ? LPVG_CAN_FMI_ROOT_UNKNOWN : LPVG_CAN_FMI_CONDITION;
    for (uint32_t k = 0U; k <= most_parts; ++k) {
        const bool is_named = k == 0U ? parts->parts == 0U : ((parts->parts >> (k - 1U)) & 1U) != 0U;
        if (is_named && findings->n_codes < LPVG_J1939_CODES_MAX) {
            findings->code[findings->n_codes] = {LPVG_ISOLATION_SPN + k, mode, 0U};
            ++findings->n_codes;
        }
    }
}
