"""Databases of opendbc: every one opens, and the signals of its cars are proposed right.

LPVGUARD_SOURCES names a folder of clones; opendbc is not committed here. The right signals are those that the
car ports of opendbc read (opendbc/car/*/carstate.py), and others of the same quantity in the same database.
"""

import json
import math
import os
import re
import subprocess
import sys
import warnings
from pathlib import Path

import pytest

from lpvguard.base.errors import InputError
from lpvguard.can.decode import load_database
from lpvguard.can.sign_bits import sign_bits
from lpvguard.start.new_project import new
from lpvguard.start.signals import ranked
from steered_car import STEERING_RATIO, write_logs

OPENDBC = Path(os.environ.get("LPVGUARD_SOURCES", "/nonexistent")) / "opendbc"
pytestmark = [
    pytest.mark.skipif(not OPENDBC.is_dir(), reason="no clone of opendbc: set LPVGUARD_SOURCES"),
    pytest.mark.slow(60, "loads all databases of opendbc"),
]
ROLES = ("speed", "input", "output")
HONDA = (r"CAR_SPEED\.CAR_SPEED|ENGINE_DATA\.XMISSION_SPEED", r"STEERING_SENSORS\.STEER_ANGLE", None)
TOYOTA = (r"SPEED\.SPEED", r"STEER_ANGLE_SENSOR\.STEER_ANGLE", r"KINEMATICS\.YAW_RATE")
HYUNDAI = (r"WHL_SPD1?1?\.WHL_SPD_..", r"SAS1?1\.SAS_Angle", r"ESP1?2\.YAW_RATE")
SUBARU = (r"Brake_Pedal\.Speed|Wheel_Speeds\...", r"Steering(_2|_Torque)?\.Steering_Angle", None)
NISSAN = (r"WHEEL_SPEEDS_\w+\.WHEEL_SPEED_..", r"STEER_(ANGLE|TORQUE)_SENSOR\.STEER_ANGLE", None)
CHRYSLER = (r"ESP_[18]\.Vehicle_Speed|SPEED_1\.SPEED_(LEFT|RIGHT)", r"STEERING\.STEERING_ANGLE", None)
MQB = (r"ESP_(01|21)\.ESP_v_Signal", r"LWI_01\.LWI_Lenkradwinkel", r"ESP_02\.ESP_Gierrate")
MEB = (
    r"ESP_21\.ESP_v_Signal|ESC_50\.Longitudinal_Speed|ESC_51\.._Radgeschw",
    r"LWI_01\.LWI_Lenkradwinkel",
    r"ESC_50\.Yaw_Rate",
)
CARS = {
    "acura_rdx_2018_can_generated": HONDA,
    "bmw_e9x_e8x": (r"Speed\.VehicleSpeed", r"SteeringWheelAngle\w*\.SteeringPosition", r"\w+\.YawRate"),
    "cadillac_ct6_powertrain": (
        r"ECMVehicleSpeed\.VehicleSpeed",
        r"PSCMSteeringAngle\.SteeringWheelAngle",
        r"EBCMVehicleDynamic\.YawRate",
    ),
    "chrysler_pacifica_2017_hybrid_generated": CHRYSLER,
    "chrysler_ram_dt_generated": (*CHRYSLER[:2], r"ESP_4\.Yaw_Rate"),
    "fca_giorgio": (r"\w+\.VEHICLE_SPEED", r"EPS_1\.STEERING_ANGLE", r"ABS_2\.YAW_RATE"),
    "ford_cgea1_2_ptcan_2011": (
        r"\w+\.Veh_V_Actl(Brk|Eng)",
        r"BrakeSnData_2_CG1\.SteWhlComp_An_Est",
        r"Yaw_Data\.VehYaw_W_Actl",
    ),
    "ford_lincoln_base_pt": (
        r"BrakeSysFeatures\.Veh_V_ActlBrk",
        r"SteeringPinion_Data(_Alt)?\.StePinComp_An_Est",
        r"Yaw_Data_FD1\.VehYaw_W_Actl",
    ),
    "gm_global_a_powertrain_generated": (
        r"ECMVehicleSpeed\.VehicleSpeed",
        r"PSCMSteeringAngle\.SteeringWheelAngle",
        r"EBCMVehicleDynamic\.YawRate2",
    ),
    "honda_civic_touring_2016_can_generated": HONDA,
    "hyundai_2015_ccan": HYUNDAI,
    "hyundai_can_generated": HYUNDAI,
    "hyundai_canfd_generated": (
        r"WHEEL_SPEEDS\.WHL_Spd..Val",
        r"STEERING_SENSORS\.STEERING_ANGLE",
        r"\w+\.(IMU|ESC)_YawRtVal",
    ),
    "hyundai_i30_2014": HYUNDAI,
    "hyundai_palisade_2023_generated": HYUNDAI,
    "mazda_2017": (r"(ENGINE_DATA|CURVE_CTRS)\.SPEED", r"STEER\.STEER_ANGLE", None),
    "mg": (r"SCS_HSC2_FrP19\.VehSpdAvgHSC2", r"SAS_HSC2_FrP00\.StrgWhlAngHSC2", None),
    "nissan_leaf_2018_generated": NISSAN,
    "nissan_x_trail_2017_generated": NISSAN,
    "psa_aee2010_r3": (
        r"HS2_DYN_ABR_38D\.VITESSE_VEHICULE_ROUES|Dyn4_FRE\.P26\d_VehV\w+",
        r"STEERING_ALT\.ANGLE",
        r"HS2_DYN_UCF\w*\.VITESSE_LACET(_BRUTE)?",
    ),
    "rivian_primary_actuator": (
        r"(ESP_Status\.ESP_Vehicle_Speed|ESPiB1\.ESPiB1_VehicleSpeed)",
        r"EPAS_AdasStatus\.EPAS_InternalSas",
        r"RCM_IMU_LatAccYaw\.RCM_IMU_Yaw",
    ),
    "subaru_global_2017_generated": SUBARU,
    "subaru_outback_2019_generated": SUBARU,
    "tesla_can": (
        r"ESP_B\.ESP_vehicleSpeed|DI_torque2\.DI_vehicleSpeed",
        r"STW_ANGL(HP)?_STAT\.StW_Angl(HP)?|EPAS_sysStatus\.EPAS_internalSAS",
        None,
    ),
    "tesla_model3_party": (
        r"DI_speed\.DI_vehicleSpeed|ESP_B\.ESP_vehicleSpeed",
        r"EPAS3S_sysStatus\.EPAS3S_internalSAS|SCCM_steeringAngleSensor\.SCCM_steeringAngle",
        None,
    ),
    "toyota_new_mc_pt_generated": TOYOTA,
    "toyota_nodsu_pt_generated": TOYOTA,
    "toyota_prius_2010_pt": TOYOTA,
    "toyota_secoc_pt_generated": TOYOTA,
    "toyota_tnga_k_pt_generated": TOYOTA,
    "volvo_v60_2015_pt": (r"VehicleSpeed1\.VehicleSpeed", r"(SAS0|fromWhere)\.SteeringAngle", None),
    "vw_meb_2024_generated": MEB,
    "vw_meb_generated": MEB,
    "vw_mlb": MQB,
    "vw_mqb": MQB,
    "vw_mqbevo": MQB,
    "vw_pq": (
        r"Bremse_1\.BR1_Rad_kmh",
        r"Lenkwinkel_1\.LW1_LRW|Lenkhilfe_3\.LH3_BLW",
        r"Bremse_5\.BR5_Giergeschw",
    ),
}
"""By database: pattern of the right signal by role; None where it has none, and none is the right answer."""
WHOLE = [name for name, right in CARS.items() if None not in right]
"""Databases that have all three signals."""
UNSAID = {"": {"speed": 3.6, "input": math.degrees(1), "output": math.degrees(1)}}
PER_SI = {
    "m/s": 1.0,
    "mph": 1 / 0.44704,
    "rad/s": 1.0,
    "[Kk](m[/^]|p)h|[Uu]nit_Kilo[Mm]eterPerHour": 3.6,
    "kph|KPH|Kph": 3.6,
    ".*([Dd]eg|[Gg]rad|Degr).*": math.degrees(1),
}
"""Pattern of a database's unit -> its size in an SI unit, inverted."""


