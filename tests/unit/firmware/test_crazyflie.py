"""The exchange with the firmware of the Crazyflie, by a stand-in for its compiled controllers."""

import math
import shutil
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from aerial_gym.control import CONTROLLERS, make_controller
from aerial_gym.errors import ConfigError
from aerial_gym.firmware.crazyflie.build import VARIABLE, build_controller, find_checkout
from aerial_gym.firmware.crazyflie.comparison import compare_controller
from aerial_gym.firmware.crazyflie.environment import CrazyflieEnv, make_twin_cfg, platform_constants
from aerial_gym.firmware.crazyflie.instances import INPUTS
from aerial_gym.firmware.crazyflie.parameters import firmware_parameters
from aerial_gym.firmware.environment import motor_order
from aerial_gym.firmware.flight import fly_hover, hover_options
from aerial_gym.physics import vehicle_from_config
from aerial_gym.robots import ROBOTS


class FakeGroup:
    """Answers with given motor commands."""

    def __init__(self, parameters: Mapping[str, float], num_envs: int) -> None:
        self.parameters = parameters
        self.input = {name: np.zeros((num_envs, width), np.float32) for name, width in INPUTS.items()}
        self.motors = np.full((num_envs, 4), 30_000, np.uint16)
        self.started: list[Sequence[int]] = []

    def run(self) -> None: ...

    def start(self, envs: Sequence[int]) -> None:
        self.started.append(envs)

    def close(self) -> None: ...


def build(name: str | None = None, robot: str = "crazyflie_21", law: str = "crazyflie_pid_control") -> CrazyflieEnv:
    return CrazyflieEnv(
        controller=CONTROLLERS.get(law), flown_by=name, make_group=FakeGroup,
        **hover_options(robot, instances=2, seed=0),
    )  # fmt: skip


@pytest.fixture
def env() -> Iterator[CrazyflieEnv]:
    made = build()
    made.reset()
    yield made
    made.close()


def twin_gains(name: str, robot: str = "crazyflie_21"):
    cfg = ROBOTS.get(robot)
    declared = vehicle_from_config(cfg, num_envs=1)
    return make_controller(make_twin_cfg(name), declared, 9.81, dt=0.001, control=cfg.control).gains


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("pid", {"posCtlPid.zKi": 0.5, "velCtlPid.vzKi": 15.0, "pid_attitude.yaw_kd": 0.35, "pid_rate.pitch_ki": 500.0,
                 "posCtlPid.thrustBase": 36000.0, "posCtlPid.pLimit": 20.0, "posCtlPid.yVelMax": 1.0}),
        ("mellinger", {"ctrlMel.massThrust": 132000.0, "ctrlMel.kp_xy": 0.4, "ctrlMel.kp_z": 1.25, "ctrlMel.ki_m_z": 500.0,
                       "ctrlMel.kw_z": 12000.0, "ctrlMel.kd_omega_rp": 200.0}),
        ("lee", {"ctrlLee.mass": 0.027, "ctrlLee.J_z": 2.98e-5, "ctrlLee.Kpos_Px": 7.0, "ctrlLee.KR_z": 0.008,
                 "ctrlLee.KI_y": 0.03}),
        ("brescianini", {"ctrlAtt.tau_xy": 0.3, "ctrlAtt.zeta_z": 0.85, "ctrlAtt.tau_rp": 0.25, "ctrlAtt.mixing_factor": 1.0}),
    ],
)  # fmt: skip
def test_parameters_have_the_firmwares_names_and_the_robots_numbers(name: str, expected: dict[str, float]) -> None:
    parameters = firmware_parameters(twin_gains(name))
    assert {key: parameters[key] for key in expected} == pytest.approx(expected, rel=1e-6)
    assert all(math.isfinite(value) for value in parameters.values())


def test_controllers_run_at_the_firmwares_rates() -> None:
    assert (make_twin_cfg("pid").rate_hz, make_twin_cfg("pid").crazyflie_pid.rate_hz) == (100.0, 500.0)
    assert make_twin_cfg("mellinger").rate_hz == 500.0
    assert make_twin_cfg("brescianini").brescianini.rate_hz == 500.0


def test_constants_of_the_platform_are_those_of_the_robot_file(env: CrazyflieEnv) -> None:
    constants = platform_constants(env.twin.allocation, env.robot_manager.declared)
    assert constants == pytest.approx({"THRUST_MAX": 0.142, "THRUST2TORQUE": 0.005964552}, rel=1e-5)


