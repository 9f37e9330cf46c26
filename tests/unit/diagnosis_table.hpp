/// @file diagnosis_table.hpp -- a table for the tests of the diagnosis.
#pragma once

#include "../catch.hpp"

#include <functional>

#include "lpvguard/diagnosis.h"

namespace {

using Real = lpvg_real_t;
constexpr std::size_t ny = LPVG_NY;
constexpr uint32_t n_block = LPVG_NBLOCK;
constexpr double period_s = 0.02, block_s = n_block * period_s;
constexpr std::size_t diagonal[4] = {0, 4, 7, 9};

// Sizes of 1; a healthy vehicle's gain varies by 2 %, its delay by 4 ms, its bias by 0.01.
lpvg_diagnosis_table_t table_with(const std::function<void(lpvg_diagnosis_table_t&)>& change = [](lpvg_diagnosis_table_t&) {}) {
    lpvg_diagnosis_table_t t{};
    t.words.magic = LPVG_DIAGNOSIS_MAGIC;
    t.words.schema = LPVG_DIAGNOSIS_SCHEMA;
    t.words.real_bytes = sizeof(Real);
    t.words.sizes[0] = LPVG_NY;
    t.words.sample_period_us = 20000U;
    t.words.blocks = 125U;
    t.words.stride = 1U;
    t.words.cell_blocks = 8U;
    t.reals.block_s = static_cast<Real>(block_s);
    for (std::size_t j = 0; j < ny; ++j) {
        t.reals.unit[j][0] = Real(1);
        t.reals.unit[j][1] = Real(10);
        const double deviation[4] = {0.02, 0.05 * 0.1, 0.01, 0.01};
        for (std::size_t i = 0; i < 4U; ++i) {
            t.reals.spread[j][diagonal[i]] = static_cast<Real>(deviation[i] * deviation[i]);
        }
        t.reals.correlated[j] = Real(4);
        t.reals.residue[j][0] = Real(4e-4);
        t.reals.residue[j][1] = Real(1e-4);
        t.reals.rough[j] = Real(1e-3);
        t.reals.still[j] = Real(0.01);
    }
    t.reals.excited = Real(0.05);
    t.reals.fits = Real(11.3);
    t.reals.margin = Real(4);
    t.reals.interval = Real(1.96);
    change(t);
    t.words.crc32 = lpvg_diagnosis_table_crc32(&t);
    return t;
}

}  // namespace
