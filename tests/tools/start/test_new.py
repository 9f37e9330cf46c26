"""A stranger's logs become a project and drives: names, units and signs are found; what is wrong is said."""

import os
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from known_car import KnownCar
from lpvguard.base.errors import InputError
from lpvguard.drives.ingest import ingest
from lpvguard.drives.tables import list_experiments, read_drive
from lpvguard.start.new_project import new
from lpvguard.start.readings import ROLES, Known
from lpvguard.start.signals import Recording, proposed, ranked
from lpvguard.start.templates import TEMPLATES
from lpvguard.vehicle.project import load_project
from made import ROOT

CAR = KnownCar(2.8, 0.003, 0.006, 0.04, 0.0, 0.0)


def write_logs(folder, names=("time", "speed", "steering_angle", "yaw_rate"), scale=(1.0, 1.0, 1.0), n=2):
    """Logs of a known car, with columns of these names, in other units."""
    random, logs = np.random.default_rng(4), []
    for k in range(n):
        d = CAR.drive(random, 6.0 + 4.0 * k, 60.0, f"log_{k}")
        table = np.column_stack([d.t + 100, scale[0] * d.v, scale[1] * d.u, scale[2] * d.y, 0 * d.t + 7])
        path = folder / f"log_{k}.csv"
        np.savetxt(path, table, "%.9g", ",", header=",".join([*names, "counter"]), comments="")
        path.write_text("# written by a logger\n" + path.read_text())
        logs.append(path)
    return logs


UNITS = {
    "SI": ((1.0, 1.0, 1.0), ("m/s", "rad", "rad/s"), 1.0),
    "km/h": ((3.6, 1.0, 1.0), ("km/h", "rad", "rad/s"), 1.0),
    "degrees a second": ((1.0, 1.0, 180 / np.pi), ("m/s", "rad", "deg/s"), 1.0),
    "turned round": ((1.0, -1.0, 1.0), ("m/s", "rad", "rad/s"), -1.0),
    "steering wheel": ((1.0, 16.0, 1.0), ("m/s", "rad", "rad/s"), 1 / 16),
}


@pytest.mark.parametrize("name", UNITS)
def test_units_and_signs_follow_from_the_wheelbase(tmp_path, name):
    scale, units, factor = UNITS[name]
    logs = write_logs(tmp_path, scale=scale)
    said = {"input": "rad"} if name == "km/h" else None  # it may be a share of full lock, beside miles
    made = new("mine", logs, tmp_path / "out", wheelbase_m=2.8, units=said)
    assert tuple(p.unit for p in made.proposals.values()) == units
    assert abs(made.proposals["input"].factor / factor - 1) < 0.25
    project = load_project(tmp_path / "out" / "mine.toml")
    drive = read_drive(tmp_path / "out" / "drives" / "log_0.csv", project)
    assert abs(drive.v.mean() - 6.0) < 0.3 and project.Ts_s == 0.02
    assert [e.split for e in list_experiments(tmp_path / "out" / "drives")] == ["train", "valid"]


NAMED_UNITS = {
    "mph": (("speed_mph", "steering_angle", "yaw_rate"), (1 / 0.44704, 1.0, 1.0), ("mph", "rad", "rad/s")),
    "radps": (("speed", "steering_angle", "yaw_rate_radps"), (1.0, 1.0, 1.0), ("m/s", "rad", "rad/s")),
    "dps": (("speed", "steering_angle", "yaw_rate_dps"), (1.0, 1.0, 180 / np.pi), ("m/s", "rad", "deg/s")),
    "brackets": (
        ("Speed [km/h]", "Steering angle [deg]", "yaw_rate [deg/s]"),
        (3.6, 180 / np.pi, 180 / np.pi),
        ("km/h", "deg", "deg/s"),
    ),
}


@pytest.mark.parametrize("case", NAMED_UNITS)
def test_the_unit_in_a_name_is_read_as_words(tmp_path, case):
    names, scale, units = NAMED_UNITS[case]
    logs = write_logs(tmp_path, ("time", *names), scale)
    made = new("mine", logs, tmp_path / "out", wheelbase_m=2.8)
    assert tuple(p.unit for p in made.proposals.values()) == units


