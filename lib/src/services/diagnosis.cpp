// diagnosis.cpp -- see diagnosis.h.
//
// Regressors are divided by their sizes on the bound-setting drives, so that float is enough for the normal equations.
#include "lpvguard/diagnosis.h"

#include <cmath>

#include "diagnosis_checks.hpp"
#include "monitor/eigen.hpp"

namespace {

using Real = lpvg_real_t;
constexpr std::size_t ny = LPVG_NY, parts = LPVG_DIAGNOSIS_PARTS, delays = LPVG_DIAGNOSIS_DELAYS, shifts = 2U * delays,
                      cells = LPVG_DIAGNOSIS_CELLS;
constexpr uint32_t yhats = LPVG_DIAGNOSIS_HISTORY, errors = LPVG_DIAGNOSIS_ERRORS;
constexpr uint32_t n_block = LPVG_NBLOCK, done = LPVG_DIAGNOSIS_DONE;
constexpr Real weakest = Real(1e-5);  // of the normal equations: what is not excited at all has no estimate but 0
constexpr Real floor_share = Real(0.01);  // of the largest healthy residue: below it rounding speaks
constexpr Real growing = Real(0.1);  // of e's mean square: a cause that grows to three times its size leaves 8 % of itself
constexpr uint32_t most_halves = 64U;  // of a record, in the past: some five minutes
using Row = Eigen::Array<Real, LPVG_DIAGNOSIS_PARTS, 1>;
using Triangle = Eigen::Array<Real, LPVG_DIAGNOSIS_TRIANGLE, 1>;

Real dot(const Row& a, const Row& b) { return (a * b).sum(); }

// x x' of a symmetric positive definite matrix, by Cholesky without roots. Out of line: it is called from many places, and nobody waits.
class Factor {
public:
    // Of a A + b B.
    Factor(const Triangle& A, Real a, const Triangle& B, Real b);
    explicit Factor(const Triangle& A) : Factor(A, Real(1), A, Real(0)) {}
    bool well() const { return well_; }
    // The solution of A x = b.
    Row solved(const Row& b) const;
    // b' A^-1 b
    Real square(const Row& b) const { return dot(b, solved(b)); }

private:
    Real unit_[parts][parts]{}, pivot_[parts]{};
    bool well_ = true;
};

Factor::Factor(const Triangle& A, Real a, const Triangle& B, Real b) {
    std::size_t at = 0U;
    for (std::size_t i = 0; i < parts; ++i) {
        for (std::size_t k = i; k < parts; ++k) {
            Real x = a * A[static_cast<Eigen::Index>(at)] + b * B[static_cast<Eigen::Index>(at)];
            ++at;
            for (std::size_t m = 0; m < i; ++m) {
                x -= unit_[i][m] * unit_[k][m] * pivot_[m];
            }
            if (k == i) {
                well_ = well_ && x > Real(0);
                pivot_[i] = well_ ? x : Real(1);  // what is not well is not read, and divides by no zero
            }
            unit_[k][i] = x / pivot_[i];
        }
    }
}

Row Factor::solved(const Row& b) const {
    Real x[parts];
    for (std::size_t i = 0; i < parts; ++i) {
        x[i] = b[static_cast<Eigen::Index>(i)];
        for (std::size_t m = 0; m < i; ++m) {
            x[i] -= unit_[i][m] * x[m];
        }
    }
    Row solution;
    for (std::size_t i = parts; i-- > 0U;) {
        Real y = x[i] / pivot_[i];
        for (std::size_t m = i + 1U; m < parts; ++m) {
            y -= unit_[m][i] * solution[static_cast<Eigen::Index>(m)];
        }
        solution[static_cast<Eigen::Index>(i)] = y;
    }
    return solution;
}

Row basis(std::size_t i) {
    Row e = Row::Zero();
    e[static_cast<Eigen::Index>(i)] = Real(1);
    return e;
}

Triangle inverse(const Factor& A) {
    Triangle found;
    Eigen::Index at = 0;
    for (std::size_t i = 0; i < parts; ++i) {
        const Row column = A.solved(basis(i));
        for (std::size_t k = i; k < parts; ++k) {
            found[at] = column[static_cast<Eigen::Index>(k)];
            ++at;
        }
    }
    return found;
}

// The diagonal of a triangle: where its items are.
constexpr Eigen::Index diagonal[parts] = {0, 4, 7, 9};

// Regressors from yhat, its change over a block, and their sizes.
Row regressors(Real yhat, Real change, const Real* unit) {
    const Real p = yhat * unit[0];
    return {p, -change * unit[1], Real(1), p * std::abs(p)};
}

// A cause that may explain theta and the residue.
struct Hypothesis {
    lpvg_cause_t cause;
    Real value, deviation;
    Real strange;  // how far what it leaves of theta is from a healthy vehicle's, a chi-squared
    Real left;     // sum of squares of the residue that it leaves
    Real scale;    // on what a healthy residue may be
    bool outside;  // the interval leaves out "no change"
};

lpvg_found_t other() { return {lpvg_cause_other, Real(0), Real(0), Real(0), 0U, false}; }

Real larger(Real a, Real b) { return a > b ? a : b; }

Row row(const Real* items) { return Eigen::Map<const Row>(items); }

// The normal equations of n blocks.
Triangle regular(const Real* gram, Real n) {
    Triangle A = Eigen::Map<const Triangle>(gram);
    for (const Eigen::Index i : diagonal) {
        A[i] += weakest * n;
    }
    return A;
}

// A healthy vehicle's theta: mean and covariance.
struct Healthy {
    Row mean;
    Triangle spread;
};

// Of a drive, of which n blocks from before an alarm are known, from what it is of any: the best linear estimate from theirs, as a drive
// keeps the share `kept` of the spread. Informations of both add up.
void foretell(const lpvg_past_t& past, const lpvg_diagnosis_reals_t& r, std::size_t j, Real n, Healthy& healthy) {
    const Triangle gram = regular(past.gram, n);
    const Row along = row(past.along);
    const Real left = larger(past.error_square - dot(along, Factor(gram).solved(along)), floor_share * r.residue[j][0] * n);
    const Real weight = n / (r.correlated[j] * left), kept = r.kept[j];
    const Factor both(inverse(Factor(healthy.spread)), Real(1), gram, weight);
    const Triangle known = inverse(both);
    healthy.mean = both.solved(along) * (weight * kept);
    for (Eigen::Index i = 0; i < known.size(); ++i) {
        healthy.spread[i] += kept * kept * (known[i] - healthy.spread[i]);
    }
}

// Where a shift by m steps is kept, m > 0 later, m < 0 sooner.
std::size_t kept_at(int m) { return static_cast<std::size_t>(m > 0 ? m - 1 : static_cast<int>(delays) - m - 1); }

// The square of a mixture with the share f of the second.
Real mixed(Real first, Real both, Real second, Real f) {
    const Real g = Real(1) - f;
    return g * g * first + Real(2) * g * f * both + f * f * second;
}

// What the sums of one output say.
class Judgement {
public:
    Judgement(const lpvg_diagnosis_output_t& of, const lpvg_diagnosis_reals_t& r, std::size_t j, Real n, const Healthy& healthy)
        : of_(of),
          r_(r),
          j_(j),
          n_(n),
          healthy_(healthy),
          gram_(regular(of.gram, n)),
          theta_(gram_.solved(row(of.along))),
          change_(theta_ - healthy.mean),
          square_(larger(of.error_square - dot(row(of.along), theta_), Real(0))) {}

