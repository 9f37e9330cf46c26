/// @file random.hpp -- random numbers whose bytes are the same with every compiler and C library.
///
/// Generator: xoshiro256++ seeded by splitmix64 (Blackman and Vigna, "Scrambled linear pseudorandom number generators", 2019;
/// both published by their authors as public domain). Gaussian: inversion by Wichura's AS 241, routine PPND7 (Applied
/// Statistics 37, 1988; absolute error below 2e-7). std::normal_distribution and libm's log are not specified to the
/// bit, so neither is used. The bits of sqrt, frexp and the four operations are specified.
#pragma once

#include <array>
#include <cstdint>

namespace lpvguard_plant {

class Random {
public:
    /// Different streams of one seed are independent. A change in the use of one stream does not affect the others.
    Random(std::uint64_t seed, std::uint64_t stream);

    std::uint64_t bits();
    double uniform();                        ///< In (0, 1), never an end point.
    double uniform(double low, double high);
    double normal();                         ///< Mean 0, standard deviation 1.

private:
    std::array<std::uint64_t, 4> state_;
};

}  // namespace lpvguard_plant