@pytest.fixture(scope="module")
def databases(tmp_path_factory):
    """Folder of all databases, those that opendbc generates too."""
    folder = tmp_path_factory.mktemp("opendbc")
    for path in OPENDBC.glob("opendbc/dbc/*.dbc"):
        (folder / path.name).write_bytes(path.read_bytes())
    program = (
        "import json; from opendbc.dbc.generator.generator import generate_all as g; print(json.dumps(g()))"
    )
    said = subprocess.run(
        [sys.executable, "-c", program], cwd=OPENDBC, capture_output=True, check=True, text=True
    )
    for name, text in json.loads(said.stdout).items():
        (folder / f"{name}.dbc").write_text(text)
    return folder


def load(path):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return load_database(path)


def test_every_database_opens(databases):
    paths = sorted(databases.glob("*.dbc"))
    closed = []
    for path in paths:
        try:
            assert load(path).messages
        except InputError as error:
            closed.append(str(error))
    print(f"{len(paths) - len(closed)} of {len(paths)} open", *closed, sep="\n")
    assert len(paths) > 90 and not closed


def test_steering_yaw_rate_and_speed_are_proposed_right(databases):
    wrong = []
    for name, right in CARS.items():
        signals = [
            (f"{m.name}.{s.name}", s) for m in load(databases / f"{name}.dbc").messages for s in m.signals
        ]
        units = {n: s.unit or "" for n, s in signals if s.length > 1}  # `new` asks for more than two values
        for role, pattern in zip(ROLES, right, strict=True):
            proposed = next(iter(ranked(role, units, units)), None)
            if not (re.fullmatch(pattern, proposed or "") if pattern else proposed is None):
                wrong.append(f"{name} {role}: {proposed}, expected {pattern}")
    cars = len({text.split()[0] for text in wrong})
    print(f"{len(CARS) - cars} of {len(CARS)} cars right", *wrong, sep="\n")
    assert cars <= len(CARS) // 6


