"""Thrust and attitude setpoints of PX4's position control: numbers by hand, and SciPy."""

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from aerial_gym.control.px4.cascade import PositionGains, attitude_from_thrust, quat_from_axes, velocity_control

F64 = torch.float64
NUMBERS = {"position": 1.0, "velocity": 2.0, "integral": 0.5, "derivative": 0.0}
LIMITS = {"speed": 10.0, "up": 3.0, "down": 1.0, "least_thrust": 0.12, "most_thrust": 0.9, "margin": 0.3, "tilt": 0.8,
          "hover": 0.5, "gravity": 9.8}  # fmt: skip


def make_gains(**changes: float) -> PositionGains:
    rows = {name: torch.full((1, 3), value, dtype=F64) for name, value in NUMBERS.items()}
    return PositionGains(
        **rows, **{name: torch.tensor([[value]], dtype=F64) for name, value in (LIMITS | changes).items()}
    )


def control(error: list[float], integral: list[float], **changes: float) -> tuple[list[float], list[float]]:
    """Return thrust and integral after a run of 0.01 s."""
    rows = (torch.tensor([row], dtype=F64) for row in (error, integral, [0.0, 0.0, 0.0]))
    _, thrust, after = velocity_control(*rows, make_gains(**changes), 0.01)
    return thrust[0].tolist(), after[0].tolist()


@pytest.mark.parametrize(("error", "integral", "after"), [
    (0.5, -9.0, -8.9975),  # at the least thrust, but upwards
    (-0.5, -9.0, -9.0),  # at the least thrust, and downwards
    (0.5, 9.0, 9.0),  # at the most thrust, and upwards
    (-0.5, 9.5, 9.4975),  # at the most thrust, but downwards
])  # fmt: skip
def test_the_vertical_integral_leaves_a_limit_of_thrust(error: float, integral: float, after: float) -> None:
    """It grows by ``0.5 e 0.01`` unless the thrust is at a limit that the error would exceed more."""
    assert control([0.0, 0.0, error], [0.0, 0.0, integral])[1][2] == pytest.approx(after, abs=1e-12)


def test_full_vertical_thrust_without_a_margin_leaves_no_lateral_thrust() -> None:
    assert control([1.0, 0.0, 5.0], [0.0, 0.0, 9.0], margin=0.0)[0] == pytest.approx([0.0, 0.0, 0.9], abs=1e-12)


def test_a_quaternion_of_axes_is_scipys() -> None:
    """Random turns, most of which need one of the three forms for large angles."""
    rotations = Rotation.random(500, random_state=0)
    axes = torch.from_numpy(rotations.as_matrix())
    actual, expected = quat_from_axes(*axes.unbind(-1)), torch.from_numpy(rotations.as_quat())
    forms = expected.abs().argmax(-1)
    assert forms.unique().tolist() == [0, 1, 2, 3]
    sign = (actual * expected).sum(-1, keepdim=True).sign()
    torch.testing.assert_close(sign * actual, expected, rtol=0.0, atol=1e-14)


def test_an_attitude_points_its_thrust_and_keeps_the_heading() -> None:
    """Body z is along the thrust, body x in the vertical plane of the heading and on its side."""
    rng = np.random.default_rng(0)
    thrust = rng.normal(size=(100, 3)) + np.array([0.0, 0.0, 4.0])
    yaw = rng.uniform(-np.pi, np.pi, 100)
    heading = np.stack((np.cos(yaw), np.sin(yaw), 0.0 * yaw), axis=1)
    attitude = Rotation.from_quat(attitude_from_thrust(torch.from_numpy(thrust), torch.from_numpy(heading)).numpy())
    x, _, z = np.moveaxis(attitude.as_matrix(), 2, 0)
    np.testing.assert_allclose(z, thrust / np.linalg.norm(thrust, axis=1)[:, None], atol=1e-14)
    np.testing.assert_allclose(x[:, 0] * heading[:, 1], x[:, 1] * heading[:, 0], atol=1e-14)
    assert ((x * heading).sum(1) > 0.0).all()
