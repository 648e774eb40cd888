"""Integrated attitude against closed forms."""

import numpy as np
from scipy.spatial.transform import Rotation

from aerial_gym.sim2real.logs.raw_log import LogChannel
from aerial_gym.sim2real.logs.readers.integration import integrate_attitude, product_of_turns


def test_products_equal_those_one_after_the_other() -> None:
    turns = Rotation.random(103, random_state=0)
    expected = [turns[0]]
    for turn in turns[1:]:
        expected.append(expected[-1] * turn)
    products = Rotation.from_quat(product_of_turns(turns.as_quat()))
    assert max((one.inv() * other).magnitude() for one, other in zip(products, expected, strict=True)) < 1e-12


def test_a_constant_rate_turns_by_rate_times_time() -> None:
    """Turning left at 0.5 rad/s for 2 s ends at a yaw of 1 rad."""
    time = np.linspace(0.0, 2.0, 401)
    gyro = LogChannel(quantity="ang_vel", time=time, values=np.tile((0.0, 0.0, 0.5), (401, 1)), source="imu[0]")
    final = Rotation.from_quat(integrate_attitude(gyro).values[-1])
    np.testing.assert_allclose(final.as_rotvec(), (0.0, 0.0, 1.0), atol=1e-12)
