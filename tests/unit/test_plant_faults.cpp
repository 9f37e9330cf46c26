/// @file test_plant_faults.cpp -- do faults and variations act where they should, and nowhere else?
#include "../catch.hpp"

#include <cmath>

#include "plant_drives.hpp"

using namespace plant_drives;
using Catch::Matchers::ContainsSubstring;

TEST_CASE("a fault from the start equals the same variation", "[unit][plant]") {
    const PlantParameters p = quiet();
    Variation variation;
    Faults faults;
    faults.surroundings.resize(1);
    faults.actuators.resize(1);
    SECTION("friction left") { variation.friction_left_ratio = faults.surroundings[0].friction_left_ratio = 0.4; }
    SECTION("friction right") { variation.friction_right_ratio = faults.surroundings[0].friction_right_ratio = 0.4; }
    SECTION("front tyres") { variation.cornering_stiffness_front_ratio = faults.surroundings[0].cornering_stiffness_front_ratio = 0.7; }
    SECTION("rear tyres") { variation.cornering_stiffness_rear_ratio = faults.surroundings[0].cornering_stiffness_rear_ratio = 0.7; }
    SECTION("wind") { variation.crosswind_mean_mps = faults.surroundings[0].crosswind_mps = 5.0; }
    SECTION("brake gain") { variation.brake_gain_ratio = faults.actuators[0].brake_gain_ratio = 0.4; }
    SECTION("brake lag") {
        variation.brake_lag_ratio = 3.0;
        faults.actuators[0].extra_lag_s = 2.0 * p.brake_lag_s;
    }
    SECTION("brake delay") { variation.extra_brake_delay_s = faults.actuators[0].extra_delay_s = 0.4; }
    Plant varied_plant(varied(p, variation), at(15.0), 1);
    Plant faulty_plant(p, at(15.0), 1, faults);
    Plant healthy_plant(p, at(15.0), 1);
    for (Plant* plant : {&varied_plant, &faulty_plant, &healthy_plant}) {
        run(*plant, 3.0, 1.5);
    }
    CHECK(faulty_plant.truth().yaw_rate_radps == Approx(varied_plant.truth().yaw_rate_radps).epsilon(1e-9));
    CHECK(faulty_plant.truth().yaw_rate_radps != Approx(healthy_plant.truth().yaw_rate_radps).epsilon(1e-4));
}

TEST_CASE("a plant that is revised goes on as one that had it from the start, and keeps what it had when refused", "[unit][plant]") {
    Drive drive = at(15.0);
    Faults faults;
    faults.actuators.push_back({{1.0, 100.0}, 0.9, 0.0, 0.0});
    Plant revised(shipped(), drive, 7, faults);
    run(revised, 4.0, 1.0);

    Faults too_late = faults;
    too_late.actuators.push_back({{5.0, 6.0}, 1.0, 0.0, 1.99});
    CHECK_THROWS_WITH(revised.revise(drive, too_late), ContainsSubstring("at most 2 s of brake delay"));
    run(revised, 4.0, -1.0);

    Drive other_drive = drive;
    other_drive.speed_changes = {{8.5, 12.0, 1.0}};
    Faults other_faults = faults;
    other_faults.actuators[0].window.end_s = 8.5;
    SensorFault frozen;
    frozen.window = {8.5, 10.0};
    frozen.frozen = true;
    other_faults.sensors.push_back(frozen);
    revised.revise(other_drive, other_faults);
    Plant whole(shipped(), other_drive, 7, other_faults);
    run(whole, 4.0, 1.0);
    run(whole, 4.0, -1.0);
    for (int k = 0; k < 400; ++k) {
        run(revised, 0.01, 1.0);
        run(whole, 0.01, 1.0);
        REQUIRE(revised.truth().yaw_rate_radps == whole.truth().yaw_rate_radps);
        REQUIRE(revised.truth().speed_mps == whole.truth().speed_mps);
        REQUIRE(revised.sensors().yaw_rate_radps == whole.sensors().yaw_rate_radps);
    }
    CHECK(whole.truth().speed_mps == Approx(12.0));
}

