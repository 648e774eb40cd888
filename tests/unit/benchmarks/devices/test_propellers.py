"""Static tests of propellers against blade elements: what is computed, against closed forms."""

from math import sqrt

import numpy as np
import pytest

from benchmarks.devices.propellers import blade_inflow, flat_plate, induced_factor, left_out


@pytest.mark.parametrize(
    ("slope", "thrust", "factor"),
    [(1e5, 1e-6, 0.8 * sqrt(2.0)), (1e-3, 5e-5, (4.0 / 3.5) * sqrt(2.0) / (4.0 / 3.0) ** 1.5)],
)
def test_induced_power_of_blades_without_twist(slope: float, thrust: float, factor: float) -> None:
    """Much lift: ``lambda = theta r``, kappa = 1.131; little: ``lambda ~ sqrt(r)``, 1.050."""
    assert induced_factor(thrust, solidity=0.1, slope=slope, twist=0.0, rows=4000) == pytest.approx(factor, rel=2e-3)


def test_the_inflow_balances_momentum_and_blades_at_each_radius() -> None:
    """``4 lambda² r = s a / 2 (theta r² - lambda r)``: thrust of an annulus from both."""
    radius = np.array([0.2, 0.7, 1.0])
    inflow = blade_inflow(0.4, radius, solidity=0.1, slope=5.7, twist=-0.2)
    blades = 0.285 * ((0.4 - 0.2 * radius) * radius**2 - inflow * radius)
    np.testing.assert_allclose(4.0 * inflow**2 * radius, blades, rtol=1e-12)


def test_rows_that_are_left_out_are_not_fitted() -> None:
    """Rows 1, 3, 5 are a tenth larger than the law of the others says: predicted too small by 1 - 1 / 1.1."""
    law = np.arange(1.0, 7.0)
    measured = 2.0 * law * np.array([1.0, 1.1] * 3)
    fitted, between, _ = left_out(measured, lambda rows: law[rows, None])
    assert fitted[0] == pytest.approx(2.0)
    assert between == pytest.approx(1.0 - 1.0 / 1.1)
    slow_half = np.where(law > 3.0, 1.25, 1.0)
    assert left_out(2.0 * law * slow_half, lambda rows: law[rows, None])[2] == pytest.approx(0.2)


def test_what_is_known_is_not_fitted() -> None:
    law, known = np.arange(1.0, 7.0), np.arange(1.0, 7.0) ** 2
    fitted, between, fast = left_out(3.0 * law + known, lambda rows: law[rows, None], known)
    assert fitted[0] == pytest.approx(3.0)
    assert max(between, fast) < 1e-12


def test_friction_of_a_plate() -> None:
    """Re = 5e4 at 3/4 of 0.0635 m, 1 cm and 1.5e-5 m²/s: 2.656 / 223.6."""
    assert flat_plate(np.array([5e4 * 1.5e-5 / (0.75 * 0.0635 * 0.01)]))[0] == pytest.approx(0.011878, rel=1e-4)
