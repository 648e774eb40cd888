"""Randomised quantities: drawn as said, written by mask, and flown as a robot whose file says the drawn numbers."""

from collections.abc import Mapping
from dataclasses import replace
from math import log
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy import stats

from aerial_gym import ENVIRONMENTS, ROBOTS, EnvManager
from aerial_gym.config import dump_yaml, load
from aerial_gym.config.loader import build as from_mapping
from aerial_gym.config.randomize import RandomizeCfg
from aerial_gym.config.robot import InitialStateCfg, RobotCfg
from aerial_gym.errors import ConfigError
from aerial_gym.robots.parameter_draws import scale_second_moments
from tests.builders import simulation
from tests.physics.vehicles import BATTERY
from tests.refusals import assert_refused

QUAD = ROBOTS.get("base_quadrotor")
CELL = replace(BATTERY, capacity=36.0)
MANY: dict[str, RandomizeCfg] = {
    "body.mass": RandomizeCfg(low=0.8, high=1.2),
    "body.inertia": RandomizeCfg(low=0.9, high=1.1),
    "body.com": RandomizeCfg(how="offset", low=(-0.01, -0.01, 0.0), high=(0.01, 0.01, 0.0)),
    "rotor.thrust_map": RandomizeCfg(each_rotor=True, distribution="normal", mean=1.0, std=0.03, low=0.9, high=1.1),
    "rotor.time_constant": RandomizeCfg(low=0.8, high=1.2),
    "mounts.*.position": RandomizeCfg(how="offset", low=-0.002, high=0.002, each_rotor=True),
    "mounts.2.axis": RandomizeCfg(how="offset", low=(-0.05, -0.05, 0.0), high=(0.05, 0.05, 0.0)),
    "effects.rotor_drag.dx": RandomizeCfg(how="value", distribution="log_uniform", low=0.05, high=0.2),
    "effects.payload_mass.dm": RandomizeCfg(how="value", low=-0.02, high=0.02),
    "gains.velocity": RandomizeCfg(low=0.9, high=1.1),
}


def make(
    randomize: Mapping[str, RandomizeCfg], num_envs: int = 6, *, robot=QUAD, controller="lee_velocity_control",
    backend="warp", **options,
) -> EnvManager:  # fmt: skip
    options |= {"num_envs": num_envs, "seed": 4, "randomize": randomize, "backend": backend}
    env = simulation(robot, controller, **options)
    env.reset()
    return env


@pytest.fixture(scope="module", params=["warp", "torch"])
def many(request: pytest.FixtureRequest) -> EnvManager:
    return make(MANY, backend=request.param)


def test_draws_have_their_distributions() -> None:
    """Kolmogorov-Smirnov over 20,000 environments; a p-value below 1e-4 would be seen once in 10,000 seeds."""
    cfg = {
        "body.mass": RandomizeCfg(low=0.5, high=2.0),
        "rotor.time_constant": RandomizeCfg(distribution="log_uniform", low=0.1, high=10.0),
        "body.com": RandomizeCfg(how="offset", distribution="normal", mean=0.01, std=0.02, low=-0.01, high=0.05),
        "rotor.torque_map": RandomizeCfg(distribution="normal", mean=1.0, std=0.1, low=0.5, each_rotor=True),
    }
    drawn = {name: values.double().view(20_000, -1) for name, values in make(cfg, 20_000).draws().items()}
    laws = {
        "body.mass": stats.uniform(0.5, 1.5),
        "rotor.time_constant": stats.loguniform(0.1, 10.0),
        "body.com": stats.truncnorm(-1.0, 2.0, loc=0.01, scale=0.02),
        "rotor.torque_map": stats.truncnorm(-5.0, float("inf"), loc=1.0, scale=0.1),
    }
    for name, law in laws.items():
        for column in drawn[name].unbind(1):
            assert stats.kstest(column.numpy(), law.cdf).pvalue > 1e-4, name
    table = torch.cat(list(drawn.values()), dim=1)
    table = torch.cat((table, table.roll(1, dims=0)), dim=1)
    correlation = torch.corrcoef(table.T) - torch.eye(table.shape[1], dtype=table.dtype)
    assert correlation.abs().max() < 5.0 / 20_000**0.5
    assert (drawn["rotor.time_constant"].log().std(0) - log(100.0) / 12**0.5).abs().max() < 0.02


