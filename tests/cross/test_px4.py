"""PX4's cascade against PX4's own control libraries: golden vectors of 10,000 random states each.
``tests/cross/firmware/px4_vectors.py`` made them; ``px4_pairs.py`` lays ours beside them."""

import pytest
from torch import Tensor

from aerial_gym.control.lee import canonical_quat, shortest_turn
from aerial_gym.math.quaternion import quat_conjugate, quat_multiply, quat_rotate
from tests.cross.firmware.px4_pairs import (
    attitude_cases,
    attitude_pair,
    mixer_pair,
    position_pairs,
    rate_pair,
    read_vectors,
)

EPS = 2.0**-24
"""Half a unit in the last place of float32, in which PX4 computes."""


@pytest.fixture(scope="module")
def vectors() -> dict[str, Tensor]:
    return read_vectors()


def test_rate_control_is_px4s(vectors: dict[str, Tensor]) -> None:
    """Runs of four steps, with integral, feed-forward, limits and saturated rotors."""
    actual, reference, size = rate_pair(vectors)
    assert actual.shape == (4, 2500, 3)
    assert ((actual - reference).abs() <= 8 * EPS * size).all()


def test_the_mixer_is_px4s() -> None:
    """All three airmodes, quadrotors and six motors with random parts; four in five commands are beyond the limits. A step
    along a column is a quotient by a part of at least 0.2, and there are at most six: 8 roundings of numbers up to 5."""
    actual, reference = mixer_pair()
    assert actual.shape == (10_000, 6)
    assert float((actual - reference).abs().max()) <= 8 * EPS * 5.0


def test_attitude_control_is_px4s(vectors: dict[str, Tensor]) -> None:
    """From any attitude to any other. Rounding grows where the turn is ill-conditioned: between opposite tilts by the length
    n of half the turn between them, and where the heading error w, z nears 0 or 180 degrees, as PX4 takes arc cosine and arc
    sine, which lose digits there."""
    attitude, wanted, _, gain, weight, _ = attitude_cases()
    actual, reference = attitude_pair(vectors)
    up, goal = (quat_rotate(q, q.new_tensor((0.0, 0.0, 1.0)).expand(len(q), 3)) for q in (attitude, wanted))
    turn, _ = shortest_turn(up, goal)
    heading = canonical_quat(quat_multiply(quat_conjugate(quat_multiply(turn, attitude)), wanted)).abs()
    n = (2.0 + 2.0 * (up * goal).sum(-1)).sqrt()
    growth = 1.0 / n + 1.0 / heading[:, 3] + 1.0 / heading[:, 2]
    bound = 8 * EPS * gain.amax(-1) / weight[:, 0] * growth
    error = (actual - reference).abs().amax(-1)
    assert len(error) == 10_000
    assert (error <= bound).all()
    assert float(error.median()) < 2e-6


def test_position_control_is_px4s(vectors: dict[str, Tensor]) -> None:
    """Runs of four steps, to positions or velocities, against all limits: acceleration, thrust and attitude."""
    pairs = position_pairs(vectors)
    for name, (actual, reference, size) in pairs.items():
        assert actual.shape[:2] == (4, 2500)
        assert ((actual - reference).abs() <= 64 * EPS * size).all(), name
    thrust = pairs["normalised thrust"][1].norm(dim=-1)
    assert int((thrust >= 0.6).sum()) > 1000  # so many are near the limits, 0.6 to 1, or the test would not see them
