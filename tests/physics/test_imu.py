"""The inertial measurement unit: signed closed forms, order of convergence, and the statistics of its errors. The
kernel is float32: without noise, a tolerance is the round-off of a velocity difference, 1e-7 |v| / dt, unless
stated."""

from dataclasses import replace
from itertools import pairwise
from math import cos, pi, radians, sin, sqrt

import pytest
import torch
from torch import Tensor

from aerial_gym.config.robot import InitialStateCfg
from aerial_gym.config.sensor import ImuCfg
from aerial_gym.errors import ConfigError, ShapeError
from aerial_gym.math import quaternion
from aerial_gym.math.random import Randomness
from aerial_gym.physics import effects_from_config, state_at_rest
from aerial_gym.physics.effects.sensor_errors import imu_errors
from aerial_gym.robots import ROBOTS
from aerial_gym.robots.initial_state import InitialState
from aerial_gym.robots.secondary_states import SecondaryStates
from aerial_gym.sensors import Pose
from aerial_gym.sensors.imu import Imu
from aerial_gym.sensors.mounts import Carrier
from benchmarks.devices.imu_allan import record_at_rest
from tests.physics.imu_rig import IDEAL, NOISY, ZERO, G, ImuRig, spin_about_z

QUADROTOR = ROBOTS.get("base_quadrotor")


def close(result: Tensor, expected: object, atol: float) -> None:
    torch.testing.assert_close(
        result.double(), torch.as_tensor(expected, dtype=torch.float64).expand_as(result), atol=atol, rtol=0.0
    )


def assert_spread(draws: Tensor, std: Tensor) -> None:
    count = len(draws)
    assert (draws.mean(0).abs() <= 5.0 * std / count**0.5).all()
    assert ((draws.std(0) / std - 1.0).abs() <= 5.0 / (2.0 * count) ** 0.5).all()


@pytest.mark.parametrize("dt", [0.002, 0.05])
def test_white_noise_has_its_density_at_every_rate(dt: float) -> None:
    """Standard deviation sigma / sqrt(dt), normal (68.27 % within one), and no channel knows of another or of the next."""
    cfg = replace(IDEAL, accel_noise_density=NOISY.accel_noise_density, gyro_noise_density=NOISY.gyro_noise_density)
    samples = record_at_rest(cfg, num_sensors=2000, num_samples=11, dt=dt, seed=1)
    samples[..., 2] -= G
    std = torch.tensor([*cfg.accel_noise_density, *cfg.gyro_noise_density]) / sqrt(dt)
    draws = samples.reshape(-1, 6)
    assert_spread(draws, std)
    share = (draws.abs() < std).float().mean(0)
    assert ((share - 0.6827).abs() <= 5.0 * sqrt(0.6827 * 0.3173 / len(draws))).all()
    pairs = torch.cat((samples[:-1], samples[1:], samples[:-1].roll(1, dims=1)), dim=-1).reshape(-1, 18)
    assert (torch.corrcoef(pairs.T) - torch.eye(18)).abs().max() < 5.0 / len(pairs) ** 0.5


def test_noise_and_walk_are_independent() -> None:
    """No correlation among the 12 draws of a sample."""
    count = 20_000
    rig = ImuRig(replace(NOISY, misalignment_deg=ZERO), count)
    rig.reset()
    before = rig.imu.bias.clone()
    rig.imu.measure()
    draws = torch.cat((rig.imu.bias - before, rig.measurement - rig.imu.bias), dim=-1)
    assert (torch.corrcoef(draws.T) - torch.eye(12)).abs().max() < 5.0 / count**0.5


