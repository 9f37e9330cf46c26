/// @file test_plant.cpp -- is the simulated truck a truck, does it repeat to the bit, and do its faults act where they should?
#include "../catch.hpp"

#include <cmath>
#include <fstream>
#include <limits>
#include <sstream>
#include <string>
#include <vector>

#include "heap_counter.hpp"
#include "lpvguard_plant/plant.hpp"
#include "lpvguard_plant/scenario.hpp"

namespace {

using namespace lpvguard_plant;
using Catch::Matchers::ContainsSubstring;

PlantParameters shipped() {
    return load_parameters(LPVGUARD_TRUCK_TOML);
}

/// Flat road, no wind, exact sensors.
PlantParameters quiet() {
    PlantParameters p = shipped();
    p.bank_rms_rad = 0.0;
    p.crosswind_gust_rms_mps = 0.0;
    for (SensorParameters* sensor : {&p.yaw_rate_sensor, &p.steering_wheel_sensor, &p.lateral_acceleration_sensor,
                                     &p.speed_sensor, &p.wheel_speed_sensor, &p.brake_pressure_sensor}) {
        *sensor = SensorParameters{0.0, 1e-7, 0.0};
    }
    return p;
}

Drive at(double speed_mps) {
    Drive drive;
    drive.speed_profile = {{0.0, speed_mps}};
    return drive;
}

void run(Plant& plant, double duration_s, double demand_bar, double driver_torque_nm = 0.0) {
    const long steps = std::lround(duration_s / Plant::step_s);
    for (long k = 0; k < steps; ++k) {
        plant.step(demand_bar, driver_torque_nm);
    }
}

std::string text_of(const char* path) {
    std::ifstream file(path);
    std::ostringstream text;
    text << file.rdbuf();
    return text.str();
}

std::string replaced(std::string text, const std::string& old_words, const std::string& new_words) {
    const std::size_t found = text.find(old_words);
    REQUIRE(found != std::string::npos);
    return text.replace(found, old_words.size(), new_words);
}

double sum(const std::array<double, 4>& values) {
    return values[0] + values[1] + values[2] + values[3];
}

}  // namespace

TEST_CASE("parameter files: what is wrong is named with its file, key and range", "[unit][plant]") {
    const std::string good = text_of(LPVGUARD_TRUCK_TOML);
    REQUIRE_NOTHROW(parse_parameters(good, "good.toml"));

    const auto fails = [&](const std::string& text, const std::string& expected) {
        CHECK_THROWS_WITH(parse_parameters(text, "bad.toml"), ContainsSubstring("bad.toml") && ContainsSubstring(expected));
    };
    fails(replaced(good, "value = 9285.0", "value = -1.0"), "chassis.mass_kg = -1: expected 3000 .. 40000");
    fails(replaced(good, "value = 9285.0", "value = nan"), "chassis.mass_kg");
    fails(replaced(good, "value = 9285.0", "value = \"heavy\""), "chassis.mass_kg.value: expected a number");
    fails(replaced(good, "mass_kg = { value = 9285.0, source = \"design\" }", ""), "chassis.mass_kg: missing");
    fails(replaced(good, "value = 9285.0, source = \"design\"", "value = 9285.0"), "chassis.mass_kg.source: missing");
    fails(replaced(good, "[tyres]", "[tyres]\ntread_mm = { value = 1.0, source = \"x\" }"), "tyres.tread_mm: unknown key");
    fails(good + "\n[paint]\n", "[paint]: unknown section");
    fails(replaced(good, "[tyres]", "[tyres"), "bad.toml:");
    fails(replaced(good, "value = 7057.0", "value = 9300.0"), "sprung_mass_kg < chassis.mass_kg");
    fails(replaced(good, "value = 0.0001220703125", "value = 0.0"), "sensor_yaw_rate_radps.lsb");
    CHECK_THROWS_WITH(load_parameters("/nowhere/truck.toml"), ContainsSubstring("/nowhere/truck.toml"));
}

TEST_CASE("the constructor refuses what the model cannot mean", "[unit][plant]") {
    const PlantParameters p = quiet();
    CHECK_THROWS_AS(Plant(p, Drive{}, 1), ParameterError);
    CHECK_THROWS_AS(Plant(p, at(2.0), 1), ParameterError);
    CHECK_THROWS_AS(Plant(p, at(31.0), 1), ParameterError);
    Drive backwards;
    backwards.speed_profile = {{1.0, 10.0}, {1.0, 12.0}};
    CHECK_THROWS_AS(Plant(p, backwards, 1), ParameterError);
    Faults late;
    late.actuators.push_back({{}, 1.0, 0.0, 1.99});
    CHECK_THROWS_WITH(Plant(p, at(12.0), 1, late), ContainsSubstring("2 s"));
    Faults reversed;
    reversed.sensors.push_back({});
    reversed.sensors[0].window = {5.0, 4.0};
    CHECK_THROWS_AS(Plant(p, at(12.0), 1, reversed), ParameterError);
    Variation tipping;
    tipping.cg_height_ratio = 2.4;
    tipping.load_ratio = 3.0;
    CHECK_THROWS_AS(varied(p, tipping), ParameterError);
}