def test_miles_an_hour_without_a_word_follow_from_the_wheelbase(tmp_path):
    logs = write_logs(tmp_path, scale=(1 / 0.44704, 1.0, 1.0))
    made = new("mine", logs, tmp_path / "out", wheelbase_m=2.8, units={"input": "rad"})
    assert [p.unit for p in made.proposals.values()] == ["mph", "rad", "rad/s"]


ASKED = {
    "speed at a steering wheel": (
        (3.6, 15 * 180 / np.pi, 180 / np.pi),
        {"speed": "km/h"},
        ("km/h", "deg", "deg/s"),
        1 / 15,
    ),
    "steering at low speed": ((1.0, 180 / np.pi, 1.0), {"input": "Grad"}, ("m/s", "deg", "rad/s"), 1.0),
}


@pytest.mark.parametrize("name", ASKED)
def test_where_two_readings_fit_the_option_that_settles_it_is_named(tmp_path, name):
    scale, settled, units, factor = ASKED[name]
    logs = write_logs(tmp_path, scale=scale)
    role = next(iter(settled))
    said = rf"readings fit: .*; expected .*--{role}-unit {units[ROLES.index(role)]}"
    with pytest.raises(InputError, match=said):
        new("mine", logs, tmp_path / "out", wheelbase_m=2.8)
    made = new("mine", logs, tmp_path / "out", wheelbase_m=2.8, units=settled)
    assert tuple(p.unit for p in made.proposals.values()) == units
    assert abs(made.proposals["input"].factor / factor - 1) < 0.15
    with pytest.raises(InputError, match=f"--{role}-unit: furlong"):
        new("mine", logs, tmp_path / "other", wheelbase_m=2.8, units={role: "furlong"})


def test_a_share_of_full_lock_is_taken_for_no_angle_and_miles_an_hour(tmp_path):
    logs = write_logs(tmp_path, scale=(1.0, 1 / 0.45, 1.0))
    with pytest.raises(InputError, match=r"2 readings fit: .* as a share of .* --input-unit '0\.4\d rad'"):
        new("mine", logs, tmp_path / "out", wheelbase_m=2.8)
    logs = write_logs(tmp_path, ("time", "speed_mps", "steering", "yaw_rate"), (1.0, 1 / 0.45, 1.0))
    with pytest.raises(InputError, match=r"no more readings fit: .* as a share of full lock"):
        new("mine", logs, tmp_path / "out", wheelbase_m=2.8)
    made = new("mine", logs, tmp_path / "out", wheelbase_m=2.8, units={"input": "0.45 rad"})
    assert [p.unit for p in made.proposals.values()] == ["m/s", "0.45 rad", "rad/s"]


def test_units_of_log_and_name_that_differ_are_named():
    t = np.arange(0.0, 60.0, 0.05)
    delta = 0.02 * np.sin(0.5 * t)
    values = {"speed": 10 + np.sin(0.1 * t), "steering_deg": delta, "yaw_rate": 3.5 * delta}
    for units, says in (
        ({"steering_deg": "rad"}, "steering_deg: two units: the log states rad, its name deg"),
        ({"yaw_rate": "m/s"}, "yaw_rate: its unit is m/s, none of a yaw rate"),
    ):
        with pytest.raises(InputError, match=says):
            proposed([Recording("a", t, values, units)], {}, Known("car", 2.7))
    named = {"speed": values["speed"], "steering_deg": np.degrees(delta), "yaw_rate_kmh": values["yaw_rate"]}
    with pytest.raises(InputError, match="yaw_rate_kmh: its name states km/h, none of a yaw rate"):
        proposed([Recording("a", t, named, {})], {}, Known("car", 2.7))


def test_one_column_is_never_input_and_output(tmp_path):
    logs = write_logs(tmp_path)
    with pytest.raises(InputError, match="yaw_rate is both"):
        new("mine", logs, tmp_path / "out", wheelbase_m=2.8, chosen={"input": "yaw_rate"})