    // Whether theta can be had at all.
    bool well() const { return gram_.well() && theta_.isFinite().all() && std::isfinite(square_); }
    // Of theta, from a healthy vehicle's.
    const Row& change() const { return change_; }
    // Whether the interval of the cause that explains best holds "no change".
    bool unchanged() const { return unchanged_; }

    // The cause by the estimate; `other` where none explains, or several do.
    lpvg_found_t found(Real block_s, uint32_t stride) {
        const Real largest = r_.residue[j_][0] + r_.residue[j_][1] * yhat_square();
        const Real step_s = block_s * static_cast<Real>(stride);
        const Real floor = floor_share * r_.residue[j_][0] * n_;
        least_ = square_;
        for (int m = -static_cast<int>(delays); m <= static_cast<int>(delays); ++m) {
            const Real tried = remains(gram_, m, m).left;
            least_ = tried < least_ ? tried : least_;
        }
        least_ = larger(least_, floor);
        white_ = r_.correlated[j_] * least_ / n_;
        const Triangle noise = inverse(gram_);
        const Factor healthy(healthy_.spread, Real(1), noise, white_);
        // A gain g multiplies yhat, which is 1 / unit in the first part, and what a healthy vehicle has beside it.
        Row gained = healthy_.mean;
        gained[0] += Real(1) / r_.unit[j_][0];
        const Real g = along(healthy, lpvg_cause_gain, gained, Real(1)).value;
        const Real g2 = g * g;
        const Factor scaled(healthy_.spread, g2, noise, white_);
        Hypothesis all[3] = {along(scaled, lpvg_cause_gain, gained, Real(1)), delayed(healthy, step_s),
                             along(healthy, lpvg_cause_bias, basis(2U), Real(0))};
        all[0].scale = larger(Real(1), g2);
        if (of_.rough > r_.rough[j_] * n_ * all[0].scale) {
            // Noise explains no estimate; it is another cause beside what else there is.
            const bool alone = healthy.square(change_) <= r_.fits;
            return alone ? lpvg_found_t{lpvg_cause_noise, std::sqrt(of_.rough / n_), Real(0), Real(0), 0U, false} : other();
        }
        return best(all, largest);
    }

private:
    const lpvg_diagnosis_output_t& of_;
    const lpvg_diagnosis_reals_t& r_;
    std::size_t j_;
    Real n_;
    const Healthy& healthy_;
    Factor gram_;
    Row theta_, change_;
    Real square_;  // sum of squares that theta leaves
    Real least_ = Real(0), white_ = Real(1);
    bool unchanged_ = false;

