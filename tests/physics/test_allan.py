"""Allan deviation: closed forms of the estimator, and the densities that it finds in simulated IMUs."""

import pytest
import torch
from torch import Tensor

from aerial_gym.errors import ShapeError
from aerial_gym.sensors import IMUS
from aerial_gym.sensors.allan import allan_deviation, record_at_rest

DT = 0.25


def test_a_ramp_and_an_alternating_signal_are_exact() -> None:
    """Neighbouring averages of ``c t`` differ by c tau: c tau / sqrt(2). Of +1, -1, ...: sqrt(2), and 0 for even m."""
    t = DT * torch.arange(100, dtype=torch.float64)
    signs = 1.0 - 2.0 * (torch.arange(100) % 2)
    tau, deviation = allan_deviation(torch.stack((3.0 * t, signs.double()), dim=-1), DT)
    torch.testing.assert_close(tau, DT * torch.tensor([1, 2, 4, 8, 16, 32], dtype=torch.float64))
    torch.testing.assert_close(deviation[:, 0], 3.0 * tau / 2.0**0.5, rtol=1e-9, atol=0.0)
    torch.testing.assert_close(deviation[:, 1], torch.tensor([2.0**0.5, 0, 0, 0, 0, 0]).double(), rtol=0, atol=1e-7)


def assert_unbiased(result: Tensor, expected: Tensor) -> None:
    """The mean over S independent signals, (S, ...), is within 5 standard errors, and these are below a tenth of it."""
    error = result.std(0) / len(result) ** 0.5
    assert ((result.mean(0) - expected).abs() <= 5.0 * error).all()
    assert (error < 0.1 * expected).all()


def shares(tau: Tensor, dt: float) -> Tensor:
    """Return the Allan variance of white noise of N = 1 and of a random walk of K = 1 that is sampled every dt, (K, 2).
    ``1 / tau`` and ``tau / 3 (1 + 1 / (2 m²))`` with m = tau / dt. Derived: the variance of the difference of
    neighbouring averages of m samples of a walk with unit steps is ``(2 m² + 1) / (3 m)``."""
    return torch.stack((1.0 / tau, tau / 3.0 * (1.0 + 0.5 * (dt / tau) ** 2)), dim=-1)


def test_white_noise_and_random_walk_give_their_closed_forms() -> None:
    """N²/tau, and K² tau/3 in the limit of many samples."""
    n, k, count = 0.7, 0.2, 512
    draws = torch.randn(2, 1024, count, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    tau, white = allan_deviation(n * draws[0] / DT**0.5, DT)
    _, walk = allan_deviation((k * draws[1] * DT**0.5).cumsum(0), DT)
    assert_unbiased(white.square().T, n**2 * shares(tau, DT)[:, 0])
    assert_unbiased(walk.square().T, k**2 * shares(tau, DT)[:, 1])


@pytest.mark.parametrize(("name", "dt"), [pytest.param("vn100", 10.0, marks=pytest.mark.slow), ("bmi088", 2.0)])
def test_simulated_imus_have_the_configured_densities(name: str, dt: float) -> None:
    """N² and K², fitted to the Allan variance of each of 128 sensors, are those of the file on average. The rate is such
    that the record spans the time at which both lines meet, 4 s to 40 min."""
    cfg = IMUS.get(name)
    tau, deviation = allan_deviation(record_at_rest(cfg, num_sensors=128, num_samples=4096, dt=dt, seed=7), dt)
    densities = [(*cfg.accel_noise_density, *cfg.gyro_noise_density), (*cfg.accel_bias_walk, *cfg.gyro_bias_walk)]
    for channel, truth in enumerate(torch.tensor(densities, dtype=torch.float64).square().T):
        parts = shares(tau, dt) * truth
        weight = 1.0 / (parts.sum(-1, keepdim=True) * tau.sqrt().unsqueeze(-1))  # relative errors grow with sqrt(tau)
        fit = torch.linalg.lstsq(parts * weight, deviation[:, :, channel].square() * weight).solution.T
        assert_unbiased(fit, torch.ones(2, dtype=torch.float64))


def test_one_sample_is_refused() -> None:
    with pytest.raises(ShapeError, match=r"samples has shape \(1, 6\): the first axis must hold at least two samples"):
        allan_deviation(torch.zeros(1, 6), DT)
