"""A made-up car with a bus of its own: its database, and the shipped vehicles on that bus."""

from pathlib import Path

from lpvguard.vehicle.project import CanPlace, OwnBus, Project

DBC = """VERSION ""
NS_ :
BS_:
BU_: CAR
BO_ 416 SPEED: 8 CAR
 SG_ V : 7|16@0+ (0.01,0) [0|250] "km/h" CAR
 SG_ CHECKSUM : 56|8@1+ (1,0) [0|255] "" CAR
 SG_ COUNTER : 48|4@1+ (1,0) [0|15] "" CAR
BO_ 2566844672 MOTION: 8 CAR
 SG_ YAW : 32|16@1- (0.005,0) [-160|160] "deg/s" CAR
BO_ 418 COMMAND: 8 CAR
 SG_ ANGLE : 16|16@1- (0.002,0) [-65|65] "deg" CAR
 SG_ MOMENT : 47|16@0- (1,0) [-32000|32000] "N m" CAR
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 10000;
BA_DEF_DEF_ "GenMsgCycleTime" 20;
BA_ "GenMsgCycleTime" BO_ 416 10;
"""
DEG = 57.29577951308232
DATA_ID = 0x5A
DEMANDS = {
    "road_wheel_angle": CanPlace(message="COMMAND", signal="ANGLE", factor=DEG),
    "yaw_moment": CanPlace(message="COMMAND", signal="MOMENT", factor=1000.0),
}
MEASURED = {
    "speed": CanPlace(message="SPEED", signal="V", factor=3.6),
    "yaw_rate": CanPlace(message="MOTION", signal="YAW", factor=DEG),
}


def on_own_bus(project: Project, folder: Path) -> Project:
    """The vehicle on the made-up car's bus; the database is written into ``folder``."""
    (folder / "car.dbc").write_text(DBC)
    bus = OwnBus.model_validate(
        {
            "dbc": str(folder / "car.dbc"),
            "messages": {
                "SPEED": {"checksum": "tesla"},
                "MOTION": {"checksum": "autosar_p11", "data_id": 7},
                "COMMAND": {"checksum": "autosar_p01", "data_id": DATA_ID},
            },
            "demand": {s.name: DEMANDS[s.name] for s in project.inputs},
        }
    )
    signals = [s.model_copy(update={"can": MEASURED.get(s.name)}) for s in project.signals]
    return project.model_copy(update={"can": bus, "signals": signals})
