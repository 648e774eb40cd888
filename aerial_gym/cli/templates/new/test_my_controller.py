"""Test of ``my_controller``: it reaches the commanded climb rate, up and down."""

import pytest
from my_controller import fly


def test_climb_rate_is_reached() -> None:
    for climb_rate in (0.5, -0.5):
        assert fly(climb_rate)[:, 2].tolist() == pytest.approx([climb_rate] * 2, abs=0.02)
