"""Keys of the page: the entry of an action that each moves."""

import pytest

from aerial_gym.control.laws import LAWS
from aerial_gym.viewer.panel import axis_entry


@pytest.mark.parametrize(
    ("law", "expected"),
    [
        ("velocity", {"forward": (0, 1), "left": (1, 1), "up": (2, 1), "turn": (3, 1)}),
        ("position", {"forward": (0, 1), "left": (1, 1), "up": (2, 1), "turn": (3, 1)}),
        ("attitude", {"forward": (2, 1), "left": (1, -1), "up": (0, 1), "turn": (3, 1)}),
        ("rates", {"forward": (2, 1), "left": (1, -1), "up": (0, 1), "turn": (3, 1)}),
    ],
)
def test_keys_move_the_entry_of_their_direction(law: str, expected: dict[str, tuple[int, int]]) -> None:
    assert {axis: axis_entry(axis, LAWS[law].action) for axis in expected} == expected


def test_rotor_commands_have_no_direction() -> None:
    assert axis_entry("forward", ("speed 1 [rad/s]", "speed 2 [rad/s]")) is None
