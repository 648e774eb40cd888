"""IMUs whose places a reset draws: what each feels at its own lever arm, and that draws are of its environment alone.
The kernel is float32: without noise, a tolerance is the round-off of a velocity difference, 1e-7 |v| / dt, unless
stated.
What a reset draws of the robot's own errors of inertial sensors, seen in what the IMU measures. ``measured = R^T
(true + bias)`` with R from sensors to body, by the draws of each environment. The effects do not change the flight:
what is true stands in the same simulation without draws. Tolerances are float32 round-off: 8 ulp of 16 m/s².
"""

from dataclasses import replace
from itertools import pairwise
from math import cos, pi, sin
from pathlib import Path

import pytest
import torch
from torch import Tensor

from aerial_gym.config.randomize import RandomizeCfg
from aerial_gym.config.sensor_mount import SensorMountCfg
from aerial_gym.env_manager import EnvManager
from aerial_gym.errors import ConfigError
from aerial_gym.math.quaternion import quat_from_euler, quat_multiply, quat_rotate, quat_rotate_inverse
from aerial_gym.robots import ROBOTS
from aerial_gym.sensors import Pose
from tests.builders import simulation
from tests.physics.imu_rig import IDEAL, NOISY, G, ImuRig, wobble

LOW, HIGH = (-0.2, -0.3, -0.1), (0.4, 0.1, 0.2)
DRAWN = replace(IDEAL, position_low=LOW, position_high=HIGH)


def test_places_are_uniform_and_independent_of_the_errors() -> None:
    """Mean and standard deviation of a uniform draw, no correlation with bias, noise or each other: five standard errors."""
    count, low, high = 20_000, torch.tensor(LOW), torch.tensor(HIGH)
    turned = replace(NOISY, position_low=LOW, position_high=HIGH, euler_low=(-0.1,) * 3, euler_high=(0.1,) * 3)
    rig = ImuRig(replace(turned, misalignment_deg=(0.0, 0.0, 0.0)), count, seed=3)
    rig.reset()
    place, turn = rig.imu.mount_position, rig.imu.mount_attitude[:, :3]
    assert ((place >= low) & (place <= high)).all()
    spread = (high - low) / 12.0**0.5
    assert ((place.mean(0) - 0.5 * (low + high)).abs() < 5.0 * spread / count**0.5).all()
    assert ((place.std(0) / spread - 1.0).abs() < 5.0 * (0.2 / count) ** 0.5).all()  # kurtosis 9/5: (9/5 - 1) / 4
    upwards = quat_rotate_inverse(rig.imu.mount_attitude, torch.tensor([[0.0, 0.0, G]]).expand(count, 3))
    noise = (rig.measurement - rig.imu.bias - torch.cat((upwards, torch.zeros_like(upwards)), dim=-1)).square()
    columns = torch.cat((place, turn, rig.imu.bias, noise, place.roll(1, dims=0)), dim=-1)
    assert (torch.corrcoef(columns.T) - torch.eye(columns.shape[1])).abs().max() < 5.0 / count**0.5


def test_force_is_the_second_derivative_of_the_place_of_each() -> None:
    """``R_m^T (p'' + g z)`` with ``p = x + R r`` differenced twice in float64: no lever-arm term is written down. The root
    mean square error at t - dt/2 falls with dt² as dt is halved."""
    cfg = replace(DRAWN, euler_low=(-0.5, -0.4, -0.3), euler_high=(0.5, 0.4, 0.3))
    t, steps, errors = torch.linspace(0.5, 2.0, 200).double(), (0.08, 0.04, 0.02), []
    for dt in steps:
        rig = ImuRig(cfg, len(t), dt=dt)
        rig.move(*wobble(t - 2.0 * dt, torch.zeros(3))[:3])
        rig.reset()
        rig.sample(*wobble(t - dt, torch.zeros(3))[:3])
        result = rig.sample(*wobble(t, torch.zeros(3))[:3])
        lever, mount = rig.imu.mount_position.double(), rig.imu.mount_attitude.double()
        middle, h = t - 0.5 * dt, 1e-4
        before, now, after = (point(middle + shift, lever) for shift in (-h, 0.0, h))
        felt = (before - 2.0 * now + after) / h**2 + torch.tensor([0.0, 0.0, G], dtype=torch.float64)
        attitude = quat_multiply(wobble(middle, torch.zeros(3))[0], mount)
        errors.append((result[:, :3] - quat_rotate_inverse(attitude, felt)).square().mean().sqrt())
    assert [torch.log2(a / b).item() for a, b in pairwise(errors)] == pytest.approx([2.0, 2.0], abs=0.1)


