"""Terms of flights to a point and a heading: numbers worked out by hand for chosen states, in float64."""

from math import inf, pi

import pytest
import torch
from torch import Tensor

from aerial_gym.math.quaternion import quat_from_euler, wrap_angle
from aerial_gym.task.terms import heading

ORIGIN = torch.zeros(1, 3, dtype=torch.float64)
HALF_A_METRE = torch.tensor([[0.3, 0.0, -0.4]], dtype=torch.float64)
SIX_METRES = torch.tensor([[-6.0, 0.0, 0.0]], dtype=torch.float64)  # Positions; targets are the origin


def row(*numbers: float) -> Tensor:
    return torch.tensor([numbers], dtype=torch.float64)


def number(value: float) -> Tensor:
    return torch.tensor([value], dtype=torch.float64)


def yaw_attitude(yaw: float, roll: float = 0.0, pitch: float = 0.0) -> Tensor:
    return quat_from_euler(row(roll, pitch, yaw))


@pytest.mark.parametrize(("target", "yaw", "error"), [
    (1.2, 0.7, 0.5),  # to the left
    (0.7, 1.2, -0.5),
    (-3.0, 3.0, 2.0 * pi - 6.0),  # the short way, to the left through pi
    (3.0, -3.0, 6.0 - 2.0 * pi),
])  # fmt: skip
def test_the_heading_error_is_the_short_turn_from_the_robot_to_the_target(target, yaw, error) -> None:
    for tilt in (0.0, 0.3):
        result = heading.heading_error(number(target), yaw_attitude(yaw, tilt, -tilt))
        assert result.shape == (1, 1)
        assert result.item() == pytest.approx(error, abs=1e-12)


def test_angles_are_wrapped_to_half_a_turn_on_both_sides() -> None:
    angles = torch.tensor([-7.0, -pi, -0.1, 0.0, 3.0, pi, 4.0, 100.0], dtype=torch.float64)
    result = wrap_angle(angles)
    assert ((result >= -pi) & (result < pi)).all()
    torch.testing.assert_close(torch.sin(result), torch.sin(angles), rtol=0.0, atol=1e-12)
    torch.testing.assert_close(torch.cos(result), torch.cos(angles), rtol=0.0, atol=1e-12)


@pytest.mark.parametrize(("position", "velocity", "expected"), [
    (SIX_METRES, (1.0, 3.0**0.5, 0.0), 1.0),  # 2 m/s, 60 degrees off: 0.5 2
    (SIX_METRES, (1.0, 0.0, 0.0), 0.2706706),  # straight, 1 m/s too slow: 2 exp(-2)
    (SIX_METRES, (3.0, 0.0, 0.0), 0.2706706),
    (SIX_METRES, (-2.0, 0.0, 0.0), -0.2),
    (SIX_METRES, (0.0, 0.0, 0.0), -0.2),  # no way is flown
    (0.25 * SIX_METRES, (2.0, 0.0, 0.0), 1.0),  # at 1.5 m: half
    (0.25 * SIX_METRES, (-2.0, 0.0, 0.0), -0.1),
    (ORIGIN, (2.0, 0.0, 0.0), 0.0),
])  # fmt: skip
def test_flight_to_the_target_counts_by_its_direction_and_speed(position, velocity, expected) -> None:
    result = heading.flight_to_target(
        ORIGIN, position, row(*velocity), speed=2.0, height=2.0, width=2.0, away=-0.2, near=3.0
    )
    assert result.item() == pytest.approx(expected, abs=1e-7)


