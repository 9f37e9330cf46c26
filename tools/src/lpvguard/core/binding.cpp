// binding.cpp -- flat functions around one vehicle's compiled core, for lpvguard.core.compiled (ctypes). Not part of the ECU image.
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <new>

#include "lpvguard/diagnosis.h"
#include "lpvguard/isolation.h"

namespace {

struct Handle {
    lpvg_coeff_t coeff;
    lpvg_monitor_t monitor;
    lpvg_diagnosis_t diagnosis;
    lpvg_isolation_t isolation;
};

constexpr std::size_t n_words = sizeof(lpvg_coeff_words_t) / sizeof(uint32_t);
constexpr std::size_t n_reals = sizeof(lpvg_coeff_reals_t) / sizeof(lpvg_real_t);
constexpr std::size_t frame_columns = 12U + 4U * LPVG_NY;
constexpr int64_t cause_columns = 10, part_columns = 10;

// t_us: time of the sample with which the core said so; a frame waits for its turn after its end.
void write_frame(const lpvg_frame_t& f, int64_t t_us, double* row) {
    const double head[10] = {static_cast<double>(t_us),     static_cast<double>(f.bin),       static_cast<double>(f.t_end_us),
                             static_cast<double>(f.reason), f.falsified ? 1.0 : 0.0,          static_cast<double>(f.speed),
                             static_cast<double>(f.margin), static_cast<double>(f.statistic), static_cast<double>(f.evidence),
                             static_cast<double>(f.test)};
    std::memcpy(row, head, sizeof head);
    for (std::size_t j = 0; j < LPVG_NY; ++j) {
        for (std::size_t part = 0; part < 2U; ++part) {
            row[10U + 2U * j + part] = static_cast<double>(f.E[j][part]);
            row[10U + 2U * LPVG_NY + 2U * j + part] = static_cast<double>(f.Z[j][part]);
        }
    }
    row[10U + 4U * LPVG_NY] = static_cast<double>(f.pooled);
    row[11U + 4U * LPVG_NY] = f.refuted ? 1.0 : 0.0;
}

// An output's cause, as the newest diagnosis found it.
void write_cause(const lpvg_diagnosis_t& d, std::size_t j, double* row) {
    const lpvg_found_t& f = d.found[j];
    const double numbers[cause_columns] = {static_cast<double>(d.t_found_us),
                                           static_cast<double>(d.t_alarm_us),
                                           static_cast<double>(j),
                                           static_cast<double>(f.cause),
                                           static_cast<double>(f.value),
                                           static_cast<double>(f.low),
                                           static_cast<double>(f.high),
                                           static_cast<double>(f.onset_blocks),
                                           f.before ? 1.0 : 0.0,
                                           d.blocks == LPVG_DIAGNOSIS_DONE ? 1.0 : 0.0};
    std::memcpy(row, numbers, sizeof numbers);
}

// The finding of the newest judged window.
void write_parts(const lpvg_parts_t& f, double* row) {
    const double numbers[part_columns] = {static_cast<double>(f.from_us), static_cast<double>(f.until_us), f.alarmed ? 1.0 : 0.0,
                                          f.differs ? 1.0 : 0.0,          static_cast<double>(f.parts),    static_cast<double>(f.likeliest),
                                          static_cast<double>(f.size),    static_cast<double>(f.value),    static_cast<double>(f.low),
                                          static_cast<double>(f.high)};
    std::memcpy(row, numbers, sizeof numbers);
}

}  // namespace

