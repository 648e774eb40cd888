"""Allocation and controllers: geometry, signs and limits."""

from dataclasses import replace
from math import sqrt, tan

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from aerial_gym.config.controller import ControlCfg
from aerial_gym.control import CONTROLLERS, Controller, make_controller
from aerial_gym.control.allocation import Allocation, allocation_matrix
from aerial_gym.control.catalog import AERIAL_GYM_GAINS
from aerial_gym.control.laws import LAWS
from aerial_gym.control.lee import LeeGains
from aerial_gym.errors import ConfigError
from aerial_gym.physics import BodyState, accelerations, build_model, state_at_rest, vehicle_from_config
from aerial_gym.robots import ROBOTS
from tests.physics.vehicles import F64, asymmetric_robot, random_state


def test_allocation_matrix_of_base_quadrotor_is_the_published_one() -> None:
    """Rows Fz ones, Mx (-l, -l, l, l), My (-l, l, l, -l), Mz (-c, c, -c, c), l = 0.13 m, c = 0.01 m (parity.md 2.4)."""
    vehicle = vehicle_from_config(ROBOTS.get("base_quadrotor"), num_envs=1, dtype=F64)
    l, c = 0.13, 0.01  # noqa: E741
    rows = [[0] * 4, [0] * 4, [1] * 4, [-l, -l, l, l], [-l, l, l, -l], [-c, c, -c, c]]
    torch.testing.assert_close(allocation_matrix(vehicle, 9.81)[0], torch.tensor(rows, dtype=F64), atol=1e-12, rtol=0)


def test_allocation_reproduces_the_wrench_that_the_physics_makes_of_it() -> None:
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
    limits = torch.tensor([[sqrt(t / robot.rotor.thrust_map[2]) for t in (0.2, 0.5, 0.2, 1.2)]], dtype=F64)
    torch.testing.assert_close(speed, limits)


def draw_gains(num_envs: int) -> LeeGains:
    g = torch.Generator().manual_seed(5)

    def uniform(*shape: int) -> torch.Tensor:
        return 0.5 + torch.rand(num_envs, *shape, dtype=F64, generator=g)

    skew = uniform(3, 3)
    return LeeGains(
        position=uniform(3), velocity=uniform(3), attitude=uniform(3), rate=uniform(3), mass=uniform(),
        inertia=skew @ skew.transpose(1, 2), gravity=9.81, max_yaw_rate=1.0, max_inclination=0.9,
    )  # fmt: skip


def wrench_with_scipy(law: str, state: BodyState, action: np.ndarray, gains: LeeGains, env: int) -> np.ndarray:
    """Return Lee (2010), eq. 10-16, for one environment, in rotations of SciPy."""
    x, v, w = (rows[env].numpy() for rows in (state.position, state.lin_vel, state.ang_vel))
    kp, kv, kr, kw = (rows[env].numpy() for rows in (gains.position, gains.velocity, gains.attitude, gains.rate))
    mass, inertia, gravity = float(gains.mass[env]), gains.inertia[env].numpy(), np.array([0.0, 0.0, gains.gravity])
    turn = Rotation.from_quat(state.attitude[env].numpy())
    heading = turn.as_euler("ZYX")[0]
    rate, push = np.zeros(3), np.zeros(3)
    if law in ("velocity", "acceleration", "attitude"):
        rate = turn.inv().apply([0.0, 0.0, np.clip(action[3], -gains.max_yaw_rate, gains.max_yaw_rate)])
    if law in ("attitude", "rates"):
        push[2] = (1.0 + action[0]) * mass * gains.gravity
        desired = turn if law == "rates" else Rotation.from_euler("ZYX", [heading, action[2], action[1]])
        rate = action[1:4] if law == "rates" else rate
    elif law == "pose":
        push = turn.inv().apply(mass * (kp * (action[:3] - x) - kv * v + gravity))
        desired = Rotation.from_quat(action[3:]) if action[3:].any() else Rotation.identity()
    else:
        course = Rotation.from_euler("z", heading).apply(action[:3])
        force = {"position": kp * (action[:3] - x) - kv * v, "acceleration": action[:3]}.get(law, kv * (course - v))
        force = mass * (force + gravity)
        force[2] = max(force[2], 0.1 * mass * gains.gravity)
        force[:2] *= min(1.0, force[2] * tan(gains.max_inclination) / np.linalg.norm(force[:2]))
        push[2] = turn.inv().apply(force)[2]
        ahead = action[3] if law in ("position", "steering") else heading
        axes = [force, [np.cos(ahead), np.sin(ahead), 0.0]]
        desired = Rotation.align_vectors(axes, [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0]], weights=[np.inf, 1.0])[0]
    error = (desired.inv() * turn).as_rotvec()
    angle = np.linalg.norm(error)
    sine = error * np.sinc(angle / np.pi)
    torque = np.cross(w, inertia @ w) - kw * (w - (turn.inv() * desired).apply(rate)) - kr * sine
    return np.concatenate((push, torque))


