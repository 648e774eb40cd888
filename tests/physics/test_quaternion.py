"""Rotations against matrices, identities and signed cases."""

import pytest
import torch

from aerial_gym.math import quaternion as qm

F64 = torch.float64


def random_quats(n: int = 200, seed: int = 0) -> torch.Tensor:
    return qm.quat_normalize(torch.randn(n, 4, dtype=F64, generator=torch.Generator().manual_seed(seed)))


def test_rotate_is_the_matrix_and_preserves_length() -> None:
    q, v = random_quats(), torch.randn(200, 3, dtype=F64, generator=torch.Generator().manual_seed(1))
    rotated = qm.quat_rotate(q, v)
    torch.testing.assert_close(rotated, (qm.quat_to_matrix(q) @ v.unsqueeze(-1)).squeeze(-1), atol=1e-13, rtol=0)
    torch.testing.assert_close(rotated.norm(dim=-1), v.norm(dim=-1), atol=1e-13, rtol=0)
    torch.testing.assert_close(qm.quat_rotate_inverse(q, rotated), v, atol=1e-13, rtol=0)


def test_product_is_composition_of_matrices() -> None:
    a, b = random_quats(seed=1), random_quats(seed=2)
    product = qm.quat_to_matrix(qm.quat_multiply(a, b))
    torch.testing.assert_close(product, qm.quat_to_matrix(a) @ qm.quat_to_matrix(b), atol=1e-13, rtol=0)


@pytest.mark.parametrize("size", [0.0, 1e-9, 1e-5, 1e-4, 1.1e-4, 0.5, 3.1])
def test_exp_is_the_matrix_exponential_and_log_its_inverse(size: float) -> None:
    axis = torch.nn.functional.normalize(
        torch.randn(50, 3, dtype=F64, generator=torch.Generator().manual_seed(3)), dim=-1
    )
    rotation = size * axis
    x, y, z = rotation.unbind(-1)
    zero = torch.zeros_like(x)
    skew = torch.stack((zero, -z, y, z, zero, -x, -y, x, zero), -1).unflatten(-1, (3, 3))
    q = qm.quat_exp(rotation)
    torch.testing.assert_close(qm.quat_to_matrix(q), torch.linalg.matrix_exp(skew), atol=1e-13, rtol=0)
    torch.testing.assert_close(qm.quat_log(q), rotation, atol=1e-13, rtol=1e-12)


def test_log_takes_the_shorter_turn_for_both_signs() -> None:
    rotation = torch.tensor([[0.3, -0.2, 0.9]], dtype=F64)
    torch.testing.assert_close(qm.quat_log(-qm.quat_exp(rotation)), rotation, atol=1e-14, rtol=0)


def test_exp_gradient_is_finite_at_zero() -> None:
    rotation = torch.zeros(1, 3, dtype=F64, requires_grad=True)
    assert torch.autograd.gradcheck(qm.quat_exp, (rotation,))


def test_euler_is_zyx_and_round_trips() -> None:
    angles = torch.tensor([[0.3, -0.4, 2.5], [-3.0, 1.2, -3.0]], dtype=F64)
    q = qm.quat_from_euler(angles)

    def axis_rotation(axis: int, angle: torch.Tensor) -> torch.Tensor:
        vector = torch.zeros(len(angle), 3, dtype=F64)
        vector[:, axis] = angle
        return qm.quat_exp(vector)

    expected = qm.quat_multiply(
        qm.quat_multiply(axis_rotation(2, angles[:, 2]), axis_rotation(1, angles[:, 1])), axis_rotation(0, angles[:, 0])
    )
    torch.testing.assert_close(qm.quat_to_matrix(q), qm.quat_to_matrix(expected), atol=1e-14, rtol=0)
    torch.testing.assert_close(qm.euler_from_quat(q), angles, atol=1e-13, rtol=0)


def test_yaw_keeps_the_heading_of_body_x() -> None:
    angles = torch.tensor([[0.3, -0.4, 2.5]], dtype=F64)
    yaw = qm.quat_without_tilt(qm.quat_from_euler(angles))
    torch.testing.assert_close(qm.euler_from_quat(yaw), torch.tensor([[0.0, 0.0, 2.5]], dtype=F64), atol=1e-14, rtol=0)