TEST_CASE("braking the right wheel turns the truck right, with Table I's DC gain", "[unit][plant]") {
    const double speed_mps = GENERATE(8.0, 12.0, 17.0, 22.0);
    CAPTURE(speed_mps);
    Plant plant(quiet(), at(speed_mps), 1);
    constexpr double demand_bar = 0.5;
    run(plant, 60.0, demand_bar);
    const double nominal_radps = -1.94 / speed_mps * demand_bar;
    CHECK(plant.truth().yaw_rate_radps == Approx(nominal_radps).epsilon(0.35));
    CHECK(plant.truth().road_wheel_rad < 0.0);
    CHECK(plant.truth().pressure_right_bar == Approx(demand_bar));
    CHECK(plant.truth().pressure_left_bar == Approx(0.0).margin(1e-12));
}

TEST_CASE("left and right are mirror images", "[unit][plant]") {
    Plant left(quiet(), at(15.0), 1);
    Plant right(quiet(), at(15.0), 1);
    run(left, 10.0, -1.3);
    run(right, 10.0, 1.3);
    CHECK(left.truth().yaw_rate_radps == -right.truth().yaw_rate_radps);
    CHECK(left.truth().roll_rad == -right.truth().roll_rad);
    CHECK(left.truth().wheel_load_n[front_left] == right.truth().wheel_load_n[front_right]);
}

TEST_CASE("a steady circle balances forces, loads and roll", "[unit][plant]") {
    const PlantParameters p = quiet();
    const double demand_bar = GENERATE(-0.5, -1.0, -1.5);
    CAPTURE(demand_bar);
    Plant plant(p, at(14.0), 1);
    run(plant, 60.0, demand_bar);
    const Truth& t = plant.truth();
    const double weight_n = 9.81 * p.mass_kg;

    CHECK(t.lateral_acceleration_mps2 == Approx(t.speed_mps * t.yaw_rate_radps).epsilon(1e-4));
    CHECK(t.lateral_acceleration_mps2 > 0.3);
    CHECK(t.lateral_acceleration_mps2 < 9.81 * p.friction_left_ratio);
    CHECK(sum(t.wheel_load_n) == Approx(weight_n));
    CHECK(sum(t.tyre_lateral_force_n) == Approx(p.mass_kg * t.lateral_acceleration_mps2).epsilon(0.02));
    CHECK(t.wheel_load_n[front_right] > t.wheel_load_n[front_left]);
    CHECK(t.wheel_load_n[rear_right] > t.wheel_load_n[rear_left]);

    const double sprung_moment = p.sprung_mass_kg * p.sprung_cg_height_m;
    const double stiffness = p.roll_stiffness_front_nmprad + p.roll_stiffness_rear_nmprad - 9.81 * sprung_moment;
    CHECK(t.roll_rad == Approx(sprung_moment * t.lateral_acceleration_mps2 / stiffness).epsilon(1e-3));
    // Overturning moment: loads times half a track carry CG height times lateral force plus the CG's own shift by roll.
    const double moment = 0.5 * p.track_m * (t.wheel_load_n[front_right] + t.wheel_load_n[rear_right] -
                                             t.wheel_load_n[front_left] - t.wheel_load_n[rear_left]);
    const double unsprung_moment = (p.mass_kg - p.sprung_mass_kg) * p.unsprung_cg_height_m;
    CHECK(moment == Approx((sprung_moment + unsprung_moment) * t.lateral_acceleration_mps2 + 9.81 * sprung_moment * t.roll_rad)
                        .epsilon(1e-3));
    // Near-neutral handling: the wheels stay within 3 degrees of the geometric angle.
    CHECK(std::fabs(t.road_wheel_rad - p.wheelbase_m * t.yaw_rate_radps / t.speed_mps) < 0.05);
}

// The equations of plant.hpp, written a second time from the header and compared with what the plant does.

