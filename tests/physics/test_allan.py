"""Allan deviation: closed forms of the estimator, and the densities that it finds in simulated IMUs."""

from pathlib import Path

import pytest
import torch
from torch import Tensor

from aerial_gym.errors import ShapeError
from aerial_gym.sensors import IMUS
from benchmarks.devices import imu_allan

DT = 0.25


def test_a_ramp_and_an_alternating_signal_are_exact() -> None:
    """Neighbouring averages of ``c t`` differ by c tau: c tau / sqrt(2). Of +1, -1, ...: sqrt(2), and 0 for even m."""
    t = DT * torch.arange(100, dtype=torch.float64)
    signs = 1.0 - 2.0 * (torch.arange(100) % 2)
    tau, deviation = imu_allan.allan_deviation(torch.stack((3.0 * t, signs.double()), dim=-1), DT)
    torch.testing.assert_close(tau, DT * torch.tensor([1, 2, 4, 8, 16, 32], dtype=torch.float64))
    torch.testing.assert_close(deviation[:, 0], 3.0 * tau / 2.0**0.5, rtol=1e-9, atol=0.0)
    torch.testing.assert_close(deviation[:, 1], torch.tensor([2.0**0.5, 0, 0, 0, 0, 0]).double(), rtol=0, atol=1e-7)


def assert_unbiased(result: Tensor, expected: Tensor) -> None:
    """The mean over S independent signals, (S, ...), is within 5 standard errors, and these are below a tenth of it."""
    error = result.std(0) / len(result) ** 0.5
    assert ((result.mean(0) - expected).abs() <= 5.0 * error).all()
    assert (error < 0.1 * expected).all()


def test_white_noise_and_random_walk_give_their_closed_forms() -> None:
    """N²/tau, and K² tau/3 in the limit of many samples."""
    n, k, count = 0.7, 0.2, 512
    draws = torch.randn(2, 1024, count, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    tau, white = imu_allan.allan_deviation(n * draws[0] / DT**0.5, DT)
    _, walk = imu_allan.allan_deviation((k * draws[1] * DT**0.5).cumsum(0), DT)
    assert_unbiased(white.square().T, n**2 * imu_allan.variance_shares(tau, DT)[:, 0])
    assert_unbiased(walk.square().T, k**2 * imu_allan.variance_shares(tau, DT)[:, 1])


@pytest.mark.parametrize(("name", "dt"), [pytest.param("vn100", 10.0, marks=pytest.mark.slow), ("bmi088", 2.0)])
def test_simulated_imus_have_the_configured_densities(name: str, dt: float) -> None:
    """N² and K², fitted to the Allan variance of each of 128 sensors, are those of the file on average. The rate is such
    that the record spans the time at which both lines meet, 4 s to 40 min."""
    cfg = IMUS.get(name)
    tau, deviation = imu_allan.allan_deviation(
        imu_allan.record_at_rest(cfg, num_sensors=128, num_samples=4096, dt=dt, seed=7), dt
    )
    densities = [(*cfg.accel_noise_density, *cfg.gyro_noise_density), (*cfg.accel_bias_walk, *cfg.gyro_bias_walk)]
    for channel, truth in enumerate(torch.tensor(densities, dtype=torch.float64).square().T):
        assert_unbiased(imu_allan.fit_densities(tau, deviation[:, :, channel], dt, truth), truth)


def test_one_sample_is_refused() -> None:
    with pytest.raises(ShapeError, match=r"samples has shape \(1, 6\): the first axis must hold at least two samples"):
        imu_allan.allan_deviation(torch.zeros(1, 6), DT)


NOISE, WALK = 0.7, 0.2


def signals(num_signals: int, count: int, seed: int) -> torch.Tensor:
    """Return white noise on a bias that walks, (T, S), made without the IMU."""
    draws = torch.randn(2, count, num_signals, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))
    return NOISE * draws[0] / DT**0.5 + (WALK * draws[1] * DT**0.5).cumsum(0)


