"""The shift of a robot out of a corner between two planes, against the closed form of alternating projections."""

from math import cos, radians, sin

import numpy as np
import pytest
import warp as wp

from aerial_gym.robots.contact_pairs import ContactPairs
from aerial_gym.robots.crossings import CORNER_ANGLE, CORNER_REMAINDER, MAX_PLANES, PASSES, ROUNDS, shift_to_floors


@wp.kernel(enable_backward=False)
def _shift(normal_a: wp.vec3, normal_b: wp.vec3, shift_out: wp.array[wp.vec3]):
    """Shift a robot 1 m below plane a and on plane b, with floors on both planes."""
    pairs = ContactPairs()
    pairs.gaps[0] = -1.0
    pairs.normals[0] = normal_a
    pairs.normals[1] = normal_b
    shift_out[0] = shift_to_floors(pairs, wp.vec4(), 2, wp.vec3())


@pytest.mark.parametrize("degrees", [90.0, 60.0, 45.0, 30.0])
def test_a_pass_leaves_the_squared_cosine_of_the_corner(degrees: float) -> None:
    """After n passes ``cos(a)^(2 n)`` of the depth is left below plane a, and nothing below plane b."""
    a, b = np.array([1.0, 0.0, 0.0]), np.array([-cos(radians(degrees)), sin(radians(degrees)), 0.0])
    out = wp.zeros(1, dtype=wp.vec3, device="cpu")
    wp.launch(_shift, dim=1, inputs=[wp.vec3(*a), wp.vec3(*b)], outputs=[out], device="cpu")
    shift = out.numpy()[0]
    assert 1.0 - a @ shift == pytest.approx(cos(radians(degrees)) ** (2 * PASSES), abs=1e-6)
    assert b @ shift == pytest.approx(0.0, abs=1e-6)


def test_numbers_of_passes_and_rounds_follow_from_the_corner() -> None:
    assert cos(CORNER_ANGLE) ** (2 * PASSES) == pytest.approx(CORNER_REMAINDER)
    assert int(ROUNDS) == MAX_PLANES + 1 == 4  # vectors of four hold the planes
