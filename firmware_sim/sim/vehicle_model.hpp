/// @file vehicle_model.hpp -- the vehicle of a loop from tick to tick: the simulated truck, or an FMU in its place.
#pragma once

#include <memory>
#include <string>

#include "lpvguard_plant/plant.hpp"
#include "scenario.hpp"

namespace lpvguard_sim {

class VehicleModel {
public:
    virtual ~VehicleModel() = default;

    virtual const lpvguard_plant::Truth& truth() const = 0;
    virtual const lpvguard_plant::Sensors& sensors() const = 0;
    virtual void advance(double demand_bar) = 0;  ///< By one tick, 10 ms. Throws std::runtime_error.
    /// Goes on with another drive and other faults, as lpvguard_plant::Plant does.
    virtual void revise(const lpvguard_plant::Drive& drive, const lpvguard_plant::Faults& faults) = 0;
};

std::unique_ptr<VehicleModel> simulated_truck(const Scenario& scenario, const lpvguard_plant::PlantParameters& parameters);

/// A co-simulation FMU of FMI 2.0 or 3.0. `link`: TOML file of `lpvguard sim --plant` (tools/src/lpvguard/extras/loop/foreign_plant.py):
/// the library, what identifies the FMU, and the value references of what is set and read. `text`: the scenario, for an FMU that takes it.
/// Throws lpvguard_plant::ParameterError or std::runtime_error with the FMU's own words.
std::unique_ptr<VehicleModel> fmu_vehicle(const std::string& link, const Scenario& scenario, const std::string& text);

}  // namespace lpvguard_sim