    Real yhat_square() const { return of_.gram[0] / (n_ * r_.unit[j_][0] * r_.unit[j_][0]); }

    // A change by a multiple of `direction`, from `none`, and what healthy vehicles differ by: generalised least squares.
    Hypothesis along(const Factor& C, lpvg_cause_t cause, const Row& direction, Real none) const {
        const Row weights = C.solved(direction);
        const Real information = dot(weights, direction);
        const Real more = dot(weights, change_) / information;
        const Real deviation = std::sqrt(Real(1) / information);
        const Real strange = C.square(change_ - direction * more);
        return {cause, none + more, deviation, strange, square_, Real(1), std::abs(more) > r_.interval * deviation};
    }

    Row moved(int m) const { return m == 0 ? Row(Row::Zero()) : row(of_.moved_to[kept_at(m)]); }
    Real moved_error(int m) const { return m == 0 ? Real(0) : of_.moved_error[kept_at(m)]; }

    // What a shift leaves: how strange theta is beside a healthy one, and the sum of squares. Or of two shifts, what stands for both in
    // that of a mixture of them.
    struct Remains {
        Real strange, left;
    };

    // Of the shifts by a and by b steps, neighbours or one and the same.
    Remains remains(const Factor& C, int a, int b) const {
        const int outer = (a > 0 ? a : -a) > (b > 0 ? b : -b) ? a : b;
        const Real square = outer == 0 ? Real(0) : a == b ? of_.moved_square[kept_at(outer)] : of_.moved_cross[kept_at(outer)];
        const Row first = gram_.solved(moved(a)), second = gram_.solved(moved(b));
        const Real left = of_.error_square + moved_error(a) + moved_error(b) + square - dot(row(of_.along) + moved(a), theta_ + second);
        return {dot(change_ + first, C.solved(change_ + second)), left};
    }

