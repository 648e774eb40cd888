"""Allocation and controllers: geometry, signs, fixed points and convergence."""

from dataclasses import replace

import pytest
import torch

from aerial_gym.config.controller import ControlCfg
from aerial_gym.control import CONTROLLERS, Controller, make_controller
from aerial_gym.control.allocation import Allocation, allocation_matrix
from aerial_gym.control.catalog import AERIAL_GYM_GAINS
from aerial_gym.control.lee import (
    attitude_error,
    attitude_from_force,
    body_rates_of_yaw_rate,
    limit_inclination,
    matrix_from_euler,
)
from aerial_gym.errors import ConfigError
from aerial_gym.math.quaternion import euler_from_quat, quat_exp, quat_from_euler, quat_multiply, quat_to_matrix
from aerial_gym.physics import (
    INTEGRATORS,
    BodyState,
    accelerations,
    advance,
    build_model,
    state_at_rest,
    vehicle_from_config,
)
from aerial_gym.robots import ROBOTS
from tests.physics.vehicles import F64, asymmetric_robot, random_state


def test_allocation_matrix_of_base_quadrotor_is_the_published_one() -> None:
    """Rows Fz ones, Mx (-l, -l, l, l), My (-l, l, l, -l), Mz (-c, c, -c, c), l = 0.13 m, c = 0.01 m (parity.md 2.4)."""
    vehicle = vehicle_from_config(ROBOTS.get("base_quadrotor"), num_envs=1, dtype=F64)
    l, c = 0.13, 0.01  # noqa: E741
    rows = [[0] * 4, [0] * 4, [1] * 4, [-l, -l, l, l], [-l, l, l, -l], [-c, c, -c, c]]
    torch.testing.assert_close(allocation_matrix(vehicle, 9.81)[0], torch.tensor(rows, dtype=F64), atol=1e-12, rtol=0)


def test_allocation_reproduces_the_wrench_that_the_physics_makes_of_it() -> None:
    """Thrusts of an attainable wrench, turned into speeds, accelerate the lopsided vehicle by exactly that wrench."""
    robot = asymmetric_robot()
    robot = replace(robot, rotor=replace(robot.rotor, torque_map=None, torque_ratio=0.015))
    vehicle = vehicle_from_config(robot, num_envs=32, dtype=F64)
    thrust = 1.0 + 2.0 * torch.rand(32, 4, dtype=F64, generator=torch.Generator().manual_seed(0))
    wrench = (allocation_matrix(vehicle, 9.81) @ thrust.unsqueeze(-1)).squeeze(-1)
    allocation = Allocation(vehicle, 9.81)
    torch.testing.assert_close(allocation.thrust(wrench), thrust, atol=1e-9, rtol=0)
    state = replace(random_state(32), rotor_speed=allocation.speed(thrust), ang_vel=torch.zeros(32, 3, dtype=F64))
    result = accelerations(build_model(vehicle), state)
    torque = (vehicle.inertia @ result.ang_acc.unsqueeze(-1)).squeeze(-1)
    torch.testing.assert_close(torque, wrench[:, 3:], atol=1e-9, rtol=0)
    force = 0.8 * (result.specific_force + torch.linalg.cross(result.ang_acc, vehicle.com))
    torch.testing.assert_close(force, wrench[:, :3], atol=1e-9, rtol=0)


def test_allocation_clamps_to_the_thrust_limits() -> None:
    robot = ROBOTS.get("tinyprop")
    allocation = Allocation(vehicle_from_config(robot, num_envs=1, dtype=F64), 9.81)
    speed = allocation.speed(torch.tensor([[-3.0, 0.5, 0.2, 9.0]], dtype=F64))
    limits = torch.tensor([[robot.rotor.speed_for_thrust(t) for t in (0.2, 0.5, 0.2, 1.2)]], dtype=F64)
    torch.testing.assert_close(speed, limits)


def test_attitude_error_is_the_small_rotation_and_its_sign() -> None:
    """For R = Rd exp(e), e_R = e to third order: turned too far about x gives +x."""
    desired = quat_from_euler(torch.tensor([[0.3, -0.2, 1.0]], dtype=F64))
    e = torch.tensor([[1e-4, -2e-4, 3e-4]], dtype=F64)
    rotation = quat_to_matrix(quat_multiply(desired, quat_exp(e)))
    torch.testing.assert_close(attitude_error(rotation, quat_to_matrix(desired)), e, atol=1e-11, rtol=0)