@pytest.mark.parametrize("law", LAWS)
def test_geometric_laws_are_those_of_lee_written_out_with_scipy(law: str) -> None:
    """Beyond limits of lift, tilt and yaw rate too: an acceleration of 12 m/s² and a yaw rate of 4 rad/s are usual draws."""
    num_envs = 64
    state, gains = random_state(num_envs), draw_gains(num_envs)
    scale = torch.tensor([12.0, 12.0, 12.0, 4.0] if law in ("acceleration", "velocity") else [2.0], dtype=F64)
    width = len(LAWS[law].action)
    action = scale * torch.randn(num_envs, width, dtype=F64, generator=torch.Generator().manual_seed(6))
    action[0, 3:] = 0.0
    given = action.clone()
    wrench = LAWS[law].wrench(state, action, gains)
    expected = [wrench_with_scipy(law, state, action[env].numpy(), gains, env) for env in range(num_envs)]
    torch.testing.assert_close(wrench, torch.from_numpy(np.stack(expected)), atol=1e-11, rtol=1e-11)
    assert torch.equal(action, given)


def test_explicit_gains_stand_in_place_of_derived_ones() -> None:
    """In the controller or in the robot file; those of Aerial Gym are the middle of its ranges (parity.md 2.3)."""
    vehicle = vehicle_from_config(ROBOTS.get("tinyprop"), num_envs=3, dtype=F64)
    cfg, of_robot = CONTROLLERS.get("lee_position_control"), ControlCfg(gains=AERIAL_GYM_GAINS)
    gains = make_controller(replace(cfg, gains=AERIAL_GYM_GAINS), vehicle, 9.81).gains
    torch.testing.assert_close(make_controller(cfg, vehicle, 9.81, control=of_robot).gains.attitude, gains.attitude)
    torch.testing.assert_close(gains.position, torch.tensor([2.5, 2.5, 1.5], dtype=F64).expand(3, 3))
    torch.testing.assert_close(gains.attitude, torch.tensor([1.0, 1.0, 0.5], dtype=F64).expand(3, 3))
    torch.testing.assert_close(gains.rate, torch.tensor([0.15, 0.15, 0.15], dtype=F64).expand(3, 3))


def vehicle_controller(name: str, robot_name: str, num_envs: int) -> Controller:
    vehicle = vehicle_from_config(ROBOTS.get(robot_name), num_envs=num_envs, dtype=F64)
    return make_controller(CONTROLLERS.get(name), vehicle, 9.81, dt=0.01)


@pytest.mark.parametrize(("name", "unit"), [("no_control", "thrust"), ("rotor_speed_control", "speed")])
def test_direct_control_passes_the_action_unchanged(name: str, unit: str) -> None:
    controller = vehicle_controller(name, "tinyprop", 1)
    rotor = ROBOTS.get("tinyprop").rotor
    thrusts = [0.3, 0.5, 0.7, 0.9]
    speeds = torch.tensor([[sqrt(t / rotor.thrust_map[2]) for t in thrusts]], dtype=F64)
    action = torch.tensor([thrusts], dtype=F64) if unit == "thrust" else speeds
    state = state_at_rest(1, 4, device=torch.device("cpu"), dtype=F64)
    torch.testing.assert_close(controller.rotor_command(state, action), speeds)
    assert len(controller.action_names) == 4


def test_unknown_law_is_named() -> None:
    vehicle = vehicle_from_config(ROBOTS.get("tinyprop"), num_envs=1)
    with pytest.raises(ConfigError, match="law = 'attitud': unknown. Known: thrust"):
        make_controller(replace(CONTROLLERS.get("no_control"), law="attitud"), vehicle, 9.81)