TEST_CASE("sensor faults act on the sensor, in their window, and nowhere else", "[unit][plant]") {
    const PlantParameters p = quiet();
    Faults faults;
    SensorFault fault;
    fault.signal = Signal::yaw_rate;
    fault.window = {20.0, 30.0};
    const auto measured_at = [&](double time_s) {
        faults.sensors = {fault};
        Plant healthy(p, at(12.0), 4);
        Plant faulty(p, at(12.0), 4, faults);
        run(healthy, time_s, -1.0);
        run(faulty, time_s, -1.0);
        CHECK(healthy.truth().yaw_rate_radps == faulty.truth().yaw_rate_radps);
        CHECK(healthy.sensors().steering_wheel_rad == faulty.sensors().steering_wheel_rad);
        return faulty.sensors().yaw_rate_radps - healthy.sensors().yaw_rate_radps;
    };
    Plant reference(p, at(12.0), 4);
    run(reference, 25.0, -1.0);
    const double truth_radps = reference.sensors().yaw_rate_radps;

    fault.gain = -1.0;
    CHECK(measured_at(19.99) == 0.0);
    CHECK(measured_at(25.0) == Approx(-2.0 * truth_radps));
    CHECK(measured_at(30.0) == 0.0);
    fault.gain = 1.0;
    fault.bias = 0.05;
    CHECK(measured_at(25.0) == Approx(0.05));
    fault.drift_ps = 0.001;
    CHECK(measured_at(25.0) == Approx(0.055));
    fault = SensorFault{};
    fault.window = {0.5, 30.0};
    fault.frozen = true;
    CHECK(measured_at(25.0) < -0.5 * truth_radps);
    fault = SensorFault{};
    fault.window = {20.0, 30.0};
    fault.extra_noise_rms = 0.1;
    CHECK(measured_at(25.0) != 0.0);
}

TEST_CASE("a fault with a ramp has its share of the size, and all of it afterwards", "[unit][plant]") {
    Window window{10.0, 60.0, 20.0};
    CHECK(window.share(9.9) == 0.0);
    CHECK(window.share(15.0) == Approx(0.25));
    CHECK(window.share(30.0) == 1.0);
    CHECK(window.share(60.0) == 0.0);
    CHECK(shared_ratio(0.4, window.share(20.0)) == Approx(0.7));
    CHECK(shared_ratio(0.4, 1.0) == 0.4);

    const PlantParameters p = quiet();
    SensorFault sensor;
    sensor.signal = Signal::yaw_rate;
    ActuatorFault actuator;
    SurroundingsFault surroundings;
    sensor.window = actuator.window = surroundings.window = window;
    const auto after_20_s = [&](const Faults& faults) {
        Plant plant(p, at(12.0), 4, faults);
        run(plant, 20.0, -1.0);
        return plant.sensors().yaw_rate_radps;
    };
    Faults faults;
    const double healthy_radps = after_20_s(faults);
    SECTION("gain, bias and drift") {
        sensor.gain = 0.6;
        sensor.bias = 0.1;
        sensor.drift_ps = 0.01;
        faults.sensors = {sensor};
        CHECK(after_20_s(faults) == Approx(0.8 * healthy_radps + 0.5 * (0.1 + 0.1)).epsilon(1e-3));
    }
    SECTION("frozen") {
        Plant before(p, at(12.0), 4);
        run(before, 10.0, -1.0);
        sensor.frozen = true;
        faults.sensors = {sensor};
        CHECK(after_20_s(faults) == Approx(0.5 * (healthy_radps + before.sensors().yaw_rate_radps)).epsilon(1e-3));
    }
    SECTION("noise") {
        sensor.extra_noise_rms = 0.1;
        faults.sensors = {sensor};
        const double ramped_radps = after_20_s(faults) - healthy_radps;
        faults.sensors[0].window = {};
        faults.sensors[0].extra_noise_rms = 0.05;
        CHECK(ramped_radps == Approx(after_20_s(faults) - healthy_radps).epsilon(1e-3));
        CHECK(std::fabs(ramped_radps) > 1e-4);
    }
    SECTION("brakes") {
        actuator.brake_gain_ratio = 0.2;
        faults.actuators = {actuator};
        const double ramped_radps = after_20_s(faults);
        faults.actuators[0].window.ramp_s = 0.0;
        CHECK(std::fabs(ramped_radps) < 0.8 * std::fabs(healthy_radps));
        CHECK(std::fabs(ramped_radps) > 1.5 * std::fabs(after_20_s(faults)));
    }
    SECTION("tyres") {
        surroundings.cornering_stiffness_front_ratio = 0.5;
        faults.surroundings = {surroundings};
        const double ramped_radps = after_20_s(faults);
        faults.surroundings[0].window = {};
        const double whole_radps = after_20_s(faults);
        faults.surroundings[0].cornering_stiffness_front_ratio = 0.75;
        CHECK(ramped_radps == Approx(after_20_s(faults)).epsilon(0.1));
        CHECK(std::fabs(ramped_radps - whole_radps) > 0.01 * std::fabs(whole_radps));
    }
    SECTION("a ramp is no negative time") {
        sensor.window.ramp_s = -1.0;
        faults.sensors = {sensor};
        CHECK_THROWS_AS(after_20_s(faults), ParameterError);
    }
}

