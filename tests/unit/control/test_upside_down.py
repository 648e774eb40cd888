"""Starts from which a law does not turn a vehicle over are refused, and the verdict is that of a flight. The values of an
action that fused laws compute once per launch.
"""

import logging
from dataclasses import replace
from math import pi, radians

import pytest
import torch

from aerial_gym.config.controller import ControllerCfg
from aerial_gym.config.robot import RobotCfg
from aerial_gym.control import CONTROLLERS, make_controller
from aerial_gym.control.laws import LAWS
from aerial_gym.control.stateful import StatefulController
from aerial_gym.control.upside_down import check_starts
from aerial_gym.errors import ConfigError
from aerial_gym.math.quaternion import quat_from_euler, quat_to_matrix
from aerial_gym.physics import BodyState, WarpBackend, build_model, state_at_rest, vehicle_from_config
from aerial_gym.physics.integrators import INTEGRATORS, to_body_state, to_mass_state
from aerial_gym.physics.law_memory import fresh_law_memory, rotor_command_and_memory
from aerial_gym.robots import ROBOTS
from tests.builders import simulation
from tests.physics.vehicles import random_state

F64 = torch.float64
CRAZYFLIE = ROBOTS.get("crazyflie_21")
STILL = (0.0, 0.0, 0.0)
CLAMPED = {
    name: replace(CONTROLLERS.get(name), allocation="clamp")
    for name in ("lee_position_control", "lee_attitude_control", "pid_velocity_control")
}


def from_angles(low: float, high: float, *, pitch: float = 0.0, ang_vel: float = 0.0) -> RobotCfg:
    """Return the Crazyflie with a roll between two angles [deg], any yaw, and a pitch within plus and minus one."""
    start = replace(
        CRAZYFLIE.initial_state, euler_low=(radians(low), -radians(pitch), -pi),
        euler_high=(radians(high), radians(pitch), pi), ang_vel_low=(-ang_vel,) * 3, ang_vel_high=(ang_vel,) * 3,
    )  # fmt: skip
    return replace(CRAZYFLIE, initial_state=start)


def check(robot: RobotCfg, controller: str | ControllerCfg, dt: float = 0.005) -> None:
    cfg = CONTROLLERS.get(controller) if isinstance(controller, str) else controller
    check_starts(robot, cfg, gravity=9.81, dt=dt, names=("cf", "law"))


def fall(
    cfg: ControllerCfg, rolls_deg: list[float], seconds: float = 0.4, dt: float = 0.005
) -> tuple[list[bool], list[float]]:
    """Return whether body z points up after a fall from rest, and the body rates [rad/s] then, for each start."""
    count = len(rolls_deg)
    vehicle = vehicle_from_config(CRAZYFLIE, num_envs=count, dtype=F64)
    law = make_controller(cfg, vehicle, 9.81, dt=dt, control=CRAZYFLIE.control)
    model = build_model(vehicle, gravity=9.81)
    state = state_at_rest(count, 4, device=torch.device("cpu"), dtype=F64)
    state.attitude[:] = quat_from_euler(torch.tensor([[radians(roll), 0.0, 0.3] for roll in rolls_deg], dtype=F64))
    state.position[:, 2] = 1000.0
    action = torch.tensor([[0.0, 0.0, 1000.0, 0.0]], dtype=F64).expand(count, -1)
    memory = fresh_law_memory(law.needs, count, state.position) if isinstance(law, StatefulController) else None
    for _ in range(round(seconds / dt)):
        command, memory = rotor_command_and_memory(law, state, action, memory)
        state = to_body_state(model, INTEGRATORS["euler"](model, to_mass_state(model, state), command, dt))
    return (quat_to_matrix(state.attitude)[:, 2, 2] > 0.0).tolist(), state.ang_vel.norm(dim=-1).tolist()


def test_the_crazyflies_mellinger_is_refused_from_a_right_angle() -> None:
    check(from_angles(-89.0, 89.0), "crazyflie_mellinger_control")
    tumbling = {"pitch": 90.0, "ang_vel": 10.0}
    for low, high, more in ((-91, 91, {}), (-180, 180, {}), (180, 180, {}), (91, 92, {}), (-180, 180, tumbling)):
        with pytest.raises(ConfigError, match="euler_low"):
            check(from_angles(low, high, **more), "crazyflie_mellinger_control")


def test_it_flies_with_a_warning_if_asked(caplog: pytest.LogCaptureFixture) -> None:
    cfg = replace(CONTROLLERS.get("crazyflie_mellinger_control"), if_unstable="warn")
    with caplog.at_level(logging.WARNING):
        check(from_angles(-180.0, 180.0), cfg)
    assert [record.levelname for record in caplog.records] == ["WARNING"]