def test_a_draw_does_not_depend_on_what_else_is_drawn() -> None:
    alone = make({"body.mass": MANY["body.mass"]}).draws()["body.mass"]
    assert torch.equal(alone, make({"body.com": MANY["body.com"], "body.mass": MANY["body.mass"]}).draws()["body.mass"])


def test_an_episode_begins_as_without_draws(many: EnvManager) -> None:
    plain = make({}, backend=many.sim_cfg.backend)
    drawn = make(MANY, backend=many.sim_cfg.backend)
    for env in (plain, drawn):
        env.reset(torch.tensor([True, False, True, True, False, True]))
    assert not torch.equal(plain.gtd["robot_mass"], drawn.gtd["robot_mass"])
    for key in ("vec_root_tensor", "robot_position", "robot_body_angvel", "robot_euler_angles", "rotor_speed"):
        assert torch.equal(plain.gtd[key], drawn.gtd[key]), key


def test_only_the_rows_of_the_mask_are_written(many: EnvManager) -> None:
    manager, mask = many.robot_manager, torch.tensor([True, False, True, False, False, True])
    assert manager._update.why_slow == ""
    targets = [*manager.backend.parameter_targets(), many.gtd["robot_mass"], many.gtd["robot_inertia"]]
    targets += [many.gtd["effect_rotor_drag"], manager.controller.gains.velocity]
    before = [target.clone() for target in targets]
    many.reset(mask)
    for old, new in zip(before, targets, strict=True):
        assert torch.equal(old[~mask], new[~mask])
        assert (old[mask] != new[mask]).flatten(1).any(1).all() if old.ndim > 1 else (old[mask] != new[mask]).all()
    after = [target.clone() for target in targets]
    manager.refresh_model()
    for written, built in zip(after, targets, strict=True):
        torch.testing.assert_close(written, built, rtol=1e-6, atol=0.0)


def as_file(env: EnvManager, i: int) -> RobotCfg:
    """Return a robot file that says the numbers which environment i of ``MANY`` has drawn."""
    draws = {name: values[i] for name, values in env.draws().items()}
    mass = QUAD.body.mass * float(draws["body.mass"])
    inertia = torch.tensor([QUAD.body.inertia], dtype=torch.float64) * float(draws["body.mass"])
    inertia = scale_second_moments(inertia, draws["body.inertia"].double().unsqueeze(0))[0]
    body = replace(
        QUAD.body, mass=mass, inertia=tuple(map(tuple, inertia.tolist())), com=tuple(draws["body.com"].tolist())
    )
    rotors, layout = {}, []
    for number, mount in enumerate(QUAD.mounts.layout):
        factor, lag = float(draws["rotor.thrust_map"][number]), float(draws["rotor.time_constant"])
        lags = {f"time_constant_{way}": lag * getattr(QUAD.rotor, f"time_constant_{way}") for way in ("up", "down")}
        rotors[f"r{number}"] = replace(QUAD.rotor, thrust_map=tuple(factor * c for c in QUAD.rotor.thrust_map), **lags)
        changes = {"position": draws["mounts.*.position"][number].tolist()}
        changes["axis"] = draws["mounts.2.axis"].tolist() if number == 1 else [0.0, 0.0, 0.0]
        moved = {key: tuple(np.add(getattr(mount, key), change).tolist()) for key, change in changes.items()}
        layout.append(replace(mount, rotor=f"r{number}", **moved))
    effects = {"rotor_drag": {"dx": float(draws["effects.rotor_drag.dx"]), "dy": 0.0, "dz": 0.0}}
    effects["payload_mass"] = {"dm": float(draws["effects.payload_mass.dm"])}
    robot = replace(QUAD, body=body, rotor=None, rotors=rotors, mounts=replace(QUAD.mounts, layout=tuple(layout)))
    return replace(robot, effects=effects, effects_source="test")


