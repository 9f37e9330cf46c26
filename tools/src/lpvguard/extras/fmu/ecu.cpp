// ecu.cpp -- a vehicle's ECU as an FMU: firmware.c on the CAN terminal of FMI-LS-BUS. Without event mode it makes the frames of the plain
// inputs itself.
#include <cstring>

#include "firmware.h"
#include "lpvg_can_codec.h"
#include "lpvg_fmu_signals.hpp"  // n_inputs, n_counters and each_message, by signals.py
#include "ls_bus.hpp"
#include "results.hpp"
#include "test_key.hpp"

namespace lpvguard_fmu {
namespace {

constexpr unsigned vr_time = 99, vr_demand = 111, vr_verdict = 200, vr_supervision = 206, vr_authentication = 300;
constexpr uint32_t bits_ps = FIRMWARE_OWN_BUS ? 500000 : 250000;  // J1939's, or that of most cars

struct State {
    firmware_t firmware;
    Terminal terminal;
    double input[n_inputs];
    int64_t t_us;
    uint16_t counters[n_counters];  // of the messages that the plain inputs make
    bool authentication;
};

class Ecu final : public BusUnit {
public:
    explicit Ecu(const Log& log) : BusUnit(log) {
        std::memset(static_cast<void*>(&state_), 0, sizeof state_);
        std::memcpy(state_.input, start_values, sizeof start_values);
    }

    double period_s() const override { return lpvg_coeff.words.sample_period_us * 1e-6; }

    Status start() override {
        state_.terminal.clear();
        state_.terminal.configure(bits_ps);
        state_.t_us = now_us();
        const bool key = state_.authentication && with_events;
        const lpvg_status_t status = firmware_init(&state_.firmware, &bus_, &firmware_config, key ? test_key() : nullptr, now_us());
        return status == lpvg_status_ok ? ok : say(error, "the firmware refused the coefficients with status %d", static_cast<int>(status));
    }

    using Unit::get;
    using Unit::set;
    Status set(unsigned reference, double value) override { return set_input(state_.input, reference, value); }
    Status set(unsigned reference, bool value) override {
        if (reference != vr_authentication) {
            return none(reference, "boolean parameter");
        }
        state_.authentication = value;
        return ok;
    }
    Status get(unsigned reference, double& value) const override {
        if (reference < n_inputs) {
            value = state_.input[reference];
        } else if (reference == vr_time) {
            value = static_cast<double>(state_.t_us) * 1e-6;
        } else if (reference >= vr_demand && reference < vr_demand + LPVG_NU) {
            value = static_cast<double>(ecu().control.u[reference - vr_demand]);
        } else if (!get_result(ecu().monitor, diagnosis(), reference, value)) {
            return none(reference, "number");
        }
        return ok;
    }
    Status get(unsigned reference, int64_t& value) const override {
        const int64_t own[] = {ecu().report.supervision, ecu().report.engagement, ecu().fault, ecu().causes, ecu().plausibility.flags};
        if (reference == vr_verdict) {
            value = ecu().report.verdict;
        } else if (reference >= vr_supervision && reference < vr_supervision + sizeof own / sizeof *own) {
            value = own[reference - vr_supervision];
        } else if (!get_result(ecu().monitor, diagnosis(), state_.t_us, reference, value)) {
            return none(reference, "integer");
        }
        return ok;
    }
    Status get(unsigned reference, bool& value) const override {
        value = state_.authentication;
        return reference == vr_authentication ? ok : none(reference, "boolean");
    }

    std::unique_ptr<Unit> copy() const override { return std::make_unique<Ecu>(*this); }
    void go_on_from(const Unit& kept) override {
        state_ = static_cast<const Ecu&>(kept).state_;
        set_addresses(state_, &bus_);
    }
    std::vector<unsigned char> bytes() const override {
        State state = state_;
        set_addresses(state, nullptr);
        return bytes_of(state);
    }
    Status go_on_from(const unsigned char* bytes, std::size_t size) override {
        if (const char* why = state_of(bytes, size, state_)) {
            return say(error, "%s", why);
        }
        set_addresses(state_, &bus_);
        return ok;
    }

private:
    Terminal& terminal() override { return state_.terminal; }

    Status communicate() override {
        const int64_t now = now_us();
        state_.t_us = now;
#if FIRMWARE_OWN_BUS
        state_.terminal.spread(lpvg_coeff.words.sample_period_us, &rest_period_us);
#endif
        const lpvg_status_t status = firmware_tick(&state_.firmware, now);
        firmware_idle(&state_.firmware);
        return status == lpvg_status_ok ? ok
                                        : say(error, "the firmware refused the step at %.6f s with status %d; its period is %.9g s", now_s,
                                              static_cast<int>(status), period_s());
    }
    Status advance() override {
        if (with_events) {
            return ok;
        }
        const int64_t now = now_us();
        state_.terminal.clear();
        each_message(state_.input, now, state_.counters,
                     [&](const lpvg_can_frame_t& frame) { static_cast<void>(state_.terminal.send(frame)); });
        // What the vehicle sends is what arrives; what the ECU answers is dropped at the next step.
        State& state = state_;
        const std::vector<unsigned char> sent(state.terminal.data(), state.terminal.data() + state.terminal.size());
        state.terminal.clear();
        static_cast<void>(state.terminal.take(sent.data(), sent.size(), now));
        return communicate();
    }

    const lpvg_ecu_t& ecu() const { return state_.firmware.ecu; }
    const lpvg_diagnosis_t& diagnosis() const {
#ifdef LPVG_FMU_DIAGNOSIS
        return state_.firmware.diagnosis;
#else
        static const lpvg_diagnosis_t none{};
        return none;
#endif
    }

    static bool send(void* self, const lpvg_can_frame_t* frame) { return static_cast<Ecu*>(self)->state_.terminal.send(*frame); }
    static bool receive(void* self, int64_t, lpvg_can_frame_t* frame) { return static_cast<Ecu*>(self)->state_.terminal.receive(*frame); }

    // Those of this process, or none where bus is null. The ECU keeps a sum and an inverted copy of two of them (ecu.h).
    static void set_addresses(State& state, const bus_t* bus) {
        const bool here = bus != nullptr;
        firmware_t& firmware = state.firmware;
        lpvg_ecu_t& ecu = firmware.ecu;
        firmware.bus = bus;
        const bool key = ecu.kept.config.authenticated;
        firmware.authentication.config.cmac = here && key ? test_key()->cmac : nullptr;
        firmware.authentication.config.context = here && key ? test_key()->context : nullptr;
        ecu.kept.coeff = ecu.monitor.coeff = here ? &lpvg_coeff : nullptr;
        ecu.kept.control = ecu.control.coeff = here ? &lpvg_control_coeff : nullptr;
        ecu.supervisor.rules = here ? lpvg_bus.rules : nullptr;
#ifdef LPVG_FMU_DIAGNOSIS
        firmware.diagnosis.table = here ? &lpvg_diagnosis_table : nullptr;
#endif
        uint32_t words[sizeof ecu.kept / sizeof(uint32_t)];
        std::memcpy(words, &ecu.kept, sizeof words);
        ecu.sum = 0U;
        for (std::size_t i = 0; i < sizeof words / sizeof *words; ++i) {
            ecu.inverted[i] = ~words[i];
            ecu.sum += words[i];
        }
    }

    State state_;
    bus_t bus_ = {this, &Ecu::send, &Ecu::receive};
};

}  // namespace

std::unique_ptr<Unit> make_unit(const Log& log) { return started<Ecu>(log); }

}  // namespace lpvguard_fmu