    // Between two that were tried, yhat is taken as linear: the misfit is a parabola there, and the delay its least over all of them.
    // Shifts find the healthy vehicle's own delay with it.
    Hypothesis delayed(const Factor& C, Real step_s) {
        constexpr int longest = static_cast<int>(delays);
        change_[1] += healthy_.mean[1];
        Remains last = remains(C, -longest, -longest);
        Hypothesis found{lpvg_cause_delay, Real(0), Real(0), last.strange, last.left, Real(1), false};
        for (int m = -longest; m < longest; ++m) {
            const Remains first = last, both = remains(C, m, m + 1);
            last = remains(C, m + 1, m + 1);
            const Real falls = sum(first) - sum(both);
            const Real curved = larger(falls - sum(both) + sum(last), Real(1e-6));
            const Real vertex = falls / curved;
            const Real f = larger(Real(0), vertex < Real(1) ? vertex : Real(1));
            const Remains here{mixed(first.strange, both.strange, last.strange, f), mixed(first.left, both.left, last.left, f)};
            if (sum(here) < sum({found.strange, found.left})) {
                found.strange = here.strange;
                found.left = here.left;
                found.value = step_s * (static_cast<Real>(m) + f);
                found.deviation = step_s / std::sqrt(curved);
            }
        }
        change_[1] -= healthy_.mean[1];
        // The misfit takes a healthy vehicle's own delay for the fault's, and knows their sum better than the fault.
        const Real unit_s = r_.unit[j_][1] * r_.block_s;
        found.deviation = larger(found.deviation, std::sqrt(Real(1) / C.solved(basis(1U))[1]) * unit_s);
        // As long as any that was tried, or longer, is no estimate.
        const bool inside = std::abs(found.value) < Real(0.999) * step_s * static_cast<Real>(longest);
        found.value -= healthy_.mean[1] * unit_s;
        found.outside = inside && std::abs(found.value) > r_.interval * found.deviation;
        return found;
    }
    Real sum(const Remains& r) const { return r.strange + r.left / white_; }
    Real misfit(const Hypothesis& h) const { return larger(h.strange, Real(0)) + (larger(h.left, least_) - least_) / white_; }

