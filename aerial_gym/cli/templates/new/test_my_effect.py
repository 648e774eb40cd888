"""Test of ``my_effect`` against a closed form, with its sign."""

import pytest
from my_effect import fly


def test_force_accelerates_forward() -> None:
    """The velocity changes by ``force t / mass`` along body x; base_quadrotor has 0.25 kg."""
    assert (fly(0.5) - fly(0.0)).tolist() == pytest.approx([0.5 * 0.1 / 0.25, 0.0, 0.0], abs=2e-3)
