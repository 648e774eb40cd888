"""Settings, sticks, motors and sensors in Betaflight's units."""

from dataclasses import replace
from math import pi

import numpy as np
import pytest
import torch

from aerial_gym.config.autopilots import BetaflightCfg
from aerial_gym.control import CONTROLLERS, make_controller
from aerial_gym.control.betaflight.controller import BetaflightController
from aerial_gym.errors import ConfigError
from aerial_gym.firmware.betaflight.settings import firmware_settings
from aerial_gym.firmware.betaflight.vehicle import (
    ARM,
    PITCH,
    ROLL,
    THROTTLE,
    YAW,
    BetaflightVehicle,
    gyro_counts,
    write_state,
)
from aerial_gym.physics import vehicle_from_config
from aerial_gym.robots import ROBOTS


def make(cfg: BetaflightCfg | None = None, *, reverse: bool = False) -> tuple[BetaflightController, BetaflightVehicle]:
    robot = ROBOTS.get("racing_quadrotor")
    declared = vehicle_from_config(robot, num_envs=2, device=torch.device("cpu"))
    if reverse:
        declared = replace(declared, spin=-declared.spin)
    controller = replace(CONTROLLERS.get("betaflight_rate_control"), betaflight=cfg or BetaflightCfg())
    twin = make_controller(controller, declared, 9.81, dt=0.001, control=robot.control)
    assert isinstance(twin, BetaflightController)
    return twin, BetaflightVehicle(twin, declared)


def test_settings_have_the_names_and_units_of_the_command_line() -> None:
    cfg = BetaflightCfg(p_roll=45.0, i_yaw=80.0, d_pitch=34.0, airmode=False, gyro_lpf1_static_hz=250.0, tpa_mode="PD")
    twin, _ = make(cfg)
    lines = firmware_settings(cfg, twin.gains, period=0.0005, yaw_reversed=True)
    expected = {
        "set p_roll=45", "set i_yaw=80", "set d_pitch=34", "feature -AIRMODE", "set gyro_lpf1_static_hz=250",
        "set tpa_mode=PD", "set pid_process_denom=4", "set yaw_motors_reversed=ON", "set iterm_windup=80",
        "set roll_rc_rate=67",
    }  # fmt: skip
    assert expected <= set(lines)
    assert not any("None" in line or "." in line for line in lines)


def test_settings_beyond_the_firmware_are_refused_together() -> None:
    cfg = BetaflightCfg(p_roll=300.0, i_pitch=400.0)
    gains = make(cfg)[0].gains
    with pytest.raises(ConfigError, match=r"(?s)2 faults.*p_roll = 300.*at most 250.*i_pitch = 400"):
        firmware_settings(cfg, gains, period=0.001)
    with pytest.raises(ConfigError, match="version 4.5: the firmware is Betaflight 4.6"):
        firmware_settings(replace(cfg, version="4.5"), gains, period=0.001)
    with pytest.raises(ConfigError, match="time step of 0.0003 s"):
        firmware_settings(cfg, gains, period=0.0003)


def test_sticks_have_the_signs_of_betaflight() -> None:
    """Roll right and pitch forward are above 1500 us, and so is yaw to the right, which is negative about z up."""
    twin, vehicle = make()
    channels = np.zeros((2, 16), np.uint16)
    vehicle.channels(torch.tensor([[0.0, 1.0, 1.0, 1.0], [-1.0, 0.0, 0.0, 0.0]]), channels)
    step = round(180.0 / pi / 670.0 * 500.0)
    assert channels[0, [ROLL, PITCH, YAW]].tolist() == [1500 + step, 1500 + step, 1500 - step]
    assert channels[0, THROTTLE] == 1000 + round(1000 * twin.throttle(torch.ones(2, 1))[0].mean().item())
    assert (channels[1, THROTTLE], channels[1, ARM]) == (950, 2000)


def test_motors_have_the_order_and_spins_of_betaflight() -> None:
    """Racing quadrotor: front right, back left, back right, front left; Betaflight: back right, front right, back left, .."""
    twin, vehicle = make()
    pulses = np.zeros((2, 16), np.float32)
    pulses[:, :4] = [1000.0, 1250.0, 1500.0, 2000.0]
    expected = twin.speed_of_signal(torch.tensor([0.25, 0.5, 0.0, 1.0]))
    torch.testing.assert_close(vehicle.speeds(pulses), expected.expand(2, -1))
    assert not vehicle.yaw_reversed


def test_thrust_of_throttle_inverts_the_throttle() -> None:
    twin, vehicle = make()
    signal = torch.tensor([[0.1], [0.7]])
    again = twin.throttle(vehicle.thrust_of_throttle(signal)).mean(-1, keepdim=True)
    torch.testing.assert_close(again, signal, atol=1e-6, rtol=0.0)


def test_the_firmware_reads_the_nearest_count_of_the_gyro() -> None:
    """The firmware cuts ``rate * 16.4`` to a whole number; one count is 2000 / 32768 deg/s."""
    rates = np.radians(np.array([[10.0, -10.0, 0.02], [0.04, -1999.0, 2500.0]]))
    packet = np.zeros((2, 18))
    write_state(packet, ang_vel=rates)
    read = np.trunc(packet[:, 1:4] * (1.0, -1.0, -1.0) * 180.0 / pi * 16.4)
    np.testing.assert_array_equal(read, gyro_counts(rates))
    np.testing.assert_allclose(read[0] * 2000.0 / 32768.0, [10.0, -10.0, 0.0], atol=0.5 * 2000.0 / 32768.0)
    assert packet[0, 4:11].tolist() == [0.0, 0.0, -9.81, 1.0, 0.0, 0.0, 0.0]