def test_attitude_from_force_has_its_z_along_the_force_and_x_over_the_heading() -> None:
    force, yaw = torch.tensor([[1.0, -2.0, 9.0]], dtype=F64), torch.tensor([0.7], dtype=F64)
    rotation = attitude_from_force(force, yaw)[0]
    torch.testing.assert_close(rotation.T @ rotation, torch.eye(3, dtype=F64), atol=1e-12, rtol=0)
    torch.testing.assert_close(rotation[:, 2], force[0] / force[0].norm())
    torch.testing.assert_close(torch.atan2(rotation[1, 0], rotation[0, 0]), yaw[0], atol=0.05, rtol=0)
    level = attitude_from_force(torch.tensor([[0.0, 0.0, 9.0]], dtype=F64), yaw)
    torch.testing.assert_close(level, quat_to_matrix(quat_from_euler(torch.tensor([[0.0, 0.0, 0.7]], dtype=F64))))


def test_body_rates_of_a_yaw_rate_turn_the_yaw_and_nothing_else() -> None:
    euler, rate, h = torch.tensor([[0.4, -0.3, 0.2]], dtype=F64), torch.tensor([0.8], dtype=F64), 1e-6
    attitude = quat_from_euler(euler)
    turned = quat_multiply(attitude, quat_exp(h * body_rates_of_yaw_rate(quat_to_matrix(attitude), rate)))
    change = (euler_from_quat(turned) - euler) / h
    torch.testing.assert_close(change, torch.tensor([[0.0, 0.0, 0.8]], dtype=F64), atol=1e-5, rtol=0)


def test_attitude_command_is_zyx_euler_at_any_heading() -> None:
    angles = torch.tensor([[0.4, -0.3, 2.2], [-1.0, 0.5, -0.7]], dtype=F64)
    matrix = matrix_from_euler(*angles.unbind(-1))
    torch.testing.assert_close(matrix, quat_to_matrix(quat_from_euler(angles)), atol=1e-14, rtol=0)


def test_explicit_gains_stand_in_place_of_derived_ones() -> None:
    """In the controller or in the robot file; those of Aerial Gym are the middle of its ranges (parity.md 2.3)."""
    vehicle = vehicle_from_config(ROBOTS.get("tinyprop"), num_envs=3, dtype=F64)
    cfg, of_robot = CONTROLLERS.get("lee_position_control"), ControlCfg(gains=AERIAL_GYM_GAINS)
    gains = make_controller(replace(cfg, gains=AERIAL_GYM_GAINS), vehicle, 9.81).gains
    torch.testing.assert_close(make_controller(cfg, vehicle, 9.81, control=of_robot).gains.attitude, gains.attitude)
    torch.testing.assert_close(gains.position, torch.tensor([2.5, 2.5, 1.5], dtype=F64).expand(3, 3))
    torch.testing.assert_close(gains.attitude, torch.tensor([1.0, 1.0, 0.5], dtype=F64).expand(3, 3))
    torch.testing.assert_close(gains.rate, torch.tensor([0.15, 0.15, 0.15], dtype=F64).expand(3, 3))


def test_limit_inclination_keeps_direction_and_height() -> None:
    force = torch.tensor([[30.0, 40.0, 10.0], [0.3, 0.4, 10.0], [0.0, 1.0, -5.0]], dtype=F64)
    limited = limit_inclination(force, torch.ones(3, dtype=F64), torch.pi / 4)
    expected = torch.tensor([[6.0, 8.0, 10.0], [0.3, 0.4, 10.0], [0.0, 1.0, 1.0]], dtype=F64)
    torch.testing.assert_close(limited, expected, atol=1e-12, rtol=0)


def fly(
    controller: Controller, robot_name: str, num_envs: int, action: list[float], span: float, dt: float = 0.01
) -> BodyState:
    """Return the end of a flight from a disturbed start, everything in float64."""
    robot = ROBOTS.get(robot_name)
    model = build_model(vehicle_from_config(robot, num_envs=num_envs, dtype=F64))
    g = torch.Generator().manual_seed(0)
    state = state_at_rest(num_envs, 4, device=torch.device("cpu"), dtype=F64)
    state.attitude[:] = quat_from_euler(0.3 * torch.randn(num_envs, 3, dtype=F64, generator=g))
    state.lin_vel[:] = 0.2 * torch.randn(num_envs, 3, dtype=F64, generator=g)
    state.ang_vel[:] = 0.5 * torch.randn(num_envs, 3, dtype=F64, generator=g)
    state.rotor_speed[:] = robot.rotor.speed_for_thrust(robot.body.mass * 9.81 / 4)
    command = torch.tensor(action, dtype=F64).expand(num_envs, -1)
    return advance(model, INTEGRATORS["euler"], controller, state, command, dt, round(span / dt))