@pytest.mark.slow("2 s a template: a fit")
@pytest.mark.parametrize(
    "model",
    [
        name
        if name in ("bicycle", "table-1")
        else pytest.param(name, marks=pytest.mark.long("3 s: another fit"))
        for name in TEMPLATES
    ],
)
def test_every_template_is_a_project_that_can_be_fitted(tmp_path, model, lpvguard):
    logs = write_logs(tmp_path, n=3)
    done = lpvguard("new", "mine", *logs, "--model", model, "--wheelbase", 2.8, "-o", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    vehicle = tmp_path / "out" / "mine.toml"
    fitted = lpvguard("fit", "--vehicle", vehicle, tmp_path / "out" / "drives", "-o", tmp_path / "fit")
    assert fitted.returncode in (0, 1), fitted.stderr
    project = load_project(tmp_path / "fit" / "mine.toml")
    if model == "yaw-first-order":
        assert abs(project.model.parameters["L"] - 2.8) < 0.25
        assert abs(project.model.input_delay_s - 0.04) < 0.01
    if model == "table-1":
        p = project.model.parameters
        assert abs(p["l"] - 2.8) < 0.25 and abs(-p["p2"] / p["p1"] - 0.003) < 0.001
        truck = load_project("truck").model
        assert (project.model.A[0][0], project.model.B[0][0]) == tuple(truck.A[0][:2])


def test_names_are_ranked_by_what_they_say():
    names = ["wheel_speed_fl", "vehicle_speed", "steer_rate", "steering_angle", "cmd_steer", "yaw_rate", "ay"]
    assert ranked("speed", names)[0] == "vehicle_speed"
    assert ranked("speed", ["VitesseRoueAVG", "VitesseVehicule"])[0] == "VitesseVehicule"
    assert ranked("input", names)[0] == "steering_angle"
    assert ranked("output", names) == ["yaw_rate"]


def test_units_and_messages_rank_the_signals_of_a_database():
    """Names as public databases of cars have them."""
    units = {
        "ACC_HUD.PCM_SPEED": "kph",
        "CAR_SPEED.CAR_SPEED": "kph",
        "ESP_02.ESP_VZ_Gierrate": "",
        "ESP_02.ESP_Gierrate": "Unit_DegreOfArcPerSecon",
        "ESP_21.ESP_v_Signal": "Unit_KiloMeterPerHour",
        "LH_EPS_03.EPS_Lenkmoment": "Unit_centiNewtoMeter",
        "LWI_01.LWI_Lenkradwinkel": "Unit_DegreOfArc",
        "STEER_STATUS.STEER_STATUS": "",
        "LTA_RELATED.STEER_ANGLE": "",
        "ParkAid_Data.ExtSteeringAngleReq": "Degrees",
        "Lane_Keep.Steer_Angle_Req": "deg",
        "Steering_Wheel_Data.SteWhlRelCalib_An_Sns": "deg",
    }
    assert ranked("speed", units, units)[:2] == ["CAR_SPEED.CAR_SPEED", "ESP_21.ESP_v_Signal"]
    assert ranked("input", units, units)[0] == "LWI_01.LWI_Lenkradwinkel"
    assert ranked("input", list(units)[-2:], units)[0] == "Steering_Wheel_Data.SteWhlRelCalib_An_Sns"
    assert ranked("output", units, units)[0] == "ESP_02.ESP_Gierrate"


@pytest.mark.parametrize(
    ("topics", "first"),
    [
        (
            "odom.twist.twist.linear.x odom.twist.twist.angular.z drive.drive.speed "
            "drive.drive.steering_angle core.state.speed",
            ("odom.twist.twist.linear.x", "drive.drive.steering_angle", "odom.twist.twist.angular.z"),
        ),
        (
            "drive.drive.speed drive.drive.steering_angle odom.twist.twist.linear.x "
            "ackermann_feedback.drive.steering_angle imu_raw.angular_velocity.z",
            (
                "odom.twist.twist.linear.x",
                "ackermann_feedback.drive.steering_angle",
                "imu_raw.angular_velocity.z",
            ),
        ),
        (
            "control_cmd.longitudinal.speed velocity_status.lateral_velocity control_cmd.steering_tire_angle "
            "velocity_status.longitudinal_velocity velocity_status.heading_rate steer.steering_tire_angle",
            (
                "velocity_status.longitudinal_velocity",
                "steer.steering_tire_angle",
                "velocity_status.heading_rate",
            ),
        ),
        (
            "tx_steer_rpt.command tx_steer_rpt.output speed_rpt.vehicle_speed imu.rotation_rate.1 "
            "imu.rotation_rate.2",
            ("speed_rpt.vehicle_speed", "tx_steer_rpt.output", "imu.rotation_rate.2"),
        ),
        (
            "THR.DesSpeed THR.Speed STER.DesTurnRate IMU.GyrX IMU.GyrZ ControlsOut_SteeringSteer",
            ("THR.Speed", "ControlsOut_SteeringSteer", "IMU.GyrZ"),
        ),
        (
            "/carState/vEgo /carState/steeringAngleDeg /carControl/steeringAngleDeg /carState/yawRate",
            ("/carState/vEgo", "/carState/steeringAngleDeg", "/carState/yawRate"),
        ),
        (
            "ABS_1::VehSpd[km/h] LWS_1::LWS_Angle[deg] ESP_2::YawRate[deg/s]",
            ("ABS_1::VehSpd[km/h]", "LWS_1::LWS_Angle[deg]", "ESP_2::YawRate[deg/s]"),
        ),
        (
            "Group1/Vx_[m/s] CAN/SWA(0.1deg) IMU\\psi_dot_[rad/s]",
            ("Group1/Vx_[m/s]", "CAN/SWA(0.1deg)", "IMU\\psi_dot_[rad/s]"),
        ),
        (
            "\u8f66\u901f(km/h) \u65b9\u5411\u76d8\u8f6c\u89d2(deg) \u6a2a\u6446\u89d2\u901f\u5ea6(deg/s)",
            (
                "\u8f66\u901f(km/h)",
                "\u65b9\u5411\u76d8\u8f6c\u89d2(deg)",
                "\u6a2a\u6446\u89d2\u901f\u5ea6(deg/s)",
            ),
        ),
    ],
)
def test_measurements_come_before_commands_in_the_topics_of_vehicles(topics, first):
    assert tuple(ranked(role, topics.split())[0] for role in ROLES) == first


SAME_WORDS = {
    "speed": (
        "VehSpdAvgHSC2 km/h",
        "VITESSE_VEHICULE km/h",
        "BR1_Rad_kmh",
        "Geschwindigkeit km/h",
        "WHL_SPD_FL km/h",
        "velocidad_kmh",
        "prędkość",
        "INS_Vel_Hor_X",
        "u",
        "SOG kn",
        "velocidade_kmh",
        "V_VEH",
        "vFzg",
    ),
    "input": (
        "StrgWhlAngHSC2 deg",
        "SteWhlComp_An_Est deg",
        "STEERING_ALT.ANGLE deg",
        "angle_volant",
        "EPS_internalSAS",
        "SW_pos_obd",
        "SteerAng °",
        "HWA",
        "stuurhoek",
        "kąt_skrętu_kierownicy",
        "servo_angle",
        "Angolo_sterzo",
        "StrWhlAg",
        "AVL_STEA_DV",
        "AngVol",
    ),
    "output": (
        "IMU_YawRtVal deg/s",
        "RCM_IMU_Yaw deg/s",
        "VITESSE_LACET Degré/s",
        "BR5_Giergeschw",
        "YAW.Rate",
        "omega(rad/s)",
        "psi_dot",
        "dpsi_dt",
        "gz_dps",
        "Yaw_deg/s",
        "ang_vel_z",
        "IMU_gyro.z",
        "z_rate_of_rotation",
        "GPS_Gyro",
        "Gyro_Yaw_Velocity",
        "velocidad_guiñada",
        "girhastighet",
        "AVz deg/s",
        "VYAW_VEH",
        "yaw_dot",
        "ZRate",
    ),
}
OTHER_QUANTITIES = {
    "speed": (
        "REL_SPEED m/s",
        "CRUISE_SET_SPEED km/h",
        "TSR_Speed km/h",
        "SpeedLim_Nav km/h",
        "ENGINE_SPEED",
        "SpeedSetpt m/s",
    ),
    "input": (
        "STEER_TORQUE Nm",
        "couple_volant",
        "STEER_ANGLE_RATE deg/s",
        "STEER_CONFIG_INDEX",
        "STEER_WARN",
        "StePinRelInit_An_Sns deg",
        "DAS_maxAbsSteeringWheelAngle deg",
        "WprWash_R_Sw_Posn_V2",
        "DI_steeringAngleOffset deg",
    ),
    "output": (
        "ESP_yawRateQF",
        "TrlrYaw_W_Actl rad/s",
        "Offset_Gierrate deg/s",
        "CR_Mcu_MotActRotSpd_rpm rpm",
        "X-axis_rate_of_rotation deg/s",
        "gyro_y",
        "IMU_yaw",
        "roll_rate",
        "YAW_RATE_STAT",
        "yaw_acc",
        "HIGH_YAW_ANGLE deg",
    ),
}


@pytest.mark.parametrize("role", ROLES)
def test_names_in_other_words_are_known_and_other_quantities_are_not(role):
    for text in SAME_WORDS[role]:
        name, _, unit = text.partition(" ")
        assert ranked(role, [name], {name: unit}) == [name], text
    for text in OTHER_QUANTITIES[role]:
        name, _, unit = text.partition(" ")
        assert ranked(role, [name], {name: unit}) == [], text


def write_speed(log: Path, value: str) -> None:
    """Write ``value`` as the speed of one sample."""
    lines = log.read_text().splitlines()
    cells = lines[500].split(",")
    cells[1] = value
    lines[500] = ",".join(cells)
    log.write_text("\n".join(lines) + "\n")


def test_a_spike_is_a_missing_sample_and_not_a_refused_table(tmp_path):
    logs = write_logs(tmp_path)
    write_speed(logs[0], "-80.0")
    made = new("mine", logs, tmp_path / "out", wheelbase_m=2.8)
    drive = read_drive(tmp_path / "out" / "drives" / "log_0.csv", made.project)
    assert drive.v.min() > 4.0 and len(drive.t) == 3000


def test_what_cannot_be_is_refused_by_name(tmp_path):
    logs = write_logs(tmp_path, names=("time", "speed", "a", "yaw_rate"))
    with pytest.raises(InputError, match="no name looks like the input; expected --input NAME, one of"):
        new("mine", logs, tmp_path / "out", wheelbase_m=2.8)
    made = new("mine", logs, tmp_path / "out", wheelbase_m=2.8, chosen={"input": "a"})
    assert made.proposals["input"].why[0] == "chosen by you"
    with pytest.raises(InputError, match=r"no units make a model of them"):
        new("mine", logs, tmp_path / "other", wheelbase_m=0.2, chosen={"input": "a"})
    with pytest.raises(InputError, match="--model: truck"):
        new("mine", logs, tmp_path / "other", model="truck")


def test_a_vehicles_name_is_checked_before_anything_is_read(tmp_path):
    for name in ("my car", 'a"b', "../x", "Überauto", ""):
        with pytest.raises(InputError, match=r"NAME: .*lower case letters, digits and _"):
            new(name, [tmp_path / "none.csv"], tmp_path / "out")


TIMES = {
    "a second or a thousandth": (lambda t: 50 * t, "steps of 1 are a second, or a thousandth"),
    "whole seconds": (np.floor, "time of speed: the median step is 0 s"),
    "the last sample first": (lambda t: -t, "column time: 100% of its steps go back"),
    "a jump of 30,000 years": (lambda t: t + 1e12 * (t > 130), "line 1504, column time: a time of 1e.12 s"),
}


@pytest.mark.parametrize("name", TIMES)
def test_times_that_are_none_are_named_with_their_step_or_line(tmp_path, name):
    as_written, says = TIMES[name]
    logs = write_logs(tmp_path)
    for log in logs:
        samples = np.genfromtxt(log, delimiter=",", skip_header=2)
        samples[:, 0] = as_written(samples[:, 0])
        header = "time,speed,steering_angle,yaw_rate,counter"
        np.savetxt(log, samples, "%.9g", ",", header=f"# written by a logger\n{header}", comments="")
    with pytest.raises(InputError, match=says):
        new("mine", logs, tmp_path / "out", wheelbase_m=2.8)
    assert not (tmp_path / "out").exists()


def test_signals_that_never_meet_are_named(tmp_path):
    logs = write_logs(tmp_path, n=1)
    lines = logs[0].read_text().splitlines()
    for k, line in enumerate(lines[2:], start=2):  # a speed in the first half, a yaw rate in the second
        cells = line.split(",")
        cells[1 if k > 1500 else 3] = ""
        lines[k] = ",".join(cells)
    logs[0].write_text("\n".join(lines) + "\n")
    with pytest.raises(InputError, match=r"nowhere recorded at the same time"):
        new("mine", logs, tmp_path / "out")


def test_one_impossible_value_moves_no_proposal(tmp_path):
    logs = write_logs(tmp_path)
    usual = new("mine", logs, tmp_path / "usual", wheelbase_m=2.8)
    write_speed(logs[0], "1e308")
    made = new("mine", logs, tmp_path / "out", wheelbase_m=2.8)
    assert made.proposals == usual.proposals and made.project == usual.project


def test_signals_may_be_called_anything(tmp_path):
    names = ("time", 'vehicle speed "gps"', "Steering-Angle \\ #1", 'yaw rate = "z"')
    logs = write_logs(tmp_path, names=[n.replace('"', '""').join('""') for n in names])
    made = new("mine", logs, tmp_path / "out", wheelbase_m=2.8)
    assert [p.name for p in made.proposals.values()] == [*names[1:]]
    again = ingest(logs, dbc=None, signals_map=tmp_path / "out" / "signals.toml", out=tmp_path / "again")
    assert again["log_0"]["drives"][0]["rows"] == 3000
    assert load_project(tmp_path / "out" / "mine.toml").signals == made.project.signals


def test_logs_may_be_called_anything(tmp_path):
    logs = [
        log.rename(tmp_path / name)
        for log, name in zip(write_logs(tmp_path), ('a "wet", one.csv', "a\nb.csv"), strict=True)
    ]
    new("mine", logs, tmp_path / "out", wheelbase_m=2.8)
    experiments = list_experiments(tmp_path / "out" / "drives")
    assert sorted((e.name, e.recording) for e in experiments) == sorted((log.stem, log.stem) for log in logs)


def test_a_signal_that_stands_still_is_told_apart_from_none(tmp_path):
    logs = write_logs(tmp_path, scale=(0.0, 1.0, 1.0))
    with pytest.raises(InputError, match="--speed: speed never moves"):
        new("mine", logs, tmp_path / "out", wheelbase_m=2.8)


def test_the_database_of_another_bus_is_named(tmp_path):
    log = tmp_path / "log.log"
    log.write_text("".join(f"({k / 100:.6f}) can0 123#0011223344556677\n" for k in range(100)))
    with pytest.raises(InputError, match="it is the database of another bus"):
        new("mine", [log], tmp_path / "out")


def test_a_folder_is_its_logs_without_the_index(tmp_path, lpvguard):
    (tmp_path / "logs").mkdir()
    write_logs(tmp_path / "logs")
    (tmp_path / "logs" / "experiments.csv").write_text("experiment,split\nlog_0,train\n")
    (tmp_path / "logs" / "notes.pdf").write_text("no log")
    done = lpvguard("new", "mine", tmp_path / "logs", "--wheelbase", 2.8, "-o", tmp_path / "out")
    assert done.returncode == 0 and "left out" not in done.stderr
    (tmp_path / "empty").mkdir()
    refused = lpvguard("new", "mine", tmp_path / "empty", "-o", tmp_path / "other")
    assert refused.returncode == 2 and "holds no log" in refused.stderr


@pytest.mark.skipif(sys.platform == "win32", reason="names are Unicode there")
def test_a_log_whose_name_is_no_utf8_is_named(tmp_path, lpvguard):
    (tmp_path / "logs").mkdir()
    log = write_logs(tmp_path / "logs")[0].rename(tmp_path / "logs" / os.fsdecode(b"f\xe4hrt.csv"))
    for path in (log.parent, log):
        done = lpvguard("new", "mine", path, "-o", tmp_path / "out")
        assert done.returncode == 2 and r"f\xe4hrt.csv': the name is not UTF-8" in done.stderr


def test_the_command_says_what_to_do_next(tmp_path, lpvguard):
    logs = write_logs(tmp_path)
    done = lpvguard("new", "mine", *logs, "-o", tmp_path / "out")
    assert done.returncode == 0 and "no wheelbase given" in done.stderr
    assert f"lpvguard fit --vehicle {tmp_path}/out/mine.toml" in done.stderr
    assert not (ROOT / "mine.toml").exists()


@pytest.mark.parametrize("bit", ["Steering_Angle_Sign", "LW1_Vorzeichen", "VZ", "Direction"])
def test_a_magnitude_beside_its_sign_is_refused(bit):
    """As the buses of the VW group have them; without its sign it would be taken for the signal."""
    t = np.arange(0.0, 60.0, 0.1)
    delta = 0.02 * np.sin(0.5 * t)
    values = {
        "A.Speed": 10 + 0 * t,
        "B.Steering_Angle": np.abs(delta),
        f"B.{bit}": (delta < 0) + 0.0,
        "C.Yaw_Rate": 4 * delta,
    }
    units = {"A.Speed": "m/s", "B.Steering_Angle": "rad", f"B.{bit}": "", "C.Yaw_Rate": "rad/s"}
    log = Recording("a", t, values, units)
    chosen = {"speed": "A.Speed", "input": "B.Steering_Angle", "output": "C.Yaw_Rate"}
    with pytest.raises(InputError, match=f"never negative; B.{bit} holds its sign"):
        proposed([log], chosen, Known("car", 2.7))
    signed = replace(log, values=values | {"B.Steering_Angle": delta})
    assert proposed([signed], chosen, Known("car"))["input"].name == "B.Steering_Angle"


@pytest.mark.parametrize("folded", [("steering_angle",), ("yaw_rate",), ("steering_angle", "yaw_rate")])
def test_magnitudes_without_any_sign_are_refused_unless_they_are_named(folded):
    t = np.arange(0.0, 60.0, 0.1)
    delta = 0.02 * np.sin(0.5 * t)
    values = {"speed": 10 + np.sin(0.1 * t), "steering_angle": delta, "yaw_rate": 4 * delta}
    log = Recording("a", t, values | {n: np.abs(values[n]) for n in folded}, {})
    with pytest.raises(InputError, match=f"{' and '.join(folded)}: never negative, though near 0 many times"):
        proposed([log], {}, Known("car", 2.7))
    if len(folded) == 2:
        chosen = {"input": "steering_angle", "output": "yaw_rate"}
        assert proposed([log], chosen, Known("car", 2.7), {"speed": "m/s", "input": "rad", "output": "rad/s"})
    backwards = replace(log, values=values | {"speed": -values["speed"]})
    with pytest.raises(InputError, match="--speed: speed is not positive"):
        proposed([backwards], {}, Known("car", 2.7))


def test_a_command_in_place_of_a_measurement_is_named():
    t = np.arange(0.0, 60.0, 0.1)
    delta = 0.02 * np.sin(0.5 * t)
    values = {"speed_mps": 10 + np.sin(0.1 * t), "steering_cmd_rad": delta, "yaw_rate_radps": 4 * delta}
    made = proposed([Recording("a", t, values, {})], {}, Known("car", 2.7))
    assert "by its name, which says a command and no measurement" in made["input"].why


@pytest.mark.parametrize("held", [True, False])
def test_the_rate_is_that_of_the_signals_and_not_of_the_table_they_are_merged_in(tmp_path, held):
    """Topics of 25 Hz in a table of 200 Hz, which repeats their values or leaves cells empty."""
    logs = write_logs(tmp_path)
    for log in logs:
        rows = np.genfromtxt(log, delimiter=",", skip_header=2)[::2]
        cells = [[f"{x:.9g}" for x in row] for row in rows]
        empty = [""] * 4
        merged = [
            [f"{rows[k, 0] + 0.005 * j:.3f}", *(cells[k][1:] if held or j == 0 else empty)]
            for k in range(len(rows))
            for j in range(8)
        ]
        header = "time,speed,steering_angle,yaw_rate,counter"
        log.write_text("\n".join([header, *(",".join(row) for row in merged)]) + "\n")
    made = new("mine", logs, tmp_path / "out", wheelbase_m=2.8)
    assert made.project.Ts_s == 0.04


def test_a_single_log_of_one_drive_becomes_two_drives(tmp_path):
    logs = write_logs(tmp_path, n=1)
    new("mine", logs, tmp_path / "out", wheelbase_m=2.8)
    listed = list_experiments(tmp_path / "out" / "drives")
    assert [(e.name, e.split, e.recording) for e in listed] == [
        ("log_0_1", "train", "log_0"),
        ("log_0_2", "valid", "log_0"),
    ]


def test_days_and_drivers_of_the_logs_become_groups(tmp_path):
    names = [f"2026-04-2{2 + k // 2}_{k}_driver_Kim.csv" for k in range(4)]
    for log, name in zip(write_logs(tmp_path, n=4), names, strict=True):
        log.rename(tmp_path / name)
    made = new("mine", [tmp_path / name for name in names], tmp_path / "out", wheelbase_m=2.8)
    groups = [e.group for e in list_experiments(tmp_path / "out" / "drives")]
    assert groups == ["2026-04-22 Kim", "2026-04-22 Kim", "2026-04-23 Kim", "2026-04-23 Kim"]
    assert made.notes[-1] == "groups, each left out in turn: 2026-04-22 Kim, 2026-04-23 Kim"