def test_it_flies_as_the_robot_whose_file_says_the_drawn_numbers(many: EnvManager) -> None:
    """The rotors are driven directly, as the controller goes on believing what is declared. Float32 over 25 steps."""
    backend = many.sim_cfg.backend
    cfg = {name: each for name, each in MANY.items() if not name.startswith("gains")}
    result = simulation(QUAD, "rotor_speed_control", sim=many.sim_cfg, env=many.cfg, num_envs=3, seed=9, randomize=cfg)
    result.reset()
    states = ("robot_position", "robot_orientation", "robot_linvel", "robot_body_angvel", "rotor_speed")
    start = {key: result.gtd[key].clone() for key in states}
    speed = 1.02 * result.gtd["rotor_speed"].clone()
    for _ in range(25):
        result.step(speed)
    for i in range(2):
        plain = simulation(as_file(result, i), "rotor_speed_control", sim=many.sim_cfg, env=many.cfg, num_envs=1)
        plain.reset()
        for key in states:
            plain.gtd[key].copy_(start[key][i : i + 1])
        for _ in range(25):
            plain.step(speed[i : i + 1].clamp(max=float("inf")))
        for key in states[:4]:
            told = f"{backend} {key}"
            torch.testing.assert_close(result.gtd[key][i], plain.gtd[key][0], rtol=2e-4, atol=2e-4, msg=told)


def test_a_stretched_body_has_the_inertia_of_its_points() -> None:
    g = torch.Generator().manual_seed(0)
    points = torch.randn(20, 3, dtype=torch.float64, generator=g)
    mass = torch.rand(20, dtype=torch.float64, generator=g)

    def inertia(at: torch.Tensor) -> torch.Tensor:
        unit = torch.eye(3, dtype=torch.float64)
        return (mass[:, None, None] * (at.square().sum(-1)[:, None, None] * unit - at[:, :, None] * at[:, None])).sum(0)

    factor = torch.tensor([[0.8, 1.3, 1.1]], dtype=torch.float64)
    result = scale_second_moments(inertia(points).unsqueeze(0), factor)
    torch.testing.assert_close(result[0], inertia(points * factor[0].sqrt()))
    moments = torch.linalg.eigvalsh(result[0])
    assert moments[2] < moments[0] + moments[1]


def test_a_battery_begins_at_the_drawn_charge() -> None:
    """From the drawn share on, the open-circuit voltage follows the declared line: full - (full - empty) (q0 + q) / Q."""
    robot = replace(QUAD, battery=CELL, effects={"battery_sag": {"gain": 1.0}}, effects_source="test")
    env = make({"battery.charge": RandomizeCfg(how="value", low=0.3, high=1.0)}, robot=robot)
    share = env.draws()["battery.charge"]
    _, full, empty, _, capacity, _ = env.robot_manager._build_model().vehicle.battery.unbind(-1)
    for drawn in (0.0, 5.0, 10.0):
        begun = CELL.full_voltage - (CELL.full_voltage - CELL.empty_voltage) * (drawn / CELL.capacity + 1.0 - share)
        torch.testing.assert_close(full - (full - empty) * drawn / capacity, begun)


def test_mass_can_leave_the_inertia_alone() -> None:
    grown = make({"body.mass": RandomizeCfg(low=0.8, high=1.2)}).gtd
    expected = torch.full((6,), QUAD.body.inertia[0][0] / QUAD.body.mass)
    torch.testing.assert_close(grown["robot_inertia"][:, 0, 0] / grown["robot_mass"], expected)
    kept = make({"body.mass": RandomizeCfg(low=0.8, high=1.2, keep_inertia=True)}).gtd
    assert torch.equal(kept["robot_mass"], grown["robot_mass"])
    torch.testing.assert_close(kept["robot_inertia"], torch.tensor(QUAD.body.inertia).expand(6, 3, 3))