def test_motor_commands_are_shares_of_the_largest_thrust_in_the_firmwares_order(env: CrazyflieEnv) -> None:
    """The rotors of this robot file have the firmware's order: m1 front right, then clockwise from above."""
    env.motors[:] = [65535, 0, 32768, 16384]
    vehicle = env.robot_manager.declared
    c0, c1, c2 = vehicle.thrust_map[0, 0].tolist()
    for speed, share in zip(env.rotor_speeds()[0].tolist(), (1.0, 0.0, 0.5, 0.25), strict=True):
        assert c0 + c1 * speed + c2 * speed**2 == pytest.approx(0.142 * share, abs=2e-5)
    assert [round(y, 4) for y in vehicle.rotor_lever[0, :, 1].tolist()] == [-0.0325, -0.0325, 0.0325, 0.0325]


def test_motor_order_follows_places_and_spins() -> None:
    front_left, front_right, rear_left, rear_right = (1, -1, 1), (-1, -1, -1), (1, 1, -1), (-1, 1, 1)
    inverse = torch.zeros(4, 6)
    inverse[:, 3:] = torch.tensor([front_left, front_right, rear_left, rear_right], dtype=torch.float32)
    assert motor_order(inverse, (1, 0, 2, 3)) == ([3, 0, 2, 1], False)
    inverse[:, 5] *= -1.0
    assert motor_order(inverse, (0, 1, 2, 3)) == ([3, 1, 2, 0], True)
    inverse[0, 5] *= -1.0
    with pytest.raises(ConfigError, match="neighbours spin against each other"):
        motor_order(inverse, (0, 1, 2, 3))


def test_the_firmware_gets_state_sensors_and_setpoint_of_the_instant(env: CrazyflieEnv) -> None:
    env.gtd["robot_body_angvel"].zero_()
    action = torch.tensor([[0.1, 0.2, 0.3, 0.4], [0.0, 0.0, 1.0, -1.0]])
    env.step(action)
    env.rotor_speeds()
    rows = env.group.input
    np.testing.assert_array_equal(rows["goal"], action.numpy())
    np.testing.assert_array_equal(rows["position"], env.gtd["robot_position"].numpy())
    np.testing.assert_array_equal(rows["attitude"], env.gtd["robot_orientation"].numpy())
    np.testing.assert_allclose(rows["rate"], env.gtd["robot_body_angvel"].numpy(), atol=1e-6)
    lift = 4.0 * 0.142 * 30_000 / 65535
    assert lift / 0.027 < rows["force"][0, 2] < 9.81  # the rotors slow down to this from hover


def test_a_reset_starts_the_instances_of_its_mask_only(env: CrazyflieEnv) -> None:
    env.reset(torch.tensor([False, True]))
    assert env.group.started == [[0, 1], [1]]  # type: ignore[attr-defined]


def test_the_controller_that_the_firmware_flies_is_chosen_by_the_law() -> None:
    for law, name, group in (
        ("crazyflie_mellinger_control", None, "ctrlMel"), ("lee_position_control", None, "posCtlPid"),
        ("lee_position_control", "lee", "ctrlLee"),
    ):  # fmt: skip
        env = build(name, law=law)
        assert any(key.startswith(group) for key in env.group.parameters)  # type: ignore[attr-defined]
        env.close()
    env = build("indi")
    assert env.group.parameters == {}  # type: ignore[attr-defined]
    assert fly_hover(env, duration=0.02).ended == {}
    env.close()


def test_gains_of_the_controller_are_the_firmwares() -> None:
    cfg = CONTROLLERS.get("crazyflie_mellinger_control")
    assert cfg.mellinger is not None
    own = replace(cfg, mellinger=replace(cfg.mellinger, kp_xy=0.7))
    env = CrazyflieEnv(controller=own, make_group=FakeGroup, **hover_options("crazyflie_21", instances=1, seed=0))
    assert env.group.parameters["ctrlMel.kp_xy"] == pytest.approx(0.7)  # type: ignore[attr-defined]
    assert env.twin.timing.inner_period == pytest.approx(0.002)
    env.close()


def test_what_does_not_fit_is_refused_with_a_remedy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ConfigError, match="takes positions. Take crazyflie_pid_control"):
        build(law="lee_rates_control")
    with pytest.raises(ConfigError, match="four rotors in an X"):
        build("indi", robot="typhoon_hexarotor")
    with pytest.raises(ConfigError, match="'indi': none here follows it. Take one of pid, mellinger, lee, brescianini"):
        compare_controller("indi", checkout=None)
    monkeypatch.delenv(VARIABLE, raising=False)
    with pytest.raises(
        ConfigError, match=r"no firmware of the Crazyflie given. Clone .* --firmware or the variable CRAZYFLIE"
    ):
        find_checkout()
    monkeypatch.setenv(VARIABLE, str(tmp_path))
    with pytest.raises(ConfigError, match=f"no firmware of the Crazyflie in {tmp_path}"):
        find_checkout()
    monkeypatch.setattr(shutil, "which", lambda name: f"/bin/{name}")
    with pytest.raises(ConfigError, match=r"controller_omni.c is missing. Take one of pid, mellinger"):
        build_controller("omni", tmp_path, tmp_path, {})