TEST_CASE("a growing delay and lag reach their size", "[unit][plant]") {
    const PlantParameters p = quiet();
    const auto pressure = [&](double seconds, double ramp_s, double delay_s, double lag_s) {
        Faults faults;
        faults.actuators.push_back({{0.0, 100.0, ramp_s}, 1.0, lag_s, delay_s});
        Plant plant(p, at(12.0), 1, faults);
        run(plant, 10.0, 0.0);
        run(plant, seconds, 1.0);
        return plant.truth().pressure_right_bar;
    };
    CHECK(pressure(0.5, 20.0, 0.4, 0.0) == Approx(pressure(0.5, 0.0, 0.2, 0.0)).margin(0.05));
    CHECK(pressure(0.3, 20.0, 0.4, 0.0) > pressure(0.3, 0.0, 0.4, 0.0) + 0.05);
    CHECK(pressure(0.5, 5.0, 0.4, 0.0) == pressure(0.5, 0.0, 0.4, 0.0));
    CHECK(pressure(0.5, 20.0, 0.0, 0.4) == Approx(pressure(0.5, 0.0, 0.0, 0.2)).margin(0.05));
    CHECK(pressure(0.5, 5.0, 0.0, 0.4) == pressure(0.5, 0.0, 0.0, 0.4));
}

TEST_CASE("a fault's noise leaves every other signal's noise alone", "[unit][plant]") {
    Faults faults;
    faults.sensors.resize(1);
    faults.sensors[0].frozen = true;
    Plant healthy(shipped(), at(12.0), 4);
    Plant faulty(shipped(), at(12.0), 4, faults);
    run(healthy, 5.0, 1.0);
    run(faulty, 5.0, 1.0);
    CHECK(healthy.sensors().steering_wheel_rad == faulty.sensors().steering_wheel_rad);
    CHECK(healthy.sensors().wheel_speed_mps == faulty.sensors().wheel_speed_mps);
    CHECK(healthy.sensors().yaw_rate_radps != faulty.sensors().yaw_rate_radps);
}

TEST_CASE("actuator faults act between demand and brake force", "[unit][plant]") {
    const PlantParameters p = quiet();
    Faults lost;
    lost.actuators.push_back({{}, 0.0, 0.0, 0.0});
    Plant without(p, at(12.0), 1, lost);
    run(without, 5.0, 2.0);
    CHECK(without.truth().pressure_right_bar == Approx(2.0));
    CHECK(without.truth().yaw_rate_radps == 0.0);

    Faults late;
    late.actuators.push_back({{}, 1.0, 0.0, 0.4});
    Plant prompt(p, at(12.0), 1);
    Plant delayed(p, at(12.0), 1, late);
    run(prompt, 2.0, 1.0);
    run(delayed, 2.4, 1.0);
    CHECK(delayed.truth().yaw_rate_radps == Approx(prompt.truth().yaw_rate_radps).epsilon(1e-9));

    Faults slow;
    slow.actuators.push_back({{}, 1.0, 0.5, 0.0});
    Plant sluggish(p, at(12.0), 1, slow);
    run(sluggish, p.brake_delay_s + p.brake_lag_s + 0.5, 1.0);
    CHECK(sluggish.truth().pressure_right_bar == Approx(1.0 - std::exp(-1.0)).epsilon(1e-6));
}