    lpvg_found_t best(const Hypothesis (&all)[3], Real largest) {
        const Hypothesis* first = &all[0];
        for (const Hypothesis& h : all) {
            first = misfit(h) < misfit(*first) ? &h : first;
        }
        unchanged_ = !first->outside;
        // A cause that grows leaves a share of itself.
        const Real allowed = larger(largest * first->scale, growing * of_.error_square / n_);
        bool alone = first->outside && first->strange <= r_.fits && first->left <= allowed * n_;
        for (const Hypothesis& h : all) {
            alone = alone && (&h == first || misfit(h) >= misfit(*first) + r_.margin);
        }
        if (!alone) {
            return other();
        }
        const Real half = r_.interval * first->deviation;
        const bool turned = first->cause == lpvg_cause_gain && first->value + half < Real(0);
        return {turned ? lpvg_cause_sign : first->cause, first->value, first->value - half, first->value + half, 0U, false};
    }
};

// What sums say: how theta differs from a healthy vehicle's, and that.
struct Estimate {
    Row change, healthy;
};

// Of output j, from the sums since the alarm.
lpvg_found_t judged(const lpvg_diagnosis_t& self, std::size_t j, Estimate* estimate) {
    const lpvg_diagnosis_reals_t& r = self.table->reals;
    const lpvg_diagnosis_output_t& of = self.output[j];
    const Real n = static_cast<Real>(self.blocks);
    *estimate = {Row::Zero(), Row::Zero()};
    // What was the same before the alarm is held against healthy vehicles alone, in a second turn.
    for (bool remembers = self.past_blocks > 0U && r.kept[j] > Real(0);; remembers = false) {
        Healthy healthy{Row::Zero(), Eigen::Map<const Triangle>(r.spread[j])};
        if (remembers) {
            foretell(of.past, r, j, static_cast<Real>(self.past_blocks), healthy);
        }
        Judgement judgement(of, r, j, n, healthy);
        if (!judgement.well()) {
            return other();
        }
        *estimate = {judgement.change(), healthy.mean};
        if (of.still < r.still[j] * of.changed) {
            const Real mean = (of.along[2] + of.gram[2] / r.unit[j][0]) / n;
            return {lpvg_cause_frozen, mean, Real(0), Real(0), 0U, false};
        }
        const lpvg_found_t found = judgement.found(r.block_s, self.table->words.stride);
        if (!remembers || !judgement.unchanged()) {
            return found;
        }
    }
}

// Cell `back` before the newest, 0 is the newest.
std::size_t cell_at(const lpvg_diagnosis_t& self, uint32_t back) { return (self.cell_newest + cells - back) % cells; }

// The cells before the alarm that the change of theta explains, at most those before the first that is not whole.
void find_onset(const lpvg_diagnosis_t& self, std::size_t j, const Estimate& estimate, lpvg_found_t* found) {
    const lpvg_diagnosis_output_t& of = self.output[j];
    const Real* const unit = self.table->reals.unit[j];
    const uint32_t length = self.table->words.cell_blocks;
    Real sum = Real(0), largest = Real(0);
    uint32_t best = 0U, kept = 0U;
    while (kept < self.cells && ((self.good_cells >> cell_at(self, kept)) & 1U) != 0U) {
        const Real* const cell = of.cell[cell_at(self, kept)];
        const bool has_before = kept + 1U < self.cells && ((self.good_cells >> cell_at(self, kept + 1U)) & 1U) != 0U;
        const Real change = has_before ? (cell[1] - of.cell[cell_at(self, kept + 1U)][1]) / static_cast<Real>(length) : Real(0);
        const Row phi = regressors(cell[1], change, unit);
        const Real explained = dot(estimate.change, phi);
        sum += explained * (Real(2) * (cell[0] - dot(estimate.healthy, phi)) - explained);
        ++kept;
        if (sum > largest) {
            largest = sum;
            best = kept;
        }
    }
    found->onset_blocks = best > 0U ? self.partial + best * length : 0U;
    found->before = best > 0U && best == kept;
}

// Of what since an alarm is summed, or of a part of the past, nothing yet.
void clear_sums(lpvg_diagnosis_output_t& of) {
    Eigen::Map<Triangle>(of.gram).setZero();
    Eigen::Map<Row>(of.along).setZero();
    for (std::size_t m = 0; m < shifts; ++m) {
        Eigen::Map<Row>(of.moved_to[m]).setZero();
        of.moved_error[m] = of.moved_square[m] = of.moved_cross[m] = Real(0);
    }
    of.error_square = of.rough = of.changed = of.still = Real(0);
}

bool diagnosing(const lpvg_diagnosis_t& self) { return self.alarms > 0U && self.blocks != done; }

// How many blocks delays, and leads, reach from the one that is added.
uint32_t reach(const lpvg_diagnosis_t& self) { return static_cast<uint32_t>(delays) * self.table->words.stride; }

// What is `back` blocks before the one that work takes, and the one before it, are settled. Delays and leads ask no more of theirs
// than a yhat: at the edge of settled driving it is the model's.
bool settled_at(const lpvg_diagnosis_t& self, uint32_t back) {
    static_assert(LPVG_DIAGNOSIS_HISTORY / 2 + 1 < 32, "a bit for each block back to the one before that is added");
    return ((self.settled_blocks >> back) & 3U) == 3U;
}

// Whether the block that work takes is one of the past: before an alarm it is, where it and the one before it are settled.
bool is_past(const lpvg_diagnosis_t& self) { return !diagnosing(self) && self.known > 1U && settled_at(self, 0U); }

// Half of the blocks from which causes are judged.
uint32_t half(const lpvg_diagnosis_t& self) { return self.table->words.blocks / 2U; }

// Whether with it as many blocks are filled. They join the past then, and not before: the newest ones before an alarm may be those of its
// cause.
bool fills(const lpvg_diagnosis_t& self) { return self.filling_blocks + 1U >= half(self); }

// Whether the past is long. It is halved then, so that sums stay finite and the newest minutes count most.
bool is_long(const lpvg_diagnosis_t& self) { return self.past_blocks >= most_halves * half(self); }

// Where the newest block goes in both histories.
uint32_t next(const lpvg_diagnosis_t& self) { return (self.newest + 1U) % (yhats * errors); }

// Adds a block to the normal equations.
void accumulate(const Row& phi, Real e, lpvg_diagnosis_output_t& of) {
    std::size_t at = 0U;
    for (Eigen::Index i = 0; i < phi.size(); ++i) {
        for (Eigen::Index k = i; k < phi.size(); ++k) {
            of.gram[at] += phi[i] * phi[k];
            ++at;
        }
    }
    Eigen::Map<Row>(of.along) += phi * e;
    of.error_square += e * e;
}

// Output j adds to its sums the block that is as far back as leads reach.
void add(lpvg_diagnosis_t& self, std::size_t j) {
    lpvg_diagnosis_output_t& of = self.output[j];
    const Real* const unit = self.table->reals.unit[j];
    const uint32_t far = reach(self), stride = self.table->words.stride;
    const auto yhat_back = [&](uint32_t blocks) { return of.history[(next(self) + yhats - blocks) % yhats]; };
    const auto error_back = [&](uint32_t blocks) { return of.errors[(next(self) + errors - blocks) % errors]; };
    const Real e = error_back(far), yhat = yhat_back(far);
    const Real change = yhat - yhat_back(far + 1U);
    if (self.blocks == 0U) {
        clear_sums(of);
    }
    const Row phi = regressors(yhat, change, unit);
    accumulate(phi, e, of);
    of.rough += self.settled ? self.rough[j] * self.rough[j] : Real(0);
    of.changed += change * change;
    const Real whole = change + e - error_back(far + 1U);
    of.still += whole * whole;
    Real nearer = Real(0);
    for (std::size_t m = 0; m < shifts; ++m) {
        const bool later = m < delays;
        const uint32_t steps = stride * static_cast<uint32_t>(later ? m + 1U : m - delays + 1U);
        const Real moved = yhat - yhat_back(later ? far + steps : far - steps);
        Eigen::Map<Row>(of.moved_to[m]) += phi * moved;
        of.moved_error[m] += moved * e;
        of.moved_square[m] += moved * moved;
        of.moved_cross[m] += m == delays ? Real(0) : moved * nearer;
        nearer = moved;
    }
    const Real n = static_cast<Real>(self.blocks + 1U);
    self.excited = (self.excited && j > 0U) || of.gram[0] >= self.table->reals.excited * n;
}

// Output j has the newest block, which is one of the past.
void remember(lpvg_diagnosis_t& self, std::size_t j) {
    lpvg_diagnosis_output_t& of = self.output[j];
    const Real yhat = self.mean[ny + j];
    if (self.filling_blocks == 0U) {
        clear_sums(of);
    }
    accumulate(regressors(yhat, yhat - of.history[self.newest % yhats], self.table->reals.unit[j]), self.mean[j], of);
    if (fills(self)) {
        const Real share = is_long(self) ? Real(0.5) : Real(1);
        for (std::size_t i = 0; i < LPVG_DIAGNOSIS_TRIANGLE; ++i) {
            of.past.gram[i] = (of.past.gram[i] + of.gram[i]) * share;
        }
        for (std::size_t i = 0; i < parts; ++i) {
            of.past.along[i] = (of.past.along[i] + of.along[i]) * share;
        }
        of.past.error_square = (of.past.error_square + of.error_square) * share;
    }
}

// All outputs have it.
void advance_past(lpvg_diagnosis_t& self) {
    ++self.filling_blocks;
    if (self.filling_blocks >= half(self)) {
        self.past_blocks = (self.past_blocks + self.filling_blocks) / (is_long(self) ? 2U : 1U);
        self.filling_blocks = 0U;
    }
}

// Output j keeps the newest block: in its history, and before an alarm in its cell.
void keep(lpvg_diagnosis_t& self, std::size_t j) {
    lpvg_diagnosis_output_t& of = self.output[j];
    const Real e = self.mean[j], yhat = self.mean[ny + j];
    if (is_past(self)) {
        remember(self, j);
    }
    of.errors[next(self) % errors] = e;
    of.history[next(self) % yhats] = yhat;
    if (!diagnosing(self)) {
        of.cell_sum[0] += self.settled ? e : Real(0);
        of.cell_sum[1] += self.settled ? yhat : Real(0);
        if (self.cell_blocks + 1U >= self.table->words.cell_blocks) {
            Real* const cell = of.cell[(self.cell_newest + 1U) % cells];
            const Real share = Real(1) / static_cast<Real>(self.table->words.cell_blocks);
            cell[0] = of.cell_sum[0] * share;
            cell[1] = of.cell_sum[1] * share;
            of.cell_sum[0] = of.cell_sum[1] = Real(0);
        }
    }
}

// All outputs have taken the newest block.
void advance_cells(lpvg_diagnosis_t& self) {
    self.cell_good += self.settled ? 1U : 0U;
    ++self.cell_blocks;
    if (self.cell_blocks >= self.table->words.cell_blocks) {
        self.cell_newest = (self.cell_newest + 1U) % static_cast<uint32_t>(cells);
        const uint32_t bit = 1U << self.cell_newest;
        self.good_cells = self.cell_good == self.cell_blocks ? (self.good_cells | bit) : (self.good_cells & ~bit);
        self.cells += self.cells < cells ? 1U : 0U;
        self.cell_blocks = self.cell_good = 0U;
    }
}

void all_taken(lpvg_diagnosis_t& self, bool added) {
    if (!diagnosing(self)) {
        advance_cells(self);
    }
    if (is_past(self)) {
        advance_past(self);
    }
    self.newest = next(self);
    self.blocks += added ? 1U : 0U;
    const uint32_t whole = self.table->words.blocks;
    if (added && self.excited && (self.blocks >= whole || self.blocks == half(self))) {
        self.judging = true;
        self.pending = ny;
    }
}

// What was kept is of no use any more; the next blocks are kept anew.
void forget(lpvg_diagnosis_t& self) {
    self.cells = self.cell_blocks = self.cell_good = self.good_cells = 0U;
    self.past_blocks = self.filling_blocks = 0U;
    for (lpvg_diagnosis_output_t& of : self.output) {
        of.cell_sum[0] = of.cell_sum[1] = Real(0);
        of.past = lpvg_past_t{};
    }
    for (std::size_t j = 0; j < ny; ++j) {
        self.sum[j] = lpvguard::sum_of_words(self.output[j]);
    }
}

void end_with(lpvg_diagnosis_t& self) {
    self.blocks = done;
    self.pending = 0U;
    forget(self);
}

// Output j. From half of the record a cause is kept only where it has a name.
void judge(lpvg_diagnosis_t& self, std::size_t j) {
    const bool whole = self.blocks >= self.table->words.blocks;
    Estimate estimate;
    lpvg_found_t found = judged(self, j, &estimate);
    find_onset(self, j, estimate, &found);
    if (whole || found.cause != lpvg_cause_other) {
        self.found[j] = found;
    }
    --self.pending;
    if (self.pending == 0U) {
        self.judging = false;
        self.t_found_us = self.t_us;
        if (whole) {
            end_with(self);
        }
    }
}

// The state cannot be: nothing in it is known any more.
void give_up(lpvg_diagnosis_t& self) {
    for (std::size_t j = 0; j < ny; ++j) {
        self.output[j] = lpvg_diagnosis_output_t{};
        self.found[j] = diagnosing(self) ? other() : self.found[j];
    }
    self.known = self.newest = 0U;
    self.t_found_us = self.t_us;
    self.judging = false;
    end_with(self);
}

void begin(lpvg_diagnosis_t& self) {
    for (lpvg_found_t& found : self.found) {
        found = lpvg_found_t{};
    }
    ++self.alarms;
    self.blocks = 0U;
    self.excited = false;
    self.t_alarm_us = self.t_us;
    self.partial = self.cell_blocks;
    self.filling_blocks = 0U;
    // No block from before the alarm is added.
    self.known = self.known < reach(self) ? self.known : reach(self);
}

// The means of a block, and what is neither its mean nor its slope.
void take_block(lpvg_diagnosis_t& self, const lpvg_monitor_t& monitor) {
    bool settled = true;
    for (const lpvg_taken_t& taken : monitor.block) {
        settled = settled && taken.span.reason == lpvg_reason_none;
    }
    static_assert(LPVG_NBLOCK == 4, "two halves of two samples");
    const auto& s = monitor.signal;
    bool whole = monitor.n_block == n_block;
    for (std::size_t i = 0; i < 2U * ny; ++i) {
        self.mean[i] = Real(0.25) * (s[0][i] + s[1][i] + s[2][i] + s[3][i]);
        whole = whole && std::isfinite(self.mean[i]);
    }
    for (std::size_t j = 0; j < ny; ++j) {
        const std::size_t k = ny + j;
        self.rough[j] = Real(0.5) * (s[0][j] + s[0][k] - s[1][j] - s[1][k] - s[2][j] - s[2][k] + s[3][j] + s[3][k]);
    }
    self.settled = settled && whole;
    self.settled_blocks = (self.settled_blocks << 1U) | (self.settled ? 1U : 0U);
    self.known = whole ? (self.known < LPVG_DIAGNOSIS_HISTORY ? self.known + 1U : self.known) : 0U;
    self.pending = ny;
}

}  // namespace

