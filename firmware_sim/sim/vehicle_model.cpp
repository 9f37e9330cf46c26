#include "vehicle_model.hpp"

namespace lpvguard_sim {
namespace {

using lpvguard_plant::Plant;

class SimulatedTruck final : public VehicleModel {
public:
    SimulatedTruck(const Scenario& scenario, const lpvguard_plant::PlantParameters& parameters)
        : plant_(lpvguard_plant::varied(parameters, scenario.plant.variation), scenario.plant.drive, scenario.seed, scenario.plant.faults) {
    }

    const lpvguard_plant::Truth& truth() const override { return plant_.truth(); }
    const lpvguard_plant::Sensors& sensors() const override { return plant_.sensors(); }
    void advance(const double* demand) override {
        for (int i = 0; i < Plant::steps_per_sample; ++i) {
            plant_.step(*demand);
        }
    }
    void revise(const lpvguard_plant::Drive& drive, const lpvguard_plant::Faults& faults) override { plant_.revise(drive, faults); }

private:
    Plant plant_;
};

}  // namespace

std::unique_ptr<VehicleModel> simulated_truck(const Scenario& scenario, const lpvguard_plant::PlantParameters& parameters) {
    return std::make_unique<SimulatedTruck>(scenario, parameters);
}

}  // namespace lpvguard_sim
