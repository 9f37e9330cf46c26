/// @file test_plant_inputs.cpp -- are parameters and scenarios read whole or refused; do seeds, sensors and speed profiles do what they
/// say?
#include "../catch.hpp"

#include <cmath>
#include <string>
#include <vector>

#include "heap_counter.hpp"
#include "plant_drives.hpp"

using namespace plant_drives;
using Catch::Matchers::ContainsSubstring;

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
    CHECK((s.wheel_speed_mps[rear_right] - s.wheel_speed_mps[rear_left]) / p.track_m == Approx(plant.truth().yaw_rate_radps).epsilon(1e-3));
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
    const double moment_kgm = p.sprung_mass_kg * p.sprung_cg_height_m + (p.mass_kg - p.sprung_mass_kg) * p.unsprung_cg_height_m;
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
ramp_s = 20.0
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
    CHECK(scenario.faults.sensors[0].window.ramp_s == 20.0);
    CHECK(scenario.faults.sensors[1].window.ramp_s == 0.0);
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
    fails(replaced(good, "[[0, 12], [30.0, 17.0]]", "[[0, 140]]"), "expected 0.1 .. 100");
    fails(replaced(good, "[[0, 12], [30.0, 17.0]]", "[[5, 12], [5, 13]]"), "plant.speed_profile time");
    fails(replaced(good, "[[0, 12], [30.0, 17.0]]", "[12]"), "expected [[time s, speed m/s], ...]");
    fails(replaced(good, "load_ratio", "load"), "plant.variation.load: unknown key");
    fails(replaced(good, "load_ratio = 1.4", "load_ratio = 14"), "plant.variation.load_ratio = 14: expected");
    fails(replaced(good, "\"yaw_rate\"", "\"yaw\""), "expected one of: yaw_rate");
    fails(replaced(good, "end_s = 60.0", "end_s = 20.0"), "expected later than start_s");
    fails(replaced(good, "ramp_s = 20.0", "ramp_s = -1.0"), "plant.sensor_fault.ramp_s = -1: expected");
    fails(replaced(good, "frozen = true", "frozen = 1"), "expected true or false");
    fails(replaced(good, "[[plant.actuator_fault]]", "[plant.actuator_fault]"), "expected an array of tables");
    fails(replaced(good, "gain = -1.0", "gain = \"x\""), "expected a number");
    fails(replaced(good, "speed_mps = 10.0", "rate_mps2 = 1.0"), "plant.speed_change.speed_mps: missing");
    fails(replaced(good, "speed_mps = 10.0", "speed_mps = 2.0"), "plant.speed_change.speed_mps = 2: expected 3 .. 30");
    CHECK_THROWS_AS(load_scenario("/nowhere.toml"), ParameterError);
}
