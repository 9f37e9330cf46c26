/// @file vehicle_model.hpp -- the vehicle of a loop from tick to tick: the simulated truck, or an FMU that replaces it.
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
    virtual const double* values() const { return nullptr; }  ///< Speed and outputs of a vehicle on its own bus, as in its signal table.
    virtual void advance(const double* demand) = 0;  ///< Advances by one tick, under a demand for each input. Throws std::runtime_error.
    /// Continues with another drive and other faults, as lpvguard_plant::Plant does.
    virtual void revise(const lpvguard_plant::Drive& drive, const lpvguard_plant::Faults& faults) = 0;
};

std::unique_ptr<VehicleModel> simulated_truck(const Scenario& scenario, const lpvguard_plant::PlantParameters& parameters);

/// A co-simulation FMU of FMI 2.0 or 3.0. `link` is the TOML file of `lpvguard sim --plant`. It holds the library, the identity of the
/// FMU, and the value references of its inputs and outputs (foreign_plant.py). `text` is the scenario, for an FMU with a parameter for it.
/// Throws lpvguard_plant::ParameterError, or std::runtime_error with the FMU's own message.
std::unique_ptr<VehicleModel> fmu_vehicle(const std::string& link, const Scenario& scenario, const std::string& text);

}  // namespace lpvguard_sim
