"""Our controllers against those of the Crazyflie's firmware: golden vectors of 10,000 random states each.
``tests/cross/firmware/crazyflie_vectors.py`` made them; ``crazyflie_pairs.py`` lays ours beside them."""

import pytest
import torch
from torch import Tensor

from tests.cross.firmware.crazyflie_pairs import (
    brescianini_pair,
    brescianini_reduced_pair,
    lee_integral_pair,
    lee_pair,
    mellinger_pair,
    pid_pair,
    power_pair,
    read_vectors,
)


@pytest.fixture(scope="module")
def vectors() -> dict[str, Tensor]:
    return read_vectors()


def test_lee_is_the_firmwares_wherever_thrust_is_along_the_body(vectors: dict[str, Tensor]) -> None:
    """Thrust everywhere, torque where thrust is positive: where it is not the firmware levels off, ours turns to the force."""
    actual, reference = lee_pair(vectors)
    lifts = reference[:, 0] > 1e-3
    torch.testing.assert_close(actual[:, 0], reference[:, 0], atol=1e-6, rtol=0)
    torch.testing.assert_close(actual[lifts, 1:], reference[lifts, 1:], atol=3e-8, rtol=1e-5)
    assert int(lifts.sum()) > 10_000


def test_lee_with_integrals_is_the_firmwares(vectors: dict[str, Tensor]) -> None:
    """Ten steps of a thousand runs; the few are left out whose thrust was ever below a centinewton, as it levels off there.
    Without either integral they do not agree."""
    actual, reference = lee_integral_pair(vectors)
    lifts = (reference[..., 0] > 1e-2).all(0)
    torch.testing.assert_close(actual[:, lifts, 0], reference[:, lifts, 0], atol=1e-6, rtol=0)
    torch.testing.assert_close(actual[:, lifts, 1:], reference[:, lifts, 1:], atol=5e-8, rtol=1e-5)
    assert int(lifts.sum()) > 950
    none, _ = lee_integral_pair(vectors, integrals=False)
    assert float((none[-1] - reference[-1])[lifts, 0].abs().median()) > 1e-3
    assert float((none[-1] - reference[-1])[lifts, 1:].abs().median()) > 1e-5


@pytest.mark.parametrize("pair", [mellinger_pair, pid_pair])
def test_counts_are_the_firmwares(vectors: dict[str, Tensor], pair) -> None:
    """Moments are whole counts, cut off towards zero: equal, but for one count where rounding meets the cut."""
    actual, reference = pair(vectors)
    assert actual.shape == (10, 1000, 4)
    torch.testing.assert_close(actual[..., 0], reference[..., 0], atol=0.05, rtol=1e-6)
    off = (actual[..., 1:] - reference[..., 1:]).abs()
    assert float(off.max()) <= 1.0
    assert float((off > 0.0).double().mean()) < 2e-3
    moments = reference[..., 1:].abs()
    assert int((moments < 32000.0).sum()) > 20_000  # most are not at their limit, or the test would not see much


def test_mellinger_without_thrust_has_no_moment(vectors: dict[str, Tensor]) -> None:
    actual, reference = mellinger_pair(vectors)
    falls = reference[..., 0] <= 0.0
    assert int(falls.sum()) > 50
    assert not actual[falls][:, 1:].any()
    assert not reference[falls][:, 1:].any()


def test_brescianini_is_the_firmwares(vectors: dict[str, Tensor]) -> None:
    """Torques reach 0.05 N m, those of ``w x J w``, which neither has, 1e-4 N m: rounding is far below."""
    actual, reference = brescianini_pair(vectors)
    assert actual.shape == (10, 1000, 4)
    torch.testing.assert_close(actual[..., 0], reference[..., 0], atol=3e-7, rtol=0)
    torch.testing.assert_close(actual[..., 1:], reference[..., 1:], atol=1e-7, rtol=0)
    assert (
        500 < int((reference[..., 0] > 0.52199).sum()) < 2000
    )  # most are not at the largest thrust, 0.029 kg times 18 m/s²


def test_rates_of_the_tilt_alone_are_the_firmwares_in_the_world(vectors: dict[str, Tensor]) -> None:
    actual, reference = brescianini_reduced_pair(vectors)
    assert actual.shape == (1000, 3)
    torch.testing.assert_close(actual, reference, atol=2e-5, rtol=0)
    assert float(actual.abs().max()) > 2.0


def test_power_distribution_is_the_firmwares(vectors: dict[str, Tensor]) -> None:
    """Halves of moments are whole counts there, so that rotors differ by one at most, and by two where one is cut off."""
    actual, reference = power_pair(vectors)
    cut = ((reference == 0.0) | (reference == 65535.0)).any(-1)
    off = (actual - reference).abs().amax(-1)
    assert float(off[~cut].max()) <= 1.0
    assert float(off[cut].max()) <= 2.0
    assert 1000 < int(cut.sum()) < 9000
