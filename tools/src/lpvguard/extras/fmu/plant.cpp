// plant.cpp -- the simulated truck as an FMU, driven as a scenario says: at the CAN terminal of FMI-LS-BUS the whole vehicle with the
// command and the bus's faults; without event mode the truck alone, under the plain demand.
#include <cstring>

#include "command.hpp"
#include "ls_bus.hpp"
#include "lpvg_fmu_texts.hpp"  // truck_text and scenario_text, by package.py
#include "vehicle_node.hpp"

namespace lpvguard_fmu {
namespace {

using lpvguard_plant::Plant;

constexpr unsigned vr_time = 99, vr_sensors = 100, vr_reports = 200, vr_scenario = 300;
constexpr int64_t period_us = 10'000;
constexpr uint32_t bits_ps = 250000;

// What a scenario has made of the truck and its node. A copy is a saved state.
struct Truck {
    Truck(const lpvguard_sim::Scenario& scenario, const bus_t* bus)
        : parameters(lpvguard_plant::parse_parameters(truck_text, "truck.toml")),
          plant(lpvguard_plant::varied(parameters, scenario.plant.variation), scenario.plant.drive, scenario.seed, scenario.plant.faults),
          node(bus, parameters.steering_ratio, scenario.can_faults, scenario.seed),
          command(scenario.command, scenario.seed) {}

    lpvguard_plant::PlantParameters parameters;
    Plant plant;
    lpvguard_sim::VehicleNode node;
    lpvguard_sim::Command command;
    int64_t now_us = 0;  // from the start on
};

class PlantUnit final : public BusUnit {
public:
    explicit PlantUnit(const Log& log) : BusUnit(log) { std::memset(static_cast<void*>(&terminal_), 0, sizeof terminal_); }

    double period_s() const override { return static_cast<double>(period_us) * 1e-6; }

    Status start() override {
        terminal_.clear();
        terminal_.configure(bits_ps);
        try {
            truck_ = std::make_shared<Truck>(lpvguard_sim::parse_scenario(scenario_, "scenario"), &bus_);
        } catch (const std::exception& what) {
            return say(error, "%s", what.what());
        }
        return ok;
    }

    using Unit::get;
    using Unit::set;
    Status set(unsigned reference, double value) override { return set_input(input_, reference, value); }
    Status set(unsigned reference, const char* text) override {
        if (reference != vr_scenario) {
            return none(reference, "text parameter");
        }
        scenario_ = text;
        return ok;
    }
    Status get(unsigned reference, double& value) const override {
        const lpvguard_plant::Sensors& s = truck_->plant.sensors();
        const lpvguard_plant::Truth& t = truck_->plant.truth();
        const double outputs[] = {
            s.speed_mps,          s.yaw_rate_radps,      s.steering_wheel_rad,   s.lateral_acceleration_mps2, s.wheel_speed_mps[0],
            s.wheel_speed_mps[1], s.wheel_speed_mps[2],  s.wheel_speed_mps[3],   s.brake_pressure_left_bar,   s.brake_pressure_right_bar,
            t.speed_mps,          t.yaw_rate_radps,      t.lateral_velocity_mps, t.lateral_acceleration_mps2, t.roll_rad,
            t.road_wheel_rad,     *truck_->node.demand()};
        if (reference == vr_time) {
            value = now_s;
        } else if (reference < sizeof input_ / sizeof *input_) {
            value = input_[reference];
        } else if (reference >= vr_sensors && reference < vr_sensors + sizeof outputs / sizeof *outputs) {
            value = outputs[reference - vr_sensors];
        } else {
            return none(reference, "number");
        }
        return ok;
    }
    Status get(unsigned reference, int64_t& value) const override {
        const lpvg_bus_report_t& report = truck_->node.report();
        const int64_t reports[] = {report.verdict, report.supervision, report.engagement};
        if (reference < vr_reports || reference >= vr_reports + sizeof reports / sizeof *reports) {
            return none(reference, "integer");
        }
        value = reports[reference - vr_reports];
        return ok;
    }
    Status get(unsigned reference, const char*& text) const override {
        text = scenario_.c_str();
        return reference == vr_scenario ? ok : none(reference, "text");
    }

    std::unique_ptr<Unit> copy() const override {
        auto kept = std::make_unique<PlantUnit>(*this);
        kept->truck_ = std::make_shared<Truck>(*truck_);  // its node keeps the address of this instance's bus
        return kept;
    }
    using Unit::go_on_from;
    void go_on_from(const Unit& other) override {
        const auto& kept = static_cast<const PlantUnit&>(other);
        scenario_ = kept.scenario_;
        std::memcpy(input_, kept.input_, sizeof input_);
        terminal_ = kept.terminal_;
        truck_ = std::make_shared<Truck>(*kept.truck_);
    }

private:
    Terminal& terminal() override { return terminal_; }

    Status communicate() override {
        Truck& truck = *truck_;
        truck.node.send(truck.now_us, truck.plant.sensors(), nullptr, truck.command.next());
        return full_ ? say(error, "CAN.Tx_Data: more operations than %zu bytes hold", Terminal::bytes_max) : ok;
    }
    Status advance() override {
        Truck& truck = *truck_;
        double demand_bar = input_[0];
        if (with_events) {
            truck.node.receive(truck.now_us);
            demand_bar = *truck.node.demand();
        }
        for (int i = 0; i < Plant::steps_per_sample; ++i) {
            truck.plant.step(demand_bar, input_[1]);
        }
        truck.now_us += period_us;
        return ok;
    }

    // The report of a bus controller of its own is no frame of the bus.
    static bool send(void* self, const lpvg_can_frame_t* frame) {
        auto& unit = *static_cast<PlantUnit*>(self);
        unit.full_ = unit.full_ || ((frame->id & LPVG_CAN_ERROR) == 0U && !unit.terminal_.send(*frame));
        return !unit.full_;
    }
    static bool receive(void* self, int64_t now_us, lpvg_can_frame_t* frame) {
        const bool any = static_cast<PlantUnit*>(self)->terminal_.receive(*frame);
        frame->t_us = now_us;
        return any;
    }

    std::string scenario_ = scenario_text;
    double input_[2] = {0.0, 0.0};  // demand [bar], the driver's torque [N m]
    bool full_ = false;
    Terminal terminal_;
    bus_t bus_ = {this, &PlantUnit::send, &PlantUnit::receive};
    std::shared_ptr<Truck> truck_;
};

}  // namespace

std::unique_ptr<Unit> make_unit(const Log& log) { return started<PlantUnit>(log); }

}  // namespace lpvguard_fmu