def test_a_reset_draws_bias_and_misalignment_uniformly() -> None:
    """Within +- their bounds, mean 0, standard deviation bound / sqrt(3), independent of each other and of initial states."""
    seed, count = 5, 20_000
    rig = ImuRig(replace(NOISY, euler=(0.5, -0.4, 2.0)), count, seed=seed)
    measured = rig.reset()
    nominal = quaternion.quat_conjugate(quaternion.quat_from_euler(torch.tensor([0.5, -0.4, 2.0]))).expand(count, 4)
    turn = quaternion.euler_from_quat(quaternion.quat_multiply(nominal, rig.imu.mount_attitude))
    draws = torch.cat((rig.imu.bias, turn), dim=-1)
    bound = torch.tensor([*NOISY.accel_initial_bias, *NOISY.gyro_initial_bias, *map(radians, NOISY.misalignment_deg)])
    assert (draws.abs() <= bound + 1e-6).all()
    assert (draws.abs().amax(0) > 0.99 * bound).all()
    assert_spread(draws, bound / sqrt(3.0))
    upwards = torch.tensor([0.0, 0.0, G]).expand(count, 3)
    felt = torch.cat((quaternion.quat_rotate_inverse(rig.imu.mount_attitude, upwards), torch.zeros(count, 3)), dim=-1)
    noise = (measured - rig.imu.bias - felt).square()  # a normal draw depends on the square of its first uniform one
    columns = torch.cat((draws, draws.roll(1, dims=0), noise, initial_states(seed, count)), dim=-1)
    assert (torch.corrcoef(columns.T) - torch.eye(columns.shape[1])).abs().max() < 5.0 / count**0.5


def initial_states(seed: int, count: int) -> Tensor:
    """Return the first initial states that ``aerial_gym.robots`` draws with a seed, (E, 12)."""
    names = ("position_ratio", "euler", "lin_vel", "ang_vel")
    ranges = {f"{name}_{end}": (value, value, value) for name in names for end, value in (("low", -0.1), ("high", 0.1))}
    state = state_at_rest(count, 4, device=torch.device("cpu"), dtype=torch.float32)
    widths = {"ang_vel_world": 3, "lin_vel_body": 3, "vehicle_attitude": 4, "vehicle_lin_vel": 3, "euler": 3}
    derived = {name: torch.zeros(count, width) for name, width in (*widths.items(), ("root_state", 13))}
    random = Randomness(count, seed=seed)
    initial = InitialState(
        InitialStateCfg(**ranges), state, SecondaryStates(state, **derived),
        bounds=(torch.zeros(count, 3), torch.ones(count, 3)), rest_speed=torch.zeros(4),
        actions=torch.zeros(count, 4), prev_actions=torch.zeros(count, 4), random=random,
    )  # fmt: skip
    random.begin(torch.ones(count, dtype=torch.bool))
    initial.reset(torch.ones(count, dtype=torch.bool))
    return torch.cat((state.position, derived["euler"], state.lin_vel, state.ang_vel), dim=-1)


def test_sensors_saturate() -> None:
    rig = ImuRig(replace(IDEAL, accel_range=5.0, gyro_range=2.0))
    rig.move(rig.attitude, rig.lin_vel, torch.tensor([[3.0, -3.0, 1.0]]))
    assert rig.reset().tolist() == [[0.0, 0.0, 5.0, 2.0, -2.0, 1.0]]
    falling = rig.lin_vel - torch.tensor([0.0, 0.0, 1.0])
    results = rig.sample(rig.attitude, falling, torch.tensor([[1.0, 0.0, -9.0]]))
    assert results[0, 2] == -5.0
    assert results[0, 3:].tolist() == [1.0, 0.0, -2.0]


def test_a_first_sample_is_that_of_a_vehicle_without_acceleration() -> None:
    """However fast it moves and turns: R^T g z, and the angular velocity; the next sample differs from this state."""
    rig = ImuRig(replace(IDEAL, position=(0.3, 0.2, 0.1)), dt=0.01)
    attitude, turn = quaternion.quat_from_euler(torch.tensor([[0.3, -0.2, 1.0]])), torch.tensor([[1.0, -2.0, 3.0]])
    rig.move(attitude, torch.tensor([[5.0, -4.0, 3.0]]), turn)
    upwards = quaternion.quat_rotate_inverse(attitude, torch.tensor([[0.0, 0.0, G]]))
    close(rig.reset(), torch.cat((upwards, turn), dim=-1), 3e-6)
    point = quaternion.quat_rotate(attitude, torch.linalg.cross(turn, torch.tensor([[0.3, 0.2, 0.1]])))
    close(rig.imu.state_tensors()["point_vel"], torch.tensor([[5.0, -4.0, 3.0]]) + point, 1e-6)