TEST_CASE("friction limits the truck, split friction and wind push it aside", "[unit][plant]") {
    const PlantParameters p = quiet();
    Faults ice;
    ice.surroundings.push_back({{}, 0.125, 0.125, 1.0, 1.0, 0.0});
    Plant sliding(p, at(15.0), 1, ice);
    for (int k = 0; k < 20000; ++k) {
        sliding.step(8.0);
        REQUIRE(std::fabs(sliding.truth().lateral_acceleration_mps2) < 9.81 * 0.1 * 1.15);
    }
    Faults wind;
    wind.surroundings.push_back({{10.0, 40.0}, 1.0, 1.0, 1.0, 1.0, 10.0});
    Plant blown(p, at(17.0), 1, wind);
    run(blown, 10.0, 0.0);
    CHECK(blown.truth().yaw_rate_radps == 0.0);
    run(blown, 10.0, 0.0);
    CHECK(std::fabs(blown.truth().yaw_rate_radps) > 1e-3);

    Faults soft;
    soft.surroundings.push_back({{}, 1.0, 1.0, 0.6, 1.0, 0.0});
    Plant healthy(p, at(15.0), 1);
    Plant softened(p, at(15.0), 1, soft);
    run(healthy, 30.0, 1.0);
    run(softened, 30.0, 1.0);
    CHECK(softened.truth().road_wheel_rad / softened.truth().yaw_rate_radps >
          1.01 * healthy.truth().road_wheel_rad / healthy.truth().yaw_rate_radps);
}

TEST_CASE("variations of load, CG and tyres keep the truck on the road", "[unit][plant]") {
    const double speed_mps = GENERATE(8.0, 15.0, 20.0);
    Variation variation;
    SECTION("light") { variation.load_ratio = 0.6; }
    SECTION("heavy") { variation.load_ratio = 1.4; }
    SECTION("CG forward") { variation.cg_shift_m = -0.2; }
    SECTION("slippery") { variation.friction_left_ratio = variation.friction_right_ratio = 0.4; }
    SECTION("soft tyres") { variation.cornering_stiffness_front_ratio = variation.cornering_stiffness_rear_ratio = 0.8; }
    SECTION("split friction") { variation.friction_left_ratio = 0.4; }
    CAPTURE(speed_mps);
    Plant plant(varied(shipped(), variation), at(speed_mps), 1);
    run(plant, 10.0, 1.0);
    CHECK(plant.truth().yaw_rate_radps < 0.0);
    CHECK(std::fabs(plant.truth().lateral_acceleration_mps2) < 6.0);
    run(plant, 40.0, 0.0);
    CHECK(std::fabs(plant.truth().yaw_rate_radps) < 0.05);
}

TEST_CASE("a truck that spins round stays a truck", "[unit][plant]") {
    Variation variation;
    variation.cornering_stiffness_rear_ratio = 0.3;
    Plant plant(varied(shipped(), variation), at(20.0), 1);
    double turned_rad = 0.0;
    for (int k = 0; k < 120'000; ++k) {
        plant.step(k / 3000 % 2 == 0 ? 3.0 : -3.0);
        turned_rad += std::fabs(plant.truth().yaw_rate_radps) * Plant::step_s;
    }
    CHECK(turned_rad > 6.3);  // or nothing was shown
    CHECK(std::isfinite(plant.truth().yaw_rate_radps));
    CHECK(std::isfinite(plant.truth().lateral_velocity_mps));
    CHECK(std::fabs(plant.truth().yaw_rate_radps) < 20.0);
}