def test_known_densities_are_found_whatever_is_assumed_and_their_intervals_hold_them() -> None:
    """95 % intervals of 100 experiments hold the truth in 88 to 100 of them (binomial, 3 standard errors)."""
    held = torch.zeros(2)
    for seed in range(100):
        tau, deviation = imu_allan.allan_deviation(signals(32, 1024, seed), DT)
        squares = imu_allan.fit_densities(
            tau, deviation, DT, torch.tensor([4.0 * NOISE**2, 0.5 * WALK**2], dtype=torch.float64)
        )
        for column, truth in enumerate((NOISE, WALK)):
            result, low, high = imu_allan.root_mean_interval(squares[:, column])
            assert result == pytest.approx(truth, rel=0.25)
            held[column] += low <= truth <= high
    assert ((held >= 88) & (held <= 100)).all()


def test_shares_are_the_variances_of_a_sampled_walk_by_hand() -> None:
    """Steps s of variance 1: neighbours differ by s, averages of two by (s1 + 2 s2 + s3) / 2. Half the variance of each."""
    result = imu_allan.variance_shares(torch.tensor([1.0, 2.0]), 1.0)
    torch.testing.assert_close(result, torch.tensor([[1.0, 0.5], [0.5, 0.75]]))
    torch.testing.assert_close(imu_allan.variance_shares(torch.tensor([3.0]), 3.0), torch.tensor([[1.0 / 3.0, 1.5]]))


def test_interval_is_that_of_the_mean() -> None:
    """Squares 1, 4, 9: mean 14/3, standard error sqrt(49/3) / sqrt(3)."""
    result, low, high = imu_allan.root_mean_interval(torch.tensor([1.0, 4.0, 9.0], dtype=torch.float64))
    half = 1.96 * (49.0 / 3.0) ** 0.5 / 3.0**0.5
    assert (result, low, high) == pytest.approx(((14 / 3) ** 0.5, (14 / 3 - half) ** 0.5, (14 / 3 + half) ** 0.5))


def test_the_lowest_point_is_where_the_lines_meet() -> None:
    """``N / sqrt(tau) = K sqrt(tau / 3)``; the longest averaging times do not count."""
    tau = imu_allan.crossing_s(NOISE, WALK)
    assert NOISE / tau**0.5 == pytest.approx(WALK * (tau / 3.0) ** 0.5)
    short, long = (
        imu_allan.AllanRecord(dt=dt, tau=dt * 2.0 ** torch.arange(8), deviation=torch.ones(8, 2, 6))
        for dt in (1.0, 5.0)
    )
    assert imu_allan.lowest_point(8.5, short, long) == (short, 3)
    assert imu_allan.lowest_point(60.0, short, long) == (long, 4)  # 64 s of the short record is left out
    assert imu_allan.lowest_point(20.0, short, long) == (long, 2)


def test_rows_tell_a_wrong_density_from_a_right_one() -> None:
    cfg = IMUS.get("bmi088")
    fast, slow = (
        imu_allan.AllanRecord.simulate(cfg, dt=dt, num_sensors=32, num_samples=1024, seed=3) for dt in (0.01, 0.5)
    )
    right = imu_allan.compare_densities("bmi088", cfg, fast, slow)
    assert [row["sensor"] + row["axis"] for row in right[:4]] == ["accelx", "accely", "accelz", "gyrox"]
    for row in right:
        for name in ("noise", "walk", "lowest"):
            configured, low, high = (row[f"{name}_{label}"] for label in ("configured", "low", "high"))
            assert low - (high - low) <= configured <= high + (high - low), (row, name)  # 6 standard errors
    wrong = imu_allan.compare_densities("bmi088", IMUS.get("vn100"), fast, slow)
    assert not wrong[3]["noise_low"] <= wrong[3]["noise_configured"] <= wrong[3]["noise_high"]


def test_the_command_prints_a_row_for_each_axis_and_draws(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert imu_allan.ImuAllanCmd(out=tmp_path, imu=("vn100",), num_sensors=4, num_samples=64).run() == 0
    _, _, *rows = capsys.readouterr().out.splitlines()
    assert [row.split(" | ")[1] for row in rows] == [f"{kind} {axis}" for kind in ("accel", "gyro") for axis in "xyz"]
    assert float(rows[3].split(" | ")[2]) == pytest.approx(IMUS.get("vn100").gyro_noise_density[0], rel=1e-3)
    assert (tmp_path / "imu_allan.png").read_bytes().startswith(b"\x89PNG")
