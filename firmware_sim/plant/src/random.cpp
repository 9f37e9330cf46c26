#include "lpvguard_plant/random.hpp"

#include <cmath>

namespace lpvguard_plant {
namespace {

std::uint64_t rotate_left(std::uint64_t x, int count) { return (x << count) | (x >> (64 - count)); }

std::uint64_t splitmix64(std::uint64_t& state) {
    state += 0x9E3779B97F4A7C15U;
    std::uint64_t z = state;
    z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9U;
    z = (z ^ (z >> 27)) * 0x94D049BB133111EBU;
    return z ^ (z >> 31);
}

/// Natural logarithm to 1e-10: x = 2^e m with m in [sqrt(1/2), sqrt(2)), log m = 2 artanh((m - 1) / (m + 1)).
double logarithm(double x) {
    constexpr double log_2 = 0.693147180559945309;
    constexpr double sqrt_half = 0.707106781186547524;
    int exponent = 0;
    double mantissa = std::frexp(x, &exponent);
    if (mantissa < sqrt_half) {
        mantissa *= 2.0;
        --exponent;
    }
    const double s = (mantissa - 1.0) / (mantissa + 1.0);
    const double s2 = s * s;
    const double series = 1.0 + s2 * (1.0 / 3 + s2 * (1.0 / 5 + s2 * (1.0 / 7 + s2 * (1.0 / 9 + s2 * (1.0 / 11 + s2 / 13)))));
    return static_cast<double>(exponent) * log_2 + 2.0 * s * series;
}

/// AS 241, PPND7: returns the x with the cumulative normal probability p.
double normal_quantile(double p) {
    const double q = p - 0.5;
    if (std::fabs(q) <= 0.425) {
        const double r = 0.180625 - q * q;
        return q * (((59.109374720 * r + 159.29113202) * r + 50.434271938) * r + 3.3871327179) /
               (((67.187563600 * r + 78.757757664) * r + 17.895169469) * r + 1.0);
    }
    double r = std::sqrt(-logarithm(q < 0.0 ? p : 1.0 - p));
    double value = 0.0;
    if (r <= 5.0) {
        r -= 1.6;
        value =
            (((0.17023821103 * r + 1.3067284816) * r + 2.7568153900) * r + 1.4234372777) / ((0.12021132975 * r + 0.73700164250) * r + 1.0);
    } else {
        r -= 5.0;
        value = (((0.017337203997 * r + 0.42868294337) * r + 3.0812263860) * r + 6.6579051150) /
                ((0.012258202635 * r + 0.24197894225) * r + 1.0);
    }
    return q < 0.0 ? -value : value;
}

}  // namespace

Random::Random(std::uint64_t seed, std::uint64_t stream) : state_{} {
    std::uint64_t mixer = seed;
    mixer = splitmix64(mixer) ^ stream;
    for (std::uint64_t& word : state_) {
        word = splitmix64(mixer);
    }
}

std::uint64_t Random::bits() {
    const std::uint64_t result = rotate_left(state_[0] + state_[3], 23) + state_[0];
    const std::uint64_t shifted = state_[1] << 17;
    state_[2] ^= state_[0];
    state_[3] ^= state_[1];
    state_[1] ^= state_[2];
    state_[0] ^= state_[3];
    state_[2] ^= shifted;
    state_[3] = rotate_left(state_[3], 45);
    return result;
}

double Random::uniform() {
    // Uses the 52 high bits; each value is the centre of its cell.
    return (static_cast<double>(bits() >> 12) + 0.5) * 0x1.0p-52;
}

double Random::uniform(double low, double high) { return low + (high - low) * uniform(); }

double Random::normal() { return normal_quantile(uniform()); }

}  // namespace lpvguard_plant
