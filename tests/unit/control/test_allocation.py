"""Allocation where rotors are at their limits, against linear programs, and in Warp.
Inverses of effectiveness matrices, against the pseudo-inverses of numpy.
"""

from dataclasses import replace
from math import cos, pi, sin
from typing import Any

import numpy as np
import pytest
import torch
import warp as wp
from scipy.optimize import linprog
from torch import Tensor

from aerial_gym.config.controller import ControlCfg
from aerial_gym.config.loader import build as from_mapping
from aerial_gym.config.robot import MountCfg, RobotCfg
from aerial_gym.control import CONTROLLERS, make_controller
from aerial_gym.control.allocation import Allocation, ThrustsByPriority, allocation_matrix, allot
from aerial_gym.control.controllers import LeeController
from aerial_gym.control.effectiveness import PRIORITY, find_actuation, pseudo_inverse, right_inverse
from aerial_gym.control.gains import bind_gains
from aerial_gym.errors import ConfigError
from aerial_gym.interop import start_warp
from aerial_gym.math.warp_functions import vector_type
from aerial_gym.physics import vehicle_from_config
from aerial_gym.physics.fused.torch_trace import trace_to_warp
from aerial_gym.physics.vehicle import is_shared
from aerial_gym.robots import ROBOTS
from tests.repetitions import rare_values

F64 = torch.float64


def allot_rotor_thrusts(inverse, wrench, low, high):
    return allot(inverse, wrench, low, high).thrust


def hexarotor() -> RobotCfg:
    """Return six rotors tilted in turn: forces to the side too, and unequal shares of thrust."""
    base = ROBOTS.get("tinyprop")
    arms = [(0.2 * cos(k * pi / 3), 0.2 * sin(k * pi / 3), 0.01 * k) for k in range(6)]
    tilts = [(0.3 * sin(k * pi / 3), -0.3 * cos(k * pi / 3), 1.0) for k in range(6)]
    layout = [
        MountCfg(position=arm, axis=tuple((-1) ** k * t if i < 2 else t for i, t in enumerate(tilt)), spin=(-1) ** k)
        for k, (arm, tilt) in enumerate(zip(arms, tilts, strict=True))
    ]
    return replace(base, mounts=replace(base.mounts, layout=tuple(layout)))


def with_a_pusher() -> RobotCfg:
    """Return a quadrotor with a fifth rotor that pushes forward and carries nothing."""
    base = ROBOTS.get("base_quadrotor")
    pusher = MountCfg(position=(-0.2, 0.0, 0.0), axis=(1.0, 0.0, 0.0), spin=1)
    rotor = replace(base.rotor, torque_ratio=0.0)
    return replace(base, rotor=rotor, mounts=replace(base.mounts, layout=(*base.mounts.layout, pusher)))


VEHICLES = {"quadrotor": ROBOTS.get("tinyprop"), "hexarotor": hexarotor(), "pusher": with_a_pusher()}


def make_allocation(robot: RobotCfg, num_envs: int, dtype: torch.dtype = F64) -> Allocation:
    return Allocation(vehicle_from_config(robot, num_envs=num_envs, dtype=dtype), 9.81)


def wrenches(robot: RobotCfg, count: int, size: float) -> Tensor:
    """Return wrenches about hover; ``size`` 1 is about what the rotors can give."""
    g = torch.Generator().manual_seed(0)
    weight, reach = robot.body.mass * 9.81, max(max(map(abs, m.position)) for m in robot.mounts.layout)
    scale = weight * torch.tensor([0.2, 0.2, 0.5, 0.5 * reach, 0.5 * reach, 0.02 * reach], dtype=F64)
    draw = size * scale * torch.randn(count, 6, dtype=F64, generator=g)
    draw[:, 2] += weight
    return draw


