"""The example scripts run as their first lines say, and print what they promise."""

import re

import pytest

from made import EXAMPLES, ROOT, run_example


@pytest.mark.slow("12 s: an identification")
def test_from_drives_to_bounds_and_their_picture(synthetic, tmp_path):
    said = run_example("bounds_and_margins.py", "g80", synthetic, tmp_path)
    threshold = float(re.search(r"^threshold ([\d.]+): ", said, re.MULTILINE)[1])
    assert 0 < threshold < 5 and "omega_rad_s" in said
    assert "<svg" in (tmp_path / "bounds.svg").read_text()
    assert (tmp_path / "code" / "lpvguard_coeff.c").is_file()


@pytest.mark.slow("3 s: an example runs")
def test_the_monitor_in_a_loop_finds_the_fault_and_not_before_it_is_there(vehicle, synthetic):
    said = run_example("monitor_in_a_loop.py", "g80", vehicle, synthetic / "synthetic_01.csv")
    alarm, fault = map(float, re.search(r"([\d.]+) s  alarm: .* fault at ([\d.]+) s", said).groups())
    assert fault < alarm < fault + 60
    healthy, faulty = (float(x) for x in re.findall(r"rms error \[([\d.e-]+)\]", said))
    assert faulty > 3 * healthy


@pytest.mark.unhurried
def test_responses_of_motors_lead_to_a_controller_with_a_proved_level():
    said = run_example("robust_without_a_vehicle.py")
    proved, attained = map(float, re.search(r"at most ([\d.]+); no less than ([\d.]+)", said).groups())
    assert attained <= proved < 0.6


@pytest.mark.slow("10 s: three examples run")
def test_pictures_of_an_identification_and_of_a_drive(identified, vehicle, synthetic, tmp_path):
    drive = ("g80", vehicle, synthetic / "synthetic_01.csv")
    assert "B_w" in run_example("show_bounds.py", identified, tmp_path / "bounds.svg")
    assert "none" in run_example("show_margins.py", *drive, tmp_path / "margins.svg")
    assert "yaw_rate" in run_example("nominal_and_measured.py", *drive, tmp_path / "time.svg")
    assert len([path for path in tmp_path.iterdir() if "<svg" in path.read_text()]) == 3


@pytest.mark.slow("6 s: three examples run")
def test_examples_without_a_vehicle(tmp_path):
    said = run_example("weight_above_samples.py", tmp_path / "weight.svg")
    assert "proved: True" in said
    said = run_example("wealth_of_a_vehicle.py", tmp_path / "wealth.svg")
    assert "healthy: no alarm" in said and "alarm with recording" in said
    said = run_example("hinf_controller.py", tmp_path / "hinf.svg")
    level, largest = (float(x) for x in re.findall(r"(?:level|grid) ([\d.]+)", said))
    assert 0.99 * level < largest <= level
    assert len([path for path in tmp_path.iterdir() if "<svg" in path.read_text()]) == 3


def test_no_example_goes_untested():
    files = [ROOT / "tests/tools" / name for name in ("api/test_examples.py", "control/test_any_vehicle.py")]
    tested = {name for file in files for name in re.findall(r'run_example\("(\w+\.py)"', file.read_text())}
    assert tested == {path.name for path in EXAMPLES.glob("*.py")}