def test_names_and_ranges_come_from_files(tmp_path) -> None:
    cfg = from_mapping(RandomizeCfg, {"how": "offset", "low": -0.1, "high": [0.1, 0.2, 0.3]}, where="here")
    assert cfg.component_distributions(3) == [(-0.1, 0.1, 0.0, 0.0), (-0.1, 0.2, 0.0, 0.0), (-0.1, 0.3, 0.0, 0.0)]
    drawn = {"body.mass": RandomizeCfg(how="value", low=0.3, high=0.3)}
    where = replace(ENVIRONMENTS.get("empty_env"), randomize=drawn)
    robot = replace(QUAD, randomize={"body.mass": RandomizeCfg(low=2.0, high=2.0), "body.com": MANY["body.com"]})
    env = simulation(robot, env=where)
    env.reset()
    assert env.draws().keys() == {"body.mass", "body.com"}
    torch.testing.assert_close(env.gtd["robot_mass"], torch.full((2,), 0.3))


MOTOR = "effects.weak_motor.motor"


@pytest.mark.parametrize(("cfg", "message"), [
    ({"body.mas": RandomizeCfg(low=1.0, high=1.0)}, "no quantity 'body.mas'. Did you mean 'body.mass'"),
    ({"effects.rotor_drag.dw": RandomizeCfg(low=1.0, high=1.0)}, "Did you mean 'effects.rotor_drag.d"),
    ({"battery.capacity": RandomizeCfg(low=1.0, high=1.0)}, "no quantity 'battery.capacity'"),
    ({"sensors.eye.position": RandomizeCfg(how="offset", low=0.0, high=1.0)}, "no quantity 'sensors.eye.position'"),
    ({"body.mass": RandomizeCfg(how="offset", low=-1.0, high=0.0)}, "body.mass reaches -0.75 to 0.25"),
    ({"effects.rotor_drag.dx": RandomizeCfg(how="value", low=-1.0, high=0.0)}, "must stay within"),
    ({"body.com": RandomizeCfg(how="offset", low=(0.0, 0.0), high=1.0)}, "needs one number, or 3"),
    ({"rotor.thrust_map": RandomizeCfg(how="value", low=0.0, high=1.0)}, "how = 'value' must be one of scale"),
    ({"body.mass": RandomizeCfg(low=1.0, high=1.0, each_rotor=True)}, "each_rotor is for quantities of all rotors"),
    ({MOTOR: RandomizeCfg(how="value", low=1.0, high=4.0)}, "is the number of a rotor. Give how: value, distribution: integ"),
    ({MOTOR: RandomizeCfg(how="offset", distribution="integer", low=0, high=3)}, "is the number of a rotor"),
    (
        {MOTOR: RandomizeCfg(how="value", distribution="integer", low=1, high=5)},
        r"reaches 1 to 5: must stay within \[1, 4\]",
    ),
])  # fmt: skip
def test_impossible_requests_are_refused_by_name(cfg: dict[str, RandomizeCfg], message: str) -> None:
    assert_refused(ConfigError, message, make, cfg)


@pytest.mark.parametrize(("fields", "message"), [
    ({"low": 1.0}, "a uniform distribution needs low and high"),
    ({"low": 2.0, "high": 1.0}, "needs low <= high"),
    ({"low": float("nan"), "high": 1.0}, "needs low <= high"),
    ({"low": -1.0, "high": 1.0}, "a factor needs a lowest value >= 0"),
    ({"low": 0.0, "high": 1.0, "distribution": "log_uniform"}, "needs 0 < low"),
    ({"mean": 1.0, "std": 0.0, "distribution": "normal", "low": 0.0}, "0 < std < inf"),
    ({"mean": 1.0, "std": 0.1, "distribution": "normal", "low": 2.0}, "hardly anything lies in"),
    ({"low": 1.0, "high": 1.0, "how": "factor"}, "must be one of scale, offset, value"),
    ({"low": 1.0, "high": 1.0, "mean": 1.0}, "a uniform distribution has none"),
    ({"low": 0.0, "high": 1.0, "correlation": {"body.mass": 0.5}}, "a uniform distribution has none"),
    (
        {"distribution": "normal", "mean": 0.0, "std": 1.0, "how": "offset", "correlation": {"body.mass": 1.5}},
        "must lie in -1 to 1",
    ),
    ({"distribution": "integer", "low": 1.5, "high": 4.0}, "an integer distribution needs whole numbers"),
])  # fmt: skip
def test_impossible_distributions_are_refused(fields: dict, message: str) -> None:
    assert_refused(ConfigError, message, RandomizeCfg, **fields)