def best_by_linear_programs(allocation: Allocation, wrench: np.ndarray) -> np.ndarray:
    """Return the thrusts of which each of roll-pitch share, thrust and the rest's share is the best given those before
    it. On a quadrotor the rest may help from the start; it cannot help roll and pitch there."""
    inverse, low, high = (t[0].numpy() for t in (allocation.inverse, allocation.low, allocation.high))
    parts = inverse * wrench
    turn, rest, lift = parts[:, 3] + parts[:, 4], parts[:, 0] + parts[:, 1] + parts[:, 5], inverse[:, 2]
    resting = np.where(lift == 0.0, np.clip(0.0, low, high), 0.0)  # a rotor that carries nothing starts where it may
    # Share, thrust above and below the wanted one, share of the rest.
    columns = np.stack((turn, lift, -lift, rest), axis=1)
    base = resting + wrench[2] * lift
    matrix, limit = np.concatenate((columns, -columns)), np.concatenate((high - base, base - low)) + 1e-11
    bounds = [(0.0, 1.0), (0.0, None), (0.0, None), (0.0, 1.0 if len(lift) == 4 else 0.0)]

    def solve(cost: list[float]) -> np.ndarray:
        result = linprog(cost, A_ub=matrix, b_ub=limit, bounds=bounds, method="highs")
        assert result.status == 0
        return result.x

    share = solve([-1.0, 0.0, 0.0, 0.0])[0]
    bounds[0], bounds[3] = (share, share), (0.0, 1.0)
    away = solve([0.0, 1.0, 1.0, 0.0])
    bounds[1:3] = [(away[1], away[1]), (away[2], away[2])]
    return base + columns @ solve([0.0, 0.0, 0.0, -1.0])


def has_margin(allocation: Allocation, wrench: Tensor) -> Tensor:
    """Return the mask of wrenches whose rotor thrusts all lie within the limits, (E,)."""
    plain = allocation.thrust(wrench)
    return ((plain >= allocation.low) & (plain <= allocation.high)).all(-1)


@pytest.mark.parametrize("name", VEHICLES)
@pytest.mark.parametrize("size", [0.5, 3.0])
def test_each_priority_is_the_best_that_linear_programs_find(name: str, size: float) -> None:
    allocation = make_allocation(VEHICLES[name], 40)
    wanted = wrenches(VEHICLES[name], 40, size)
    result = allot_rotor_thrusts(allocation.inverse, wanted, allocation.low, allocation.high)
    at_limits = ~has_margin(allocation, wanted)
    expected = np.stack([best_by_linear_programs(allocation, row) for row in wanted[at_limits].numpy()])
    assert len(expected) > 10
    torch.testing.assert_close(result[at_limits], torch.from_numpy(expected), atol=1e-7, rtol=0)


@pytest.mark.parametrize("name", VEHICLES)
def test_a_wrench_within_the_limits_is_the_pseudo_inverse_bit_for_bit(name: str) -> None:
    allocation = make_allocation(VEHICLES[name], 256)
    low, high = allocation.low, allocation.high
    g = torch.Generator().manual_seed(1)
    thrust = low + (high - low) * torch.rand(low.shape, dtype=F64, generator=g)
    vehicle = vehicle_from_config(VEHICLES[name], num_envs=256, dtype=F64)
    wanted = (allocation_matrix(vehicle, 9.81) @ thrust.unsqueeze(-1)).squeeze(-1)
    plain, fits = allocation.thrust(wanted), has_margin(allocation, wanted)
    assert fits.sum() > 50
    assert torch.equal(allot_rotor_thrusts(allocation.inverse, wanted, low, high)[fits], plain[fits])


def test_clamp_lets_every_rotor_stop_at_its_own_limit() -> None:
    robot = ROBOTS.get("tinyprop")
    vehicle = vehicle_from_config(robot, num_envs=1, dtype=F64)
    wanted = torch.tensor([[0.0, 0.0, 4.7, 0.05, 0.0, 0.0]], dtype=F64)
    thrust = {}
    for name in ("clamp", "prioritised"):
        speed = Allocation(vehicle, 9.81, saturation=name).speed_for_wrench(wanted)
        thrust[name] = speed[0] ** 2 * robot.rotor.thrust_map[2]
    clamped = Allocation(vehicle, 9.81)
    torch.testing.assert_close(
        thrust["clamp"], clamped.speed(clamped.thrust(wanted))[0] ** 2 * robot.rotor.thrust_map[2]
    )
    roll = {name: float(allocation_matrix(vehicle, 9.81)[0, 3] @ own) for name, own in thrust.items()}
    assert roll["prioritised"] == pytest.approx(0.05, rel=1e-9)
    assert roll["clamp"] < 0.049


def test_gradients_flow_through_limits_and_are_those_of_differences() -> None:
    allocation = make_allocation(ROBOTS.get("tinyprop"), 8)
    wanted = wrenches(ROBOTS.get("tinyprop"), 8, 1.0).requires_grad_()

    def thrust(wrench: Tensor) -> Tensor:
        return allot_rotor_thrusts(allocation.inverse, wrench, allocation.low, allocation.high)

    assert torch.autograd.gradcheck(thrust, (wanted,), atol=1e-6)