def vehicle_controller(name: str, robot_name: str, num_envs: int) -> Controller:
    vehicle = vehicle_from_config(ROBOTS.get(robot_name), num_envs=num_envs, dtype=F64)
    return make_controller(CONTROLLERS.get(name), vehicle, 9.81, dt=0.01)


def test_thrust_command_zero_is_weight_and_one_is_twice_the_weight() -> None:
    controller = vehicle_controller("lee_attitude_control", "base_quadrotor", 2)
    state = state_at_rest(2, 4, device=torch.device("cpu"), dtype=F64)
    speed = controller.rotor_command(state, torch.tensor([[0.0, 0, 0, 0], [1.0, 0, 0, 0]], dtype=F64))
    thrust = ROBOTS.get("base_quadrotor").rotor.thrust_map[2] * (speed**2).sum(-1)
    torch.testing.assert_close(thrust, torch.tensor([1.0, 2.0], dtype=F64) * 0.25 * 9.81)


@pytest.mark.parametrize(
    ("name", "action"), [("lee_attitude_control", [0.0, 0.2, 0.0, 0.0]), ("lee_rates_control", [0.0, 0.2, 0.0, 0.0])]
)
def test_positive_roll_command_speeds_up_the_left_rotors(name: str, action: list[float]) -> None:
    """Positive roll lowers the right (-y) side: rotors 3 and 4 at +y must pull harder than 1 and 2 at -y."""
    controller = vehicle_controller(name, "base_quadrotor", 1)
    speed = controller.rotor_command(
        state_at_rest(1, 4, device=torch.device("cpu"), dtype=F64), torch.tensor([action], dtype=F64)
    )[0]
    assert speed[2:].min() > speed[:2].max()


def test_a_dive_keeps_a_tenth_of_the_weight_as_thrust() -> None:
    """Below that the direction of the thrust, and so the attitude, would be undefined."""
    controller = vehicle_controller("lee_acceleration_control", "base_quadrotor", 1)
    state = state_at_rest(1, 4, device=torch.device("cpu"), dtype=F64)
    speed = controller.rotor_command(state, torch.tensor([[0.0, 0.0, -30.0, 0.0]], dtype=F64))
    thrust = ROBOTS.get("base_quadrotor").rotor.thrust_map[2] * (speed**2).sum()
    torch.testing.assert_close(thrust, torch.tensor(0.1 * 0.25 * 9.81, dtype=F64))


def test_yaw_rate_command_is_clamped_and_left_alone() -> None:
    controller = vehicle_controller("lee_velocity_control", "base_quadrotor", 1)
    state = state_at_rest(1, 4, device=torch.device("cpu"), dtype=F64)
    action = torch.tensor([[0.0, 0.0, 0.0, 50.0]], dtype=F64)
    limit = torch.tensor([[0.0, 0.0, 0.0, 1.0471976]], dtype=F64)
    torch.testing.assert_close(controller.rotor_command(state, action), controller.rotor_command(state, limit))
    assert action[0, 3] == 50.0


@pytest.mark.parametrize(("name", "unit"), [("no_control", "thrust"), ("rotor_speed_control", "speed")])
def test_direct_control_passes_the_action_unchanged(name: str, unit: str) -> None:
    controller = vehicle_controller(name, "tinyprop", 1)
    rotor = ROBOTS.get("tinyprop").rotor
    thrusts = [0.3, 0.5, 0.7, 0.9]
    speeds = torch.tensor([[rotor.speed_for_thrust(t) for t in thrusts]], dtype=F64)
    action = torch.tensor([thrusts], dtype=F64) if unit == "thrust" else speeds
    state = state_at_rest(1, 4, device=torch.device("cpu"), dtype=F64)
    torch.testing.assert_close(controller.rotor_command(state, action), speeds)
    assert len(controller.action_names) == 4


def test_unknown_law_is_named() -> None:
    vehicle = vehicle_from_config(ROBOTS.get("tinyprop"), num_envs=1)
    with pytest.raises(ConfigError, match="law = 'attitud': unknown. Known: thrust"):
        make_controller(replace(CONTROLLERS.get("no_control"), law="attitud"), vehicle, 9.81)