def test_places_of_sensors_are_drawn_about_their_mounts() -> None:
    robot = ROBOTS.get("base_quadrotor_with_camera")
    (name,) = (mount.key for mount in robot.sensor_mounts)
    plain = make({}, robot=robot).sensor_manager.casters[name]
    ends = {"low": (-0.01, 0.0, 0.0), "high": (0.01, 0.0, 0.0)}
    env = make({f"sensors.{name}.position": RandomizeCfg(how="offset", **ends)}, robot=robot)
    cfg, place = plain.cfg, env.draws()[f"sensors.{name}.position"][:, 0]
    if cfg.position_low is None:
        assert ((place - torch.tensor(cfg.position)).abs() <= torch.tensor([0.01001, 1e-6, 1e-6])).all()
    assert place[:, 0].std() > 0.001


MEANS, DEVIATIONS = (0.2, 0.1, 3.0), (0.02, 0.03, 0.5)
CORRELATION = ((1.0, -0.7, 0.3), (-0.7, 1.0, 0.2), (0.3, 0.2, 1.0))
DX, DY, WIND = "effects.rotor_drag.dx", "effects.rotor_drag.dy", "effects.constant_wind.x"


def normal(mean: float, std: float, low: float, high: float, **correlation: float) -> RandomizeCfg:
    """Return a normal value between limits, correlated with a drag ``dx`` or ``dy``, a ``wind`` or a ``mass``."""
    names = {"dx": DX, "dy": DY, "wind": WIND, "mass": "body.mass", "dz": "effects.rotor_drag.dz"}
    shares = {names[key]: share for key, share in correlation.items()}
    limits = {"mean": mean, "std": std, "low": low, "high": high}
    return RandomizeCfg(how="value", distribution="normal", correlation=shares, **limits)


TOGETHER = {
    DX: normal(0.2, 0.02, 0.0, 1.0), DY: normal(0.1, 0.03, 0.0, 1.0, dx=-0.7),
    "body.mass": RandomizeCfg(low=0.9, high=1.1), WIND: normal(3.0, 0.5, -10.0, 10.0, dx=0.3, dy=0.2),
}  # fmt: skip


def test_what_is_drawn_together_has_the_covariance_that_was_written() -> None:
    """The sample covariance of N normal draws scatters by ``sqrt((s_ii s_jj + s_ij^2) / (N - 1))``, their mean by
    ``sqrt(s_ii / N)``; five of these leave one false alarm in 100,000. (Anderson (2003), Multivariate Statistical Analysis,
    theorem 3.4.4.) A drag below zero, which is clipped, is 3.3 deviations away: one draw in 2,300."""
    count = 4096
    draws = make(TOGETHER, count).draws()
    rows = torch.stack([draws[name] for name in TOGETHER if name != "body.mass"], dim=-1).double()
    means, deviations = torch.tensor(MEANS).double(), torch.tensor(DEVIATIONS).double()
    expected = torch.tensor(CORRELATION).double() * torch.outer(deviations, deviations)
    variances = deviations.square()
    scatter = ((torch.outer(variances, variances) + expected.square()) / (count - 1)).sqrt()
    assert bool(((torch.cov(rows.T) - expected).abs() < 5.0 * scatter).all())
    assert bool(((rows.mean(0) - means).abs() < 5.0 * deviations / count**0.5).all())
    assert bool((rows[:, 1] >= 0.0).all())
    for each in rows.T:
        assert stats.kstest(((each - each.mean()) / each.std()).numpy(), "norm").pvalue > 1e-4