extern "C" uint32_t lpvg_diagnosis_table_crc32(const lpvg_diagnosis_table_t* table) {
    return table == nullptr ? 0U : lpvguard::coefficients_crc32(*table);
}

extern "C" lpvg_status_t lpvg_diagnosis_table_check(const lpvg_diagnosis_table_t* table) {
    if (table == nullptr) {
        return lpvg_status_bad_argument;
    }
    const lpvg_diagnosis_words_t& w = table->words;
    if (w.magic != LPVG_DIAGNOSIS_MAGIC) {
        return lpvg_status_bad_magic;
    }
    if (w.schema != LPVG_DIAGNOSIS_SCHEMA) {
        return lpvg_status_bad_schema;
    }
    if (w.real_bytes != sizeof(Real) || !lpvguard::sizes_match(w)) {
        return lpvg_status_bad_size;
    }
    if (w.crc32 != lpvg_diagnosis_table_crc32(table)) {
        return lpvg_status_bad_crc;
    }
    if (!lpvguard::all_finite(table->reals)) {
        return lpvg_status_not_finite;
    }
    bool good = lpvguard::items_in_range(w) && lpvguard::items_in_range(table->reals);
    for (const auto& spread : table->reals.spread) {
        good = good && Factor(Eigen::Map<const Triangle>(spread)).well();
    }
    return good ? lpvg_status_ok : lpvg_status_bad_value;
}