@pytest.mark.parametrize(
    "name",
    [
        "lee_position_control", "lee_velocity_control", "lee_acceleration_control", "lee_attitude_control",
        "lee_velocity_steering_angle_control", "pid_position_control", "pid_attitude_control", "px4_position_control",
        "px4_attitude_control", "crazyflie_pid_control", "crazyflie_lee_control", "crazyflie_brescianini_control",
        "magpie_position_control",
    ],
)  # fmt: skip
def test_other_laws_may_start_anywhere(name: str) -> None:
    check(from_angles(-180.0, 180.0, pitch=90.0), name)


def test_the_equilibrium_upside_down_is_refused_where_every_start_is_in_it() -> None:
    """Lee's error is the sine of the angle: 0 at exactly 180 degrees, not next to it, and not with body rates."""
    with pytest.raises(ConfigError, match="euler_low"):
        check(from_angles(180.0, 180.0), "lee_position_control")
    check(from_angles(180.0, 180.0, ang_vel=0.2), "lee_position_control")
    check(from_angles(175.0, 185.0), "lee_position_control")
    check(from_angles(180.0, 180.0), "px4_position_control")


def test_clamped_rotors_give_no_torque_to_a_law_that_asks_for_negative_thrust() -> None:
    for name in ("lee_position_control", "pid_velocity_control"):
        with pytest.raises(ConfigError, match="euler_low"):
            check(from_angles(-180.0, 180.0), CLAMPED[name])
    check(from_angles(-180.0, 180.0), CLAMPED["lee_attitude_control"])


@pytest.mark.parametrize(("cfg", "rolls", "over"), [
    (CONTROLLERS.get("crazyflie_mellinger_control"), [80.0, 100.0, 170.0], [True, False, False]),
    (CLAMPED["lee_position_control"], [170.0], [False]),
    (CONTROLLERS.get("crazyflie_lee_control"), [100.0, 150.0], [True, True]),
])  # fmt: skip
def test_the_verdict_is_that_of_a_flight(cfg: ControllerCfg, rolls: list[float], over: list[bool]) -> None:
    """After 0.4 s a vehicle points up, or falls at a body rate of 0; a start at that roll is accepted, or refused."""
    turned, rates = fall(cfg, rolls)
    assert turned == over
    for roll, turns, rate in zip(rolls, turned, rates, strict=True):
        if turns:
            check(from_angles(roll, roll), cfg)
            continue
        assert rate == pytest.approx(0.0, abs=1e-9)
        with pytest.raises(ConfigError, match="euler_low"):
            check(from_angles(roll, roll), cfg)


@pytest.mark.parametrize("name", ["lee_rates_control", "betaflight_rate_control", "no_control", "rotor_speed_control"])
def test_laws_that_hold_no_attitude_are_not_judged(name: str) -> None:
    check(from_angles(-180.0, 180.0), name)


def test_an_environment_refuses_such_a_start() -> None:
    with pytest.raises(ConfigError, match="euler_low"):
        simulation(from_angles(-180.0, 180.0, ang_vel=0.2), "crazyflie_mellinger_control")


ENVS, SUBSTEPS, DT = 16, 5, 0.004


@pytest.mark.parametrize("name", LAWS)
def test_a_launch_of_many_substeps_is_as_many_launches(name: str) -> None:
    """An action that is prepared once for five substeps gives, bit for bit, the flight of one that is prepared for
    each. Actions are to both sides of the limits of inclination and yaw rate, and turn all ways."""
    robot = ROBOTS.get("omnidirectional_octarotor" if name == "pose" else "base_quadrotor")
    vehicle = vehicle_from_config(robot, num_envs=ENVS)
    law = make_controller(ControllerCfg(summary="", law=name), vehicle, 9.81, dt=DT)
    backend = WarpBackend()
    backend.allocate(build_model(vehicle), law, integrator="euler")
    actions = 6.0 * (torch.rand(ENVS, len(law.action_names), generator=torch.Generator().manual_seed(1)) - 0.5)
    start = random_state(ENVS, seed=2, rotor_speed=400.0)
    start = replace(start, rotor_speed=start.rotor_speed[:, :1].expand(-1, vehicle.num_rotors))
    start = replace(start, **{key: value.float() for key, value in vars(start).items()})
    once, each = (BodyState(**{key: value.clone() for key, value in vars(start).items()}) for _ in range(2))
    backend.step(once, actions, DT, SUBSTEPS)
    for _ in range(SUBSTEPS):
        backend.step(each, actions, DT, 1)
    for key, value in vars(once).items():
        torch.testing.assert_close(value, getattr(each, key), rtol=0.0, atol=0.0)
        assert value.isfinite().all()