def argument_types(num_rotors: int) -> dict[str, Any]:
    """Return the Warp types of the arguments of ``allot_rotor_thrusts``."""
    vector = vector_type(num_rotors)
    matrix = wp.types.matrix(shape=(num_rotors, 6), dtype=wp.float32)
    return {"inverse": matrix, "wrench": vector_type(6), "low": vector, "high": vector}


@pytest.mark.parametrize("by_hand", [True, False])
@pytest.mark.parametrize("name", rare_values(VEHICLES, ["hexarotor"]))
def test_warp_gives_the_same_thrusts(name: str, by_hand: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    if not by_hand:
        monkeypatch.delattr(ThrustsByPriority, "make_warp")
    robot = VEHICLES[name]
    start_warp()
    kinds = argument_types(robot.num_rotors)
    matrix, wrench_type, vector, _ = kinds.values()
    allotted = trace_to_warp("allot", kinds, allot_rotor_thrusts, (vector,))

    @wp.kernel(module="unique", enable_backward=False)
    def spread(inverse: matrix, low: vector, high: vector, wanted: wp.array[wrench_type], thrust_out: wp.array[vector]):
        env = wp.tid()
        thrust_out[env] = allotted(inverse, wanted[env], low, high)

    exact = make_allocation(robot, 200)
    wanted = torch.cat([wrenches(robot, 100, size) for size in (0.3, 3.0)])
    numbers = [
        kind(*rows[0].flatten().tolist())
        for kind, rows in ((matrix, exact.inverse), (vector, exact.low), (vector, exact.high))
    ]
    result = torch.full((200, robot.num_rotors), torch.nan)
    wp.launch(
        spread, dim=200, inputs=[*numbers, wp.from_torch(wanted.float(), dtype=wrench_type)],
        outputs=[wp.from_torch(result, dtype=vector)], device="cpu",
    )  # fmt: skip
    expected = torch.clamp(allot_rotor_thrusts(exact.inverse, wanted, exact.low, exact.high), exact.low, exact.high)
    size = 1.0 + wanted.abs().max() * exact.inverse.abs().max()
    torch.testing.assert_close(result.double(), expected, atol=float(size) * 4e-6, rtol=0)


def test_a_vehicle_without_weight_has_an_allocation_but_no_geometric_law() -> None:
    vehicle = vehicle_from_config(ROBOTS.get("base_quadrotor"), num_envs=2)
    torch.testing.assert_close(allocation_matrix(vehicle, 0.0), allocation_matrix(vehicle, 9.81))
    make_controller(CONTROLLERS.get("no_control"), vehicle, 0.0)
    with pytest.raises(ConfigError, match="gravity = 0.0: the law 'velocity' needs a weight"):
        make_controller(CONTROLLERS.get("lee_velocity_control"), vehicle, 0.0, dt=0.01)


@pytest.mark.slow
def test_gradients_in_warp_are_those_of_torch() -> None:
    """Of a weighted sum of thrusts by the wrench, on a hexarotor, at limits of every kind."""
    robot = VEHICLES["hexarotor"]
    start_warp()
    kinds = argument_types(6)
    matrix, wrench_type, vector, _ = kinds.values()
    allotted = trace_to_warp("allot", kinds, allot_rotor_thrusts, (vector,), differentiable=True)

    @wp.kernel(module="unique", enable_backward=True, module_options={"optimization_level": 0})  # compiles in a third
    def weigh(
        inverse: matrix, low: vector, high: vector, wanted: wp.array[wrench_type], weight: vector,
        sum_out: wp.array[float],
    ):  # fmt: skip
        env = wp.tid()
        sum_out[env] = wp.dot(weight, allotted(inverse, wanted[env], low, high))

    exact, wanted = make_allocation(robot, 60), wrenches(robot, 60, 1.0).requires_grad_()
    weight = torch.linspace(-1.0, 2.0, 6, dtype=F64)
    thrust = allot_rotor_thrusts(exact.inverse, wanted, exact.low, exact.high)
    (expected,) = torch.autograd.grad((thrust @ weight).sum(), wanted)
    numbers = [
        kind(*rows[0].flatten().tolist())
        for kind, rows in ((matrix, exact.inverse), (vector, exact.low), (vector, exact.high))
    ]
    single = wp.from_torch(wanted.detach().float(), dtype=wrench_type, requires_grad=True)
    total = wp.zeros(60, dtype=wp.float32, device="cpu", requires_grad=True)
    with wp.Tape() as tape:
        wp.launch(weigh, dim=60, inputs=[*numbers, single, vector(*weight.tolist())], outputs=[total], device="cpu")
    tape.backward(grads={total: wp.full(60, 1.0, dtype=wp.float32, device="cpu")})
    result = wp.to_torch(tape.gradients[single]).view(60, 6).double()
    assert (~has_margin(exact, wanted.detach())).sum() > 20
    torch.testing.assert_close(result, expected, atol=1e-3 * float(expected.abs().max()), rtol=0)


def test_a_controller_moves_to_the_device_of_its_vehicle_with_rows_that_stay_shared() -> None:
    vehicle = vehicle_from_config(ROBOTS.get("tinyprop"), num_envs=3)
    there = vehicle.to_device("meta")
    controller = make_controller(CONTROLLERS.get("lee_velocity_control"), vehicle, 9.81, dt=0.01)
    assert isinstance(controller, LeeController)
    allocation, gains = controller.allocation.bind_vehicle(there), bind_gains(controller.gains, there)
    moved = [*there.tensors_by_name().values(), allocation.inverse, allocation.low, gains.rate, gains.max_slope]
    assert all(rows.device.type == "meta" and is_shared(rows) and len(rows) == 3 for rows in moved)
    assert allocation.vehicle is there
    assert gains.mass is there.mass
    assert (vehicle.time_constant_up is vehicle.time_constant_down) == (
        there.time_constant_up is there.time_constant_down
    )
    assert vehicle.to_device("cpu") is vehicle


def make_tilted_robot() -> RobotCfg:
    """Return a quadrotor of which each rotor leans another way: lateral forces come with whatever it does."""
    base = ROBOTS.get("tinyprop")
    axes = [(0.3, 0.1, 1.0), (-0.2, 0.3, 1.0), (0.1, -0.4, 1.0), (0.2, 0.2, 1.0)]
    layout = [replace(mount, axis=axis) for mount, axis in zip(base.mounts.layout, axes, strict=True)]
    return replace(base, mounts=replace(base.mounts, layout=tuple(layout)))


ROBOTS_OF_ALL_KINDS = {
    "quadrotor": ROBOTS.get("tinyprop"), "hexarotor": hexarotor(), "pusher": with_a_pusher(),
    "octarotor": ROBOTS.get("omnidirectional_octarotor"), "leaning": make_tilted_robot(),
}  # fmt: skip


def vehicle_matrix(name: str) -> Tensor:
    return allocation_matrix(vehicle_from_config(ROBOTS_OF_ALL_KINDS[name], num_envs=1, dtype=F64), 9.81)


def perturb(matrix: Tensor, count: int) -> Tensor:
    """Return matrices (E, 6, R) of vehicles whose parts are all some 10 % off, forces to the side included."""
    noise = torch.randn(count, *matrix.shape[1:], dtype=F64, generator=torch.Generator().manual_seed(2))
    return matrix + 0.1 * noise * matrix.abs().amax(-1, keepdim=True).clamp_min(0.02)


ASKED = {"quadrotor": (2, 3, 4, 5), "pusher": (0, 2, 3, 4), "leaning": (2, 3, 4, 5)}
"""Rows of the matrix that are asked of the rotors; of the others, all."""


def reference_inverse(matrix: np.ndarray, name: str) -> np.ndarray:
    """Return the pseudo-inverse of the rows that are asked for, with zeros for the others, (R, 6)."""
    axes, result = list(ASKED.get(name, range(6))), np.zeros((matrix.shape[1], 6))
    result[:, axes] = np.linalg.pinv(matrix[axes])
    return result


@pytest.mark.parametrize("name", ROBOTS_OF_ALL_KINDS)
def test_of_the_nominal_vehicle_it_is_the_pseudo_inverse_of_what_is_asked(name: str) -> None:
    matrix = vehicle_matrix(name)
    actuation = find_actuation(matrix[0])
    result, exact = right_inverse(matrix, actuation), matrix[0].numpy()
    torch.testing.assert_close(result[0].numpy(), reference_inverse(exact, name), atol=1e-9, rtol=0)
    torch.testing.assert_close(result, pseudo_inverse(actuation.mask_rows(matrix)), atol=1e-9, rtol=0)
    if name != "leaning":
        torch.testing.assert_close(result[0].numpy(), np.linalg.pinv(exact, rcond=1e-9), atol=1e-9, rtol=0)


def test_three_rotors_lift_roll_and_pitch_exactly_whatever_yaw_comes_with_it() -> None:
    """Two front rotors at L/2 and a tail at L carry a third each; a torque about x is that of the front ones, ``-+1 / 2a`` at
    the sides -+a. Yaw, which none of them gives by itself, is asked of none."""
    robot = ROBOTS.get("tilt_tricopter")
    inverse = Allocation(vehicle_from_config(robot, num_envs=1, dtype=F64), 9.81).inverse[0]
    side = 0.2131056
    thirds = torch.full((3,), 1.0 / 3.0, dtype=F64)
    torch.testing.assert_close(inverse[:, 2], thirds, atol=1e-7, rtol=0)
    torch.testing.assert_close(inverse[:, 3], torch.tensor([-0.5, 0.5, 0.0], dtype=F64) / side, atol=1e-7, rtol=0)
    assert not inverse[:, [0, 1, 5]].any()


@pytest.mark.parametrize("name", ROBOTS_OF_ALL_KINDS)
def test_of_another_vehicle_it_is_the_pseudo_inverse_of_what_is_asked_of_the_nominal_one(name: str) -> None:
    nominal = vehicle_matrix(name)
    matrices = perturb(nominal, 50)
    result = right_inverse(matrices, find_actuation(nominal[0]))
    axes = list(ASKED.get(name, range(6)))
    for inverse, matrix in zip(result.numpy(), matrices.numpy(), strict=True):
        expected = reference_inverse(matrix, name)
        part = np.abs(expected) * np.abs(matrix).max(1) > 2e-6
        torch.testing.assert_close(inverse[part], expected[part], atol=0, rtol=1e-7)
        torch.testing.assert_close(matrix[axes] @ inverse, np.eye(6)[axes], atol=2e-5, rtol=0)


def test_gradients_are_those_of_differences() -> None:
    nominal = vehicle_matrix("quadrotor")
    actuation = find_actuation(nominal[0])
    matrix = perturb(nominal, 3).requires_grad_()
    assert torch.autograd.gradcheck(lambda m: right_inverse(m, actuation), (matrix,), atol=1e-5)


@pytest.mark.parametrize(("arm", "turns"), [(1e-3, True), (1e-4, True), (1e-6, False), (0.0, False)])
def test_a_torque_without_lever_arm_is_asked_of_no_rotor(arm: float, turns: bool) -> None:
    nominal = vehicle_matrix("quadrotor").float()
    matrix = nominal.clone()
    matrix[0, 4] *= arm
    result = right_inverse(matrix, find_actuation(nominal[0]))[0].double().numpy()
    exact = matrix[0].double().numpy()
    if turns:
        torch.testing.assert_close(exact[2:] @ result[:, 2:], np.eye(4), atol=1e-5, rtol=0)
        return
    exact[4] = 0.0
    assert not result[:, 4].any()
    torch.testing.assert_close(result, np.linalg.pinv(exact), atol=1e-4, rtol=1e-6)


@pytest.mark.parametrize("share", [0.0, 1e-7])
def test_what_depends_on_more_important_torques_is_asked_of_no_rotor(share: float) -> None:
    nominal = vehicle_matrix("quadrotor").float()
    matrix = nominal.clone()
    matrix[0, 5] = -0.01 * matrix[0, 2] + share * nominal[0, 5]
    result = right_inverse(matrix, find_actuation(nominal[0]))[0].double().numpy()
    exact = matrix[0].double().numpy()
    exact[5] = 0.0
    assert not result[:, 5].any()
    torch.testing.assert_close(result, np.linalg.pinv(exact), atol=1e-4, rtol=1e-6)


def test_numbers_that_are_none_make_no_command() -> None:
    nominal = vehicle_matrix("quadrotor")
    assert not right_inverse(nominal * torch.nan, find_actuation(nominal[0])).any()


def test_what_is_asked_is_what_matters_most() -> None:
    assert find_actuation(vehicle_matrix("hexarotor")[0]).axes == PRIORITY
    assert find_actuation(vehicle_matrix("quadrotor")[0]).axes == (3, 4, 2, 5)
    assert find_actuation(vehicle_matrix("leaning")[0]).axes == (3, 4, 2, 5)


def test_a_robot_file_says_whose_effectiveness_it_is() -> None:
    assert from_mapping(ControlCfg, {"effectiveness": "actual"}, where="here").effectiveness == "actual"
    with pytest.raises(ConfigError, match="effectiveness = 'true': must be one of nominal, actual"):
        from_mapping(ControlCfg, {"effectiveness": "true"}, where="here")