extern "C" lpvg_status_t lpvg_diagnosis_init(lpvg_diagnosis_t* self, const lpvg_diagnosis_table_t* table) {
    const lpvg_status_t status = lpvg_diagnosis_table_check(table);
    if (self == nullptr || status != lpvg_status_ok) {
        return self == nullptr ? lpvg_status_bad_argument : status;
    }
    *self = lpvg_diagnosis_t{};
    self->table = table;
    return lpvg_status_ok;
}

extern "C" lpvg_status_t lpvg_diagnosis_take(lpvg_diagnosis_t* self, const lpvg_monitor_t* monitor) {
    if (self == nullptr || monitor == nullptr) {
        return lpvg_status_bad_argument;
    }
    if (self->table == nullptr || monitor->coeff == nullptr) {
        return lpvg_status_not_ready;
    }
    if (monitor->newest != n_block - 1U || monitor->refused || monitor->t_us == self->t_us) {
        return lpvg_status_ok;
    }
    const bool late = self->pending > 0U;
    const int64_t block_us = static_cast<int64_t>(n_block) * self->table->words.sample_period_us;
    // A block that is missing, or that has not been worked on, breaks what was kept.
    const bool gap = self->t_us != 0 && (monitor->t_us - self->t_us) * 2 > 3 * block_us;
    self->t_us = monitor->t_us;
    const lpvg_verdict_t verdict = lpvg_monitor_verdict(monitor, monitor->t_us);
    const bool alarming = verdict == lpvg_verdict_invalid || verdict == lpvg_verdict_degraded;
    const bool begins = alarming && !self->alarming && !diagnosing(*self);
    self->alarming = alarming;
    if (late || gap) {
        self->known = 0U;
        self->cell_good = 0U;
        self->good_cells = diagnosing(*self) ? self->good_cells : 0U;
    }
    if (begins) {
        begin(*self);
    }
    if (self->pending == 0U) {
        take_block(*self, *monitor);
    }
    return lpvg_status_ok;
}