def per_si(unit, role):
    return UNSAID[""][role] if not unit else next(f for p, f in PER_SI.items() if re.fullmatch(p, unit))


def place(data, signal, raw):
    """Write the raw value of a signal into its bits, by the definition of a DBC."""
    bit = signal.start
    for k in range(signal.length):
        big = signal.byte_order == "big_endian"
        on = raw >> (signal.length - 1 - k if big else k) & 1
        data[bit // 8] |= on << bit % 8
        bit += (15 if bit % 8 == 0 else -1) if big else 1


def write_drives(database, right, folder):
    """Logs of a car of 2.7 m with the three right signals, the other signals of their messages 0."""
    chosen = {}
    for role, pattern in zip(ROLES, right, strict=True):
        fitting = [
            (m, s)
            for m in database.messages
            for s in m.signals
            if re.fullmatch(pattern, f"{m.name}.{s.name}")
        ]
        chosen[role] = fitting[0] if len(fitting) == 1 else min(fitting, key=lambda f: -f[1].length)

    def frames(*values):
        payloads = {}
        for role, value in zip(ROLES, values, strict=True):
            message, signal = chosen[role]
            data = payloads.setdefault(message.name, bytearray(message.length))
            physical = value * per_si(signal.unit, role)
            if bit := sign_bits(message).get(signal.name):
                place(data, message.get_signal_by_name(bit), int(physical < 0))
                physical = abs(physical)
            place(data, signal, round((physical - float(signal.offset)) / float(signal.scale)))
        for name, data in payloads.items():
            message = database.get_message_by_name(name)
            sign = "##0" if len(data) > 8 else "#"
            width = 8 if message.is_extended_frame else 3
            yield f"{message.frame_id:0{width}X}{sign}{data.hex().upper()}"

    logs = write_logs(
        folder,
        2000,
        lambda t: 13 + 5 * math.sin(0.2 * t),
        lambda t: STEERING_RATIO * (0.03 * math.sin(0.7 * t) + 0.015 * math.sin(2.1 * t)),
        frames,
        lag_s=0.15,
    )
    return chosen, logs


def test_logs_of_these_cars_are_read_right_or_asked_about(databases, tmp_path):
    right, asked, wrong = [], [], []
    for name in WHOLE:
        folder = tmp_path / name
        folder.mkdir()
        path = databases / f"{name}.dbc"
        chosen, logs = write_drives(load(path), CARS[name], folder)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                made = new("car", logs, folder / "out", dbc=path, wheelbase_m=2.7)
        except InputError as error:
            asked.append(f"{name}: {error}")
            continue
        said = []
        for role, p in made.proposals.items():
            message, signal = chosen[role]
            size = abs(p.factor) / per_si(p.unit, role) * per_si(signal.unit, role)
            size *= STEERING_RATIO if role == "input" else 1
            if p.name != f"{message.name}.{signal.name}" or not 0.85 < size < 1.15:
                said.append(f"{role} {p.name} in {p.unit}, size {size:.3g}")
        (wrong if said else right).append(f"{name}: {'; '.join(said)}")
    print(f"{len(right)} right, {len(asked)} asked, {len(wrong)} wrong", *asked, *wrong, sep="\n")
    assert not wrong and len(right) > len(WHOLE) // 2
