/// @file test_plant_motion.cpp -- does the simulated truck move as a truck: forces, tyres, loads, brakes and their limits?
#include "../catch.hpp"

#include <cmath>
#include <limits>
#include <vector>

#include "plant_drives.hpp"

using namespace plant_drives;

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
    const double moment =
        0.5 * p.track_m *
        (t.wheel_load_n[front_right] + t.wheel_load_n[rear_right] - t.wheel_load_n[front_left] - t.wheel_load_n[rear_left]);
    const double unsprung_moment = (p.mass_kg - p.sprung_mass_kg) * p.unsprung_cg_height_m;
    CHECK(moment ==
          Approx((sprung_moment + unsprung_moment) * t.lateral_acceleration_mps2 + 9.81 * sprung_moment * t.roll_rad).epsilon(1e-3));
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
        const auto middle = [&](double Truth::* member) { return 0.5 * (before.*member + after.*member); };
        const double r = middle(&Truth::yaw_rate_radps);
        for (std::size_t i = 0; i < 4; ++i) {
            CAPTURE(k, i);
            const bool front = i == front_left || i == front_right;
            const bool left = i == front_left || i == rear_left;
            const double vx = middle(&Truth::speed_mps) + (left ? -0.5 : 0.5) * p.track_m * r;
            const double vy =
                middle(&Truth::lateral_velocity_mps) + (front ? p.cg_to_front_axle_m : p.cg_to_front_axle_m - p.wheelbase_m) * r;
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
            const double linear_n = -0.5 * axle_n * load_ratio * (1.0 - p.load_sensitivity_ratio * (load_ratio - 1.0)) * after.tyre_slip[i];
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
    CHECK(plant.truth().brake_force_n[front_right] == Approx(0.9 * 0.2 * plant.truth().wheel_load_n[front_right]).epsilon(1e-3));
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
        const double along_n = -(t.tyre_lateral_force_n[front_left] + t.tyre_lateral_force_n[front_right]) * std::sin(t.road_wheel_rad) -
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
        difference_radps = std::fmax(difference_radps, std::fabs(one.truth().yaw_rate_radps - two.truth().yaw_rate_radps));
    }
    CAPTURE(speed_mps, largest_radps, difference_radps);
    CHECK(largest_radps > 0.05);
    CHECK(difference_radps < 1e-4 * largest_radps);
}

TEST_CASE("without input motion dies out and a coasting truck only loses energy", "[unit][plant]") {
    const double speed_mps = GENERATE(8.0, 17.0, 22.0);
    CAPTURE(speed_mps);
    PlantParameters p = quiet();
    p.kingpin_friction_nm = 0.0;  // it would hold the wheels at the angle at which they stop
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
