"""Inverses of effectiveness matrices, against the pseudo-inverses of numpy."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from aerial_gym.config.controller import ControlCfg
from aerial_gym.config.loader import build as from_mapping
from aerial_gym.config.robot import RobotCfg
from aerial_gym.control.effectiveness import PRIORITY, actuation_of, allocation_matrix, pseudo_inverse, right_inverse
from aerial_gym.errors import ConfigError
from aerial_gym.physics import vehicle_from_config
from aerial_gym.robots import ROBOTS
from tests.unit.control.test_allocation import hexarotor, with_a_pusher

F64 = torch.float64


def leaning() -> RobotCfg:
    """Return a quadrotor of which each rotor leans another way: its four forces and torques are combinations of six."""
    base = ROBOTS.get("tinyprop")
    axes = [(0.3, 0.1, 1.0), (-0.2, 0.3, 1.0), (0.1, -0.4, 1.0), (0.2, 0.2, 1.0)]
    layout = [replace(mount, axis=axis) for mount, axis in zip(base.mounts.layout, axes, strict=True)]
    return replace(base, mounts=replace(base.mounts, layout=tuple(layout)))


VEHICLES = {
    "quadrotor": ROBOTS.get("tinyprop"),
    "hexarotor": hexarotor(),
    "pusher": with_a_pusher(),
    "octarotor": ROBOTS.get("omnidirectional_octarotor"),
    "leaning": leaning(),
}


def matrix_of(name: str) -> Tensor:
    return allocation_matrix(vehicle_from_config(VEHICLES[name], num_envs=1, dtype=F64), 9.81)


def changed(matrix: Tensor, count: int) -> Tensor:
    """Return matrices (E, 6, R) of vehicles whose parts are all some 10 % off, forces to the side included."""
    noise = torch.randn(count, *matrix.shape[1:], dtype=F64, generator=torch.Generator().manual_seed(2))
    return matrix + 0.1 * noise * matrix.abs().amax(-1, keepdim=True).clamp_min(0.02)


@pytest.mark.parametrize("name", VEHICLES)
def test_of_the_nominal_vehicle_it_is_the_pseudo_inverse(name: str) -> None:
    matrix = matrix_of(name)
    found = right_inverse(matrix, actuation_of(matrix[0]))
    torch.testing.assert_close(found[0].numpy(), np.linalg.pinv(matrix[0].numpy(), rcond=1e-9), atol=1e-9, rtol=0)
    torch.testing.assert_close(found, pseudo_inverse(matrix), atol=1e-9, rtol=0)


@pytest.mark.parametrize("name", VEHICLES)
def test_of_another_vehicle_it_is_the_pseudo_inverse_within_what_the_nominal_one_can(name: str) -> None:
    """With an orthonormal basis U of what the nominal rotors can give: ``(U^T B)^+ U^T``, from numpy's factorisations."""
    nominal = matrix_of(name)
    left, size, _ = np.linalg.svd(nominal[0].numpy())
    span = left[:, : int((size > 1e-6 * size[0]).sum())]
    assert span.shape[1] == {"quadrotor": 4, "hexarotor": 6, "pusher": 4, "octarotor": 6, "leaning": 4}[name]
    matrices = changed(nominal, 50)
    found = right_inverse(matrices, actuation_of(nominal[0]))
    for inverse, matrix in zip(found.numpy(), matrices.numpy(), strict=True):
        expected = np.linalg.pinv(span.T @ matrix) @ span.T
        part = np.abs(expected) * np.abs(matrix).max(1) > 2e-6
        torch.testing.assert_close(inverse[part], expected[part], atol=0, rtol=1e-7)
        torch.testing.assert_close(span.T @ matrix @ inverse, span.T, atol=2e-5, rtol=0)


def test_gradients_are_those_of_differences() -> None:
    nominal = matrix_of("quadrotor")
    actuation = actuation_of(nominal[0])
    matrix = changed(nominal, 3).requires_grad_()
    assert torch.autograd.gradcheck(lambda m: right_inverse(m, actuation), (matrix,), atol=1e-5)


@pytest.mark.parametrize(("arm", "turns"), [(1e-3, True), (1e-4, True), (1e-6, False), (0.0, False)])
def test_a_torque_without_lever_arm_is_asked_of_no_rotor(arm: float, turns: bool) -> None:
    """All hubs nearly on the y axis: below a hundred thousandth of the nominal arms nothing is asked of pitch, and the rest is
    the pseudo-inverse without it."""
    nominal = matrix_of("quadrotor").float()
    matrix = nominal.clone()
    matrix[0, 4] *= arm
    found = right_inverse(matrix, actuation_of(nominal[0]))[0].double().numpy()
    exact = matrix[0].double().numpy()
    if turns:
        torch.testing.assert_close(exact[2:] @ found[:, 2:], np.eye(4), atol=1e-5, rtol=0)
        return
    exact[4] = 0.0
    assert not found[:, 4].any()
    torch.testing.assert_close(found, np.linalg.pinv(exact), atol=1e-4, rtol=1e-6)


@pytest.mark.parametrize("share", [0.0, 1e-7])
def test_what_depends_on_more_important_torques_is_asked_of_no_rotor(share: float) -> None:
    """All rotors turn the same way: yaw torque is the torque ratio times thrust. Thrust is kept, being the more important."""
    nominal = matrix_of("quadrotor").float()
    matrix = nominal.clone()
    matrix[0, 5] = -0.01 * matrix[0, 2] + share * nominal[0, 5]
    found = right_inverse(matrix, actuation_of(nominal[0]))[0].double().numpy()
    exact = matrix[0].double().numpy()
    exact[5] = 0.0
    assert not found[:, 5].any()
    torch.testing.assert_close(found, np.linalg.pinv(exact), atol=1e-4, rtol=1e-6)


def test_numbers_that_are_none_make_no_command() -> None:
    nominal = matrix_of("quadrotor")
    assert not right_inverse(nominal * torch.nan, actuation_of(nominal[0])).any()


def test_rows_are_of_what_matters_most() -> None:
    rows = actuation_of(matrix_of("hexarotor")[0]).rows
    assert [row.index(1.0) for row in rows] == list(PRIORITY)
    assert [row.index(1.0) for row in actuation_of(matrix_of("quadrotor")[0]).rows] == [3, 4, 2, 5]


def test_a_robot_file_says_whose_effectiveness_it_is() -> None:
    assert from_mapping(ControlCfg, {"effectiveness": "actual"}, where="here").effectiveness == "actual"
    with pytest.raises(ConfigError, match="effectiveness = 'true': must be one of nominal, actual"):
        from_mapping(ControlCfg, {"effectiveness": "true"}, where="here")
