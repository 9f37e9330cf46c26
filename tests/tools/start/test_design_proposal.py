"""The proposed [design] section: what drives of known command and actuator show, and that it is valid."""

import tomllib

import numpy as np
import pytest

from lpvguard.drives.tables import Drive
from lpvguard.engine.synthesis.interconnection import zeros_poles
from lpvguard.start.design_proposal import EFFORT_RAD_S, design_section, shown
from lpvguard.vehicle.design_settings import DesignSettings

TS = 0.02


def drive(name: str, v: float) -> Drive:
    """A turn to and fro at 1 rad/s with 0.2 rad/s, by 0.1 rad at 2 rad/s around a trim of 0.03 rad."""
    t = np.arange(0.0, 126.0, TS)
    y = 0.2 * np.sin(t)[:, None]
    u = 0.03 + 0.1 * np.sin(2 * t)[:, None]
    return Drive(name, t, np.full(len(t), v), u, y)


@pytest.fixture
def driven():
    beyond = drive("parking", 1.0)
    beyond.u[:] *= 9.0
    return shown([drive("slow", 10.0), drive("fast", 14.0), beyond], TS, (5.0, 20.0))


def test_the_command_and_the_limits_are_those_driven_in_the_speed_range(driven):
    assert driven.rms == pytest.approx(0.2 / np.sqrt(2), rel=1e-2)
    assert driven.corner == pytest.approx(1.0, abs=0.15)
    assert driven.input_max == pytest.approx(0.1, rel=1e-2)
    assert driven.input_rate_max == pytest.approx(0.2, rel=2e-2)
    assert driven.lateral_mps2 == pytest.approx(0.2 * 14.0, rel=1e-2)
    assert driven.speed == pytest.approx(12.0, abs=2.0)


def test_the_section_is_valid_and_its_effort_is_one_at_the_rate_limit(driven):
    document = tomllib.loads(design_section(driven, TS))["design"]
    settings = DesignSettings.model_validate(document)
    assert settings.controlled == "yaw_rate"
    assert pytest.approx(1 / (0.3 * driven.rms), rel=0.05) == settings.A_t
    W_u = zeros_poles(settings.A_u, settings.W_u_zeros, settings.W_u_poles)
    amplitude = settings.input_rate_max_per_s[0] / EFFORT_RAD_S
    assert abs(W_u.response([EFFORT_RAD_S])[0, 0, 0]) * amplitude == pytest.approx(1.0, rel=0.05)