TEST_CASE("from straight driving, the first millisecond follows the equations of motion exactly", "[unit][plant]") {
    PlantParameters p = quiet();
    constexpr double dt = Plant::step_s;
    const double sprung_moment = p.sprung_mass_kg * p.sprung_cg_height_m;
    const double reduced_inertia = p.roll_inertia_kgm2 - sprung_moment * sprung_moment / p.mass_kg;

    SECTION("side wind pushes, turns by its arm and rolls by its height") {
        p.crosswind_mean_mps = 10.0;
        Plant plant(p, at(20.0), 1);
        plant.step(0.0);
        const double wind_n = 0.5 * 1.2 * p.side_force_area_m2 * 20.0 * 10.0;
        CHECK(plant.truth().yaw_rate_radps == Approx(wind_n * p.wind_arm_m / p.yaw_inertia_kgm2 * dt).epsilon(0.01));
        CHECK(plant.truth().roll_rate_radps ==
              Approx((sprung_moment / p.mass_kg - p.wind_height_m) * wind_n / reduced_inertia * dt).epsilon(0.02));
        CHECK(plant.truth().roll_rate_radps < 0.0);
    }
    SECTION("a banked road lets everything slide together: nothing is felt") {
        p.bank_rms_rad = 0.02;
        Plant plant(p, at(20.0), 1);
        plant.step(0.0);
        const double bank_rad = plant.truth().bank_rad;
        REQUIRE(std::fabs(bank_rad) > 1e-3);
        CHECK(plant.truth().lateral_velocity_mps == Approx(-9.81 * bank_rad * dt).epsilon(0.01));
        CHECK(plant.truth().roll_rate_radps == Approx(0.0).margin(1e-2 * std::fabs(bank_rad) * dt));
        CHECK(plant.truth().road_wheel_rate_radps == Approx(0.0).margin(1e-2 * std::fabs(bank_rad) * dt));
    }
    SECTION("a driver's torque acts through the steering ratio on the steering inertia") {
        p.kingpin_friction_nm = 0.0;
        Plant plant(p, at(20.0), 1);
        plant.step(0.0, 3.0);
        CHECK(plant.truth().road_wheel_rate_radps == Approx(3.0 * p.steering_ratio / p.steering_inertia_kgm2 * dt).epsilon(0.01));
    }
}

TEST_CASE("tyres: slip relaxes over its length, force follows slip, load, friction and brake", "[unit][plant]") {
    PlantParameters p = quiet();
    p.friction_left_ratio = 0.5;
    p.friction_right_ratio = 0.9;
    const double speed_mps = GENERATE(5.0, 15.0);
    CAPTURE(speed_mps);
    Plant plant(p, at(speed_mps), 1);
    double largest_steer_rad = 0.0;
    for (int k = 0; k < 6000; ++k) {
        const Truth before = plant.truth();
        plant.step(k > 2000 ? 6.0 : 0.0, k < 4000 ? 6.0 : -3.0);
        const Truth after = plant.truth();
        largest_steer_rad = std::fmax(largest_steer_rad, std::fabs(after.road_wheel_rad));
        if (k % 50 != 49) {
            continue;
        }
        const auto middle = [&](double Truth::*member) { return 0.5 * (before.*member + after.*member); };
        const double r = middle(&Truth::yaw_rate_radps);
        for (std::size_t i = 0; i < 4; ++i) {
            CAPTURE(k, i);
            const bool front = i == front_left || i == front_right;
            const bool left = i == front_left || i == rear_left;
            const double vx = middle(&Truth::speed_mps) + (left ? -0.5 : 0.5) * p.track_m * r;
            const double vy = middle(&Truth::lateral_velocity_mps) +
                              (front ? p.cg_to_front_axle_m : p.cg_to_front_axle_m - p.wheelbase_m) * r;
            const double steer = front ? middle(&Truth::road_wheel_rad) : p.rear_roll_steer_ratio * middle(&Truth::roll_rad);
            const double wheel_vx = vx * std::cos(steer) + vy * std::sin(steer);
            const double wheel_vy = vy * std::cos(steer) - vx * std::sin(steer);
            const double slip = 0.5 * (before.tyre_slip[i] + after.tyre_slip[i]);
            const double slip_rate = (after.tyre_slip[i] - before.tyre_slip[i]) / Plant::step_s;
            CHECK(p.relaxation_length_m * slip_rate == Approx(wheel_vy - wheel_vx * slip).margin(3e-5 * speed_mps));

            const double share = front ? p.wheelbase_m - p.cg_to_front_axle_m : p.cg_to_front_axle_m;
            const double static_n = 0.5 * p.mass_kg * 9.81 * share / p.wheelbase_m;
            const double load_ratio = after.wheel_load_n[i] / static_n;
            const double axle_n = front ? p.cornering_stiffness_front_nprad : p.cornering_stiffness_rear_nprad;
            const double linear_n = -0.5 * axle_n * load_ratio *
                                    (1.0 - p.load_sensitivity_ratio * (load_ratio - 1.0)) * after.tyre_slip[i];
            const double grip_n = (left ? p.friction_left_ratio : p.friction_right_ratio) * after.wheel_load_n[i];
            const double limit_n = std::sqrt(std::fmax(grip_n * grip_n - after.brake_force_n[i] * after.brake_force_n[i], 0.0));
            const double expected_n = linear_n / std::sqrt(1.0 + linear_n * linear_n / (limit_n * limit_n));
            CHECK(after.tyre_lateral_force_n[i] == Approx(expected_n).epsilon(1e-3).margin(2.0));
            CHECK(std::hypot(after.tyre_lateral_force_n[i], after.brake_force_n[i]) < 1.0001 * grip_n);
        }
    }
    CHECK(largest_steer_rad > 0.1);
}