extern "C" const lpvg_found_t* lpvg_diagnosis_named(const lpvg_diagnosis_t* self) {
    if (self == nullptr) {
        return nullptr;
    }
    for (const lpvg_found_t& found : self->found) {
        if (found.cause != lpvg_cause_unknown && found.cause != lpvg_cause_other) {
            return &found;
        }
    }
    return self->blocks == done ? &self->found[0] : nullptr;
}

extern "C" bool lpvg_diagnosis_work(lpvg_diagnosis_t* self) {
    if (self == nullptr || self->table == nullptr || self->pending == 0U) {
        return false;
    }
    const std::size_t j = ny - (self->pending <= ny ? self->pending : ny);
    if (self->sum[j] != lpvguard::sum_of_words(self->output[j]) || self->newest >= yhats * errors) {
        give_up(*self);
        return false;
    }
    if (self->judging) {
        judge(*self, j);
        return self->pending > 0U;
    }
    const bool added = diagnosing(*self) && self->known > 2U * reach(*self) && settled_at(*self, reach(*self));
    keep(*self, j);
    if (added) {
        add(*self, j);
    }
    self->sum[j] = lpvguard::sum_of_words(self->output[j]);
    --self->pending;
    if (self->pending == 0U) {
        all_taken(*self, added);
    }
    return self->pending > 0U;
}
