"""Inverses of effectiveness matrices, against the pseudo-inverses of numpy."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from aerial_gym.config.controller import ControlCfg
from aerial_gym.config.loader import build as from_mapping
from aerial_gym.config.robot import RobotCfg
from aerial_gym.control.allocation import Allocation
from aerial_gym.control.effectiveness import PRIORITY, allocation_matrix, find_actuation, pseudo_inverse, right_inverse
from aerial_gym.errors import ConfigError
from aerial_gym.physics import vehicle_from_config
from aerial_gym.robots import ROBOTS
from tests.unit.control.test_allocation import hexarotor, with_a_pusher

F64 = torch.float64


def make_tilted_robot() -> RobotCfg:
    """Return a quadrotor of which each rotor leans another way: lateral forces come with whatever it does."""
    base = ROBOTS.get("tinyprop")
    axes = [(0.3, 0.1, 1.0), (-0.2, 0.3, 1.0), (0.1, -0.4, 1.0), (0.2, 0.2, 1.0)]
    layout = [replace(mount, axis=axis) for mount, axis in zip(base.mounts.layout, axes, strict=True)]
    return replace(base, mounts=replace(base.mounts, layout=tuple(layout)))


VEHICLES = {
    "quadrotor": ROBOTS.get("tinyprop"), "hexarotor": hexarotor(), "pusher": with_a_pusher(),
    "octarotor": ROBOTS.get("omnidirectional_octarotor"), "leaning": make_tilted_robot(),
}  # fmt: skip


def vehicle_matrix(name: str) -> Tensor:
    return allocation_matrix(vehicle_from_config(VEHICLES[name], num_envs=1, dtype=F64), 9.81)


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


@pytest.mark.parametrize("name", VEHICLES)
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


@pytest.mark.parametrize("name", VEHICLES)
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