TEST_CASE("braking harder than the tyre holds leaves the wheel its steering", "[unit][plant]") {
    PlantParameters p = quiet();
    p.friction_left_ratio = p.friction_right_ratio = 0.2;
    Plant plant(p, at(15.0), 1);
    run(plant, 1.0, 10.0);
    CHECK(plant.truth().brake_force_n[front_right] ==
          Approx(0.9 * 0.2 * plant.truth().wheel_load_n[front_right]).epsilon(1e-3));
    CHECK(plant.truth().brake_force_n[front_left] == 0.0);
}

TEST_CASE("each axle's springs, dampers and unsprung mass shift its own wheel loads", "[unit][plant]") {
    const PlantParameters p = quiet();
    Plant plant(p, at(15.0), 1);
    run(plant, 1.0, 2.0, -5.0);  // In the middle of rolling over.
    const Truth& t = plant.truth();
    REQUIRE(std::fabs(t.roll_rate_radps) > 0.005);
    const double stiffness = p.roll_stiffness_front_nmprad + p.roll_stiffness_rear_nmprad;
    const double rear_share = p.cg_to_front_axle_m / p.wheelbase_m;
    const auto shift_n = [&](double axle_stiffness, double mass_share) {
        return (axle_stiffness * t.roll_rad + p.roll_damping_nmsprad * axle_stiffness / stiffness * t.roll_rate_radps +
                (p.mass_kg - p.sprung_mass_kg) * mass_share * p.unsprung_cg_height_m * t.speed_mps * t.yaw_rate_radps) /
               p.track_m;
    };
    CHECK(0.5 * (t.wheel_load_n[front_right] - t.wheel_load_n[front_left]) ==
          Approx(shift_n(p.roll_stiffness_front_nmprad, 1.0 - rear_share)).epsilon(1e-3));
    CHECK(0.5 * (t.wheel_load_n[rear_right] - t.wheel_load_n[rear_left]) ==
          Approx(shift_n(p.roll_stiffness_rear_nmprad, rear_share)).epsilon(1e-3));
}

TEST_CASE("the accelerometer feels gravity on a bank and under the leaning body", "[unit][plant]") {
    PlantParameters p = quiet();
    p.bank_rms_rad = 0.03;
    Plant plant(p, at(8.0), 5);
    for (int sample = 0; sample < 500; ++sample) {
        run(plant, 0.01, sample < 250 ? 2.0 : 0.0);
        const Truth& t = plant.truth();
        REQUIRE(plant.sensors().lateral_acceleration_mps2 ==
                Approx(t.lateral_acceleration_mps2 + 9.81 * (t.bank_rad + t.roll_rad)).margin(1e-6));
    }
}

TEST_CASE("a coasting truck is slowed along its own axis by its tyres and resistances only", "[unit][plant]") {
    const PlantParameters p = quiet();
    Drive coasting = at(18.0);  // At 12 m/s the lateral velocity is about zero, and its share could not be seen.
    coasting.speed_is_free = true;
    Plant plant(p, coasting, 1);
    run(plant, 3.0, 1.0, -4.0);
    for (int k = 0; k < 200; ++k) {
        const Truth before = plant.truth();
        run(plant, Plant::step_s, 1.0, -4.0);
        const Truth t = plant.truth();
        const double rear_steer = p.rear_roll_steer_ratio * t.roll_rad;
        const double along_n =
            -(t.tyre_lateral_force_n[front_left] + t.tyre_lateral_force_n[front_right]) * std::sin(t.road_wheel_rad) -
            (t.brake_force_n[front_left] + t.brake_force_n[front_right]) * std::cos(t.road_wheel_rad) -
            (t.tyre_lateral_force_n[rear_left] + t.tyre_lateral_force_n[rear_right]) * std::sin(rear_steer) -
            9.81 * p.mass_kg * p.rolling_resistance_ratio - 0.6 * p.drag_area_m2 * t.speed_mps * t.speed_mps;
        const double expected_mps2 = along_n / p.mass_kg + t.lateral_velocity_mps * t.yaw_rate_radps;
        CHECK((t.speed_mps - before.speed_mps) / Plant::step_s == Approx(expected_mps2).epsilon(2e-3));
    }
    CHECK(std::fabs(plant.truth().lateral_velocity_mps * plant.truth().yaw_rate_radps) > 0.003);
}

TEST_CASE("kingpin friction holds the wheels against less than itself", "[unit][plant]") {
    const auto angle_after = [](double friction_nm) {
        PlantParameters p = quiet();
        p.kingpin_friction_nm = friction_nm;
        Plant plant(p, at(12.0), 1);
        run(plant, 1.0, 0.0, 1.0);
        return plant.truth().road_wheel_rad;
    };
    CHECK(angle_after(0.0) > 0.003);
    CHECK(angle_after(40.0) < 0.001);
    CHECK(angle_after(40.0) > 0.0);
}