def test_what_counts_at_the_target_counts_with_the_heading_and_within_the_radius() -> None:
    """1.5 exp(-10 0.2²), 4 exp(-15 0.5²), 1.5 exp(-5 0.2² - 2 0.5²)."""
    beyond, slow = 3.0 * HALF_A_METRE, row(0.0, 0.2, 0.0)
    turn, spin = (number(1.2), yaw_attitude(0.7)), row(9.0, 9.0, -0.2)
    for position, factor in ((HALF_A_METRE, 1.0), (beyond, 0.0)):
        result = heading.slow_at_target(ORIGIN, position, slow, radius=1.0, height=1.5, width=10.0)
        assert result.item() == pytest.approx(factor * 1.0054801, abs=1e-7)
        result = heading.heading_at_target(ORIGIN, position, *turn, radius=1.0, height=4.0, width=15.0)
        assert result.item() == pytest.approx(factor * 0.0940710, abs=1e-7)
        result = heading.aligned_rest_at_target(
            ORIGIN, position, *turn, spin, radius=1.0, height=1.5, width=5.0, yaw_width=2.0
        )
        assert result.item() == pytest.approx(factor * 0.7448780, abs=1e-7)
    params = {"height": 5.0, "width": 8.0, "yaw_width": 2.0}
    result = heading.aligned_distance_bell(ORIGIN, HALF_A_METRE, number(1.2), yaw_attitude(0.7), **params)
    assert result.item() == pytest.approx(0.4104250, abs=1e-7)  # 5 exp(-8 0.5² - 2 0.5²)


@pytest.mark.parametrize(("speed", "expected"), [(2.9, 0.0), (3.0, 0.0), (3.5, -0.7869387), (90.0, -2.0)])
def test_speed_costs_above_its_limit(speed: float, expected: float) -> None:
    """2 (exp(-2 0.5²) - 1) half a metre per second above it."""
    result = heading.speeding(row(0.6 * speed, 0.0, -0.8 * speed), speed=3.0, height=2.0, width=2.0)
    assert result.item() == pytest.approx(expected, abs=1e-7)


@pytest.mark.parametrize(("velocity", "expected"), [
    ((0.0, 0.5, 0.0), -1.4952901),  # ahead: 2 (exp(-8 0.25) - 1) (1 - exp(-2))
    ((0.0, -0.5, 0.0), 0.0),  # backwards
    ((-0.5, 0.0, 0.0), 0.0),  # to the left
    ((0.0, 0.0, 5.0), 0.0),  # up
])  # fmt: skip
def test_flight_costs_to_where_the_robot_does_not_look(velocity: tuple[float, float, float], expected: float) -> None:
    """Facing world y and looking back, one metre from the target; nose down makes no difference, looking ahead mirrors it."""
    params = {"height": 2.0, "width": 8.0, "near_width": 2.0}
    for pitch in (0.0, 0.4):
        for looks in (-1.0, 1.0):
            flown = row(*(-looks * axis for axis in velocity))
            at = (ORIGIN, row(0.0, 0.0, 1.0), flown, yaw_attitude(0.5 * pi, pitch=pitch))
            assert heading.unseen_flight(*at, looks=looks, **params).item() == pytest.approx(expected, abs=1e-7)


def test_a_large_command_costs_by_the_difficulty() -> None:
    """0.5 0.15 (exp(-4) - 1) for 2 m/s² upwards, half way up the levels."""
    actions = row(9.0, 9.0, 2.0, 9.0)
    for difficulty, expected in ((0.0, 0.0), (0.5, -0.0736263), (1.0, -0.1472527)):
        share = torch.tensor(difficulty, dtype=torch.float64)
        result = heading.action_size_by_difficulty(actions, share, entry=2, height=0.15, width=1.0)
        assert result.item() == pytest.approx(expected, abs=1e-7)


@pytest.mark.parametrize(("before", "now", "expected"), [
    (1.2, 1.0, -2.6474907),  # 2 m/s and 1 m: half a second, -3 exp(-2 0.5⁴)
    (0.3, 0.2, -2.9904153),  # 1 m/s and 0.2 m: 0.2 s, -3 exp(-2 0.2⁴)
    (1.0, 1.2, 0.0),
    (1.0, 1.0, 0.0),
    (0.1, -0.01, -3.0),  # it is there
    (inf, inf, 0.0),  # nothing anywhere
])  # fmt: skip
def test_a_collision_soon_costs_by_the_time_to_it(before: float, now: float, expected: float) -> None:
    result = heading.collision_soon(
        number(now), number(before), torch.tensor(0.1, dtype=torch.float64), height=3.0, width=2.0
    )
    assert result.item() == pytest.approx(expected, abs=1e-7)