def test_a_sum_that_alone_is_known_is_drawn_as_certain_as_it_is() -> None:
    draws = make({DX: normal(0.2, 0.02, 0.0, 1.0), DY: normal(0.2, 0.02, 0.0, 1.0, dx=-1.0)}, 64).draws()
    assert float((draws[DX] + draws[DY]).std()) < 2e-3 * 0.02
    assert float(draws[DX].std()) > 0.01


@pytest.mark.parametrize(("changes", "message"), [
    ({DX: normal(0.2, 0.02, 0.0, 1.0, dz=0.5)}, "dz', which is not drawn"),
    ({DX: normal(0.2, 0.02, 0.0, 1.0, mass=0.5)}, "body.mass must be a normal distribution of one number"),
    ({DX: normal(0.2, 0.02, 0.0, 1.0, wind=0.3)}, "give each pair of two quantities once"),
    ({WIND: normal(3.0, 0.5, -10.0, 10.0, dx=0.9, dy=0.9)}, "contradict each other"),
])  # fmt: skip
def test_a_correlation_that_cannot_be_drawn_is_refused(changes: Mapping[str, RandomizeCfg], message: str) -> None:
    assert_refused(ConfigError, message, make, {**TOGETHER, **changes}, 2)


def test_a_joint_distribution_is_read_and_written(tmp_path: Path) -> None:
    robot = replace(QUAD, randomize=TOGETHER)
    path = tmp_path / "robot.yaml"
    path.write_text(dump_yaml(robot), encoding="utf-8")
    assert load(RobotCfg, path).randomize == TOGETHER
    assert "effects.rotor_drag.dx: -0.7" in path.read_text(encoding="utf-8")


def test_integers_are_drawn_equally_often_and_name_rotors() -> None:
    """Chi-square over 20,000 environments and four rotors; a p-value below 1e-4 would be seen once in 10,000 seeds."""
    failing = {"effects.motor_failure.motor": RandomizeCfg(how="value", distribution="integer", low=1, high=4)}
    env = make(failing, 20_000)
    drawn = env.draws()["effects.motor_failure.motor"].flatten()
    counts = torch.bincount(drawn.long(), minlength=5)
    assert torch.equal(drawn, drawn.round())
    assert counts[0] == 0
    assert len(counts) == 5
    assert stats.chisquare(counts[1:].numpy()).pvalue > 1e-4


STILL = InitialStateCfg(
    **{f"{name}_{end}": (0.0, 0.0, 0.0) for name in ("euler", "lin_vel", "ang_vel") for end in ("low", "high")}
)
STILL_PID = {"robot": replace(QUAD, initial_state=STILL), "controller": "pid_velocity_control"}


@pytest.mark.parametrize("backend", ["warp", "torch"])
def test_gains_over_a_rate_loop_are_drawn(backend: str) -> None:
    """From one start, the larger the gain on the velocity error the faster after 0.1 s."""
    plain, env = (
        make(cfg, backend=backend, **STILL_PID) for cfg in ({}, {"gains.velocity": RandomizeCfg(low=0.5, high=1.0)})
    )
    gains, declared = (each.robot_manager.controller.gains_by_name["velocity"] for each in (env, plain))
    factor = env.draws()["gains.velocity"]
    torch.testing.assert_close(gains, factor * declared)
    for _ in range(10):
        env.step(torch.tensor([[0.5, 0.0, 0.0, 0.0]]).expand(6, 4))
    assert torch.equal(env.gtd["robot_linvel"][:, 0].argsort(), factor[:, 0].argsort())


def test_a_unit_gain_is_not_to_be_drawn() -> None:
    """Over a rate loop the law's gain on the rate is 1: its torque is the body rates that it wants."""
    with pytest.raises(ConfigError, match=r"no quantity 'gains.rate'"):
        make({"gains.rate": RandomizeCfg(low=0.9, high=1.1)}, controller="pid_velocity_control")
