// monitor.cpp -- a vehicle's monitor as an FMU. A step takes the inputs as the sample of its beginning; its outputs are those of the core
// after that sample.
#include <cmath>
#include <cstring>

#include "results.hpp"
#include "unit.hpp"

namespace lpvguard_fmu {
namespace {

constexpr unsigned n_inputs = 1U + LPVG_NU + LPVG_NY;  // value references from 0: speed, then u, then y
constexpr unsigned vr_time = 99, vr_status = 206;

struct State {
    lpvg_monitor_t monitor;
    lpvg_diagnosis_t diagnosis;
    double input[n_inputs];
    int64_t t_us;
    uint32_t status;
};

class Monitor final : public Unit {
public:
    using Unit::Unit;

    double period_s() const override { return lpvg_coeff.words.sample_period_us * 1e-6; }

    Status start() override {
        double input[n_inputs];
        std::memcpy(input, state_.input, sizeof input);
        std::memset(static_cast<void*>(&state_), 0, sizeof state_);
        std::memcpy(state_.input, input, sizeof input);
        lpvg_status_t status = lpvg_monitor_init(&state_.monitor, &lpvg_coeff);
#ifdef LPVG_FMU_DIAGNOSIS
        if (status == lpvg_status_ok) {
            status = lpvg_diagnosis_init(&state_.diagnosis, &lpvg_diagnosis_table);
        }
#endif
        return status == lpvg_status_ok ? ok : say(error, "init refused the coefficients with status %d", static_cast<int>(status));
    }

    Status step() override {
        lpvg_sample_t sample;
        sample.t_us = std::llround(now_s * 1e6);
        const double* input = state_.input;
        sample.speed = static_cast<lpvg_real_t>(*input++);
        for (lpvg_real_t& u : sample.u) {
            u = static_cast<lpvg_real_t>(*input++);
        }
        for (lpvg_real_t& y : sample.y) {
            y = static_cast<lpvg_real_t>(*input++);
        }
        state_.t_us = sample.t_us;
        const lpvg_status_t status = lpvg_monitor_push(&state_.monitor, &sample);
        state_.status = static_cast<uint32_t>(status);
#ifdef LPVG_FMU_DIAGNOSIS
        if (lpvg_diagnosis_take(&state_.diagnosis, &state_.monitor) == lpvg_status_ok) {
            while (lpvg_diagnosis_work(&state_.diagnosis)) {
            }
        }
#endif
        lpvg_frame_t record;
        while (lpvg_monitor_take_record(&state_.monitor, &record)) {
        }
        return status == lpvg_status_ok ? ok
                                        : say(warning, "the sample at %.6f s is refused with status %d", now_s, static_cast<int>(status));
    }

    using Unit::get;
    using Unit::set;
    Status set(unsigned reference, double value) override { return set_input(state_.input, reference, value); }
    Status get(unsigned reference, double& value) const override {
        if (reference < n_inputs) {
            value = state_.input[reference];
        } else if (reference == vr_time) {
            value = static_cast<double>(state_.t_us) * 1e-6;
        } else if (!get_result(state_.monitor, state_.diagnosis, reference, value)) {
            return none(reference, "number");
        }
        return ok;
    }
    Status get(unsigned reference, int64_t& value) const override {
        if (reference == vr_status) {
            value = state_.status;
        } else if (!get_result(state_.monitor, state_.diagnosis, state_.t_us, reference, value)) {
            return none(reference, "integer");
        }
        return ok;
    }

    std::unique_ptr<Unit> copy() const override { return std::make_unique<Monitor>(*this); }
    using Unit::go_on_from;
    void go_on_from(const Unit& kept) override { state_ = static_cast<const Monitor&>(kept).state_; }
    std::vector<unsigned char> bytes() const override {
        State state = state_;
        set_addresses(state, nullptr, nullptr);
        return bytes_of(state);
    }
    Status go_on_from(const unsigned char* bytes, std::size_t size) override {
        if (const char* why = state_of(bytes, size, state_)) {
            return say(error, "%s", why);
        }
        set_addresses(state_, &lpvg_coeff, diagnosis_table());
        return ok;
    }

private:
    static const lpvg_diagnosis_table_t* diagnosis_table() {
#ifdef LPVG_FMU_DIAGNOSIS
        return &lpvg_diagnosis_table;
#else
        return nullptr;
#endif
    }
    static void set_addresses(State& state, const lpvg_coeff_t* coeff, const lpvg_diagnosis_table_t* table) {
        state.monitor.coeff = coeff;
        state.diagnosis.table = table;
    }

    State state_{};
};

}  // namespace

std::unique_ptr<Unit> make_unit(const Log& log) { return started<Monitor>(log); }

}  // namespace lpvguard_fmu
