// dense_controller.hpp -- the control law of controller.h with full matrices at every node, to measure the saving of its realisation.
//
// Node speeds, interpolation, limits, anti-windup and carry are the same. A - I, B, C and L are full and interpolated. Each row
// is summed at the lower and at the upper node. The vehicle's coefficients fill the matrices, so that both laws give the same demand.
#ifndef LPVGUARD_PORTS_DENSE_CONTROLLER_HPP
#define LPVGUARD_PORTS_DENSE_CONTROLLER_HPP

#include <cstddef>
#include <cstring>

#include "lpvguard/controller.h"

class DenseController {
public:
    static constexpr std::size_t n = LPVG_NU * LPVG_NK, nm = LPVG_NM, nu = LPVG_NU, ng = LPVG_NG;
    lpvg_real_t u[nu];

    explicit DenseController(const lpvg_control_coeff_t& coeff) : u{}, coeff_(coeff), A1_{}, B_{}, C_{}, L_{}, x_{}, carry_{} {
        for (std::size_t g = 0; g < ng; ++g) {
            for (std::size_t row = 0; row < n; ++row) {
                const std::size_t i = row / LPVG_NK, j = row % LPVG_NK, head = row - j % 2U;
                A1_[g][row][head] = coeff.reals.A1[j];
                if (row == head && j + 1U < LPVG_NK) {
                    A1_[g][row][row + 1U] = 1.0F;
                }
                C_[g][i][row] = row == head ? 1.0F : 0.0F;
                std::memcpy(B_[g][row], coeff.reals.BL[g][i][j], sizeof B_[g][row]);
                std::memcpy(L_[g][row], coeff.reals.BL[g][i][j] + nm, sizeof L_[g][row]);
            }
        }
    }

    void step(lpvg_real_t speed, const lpvg_real_t* m) {
        const lpvg_control_reals_t& r = coeff_.reals;
        const lpvg_real_t inside = speed < r.speed_min ? r.speed_min : (speed > r.speed_max ? r.speed_max : speed);
        const lpvg_real_t position = (inside - r.speed_min) / (r.speed_max - r.speed_min) * lpvg_real_t(ng - 1U);
        auto node = static_cast<std::size_t>(position);
        node = node < ng - 1U ? node : ng - 2U;
        const lpvg_real_t weight = position - static_cast<lpvg_real_t>(node);
        const lpvg_real_t period = static_cast<lpvg_real_t>(coeff_.words.sample_period_us) * 1e-6F;
        lpvg_real_t excess[nu];
        for (std::size_t i = 0; i < nu; ++i) {
            Sum sum;
            sum.add(C_[node][i], C_[node + 1U][i], x_, n);
            const lpvg_real_t v = sum.at(weight), rate = r.rate_max[i] * period;
            const lpvg_real_t top = r.u_max[node][i] + weight * (r.u_max[node + 1U][i] - r.u_max[node][i]);
            const lpvg_real_t target = v > top ? top : (v < -top ? -top : v);
            u[i] = target > u[i] + rate ? u[i] + rate : (target < u[i] - rate ? u[i] - rate : target);
            excess[i] = u[i] - v;
        }
        lpvg_real_t next[n];
        for (std::size_t row = 0; row < n; ++row) {
            Sum sum;
            sum.add(A1_[node][row], A1_[node + 1U][row], x_, n);
            sum.add(B_[node][row], B_[node + 1U][row], m, nm);
            sum.add(L_[node][row], L_[node + 1U][row], excess, nu);
            const lpvg_real_t change = sum.at(weight) + carry_[row];
            next[row] = x_[row] + change;
            carry_[row] = change - (next[row] - x_[row]);
        }
        std::memcpy(x_, next, sizeof x_);
    }

private:
    struct Sum {
        lpvg_real_t below = 0.0F, above = 0.0F;
        void add(const lpvg_real_t* row_below, const lpvg_real_t* row_above, const lpvg_real_t* values, std::size_t count) {
            for (std::size_t j = 0; j < count; ++j) {
                below += row_below[j] * values[j];
                above += row_above[j] * values[j];
            }
        }
        lpvg_real_t at(lpvg_real_t weight) const { return below + weight * (above - below); }
    };

    const lpvg_control_coeff_t& coeff_;
    lpvg_real_t A1_[ng][n][n], B_[ng][n][nm], C_[ng][nu][n], L_[ng][n][nu];
    lpvg_real_t x_[n], carry_[n];
};

#endif