extern "C" {

// Whether the vehicle's folder has a table of the diagnosis.
int lpvgb_diagnoses() {
#ifdef LPVGB_DIAGNOSIS
    return 1;
#else
    return 0;
#endif
}

void lpvgb_sizes(uint32_t* sizes) {
    const uint32_t values[7] = {LPVG_NU,
                                LPVG_NY,
                                LPVG_NBINS,
                                static_cast<uint32_t>(n_words),
                                static_cast<uint32_t>(n_reals),
                                static_cast<uint32_t>(frame_columns),
                                static_cast<uint32_t>(sizeof(lpvg_monitor_t))};
    std::memcpy(sizes, values, sizeof values);
}

void lpvgb_compiled_coeff(uint32_t* words, double* reals) {
    std::memcpy(words, &lpvg_coeff.words, sizeof lpvg_coeff.words);
    lpvg_real_t flat[n_reals];
    std::memcpy(flat, &lpvg_coeff.reals, sizeof flat);
    for (std::size_t i = 0; i < n_reals; ++i) {
        reals[i] = static_cast<double>(flat[i]);
    }
}

// NULL words: the compiled-in coefficients as they are; else the given ones, with their CRC computed when `seal`.
void* lpvgb_create(const uint32_t* words, const double* reals, int seal, int* status) {
    Handle* handle = new (std::nothrow) Handle{};
    if (handle == nullptr) {
        *status = -1;
        return nullptr;
    }
    handle->coeff = lpvg_coeff;
    if (words != nullptr) {
        std::memcpy(&handle->coeff.words, words, sizeof handle->coeff.words);
        lpvg_real_t flat[n_reals];
        for (std::size_t i = 0; i < n_reals; ++i) {
            flat[i] = static_cast<lpvg_real_t>(reals[i]);
        }
        std::memcpy(&handle->coeff.reals, flat, sizeof flat);
        if (seal != 0) {
            handle->coeff.words.crc32 = lpvg_coeff_crc32(&handle->coeff);
        }
    }
    *status = static_cast<int>(lpvg_monitor_init(&handle->monitor, &handle->coeff));
#ifdef LPVGB_DIAGNOSIS
    if (*status == 0) {
        *status = static_cast<int>(lpvg_diagnosis_init(&handle->diagnosis, &lpvg_diagnosis_table));
    }
#endif
#ifdef LPVGB_ISOLATION
    if (*status == 0) {
        *status = static_cast<int>(lpvg_isolation_init(&handle->isolation, &lpvg_isolation_table));
    }
#endif
    if (*status != 0) {
        delete handle;
        return nullptr;
    }
    return handle;
}

void lpvgb_destroy(void* handle) { delete static_cast<Handle*>(handle); }

// Pushes n samples (those with present[k] != 0; NULL: all); per sample a verdict, a status, the energy test's ratio (0: not judged) with
// its strongest band, and the change test's ratio (0: none yet), per judged frame and per alarm of these tests a row of frame_columns
// numbers. Returns the rows. Takes the monitor's records out. An output's cause, from half a record or from all, is a row in `causes`, of
// *n_causes at most, which becomes their number. A judged window of the isolation is a row in `windows`, likewise.
int64_t lpvgb_run(void* opaque, int64_t n, const int64_t* t_us, const double* v, const double* u, const double* y, const uint8_t* present,
                  double* rows, int64_t max_rows, uint8_t* verdict, uint8_t* status, double* energy, uint8_t* band, double* change,
                  double* causes, int64_t* n_causes, double* windows, int64_t* n_windows) {
    lpvg_isolation_t* isolation = &static_cast<Handle*>(opaque)->isolation;
    const int64_t max_windows = *n_windows;
    *n_windows = 0;
    lpvg_diagnosis_t* diagnosis = &static_cast<Handle*>(opaque)->diagnosis;
    const int64_t max_causes = *n_causes;
    *n_causes = 0;
    lpvg_monitor_t* monitor = &static_cast<Handle*>(opaque)->monitor;
    int64_t count = 0;
    uint32_t last = lpvg_monitor_frame(monitor)->sequence;
    for (int64_t k = 0; k < n; ++k) {
        lpvg_sample_t sample;
        sample.t_us = t_us[k];
        sample.speed = static_cast<lpvg_real_t>(v[k]);
        for (int64_t i = 0; i < LPVG_NU; ++i) {
            sample.u[i] = static_cast<lpvg_real_t>(u[k * LPVG_NU + i]);
        }
        for (int64_t j = 0; j < LPVG_NY; ++j) {
            sample.y[j] = static_cast<lpvg_real_t>(y[k * LPVG_NY + j]);
        }
        const bool push = present == nullptr || present[k] != 0U;
        status[k] = push ? static_cast<uint8_t>(lpvg_monitor_push(monitor, &sample)) : static_cast<uint8_t>(lpvg_status_ok);
        verdict[k] = static_cast<uint8_t>(lpvg_monitor_verdict(monitor, t_us[k]));
        const lpvg_frame_t* frame = lpvg_monitor_frame(monitor);
        if (frame->sequence != last && count < max_rows) {
            write_frame(*frame, t_us[k], rows + count * static_cast<int64_t>(frame_columns));
            ++count;
        }
        last = frame->sequence;
        change[k] = push && status[k] == 0U ? static_cast<double>(monitor->change.ratio) : 0.0;
        energy[k] = push && status[k] == 0U ? static_cast<double>(monitor->energy.ratio) : 0.0;
        band[k] = static_cast<uint8_t>(monitor->energy.strongest);
        if (push && lpvg_diagnosis_take(diagnosis, monitor) == lpvg_status_ok) {
            bool judged = false;
            while (lpvg_diagnosis_work(diagnosis)) {
                judged = judged || diagnosis->judging;
            }
            for (std::size_t j = 0; judged && j < LPVG_NY && *n_causes < max_causes; ++j) {
                if (diagnosis->found[j].cause != lpvg_cause_unknown) {
                    write_cause(*diagnosis, j, causes + cause_columns * *n_causes);
                    ++*n_causes;
                }
            }
        }
        if (push && lpvg_isolation_take(isolation, monitor, &sample) == lpvg_status_ok) {
            const uint32_t before = isolation->windows;
            while (lpvg_isolation_work(isolation, monitor)) {
            }
            if (isolation->windows != before && *n_windows < max_windows) {
                write_parts(isolation->newest, windows + part_columns * *n_windows);
                ++*n_windows;
            }
        }
        lpvg_frame_t record;
        while (lpvg_monitor_take_record(monitor, &record)) {
            if (record.test != lpvg_test_frame && count < max_rows) {
                write_frame(record, t_us[k], rows + count * static_cast<int64_t>(frame_columns));
                ++count;
            }
        }
    }
    return count;
}

}  // extern "C"