SLOW = replace(NOISY, rate_hz=40.0, latency_s=0.03)
"""Every 2.5 steps of 10 ms, three steps late."""

PLACED = replace(SLOW, position_low=(-0.1, -0.2, -0.3), position_high=(0.3, 0.2, 0.1))
"""Elsewhere in every episode."""


@pytest.mark.parametrize("cfg", [NOISY, SLOW, PLACED])
def test_reset_leaves_other_rows_bit_for_bit(cfg: ImuCfg) -> None:
    rig = ImuRig(cfg, 8)
    rig.reset()
    for _ in range(4):
        rig.imu.measure()
    mask = torch.tensor([True, False] * 4)
    before = [tensor.clone() for tensor in rig.memory()]
    rig.random.begin(mask)
    rig.imu.reset(mask)
    for old, new in zip(before, rig.memory(), strict=True):
        assert torch.equal(new[~mask], old[~mask])
        assert torch.isfinite(new).all()
    for old, new in zip(before[:3], rig.memory()[:3], strict=True):
        assert (new[mask] != old[mask]).any(-1).all()


def test_tensors_and_times_that_do_not_fit_are_refused() -> None:
    with pytest.raises(ConfigError, match=r"dt = 0.0: must be > 0 and finite"):
        ImuRig(IDEAL, dt=0.0)
    good = {"attitude": torch.zeros(2, 4), "lin_vel": torch.zeros(2, 3), "ang_vel": torch.zeros(2, 3)}
    good |= {"measurement_out": torch.zeros(2, 6)}
    for name in good:
        bad = {**good, name: torch.zeros(2, 5)}
        output = bad.pop("measurement_out")
        with pytest.raises(ShapeError, match=rf"{name} is \(2, 5\)"):
            Imu(IDEAL, Carrier(position=torch.zeros(2, 3), **bad), measurement_out=output, dt=0.01, gravity=G)


def test_effects_of_the_robot_act_in_body_axes_before_the_mount() -> None:
    """Turned by +0.1 about x, then a bias of 0.2 m/s² on body y; the IMU is mounted with its x along body y."""
    errors = effects_from_config(
        {
            "imu_misalignment": {"roll": 0.1, "pitch": 0.0, "yaw": 0.0},
            "imu_bias": {"ax": 0.0, "ay": 0.2, "az": 0.0, "gx": 0.03, "gy": 0.0, "gz": 0.0},
        },
        num_envs=2, device=torch.device("cpu"), dtype=torch.float32,
    )  # fmt: skip
    rig = ImuRig(replace(IDEAL, euler=(0.0, 0.0, pi / 2)), 2, errors=imu_errors(errors))
    sample = rig.reset()[1]
    in_body = (0.0, G * sin(0.1) + 0.2, G * cos(0.1))
    expected = torch.tensor([in_body[1], -in_body[0], in_body[2], 0.0, -0.03, 0.0])
    torch.testing.assert_close(sample, expected, rtol=0.0, atol=2e-6)