TEST_CASE("a fault from the start equals the same variation", "[unit][plant]") {
    const PlantParameters p = quiet();
    Variation variation;
    Faults faults;
    faults.surroundings.resize(1);
    faults.actuators.resize(1);
    SECTION("friction left") { variation.friction_left_ratio = faults.surroundings[0].friction_left_ratio = 0.4; }
    SECTION("friction right") { variation.friction_right_ratio = faults.surroundings[0].friction_right_ratio = 0.4; }
    SECTION("front tyres") {
        variation.cornering_stiffness_front_ratio = faults.surroundings[0].cornering_stiffness_front_ratio = 0.7;
    }
    SECTION("rear tyres") {
        variation.cornering_stiffness_rear_ratio = faults.surroundings[0].cornering_stiffness_rear_ratio = 0.7;
    }
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

TEST_CASE("the yaw rates and lateral accelerations of brake pulses are those of the design", "[unit][plant]") {
    double largest_mps2 = 0.0;
    for (const double speed_mps : {8.0, 12.0, 17.0, 22.0}) {
        for (const double demand_bar : {1.0, 2.0}) {
            Plant plant(quiet(), at(speed_mps), 1);
            run(plant, 30.0, demand_bar);
            CAPTURE(speed_mps, demand_bar, plant.truth().yaw_rate_radps);
            CHECK(std::fabs(plant.truth().yaw_rate_radps) > 0.06);
            CHECK(std::fabs(plant.truth().yaw_rate_radps) < 0.45);
            largest_mps2 = std::fmax(largest_mps2, std::fabs(plant.truth().lateral_acceleration_mps2));
        }
    }
    CHECK(largest_mps2 > 2.5);
    CHECK(largest_mps2 < 4.5);
}

TEST_CASE("step steer: a driver's torque turns the truck promptly and without wild overshoot", "[unit][plant]") {
    const double speed_mps = GENERATE(10.0, 17.0, 22.0);
    CAPTURE(speed_mps);
    Plant plant(quiet(), at(speed_mps), 1);
    constexpr double torque_nm = 2.0;
    double peak_radps = 0.0;
    double time_to_half_s = 0.0;
    std::vector<double> history;
    for (int k = 0; k < 40000; ++k) {
        plant.step(0.0, torque_nm);
        history.push_back(plant.truth().yaw_rate_radps);
        peak_radps = std::fmax(peak_radps, history.back());
    }
    const double final_radps = history.back();
    CHECK(final_radps > 0.0);
    CHECK(history[50] > 0.0);
    CHECK(peak_radps < 2.0 * final_radps);
    for (std::size_t k = 0; time_to_half_s == 0.0; ++k) {
        time_to_half_s = history[k] > 0.5 * final_radps ? static_cast<double>(k) * Plant::step_s : 0.0;
    }
    CHECK(time_to_half_s > 0.05);
    CHECK(time_to_half_s < 4.0);
}

TEST_CASE("the brake demand passes a pure delay and a first-order lag", "[unit][plant]") {
    const PlantParameters p = quiet();
    Plant plant(p, at(12.0), 1);
    const double demand_bar = 1.5;
    run(plant, p.brake_delay_s, demand_bar);
    CHECK(plant.truth().pressure_right_bar == 0.0);
    run(plant, p.brake_lag_s, demand_bar);
    CHECK(plant.truth().pressure_right_bar == Approx(demand_bar * (1.0 - std::exp(-1.0))).epsilon(1e-6));
    run(plant, 2.0, 50.0);
    CHECK(plant.truth().pressure_right_bar == Approx(p.brake_pressure_limit_bar).epsilon(1e-3));
    run(plant, 2.0, std::numeric_limits<double>::quiet_NaN());
    CHECK(plant.truth().pressure_right_bar == Approx(0.0).margin(1e-6));
    CHECK(std::isfinite(plant.truth().yaw_rate_radps));
}

TEST_CASE("halving the integration step changes the answer by less than 1 %", "[unit][plant]") {
    const double speed_mps = GENERATE(8.0, 15.0, 22.0);
    Drive coarse = at(speed_mps);
    Drive fine = coarse;
    fine.substeps = 2;
    PlantParameters p = quiet();
    p.bank_rms_rad = 0.008;
    Plant one(p, coarse, 3);
    Plant two(p, fine, 3);
    double largest_radps = 0.0;
    double difference_radps = 0.0;
    for (int k = 0; k < 60000; ++k) {
        const double demand_bar = (k / 1700) % 3 == 0 ? 2.0 : ((k / 900) % 2 == 0 ? -1.0 : 0.0);
        one.step(demand_bar);
        two.step(demand_bar);
        largest_radps = std::fmax(largest_radps, std::fabs(one.truth().yaw_rate_radps));
        difference_radps =
            std::fmax(difference_radps, std::fabs(one.truth().yaw_rate_radps - two.truth().yaw_rate_radps));
    }
    CAPTURE(speed_mps, largest_radps, difference_radps);
    CHECK(largest_radps > 0.05);
    CHECK(difference_radps < 1e-4 * largest_radps);
}

TEST_CASE("without input motion dies out and a coasting truck only loses energy", "[unit][plant]") {
    const double speed_mps = GENERATE(8.0, 17.0, 22.0);
    CAPTURE(speed_mps);
    const PlantParameters p = quiet();
    Drive coasting = at(speed_mps);
    coasting.speed_is_free = true;
    Plant plant(p, coasting, 1);
    run(plant, 1.0, 2.0);
    run(plant, 1.0, 0.0);  // Until the brakes are empty.
    const auto energy_j = [&] {
        const Truth& t = plant.truth();
        return 0.5 * p.mass_kg * (t.speed_mps * t.speed_mps + t.lateral_velocity_mps * t.lateral_velocity_mps) +
               0.5 * p.yaw_inertia_kgm2 * t.yaw_rate_radps * t.yaw_rate_radps;
    };
    double before_j = energy_j();
    for (int second = 0; second < 30; ++second) {
        run(plant, 1.0, 0.0);
        CHECK(energy_j() < before_j);
        before_j = energy_j();
    }
    CHECK(std::fabs(plant.truth().yaw_rate_radps) < 1e-3);
    CHECK(std::fabs(plant.truth().roll_rad) < 1e-4);
    CHECK(plant.truth().speed_mps >= Plant::slowest_mps);

    Plant at_rest(p, at(speed_mps), 1);
    run(at_rest, 5.0, 0.0);
    CHECK(at_rest.truth().yaw_rate_radps == 0.0);
    CHECK(at_rest.truth().road_wheel_rad == 0.0);
}

TEST_CASE("hands off, the truck keeps its way on a rough road and in wind", "[unit][plant]") {
    const double speed_mps = GENERATE(17.0, 19.0, 22.0);
    PlantParameters p = shipped();
    p.bank_rms_rad = 0.008;
    Plant plant(p, at(speed_mps), GENERATE(1U, 2U, 3U));
    double largest_radps = 0.0;
    double largest_steer_rad = 0.0;
    for (int k = 0; k < 300000; ++k) {
        plant.step(0.0);
        largest_radps = std::fmax(largest_radps, std::fabs(plant.truth().yaw_rate_radps));
        largest_steer_rad = std::fmax(largest_steer_rad, std::fabs(plant.truth().road_wheel_rad));
    }
    CAPTURE(speed_mps, largest_radps, largest_steer_rad);
    CHECK(largest_radps < 0.06);
    CHECK(largest_radps > 0.001);
    CHECK(largest_steer_rad < 0.03);
}

TEST_CASE("the same seed gives the same bits, another seed another drive", "[unit][plant]") {
    Plant a(shipped(), at(13.0), 7);
    Plant b(shipped(), at(13.0), 7);
    Plant c(shipped(), at(13.0), 8);
    int equal_samples = 0;
    for (int k = 0; k < 20000; ++k) {
        const double demand_bar = k % 3000 < 1500 ? 1.0 : -0.5;
        a.step(demand_bar);
        b.step(demand_bar);
        c.step(demand_bar);
        REQUIRE(a.truth().yaw_rate_radps == b.truth().yaw_rate_radps);
        REQUIRE(a.sensors().yaw_rate_radps == b.sensors().yaw_rate_radps);
        REQUIRE(a.sensors().wheel_speed_mps == b.sensors().wheel_speed_mps);
        equal_samples += a.truth().yaw_rate_radps == c.truth().yaw_rate_radps ? 1 : 0;
    }
    CHECK(equal_samples < 100);
}

TEST_CASE("a step allocates nothing", "[unit][plant]") {
    Faults faults;
    faults.sensors.resize(3);
    faults.actuators.resize(1);
    faults.surroundings.resize(1);
    Plant plant(shipped(), at(13.0), 7, faults);
    const long before = heap_allocations();
    run(plant, 1.0, 1.0);
    CHECK(heap_allocations() == before);
}

TEST_CASE("random numbers: moments, tails and independence of streams", "[unit][plant]") {
    Random random(5, 1);
    constexpr int count = 400000;
    double m1 = 0.0, m2 = 0.0, m4 = 0.0;
    int beyond_three = 0;
    for (int k = 0; k < count; ++k) {
        const double x = random.normal();
        m1 += x / count;
        m2 += x * x / count;
        m4 += x * x * x * x / count;
        beyond_three += std::fabs(x) > 3.0 ? 1 : 0;
    }
    CHECK(m1 == Approx(0.0).margin(0.008));
    CHECK(m2 == Approx(1.0).epsilon(0.012));
    CHECK(m4 == Approx(3.0).epsilon(0.03));
    CHECK(beyond_three == Approx(0.0026998 * count).epsilon(0.15));

    Random other(5, 2);
    Random again(5, 1);
    Random same(5, 1);
    double product = 0.0;
    for (int k = 0; k < count; ++k) {
        const double x = again.normal();
        REQUIRE(x == same.normal());
        product += x * other.normal() / count;
    }
    CHECK(product == Approx(0.0).margin(0.008));
}

TEST_CASE("road bank has its rms and its length, in space", "[unit][plant]") {
    const double speed_mps = GENERATE(8.0, 22.0);
    PlantParameters p = quiet();
    p.bank_rms_rad = 0.005;
    Plant plant(p, at(speed_mps), 11);
    const int lag_steps = static_cast<int>(p.bank_length_m / speed_mps / Plant::step_s);
    std::vector<double> bank;
    for (int k = 0; k < 4000000; ++k) {
        plant.step(0.0);
        bank.push_back(plant.truth().bank_rad);
    }
    double variance = 0.0, covariance = 0.0;
    const std::size_t pairs = bank.size() - static_cast<std::size_t>(lag_steps);
    for (std::size_t k = 0; k < pairs; ++k) {
        variance += bank[k] * bank[k];
        covariance += bank[k] * bank[k + static_cast<std::size_t>(lag_steps)];
    }
    CHECK(std::sqrt(variance / static_cast<double>(pairs)) == Approx(p.bank_rms_rad).epsilon(0.1));
    CHECK(covariance / variance == Approx(std::exp(-1.0)).margin(0.1));
}

TEST_CASE("sensors sample every 10 ms onto the J1939 grid", "[unit][plant]") {
    PlantParameters p = shipped();
    Plant plant(p, at(12.0), 2);
    for (int k = 1; k <= 1000; ++k) {
        plant.step(1.0);
        CHECK(plant.sensors().time_s == Approx(0.01 * (k / 10)).margin(1e-12));
        const double raw = (plant.sensors().yaw_rate_radps + 3.92) * 8192.0;
        REQUIRE(raw == Approx(std::round(raw)).margin(1e-6));
    }
    p.yaw_rate_sensor.noise_rms = 0.0;
    p.bank_rms_rad = 0.0;
    p.crosswind_gust_rms_mps = 0.0;
    Plant still(p, at(12.0), 2);
    CHECK(still.sensors().yaw_rate_radps == Approx(4.4e-5).epsilon(0.01).margin(0.0));
}

TEST_CASE("wheel speeds show the turn and the braked wheel's slip", "[unit][plant]") {
    const PlantParameters p = quiet();
    Plant plant(p, at(12.0), 2);
    run(plant, 20.0, -1.0);
    const Sensors& s = plant.sensors();
    CHECK(s.speed_mps == Approx(12.0));
    CHECK((s.wheel_speed_mps[rear_right] - s.wheel_speed_mps[rear_left]) / p.track_m ==
          Approx(plant.truth().yaw_rate_radps).epsilon(1e-3));
    const Truth& t = plant.truth();
    const double along_mps = t.speed_mps * std::cos(t.road_wheel_rad) +
                             (t.lateral_velocity_mps + p.cg_to_front_axle_m * t.yaw_rate_radps) * std::sin(t.road_wheel_rad);
    const double turn_mps = 0.5 * p.track_m * t.yaw_rate_radps * std::cos(t.road_wheel_rad);
    CHECK(s.wheel_speed_mps[front_right] == Approx(along_mps + turn_mps).epsilon(1e-6));
    CHECK(s.wheel_speed_mps[front_left] ==
          Approx((along_mps - turn_mps) * (1.0 - p.brake_force_npbar / p.brake_slip_stiffness_n)).epsilon(1e-5));
    CHECK(s.brake_pressure_left_bar == Approx(1.0).epsilon(1e-3));
    CHECK(s.steering_wheel_rad == Approx(20.0 * plant.truth().road_wheel_rad).epsilon(1e-3));
}

TEST_CASE("the speed profile is followed, and load moves forward when braking", "[unit][plant]") {
    Drive drive;
    drive.speed_profile = {{2.0, 20.0}, {12.0, 10.0}, {13.0, 10.0}};
    Plant plant(quiet(), drive, 1);
    const double front_at_rest_n = plant.truth().wheel_load_n[front_left];
    run(plant, 2.0, 0.0);
    CHECK(plant.truth().speed_mps == Approx(20.0));
    run(plant, 5.0, 0.0);
    CHECK(plant.truth().speed_mps == Approx(15.0));
    const PlantParameters p = quiet();
    const double moment_kgm =
        p.sprung_mass_kg * p.sprung_cg_height_m + (p.mass_kg - p.sprung_mass_kg) * p.unsprung_cg_height_m;
    CHECK(plant.truth().wheel_load_n[front_left] - front_at_rest_n == Approx(0.5 * moment_kgm / p.wheelbase_m));  // 1 m/s^2
    CHECK(sum(plant.truth().wheel_load_n) == Approx(9.81 * p.mass_kg));
    run(plant, 10.0, 0.0);
    CHECK(plant.truth().speed_mps == Approx(10.0));
    CHECK(plant.truth().wheel_load_n[front_left] == Approx(front_at_rest_n));
}

TEST_CASE("a speed change leaves the profile and goes at its rate", "[unit][plant]") {
    Drive drive;
    drive.speed_profile = {{0.0, 10.0}, {10.0, 20.0}};
    drive.speed_changes = {{4.0, 12.0, 0.5}, {7.0, 16.0, 2.0}};
    Plant plant(quiet(), drive, 1);
    for (const double expected : {11.0, 12.0, 13.0, 14.0, 13.5, 13.0, 12.5, 14.5, 16.0, 16.0}) {
        run(plant, 1.0, 0.0);
        CHECK(plant.truth().speed_mps == Approx(expected));
    }
    drive.speed_changes = {{7.0, 16.0, 2.0}, {4.0, 12.0, 0.5}};
    CHECK_THROWS_WITH(Plant(quiet(), drive, 1), ContainsSubstring("order"));
    drive.speed_changes = {{4.0, 31.0, 0.5}};
    CHECK_THROWS_WITH(Plant(quiet(), drive, 1), ContainsSubstring("3 .. 30 m/s"));
    drive.speed_changes = {{4.0, 12.0, 0.0}};
    CHECK_THROWS_WITH(Plant(quiet(), drive, 1), ContainsSubstring("rate"));
    drive.speed_changes = {{4.0, 12.0, 0.5}};
    drive.speed_is_free = true;
    CHECK_THROWS_WITH(Plant(quiet(), drive, 1), ContainsSubstring("coasts"));
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

TEST_CASE("scenario files: the plant's table is read whole or refused", "[unit][plant]") {
    const std::string good = R"(
name = "not the plant's business"
[plant]
speed_profile = [[0, 12], [30.0, 17.0]]
[plant.variation]
load_ratio = 1.4
bank_rms_rad = 0.008
[[plant.sensor_fault]]
signal = "yaw_rate"
start_s = 30.0
end_s = 60.0
gain = -1.0
[[plant.sensor_fault]]
signal = "steering_wheel"
frozen = true
[[plant.actuator_fault]]
extra_delay_s = 0.4
[[plant.surroundings_fault]]
friction_left_ratio = 0.3
[[plant.speed_change]]
start_s = 40.0
speed_mps = 10.0
)";
    const Scenario scenario = parse_scenario(good, "good.toml");
    CHECK(scenario.drive.speed_profile.size() == 2);
    CHECK(scenario.drive.speed_profile[1].speed_mps == 17.0);
    CHECK(scenario.variation.load_ratio == 1.4);
    CHECK(scenario.variation.bank_rms_rad.value_or(0.0) == 0.008);
    REQUIRE(scenario.faults.sensors.size() == 2);
    CHECK(scenario.faults.sensors[0].gain == -1.0);
    CHECK(scenario.faults.sensors[0].window.end_s == 60.0);
    CHECK(scenario.faults.sensors[1].signal == Signal::steering_wheel);
    CHECK(scenario.faults.sensors[1].frozen);
    CHECK(scenario.faults.sensors[1].window.contains(1e6));
    CHECK(scenario.faults.actuators.at(0).extra_delay_s == 0.4);
    CHECK(scenario.faults.surroundings.at(0).friction_left_ratio == 0.3);
    CHECK(scenario.drive.speed_changes.at(0).start_s == 40.0);
    CHECK(scenario.drive.speed_changes.at(0).speed_mps == 10.0);
    CHECK(scenario.drive.speed_changes.at(0).rate_mps2 == 1.0);

    const auto fails = [](const std::string& text, const std::string& expected) {
        CHECK_THROWS_WITH(parse_scenario(text, "bad.toml"), ContainsSubstring("bad.toml") && ContainsSubstring(expected));
    };
    fails("x = 1", "plant: missing");
    fails("[plant]\n", "plant.speed_profile: missing");
    fails(replaced(good, "[[0, 12], [30.0, 17.0]]", "[[0, 40]]"), "expected 3 .. 30");
    fails(replaced(good, "[[0, 12], [30.0, 17.0]]", "[[5, 12], [5, 13]]"), "plant.speed_profile time");
    fails(replaced(good, "[[0, 12], [30.0, 17.0]]", "[12]"), "expected [[time s, speed m/s], ...]");
    fails(replaced(good, "load_ratio", "load"), "plant.variation.load: unknown key");
    fails(replaced(good, "load_ratio = 1.4", "load_ratio = 14"), "plant.variation.load_ratio = 14: expected");
    fails(replaced(good, "\"yaw_rate\"", "\"yaw\""), "expected one of: yaw_rate");
    fails(replaced(good, "end_s = 60.0", "end_s = 20.0"), "expected later than start_s");
    fails(replaced(good, "frozen = true", "frozen = 1"), "expected true or false");
    fails(replaced(good, "[[plant.actuator_fault]]", "[plant.actuator_fault]"), "expected an array of tables");
    fails(replaced(good, "gain = -1.0", "gain = \"x\""), "expected a number");
    fails(replaced(good, "speed_mps = 10.0", "rate_mps2 = 1.0"), "plant.speed_change.speed_mps: missing");
    fails(replaced(good, "speed_mps = 10.0", "speed_mps = 2.0"), "plant.speed_change.speed_mps = 2: expected 3 .. 30");
    CHECK_THROWS_AS(load_scenario("/nowhere.toml"), ParameterError);
}