def point(t: Tensor, lever: Tensor) -> Tensor:
    """Return the position of a body point of ``wobble`` at times t: ``x + R r`` with the integral x of its velocity."""
    origin = torch.stack((-torch.cos(5.0 * t) / 5.0, torch.sin(3.0 * t) / 3.0, t**3 / 3.0), dim=-1)
    return origin + quat_rotate(wobble(t, torch.zeros(3))[0], lever)


def test_what_is_drawn_deviates_from_the_mount_along_its_own_axes() -> None:
    """``T_mount T_nominal^-1 T_drawn``: a shift to the IMU's left goes up where the mount is rolled by +90 degrees."""
    cfg = replace(IDEAL, position=(1.0, 2.0, 3.0), position_low=(1.0, 2.0, 3.0), position_high=(1.0, 2.05, 3.0))
    turned = replace(cfg, euler=(0.0, 0.0, 0.1), euler_low=(0.0, 0.0, 0.1), euler_high=(0.0, 0.0, 0.1))
    at = torch.tensor([0.3, 0.2, 0.1], dtype=torch.float64)
    rolled = quat_from_euler(torch.tensor([0.5 * pi, 0.0, 0.0], dtype=torch.float64))
    rig = ImuRig(turned, 64, pose=Pose(position=at, attitude=rolled))
    rig.reset()
    x, y, z = (rig.imu.mount_position - at.float()).unbind(-1)  # the nominal yaw turns a shift of d to (d sin, d cos)
    shift = torch.hypot(x, z)
    torch.testing.assert_close(y, torch.zeros(64), rtol=0.0, atol=1e-6)
    torch.testing.assert_close(x, shift * sin(0.1), rtol=0.0, atol=1e-6)
    torch.testing.assert_close(z, shift * cos(0.1), rtol=0.0, atol=1e-6)
    assert ((z >= 0.0) & (shift <= 0.05 + 1e-6)).all()
    assert shift.std() > 0.01
    torch.testing.assert_close(rig.imu.mount_attitude, rolled.float().expand(64, 4), rtol=0.0, atol=1e-6)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"position_low": LOW}, "give both position_low and position_high"),
        ({"position_low": HIGH, "position_high": LOW}, "must not exceed"),
        ({"euler_low": (-9.0, 0.0, 0.0), "euler_high": (0.0, 0.0, 0.0)}, r"within \+-2 pi"),
    ],
)
def test_impossible_placements_are_refused(fields: dict, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        replace(IDEAL, **fields)


TAIL = SensorMountCfg(sensor="bmi088", name="tail", position=(-0.2, 0.0, 0.0), euler=(0.0, 0.0, pi))
PLACES = {
    "sensors.base_imu.position": RandomizeCfg(how="offset", low=-0.1, high=0.1),
    "sensors.tail.position": RandomizeCfg(how="offset", low=(0.0, -0.01, 0.0), high=(0.05, 0.01, 0.0)),
    "sensors.tail.euler": RandomizeCfg(how="offset", low=-0.1, high=0.1),
}


def fly(
    num_envs: int, backend: str = "warp", *, randomize: dict[str, RandomizeCfg] = PLACES,
    first: str | SensorMountCfg = "base_imu",
) -> EnvManager:  # fmt: skip
    env = simulation(
        replace(ROBOTS.get("base_quadrotor"), sensors=(first, TAIL)), "lee_velocity_control", num_envs=num_envs,
        seed=2, randomize=randomize, backend=backend,
    )  # fmt: skip
    env.reset()
    number = torch.arange(num_envs)
    for k in range(4):
        env.step(torch.tensor([[0.3, -0.2, 0.1, 0.5]]).expand(num_envs, 4))
        env.reset(number % 3 == k)
    return env


def test_named_places_are_offsets_about_the_mount() -> None:
    """In the frame of the IMU's own file: the tail is turned by pi, so that its x is minus the body's."""
    env = fly(64)
    draws = env.draws()
    assert set(draws) == {
        f"sensors.{name}.{label}" for name in ("base_imu", "tail") for label in ("position", "attitude")
    }
    assert (draws["sensors.base_imu.position"].abs() <= 0.1).all()
    assert (draws["sensors.base_imu.position"].std(0) > 0.04).all()
    x, y, z = draws["sensors.tail.position"].unbind(-1)
    assert ((x >= -0.25 - 1e-6) & (x <= -0.2 + 1e-6) & (y.abs() <= 0.01 + 1e-6) & (z.abs() < 1e-6)).all()
    assert x.std() > 0.01
    before = {name: rows.clone() for name, rows in draws.items()}
    mask = torch.arange(64) % 2 == 0
    env.reset(mask)
    for name, rows in draws.items():
        assert torch.equal(rows[~mask], before[name][~mask])
        changed = (rows[mask] != before[name][mask]).any(-1)
        assert changed.all() or name == "sensors.base_imu.attitude"
    assert not fly(4, randomize={}).draws()


def test_a_drawn_place_is_a_mount_at_that_place() -> None:
    drawn = fly(4)
    result, places = drawn.gtd["imu_measurement"], drawn.draws()["sensors.base_imu.position"]
    for i in range(4):
        mounted = fly(4, randomize={}, first=SensorMountCfg(sensor="base_imu", position=tuple(places[i].tolist())))
        expected = mounted.gtd["imu_measurement"]
        torch.testing.assert_close(result[i], expected[i], rtol=0.0, atol=1e-4)
        rest = torch.arange(4) != i
        assert (result - expected)[rest, :3].norm(dim=-1).min() > 1e-2


ROUND_OFF = 8.0 * 2.0**-20
AXES = ("ax", "ay", "az", "gx", "gy", "gz")
TURNS = ("roll", "pitch", "yaw")
BIAS = {f"effects.imu_bias.{name}": RandomizeCfg(how="value", low=-0.5, high=1.0) for name in AXES}
TURN = {f"effects.imu_misalignment.{name}": RandomizeCfg(how="value", low=-0.1, high=0.4) for name in TURNS}
BIAS_THEN_TURN = BIAS | TURN
IDEAL_FILE = """
summary: without errors
accel_noise_density: [0.0, 0.0, 0.0]
gyro_noise_density: [0.0, 0.0, 0.0]
accel_bias_walk: [0.0, 0.0, 0.0]
gyro_bias_walk: [0.0, 0.0, 0.0]
accel_initial_bias: [0.0, 0.0, 0.0]
gyro_initial_bias: [0.0, 0.0, 0.0]
accel_range: 1000.0
gyro_range: 1000.0
source: test
"""


@pytest.fixture
def ideal(tmp_path: Path) -> str:
    path = tmp_path / "ideal.yaml"
    path.write_text(IDEAL_FILE)
    return str(path)


def build(
    sensor: str, num_envs: int, randomize: dict[str, RandomizeCfg], *, backend: str = "warp", effects=None
) -> EnvManager:
    robot = replace(ROBOTS.get("base_quadrotor"), sensors=(SensorMountCfg(sensor=sensor, name="imu"),))
    if effects:
        robot = replace(robot, effects=effects, effects_source="test")
    env = simulation(robot, "lee_velocity_control", num_envs=num_envs, seed=2, randomize=randomize, backend=backend)
    env.reset()
    return env


def fly_drawn(env: EnvManager, steps: int = 4) -> Tensor:
    number, results = torch.arange(env.num_envs), [env.gtd["imu_measurement"].clone()]
    for k in range(steps):
        env.step(torch.tensor([[0.3, -0.2, 0.1, 0.5]]).expand(env.num_envs, 4))
        results.append(env.gtd["imu_measurement"].clone())
        env.reset(number % 3 == k)
        results.append(env.gtd["imu_measurement"].clone())
    return torch.stack(results)


def read_draws(env: EnvManager, effect: str, names: tuple[str, ...]) -> Tensor:
    return torch.stack([env.draws()[f"effects.{effect}.{name}"] for name in names], dim=-1).double()


def rotation(roll: Tensor, pitch: Tensor, yaw: Tensor) -> Tensor:
    one, zero = torch.ones_like(roll), torch.zeros_like(roll)

    def matrix(*entries: Tensor) -> Tensor:
        return torch.stack(entries, dim=-1).view(-1, 3, 3)

    about_z = matrix(yaw.cos(), -yaw.sin(), zero, yaw.sin(), yaw.cos(), zero, zero, zero, one)
    about_y = matrix(pitch.cos(), zero, pitch.sin(), zero, one, zero, -pitch.sin(), zero, pitch.cos())
    about_x = matrix(one, zero, zero, zero, roll.cos(), -roll.sin(), zero, roll.sin(), roll.cos())
    return about_z @ about_y @ about_x


def rotate_inverse(turn: Tensor, vector: Tensor) -> Tensor:
    return (rotation(*turn.unbind(-1)).transpose(1, 2) @ vector.unsqueeze(-1)).squeeze(-1)


def close(result: Tensor, expected: Tensor) -> None:
    torch.testing.assert_close(result.double(), expected, rtol=0.0, atol=ROUND_OFF)


@pytest.mark.parametrize("backend", ["warp", "torch"])
def test_each_imu_measures_what_its_environment_has_drawn(ideal: str, backend: str) -> None:
    """``R^T (f + b)`` and ``R^T (w + b)``, at rest and in flight, in environments that were reset on the way or not."""
    env, plain = (build(ideal, 8, cfg, backend=backend) for cfg in (BIAS_THEN_TURN, {}))
    for steps in (0, 4):
        true, results = fly_drawn(plain, steps)[-1].double(), fly_drawn(env, steps)[-1]
        bias, turn = read_draws(env, "imu_bias", AXES), read_draws(env, "imu_misalignment", TURNS)
        assert (bias.std(0) > 0.2).all()
        close(results[:, :3], rotate_inverse(turn, true[:, :3] + bias[:, :3]))
        close(results[:, 3:], rotate_inverse(turn, true[:, 3:] + bias[:, 3:]))


def test_effects_act_in_their_order(ideal: str) -> None:
    """Turned first, then biased: ``R^T f + b``."""
    env, plain = build(ideal, 4, TURN | BIAS), build(ideal, 4, {})
    true, results = fly_drawn(plain)[-1].double(), fly_drawn(env)[-1]
    bias, turn = read_draws(env, "imu_bias", AXES), read_draws(env, "imu_misalignment", TURNS)
    close(results[:, :3], rotate_inverse(turn, true[:, :3]) + bias[:, :3])


def test_a_drawn_offset_adds_to_the_declared_bias(ideal: str) -> None:
    """A declared 0.2 m/s² and a drawn +3 m/s² along body z: 3.2 m/s² too much; the declared gyro bias stays."""
    effects = {"imu_bias": dict(zip(AXES, (0.0, 0.0, 0.2, 0.0, -0.1, 0.0), strict=True))}
    cfg = {"effects.imu_bias.az": RandomizeCfg(how="offset", low=3.0, high=3.0)}
    env, plain = build(ideal, 3, cfg, effects=effects), build(ideal, 3, {})
    true = fly_drawn(plain)[-1].double()
    close(fly_drawn(env)[-1], true + torch.tensor([0.0, 0.0, 3.2, 0.0, -0.1, 0.0], dtype=torch.float64))


def test_a_reset_by_mask_leaves_other_rows(ideal: str) -> None:
    one, other = (build(ideal, 6, BIAS_THEN_TURN) for _ in range(2))
    mask = torch.tensor([True, False, False, True, False, False])
    before = one.gtd["imu_measurement"].clone()
    one.reset(mask)
    assert torch.equal(one.gtd["imu_measurement"][~mask], before[~mask])
    assert (one.gtd["imu_measurement"][mask] != before[mask]).any(-1).all()
    for env in (one, other):
        env.step(torch.zeros(6, 4))
    assert torch.equal(one.gtd["imu_measurement"][~mask], other.gtd["imu_measurement"][~mask])


def test_a_loaded_state_measures_on_the_same(ideal: str) -> None:
    flown = build(ideal, 4, BIAS_THEN_TURN)
    fly_drawn(flown)
    state = flown.save_state()
    expected = fly_drawn(flown)
    new = build(ideal, 4, BIAS_THEN_TURN)
    for env in (flown, new):
        env.load_state(state)
        assert torch.equal(fly_drawn(env), expected)


def test_parameters_that_were_written_are_measured(ideal: str) -> None:
    effects = {"imu_bias": dict.fromkeys(AXES, 0.0)}
    env, plain = build(ideal, 3, {}, effects=effects), build(ideal, 3, {})
    bias = torch.arange(18.0).view(3, 6) * 0.05
    env.gtd["effect_imu_bias"][:] = bias
    env.robot_manager.refresh_model()
    close(fly_drawn(env)[-1], fly_drawn(plain)[-1].double() + bias.double())


def test_a_robot_without_such_effects_has_no_rows(ideal: str) -> None:
    assert "robot_imu_errors" not in build(ideal, 2, {"body.mass": RandomizeCfg(low=0.9, high=1.1)}).gtd