def test_a_rolled_mount_feels_the_lever_arm_in_its_own_axes() -> None:
    """``f = w x (w x r) + dw x r + g``: with r = (0.2, 0, 0.1), w and dw along z that is (-0.2 w², 0.2 dw, g) in body axes.
    Rolled by +90 degrees an IMU has its y along the body's z and its z along minus the body's y: (f_x, f_z, -f_y)."""
    pose = Pose(
        position=torch.tensor([0.2, 0.0, 0.1], dtype=torch.float64),
        attitude=quaternion.quat_from_euler(torch.tensor([0.5 * pi, 0.0, 0.0], dtype=torch.float64)),
    )
    w, dw = 2.0, 3.0
    rig = ImuRig(replace(IDEAL, position=(9.0, 9.0, 9.0), euler=(1.0, 1.0, 1.0)), pose=pose)  # the mount replaces these
    (results,) = spin_about_z(rig, 1, w, dw)
    middle = w + 0.5 * 0.01 * dw
    close(results, [[-0.2 * middle**2, G, -0.2 * dw, 0.0, w + 0.01 * dw, 0.0]], 0.01**2 * w * dw)  # O(dt²)


def test_a_slower_imu_gives_the_mean_of_its_period_and_holds_it() -> None:
    """With a third of the rate each sample is the mean force of three steps; the gyro stands at their end."""
    lever = replace(IDEAL, position=(0.2, 0.0, 0.0))
    every = spin_about_z(ImuRig(lever), 9, 2.0, 3.0)
    slow = spin_about_z(ImuRig(replace(lever, rate_hz=100.0 / 3.0)), 9, 2.0, 3.0)
    for k in (3, 6):
        mean = torch.stack(every[k - 3 : k])[..., :3].mean(0)
        expected = torch.cat((mean, every[k - 1][..., 3:]), dim=-1)
        for held in slow[k - 1 : k + 2]:
            close(held, expected.double(), 2e-6)
    assert torch.equal(slow[0], slow[1])  # the sample of the reset


def test_a_rate_between_those_of_the_steps_is_kept_on_average() -> None:
    """Every 2.5 steps: in 100 steps of 10 ms there are 40 samples, each two or three steps after the one before."""
    rig = ImuRig(replace(NOISY, rate_hz=40.0))
    rig.reset()
    new, before = [], rig.measurement.clone()
    for _ in range(100):
        rig.imu.measure()
        new.append(not torch.equal(rig.measurement, before))
        before = rig.measurement.clone()
    times = [k for k, is_new in enumerate(new) if is_new]
    assert len(times) == 40
    assert {b - a for a, b in pairwise(times)} == {2, 3}


def test_noise_and_walk_are_those_of_the_period() -> None:
    """The deviation is ``sigma sqrt(rate)`` and that of a step of the bias ``sigma_b / sqrt(rate)``, whatever dt is."""
    rig = ImuRig(replace(NOISY, misalignment_deg=ZERO, rate_hz=20.0), 20_000)
    rig.reset()
    start = rig.imu.bias.clone()
    for _ in range(5):
        rig.imu.measure()
    assert_spread(rig.imu.bias - start, torch.tensor([*NOISY.accel_bias_walk, *NOISY.gyro_bias_walk]) / sqrt(20.0))
    felt = torch.tensor([0.0, 0.0, G, 0.0, 0.0, 0.0])
    density = torch.tensor([*NOISY.accel_noise_density, *NOISY.gyro_noise_density])
    assert_spread(rig.measurement - rig.imu.bias - felt, density * sqrt(20.0))


def test_a_measurement_appears_after_its_latency() -> None:
    """What is late by three steps is what is not late, three steps before; until then it is the sample of the reset."""
    now = spin_about_z(ImuRig(replace(NOISY, rate_hz=50.0)), 12, 2.0, 3.0)
    late = spin_about_z(ImuRig(replace(NOISY, rate_hz=50.0, latency_s=0.03)), 12, 2.0, 3.0)
    for k in range(3, 12):
        assert torch.equal(late[k], now[k - 3])
    assert torch.equal(late[0], late[2])
    assert not torch.equal(late[3], late[5])


def test_a_rate_above_that_of_the_steps_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"rate_hz = 200.0: steps of 0.01 s give at most 100 measurements per second"):
        ImuRig(replace(IDEAL, rate_hz=200.0))
