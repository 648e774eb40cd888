"""Several vehicles in an environment: one contract for one kind and for several, starts, collisions and resets."""

from collections.abc import Mapping
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor

from aerial_gym import CONTROLLERS, ENVIRONMENTS, ROBOTS, EnvManager, SimBuilder, Task, task_registry
from aerial_gym.config.environment import ContactCfg
from aerial_gym.config.randomize import RandomizeCfg
from aerial_gym.config.robot import BoxCfg, CollisionCfg, RobotCfg, SphereCfg
from aerial_gym.errors import AerialGymError, CapabilityError, ConfigError, OwnershipError, ShapeError
from tests.unit.env_manager.test_batch_independence import assert_same

E, V = 3, 4
QUAD = "base_quadrotor_with_imu"
CLOSE, EMPTY = ENVIRONMENTS.get("env_with_obstacles"), ENVIRONMENTS.get("empty_env")
WIDE = replace(
    EMPTY, bounds_lower_low=(-500.0,) * 3, bounds_lower_high=(-500.0,) * 3, bounds_upper_low=(500.0,) * 3,
    bounds_upper_high=(500.0,) * 3,
)  # fmt: skip
DRAWN = {
    "body.mass": RandomizeCfg(low=0.8, high=1.2),
    "gains.velocity": RandomizeCfg(low=0.9, high=1.1),
    "effects.rotor_drag.dx": RandomizeCfg(how="value", low=0.1, high=0.2),
    "effects.imu_bias.ax": RandomizeCfg(how="value", low=-0.1, high=0.1),
}
AIR = {
    "effects.constant_wind.x": RandomizeCfg(how="value", low=-3.0, high=3.0),
    "effects.gusts.std": RandomizeCfg(how="value", low=0.5, high=2.0),
}
NORMAL = {"distribution": "normal", "mean": 1.0, "std": 0.1, "low": 0.5, "high": 1.5}
CORRELATED = {
    "body.mass": RandomizeCfg(**NORMAL, correlation={"effects.constant_wind.x": 0.5}),
    "effects.constant_wind.x": RandomizeCfg(**NORMAL, how="value"),
}
ONE_KIND = [{"name": QUAD, "count": V}]
TWO_KINDS = [{"name": QUAD, "count": 2}, {"name": "tilted_hexarotor", "count": 1}]


def build(robots: list[dict[str, Any]] | None = None, **options: Any) -> EnvManager:
    defaults = {
        "sim_name": "base_sim", "env_name": WIDE, "controller_name": "lee_velocity_control", "num_envs": E,
        "device": "cpu", "seed": 5, "backend": "warp",
    }  # fmt: skip
    return SimBuilder().build_env(**defaults | options, robots=robots)


def ball(radius: float) -> RobotCfg:
    """Return a robot whose collision shape is one sphere."""
    collision = CollisionCfg(spheres=(SphereCfg(center=(0.0, 0.0, 0.0), radius=radius),))
    return replace(ROBOTS.get("base_quadrotor"), collision=collision)


def actions(numbers: Tensor, width: int = 4) -> Tensor:
    return torch.sin(numbers.unsqueeze(-1) + torch.arange(float(width))).clamp(-0.5, 0.5)


def body_rows(gtd: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Return everything of the bodies that a simulation of one vehicle has too, one row for each."""
    return {key: value.clone() for key, value in gtd.items() if not key.startswith("vehicle_")}


def test_shapes_and_names() -> None:
    env = build(ONE_KIND)
    env.reset()
    env.step(torch.zeros(E, V, 4))
    assert env.gtd["robot_position"].shape == (E, V, 3)
    assert env.gtd["crashes"].shape == (E, V)
    assert env.gtd["env_bounds_min"].shape == (E, 3)
    assert env.gtd["sim_steps"].tolist() == [[1] * V] * E
    assert env.gtd["robot_position"].data_ptr() == env.kinds[QUAD].bodies["robot_position"].data_ptr()
    assert f"{V} x {QUAD}" in repr(env)
    two = build(TWO_KINDS)
    two.reset()
    two.step({QUAD: torch.zeros(E, 2, 4), "tilted_hexarotor": torch.zeros(E, 1, 4)})
    assert two.kinds[QUAD].gtd["rotor_speed"].shape == (E, 2, 4)
    assert two.kinds["tilted_hexarotor"].gtd["rotor_speed"].shape == (E, 1, 6)
    assert two.episode_ends().shape == (E, 3)
    with pytest.raises(AttributeError, match=r"several kinds of vehicles. Take env.kinds\[NAME\].imus"):
        _ = two.imus


def test_one_vehicle_in_a_list_is_as_without_a_list() -> None:
    one, listed = build(robot_name=QUAD), build([{"name": QUAD}])
    for env in (one, listed):
        env.reset()
        env.step(actions(torch.arange(float(E))))
    assert listed.vehicles is None
    assert one.gtd.keys() == listed.gtd.keys()
    assert_same(dict(one.gtd), dict(listed.gtd))


@pytest.mark.parametrize("backend", ["warp", "torch"])
def test_vehicles_far_apart_are_single_vehicles_bit_for_bit(backend: str) -> None:
    """Body b = environment x V + vehicle draws and flies as environment b of a simulation of one vehicle each."""
    many = build(ONE_KIND, randomize=DRAWN, backend=backend)
    alone = build(robot_name=QUAD, num_envs=E * V, randomize=DRAWN, backend=backend)
    number = torch.arange(float(E * V))
    for env, shape in ((many, (E, V)), (alone, (E * V,))):
        for _ in range(2):
            env.reset()
            for step in range(4):
                env.step(actions(number + step).view(*shape, 4))
    assert torch.isfinite(many.gtd["vehicle_clearance"]).all()
    bodies = body_rows(many.kinds[QUAD].bodies)
    assert_same(bodies, {key: value for key, value in alone.gtd.items() if key in bodies})
    assert {*alone.gtd} - {*bodies} == {
        key for key in alone.gtd if key.startswith(("env_", "obstacle_", "vec_", "num_"))
    }


def test_joints_bend_alike() -> None:
    many, alone = build([{"name": "morphy", "count": 2}]), build(robot_name="morphy", num_envs=2 * E)
    width = alone.robot_manager.num_actions
    for env, shape in ((many, (E, 2)), (alone, (2 * E,))):
        env.reset()
        for step in range(3):
            env.step(actions(torch.arange(2.0 * E) + step, width).view(*shape, width))
    assert many.gtd["dof_position"].shape[:2] == (E, 2)
    bodies = body_rows(many.kinds["morphy"].bodies)
    assert_same(bodies, {key: alone.gtd[key] for key in bodies})


def test_mujoco_flies_several_vehicles() -> None:
    """Free flight of another engine: the same states from both backends within 1 mm after 10 steps."""
    pytest.importorskip("mujoco")
    ends = []
    for backend in ("warp", "mujoco"):
        env = build([{"name": "base_quadrotor", "count": 2}], backend=backend, sim_name="base_sim_2ms")
        env.reset()
        for step in range(10):
            env.step(actions(torch.arange(2.0 * E) + step).view(E, 2, 4))
        ends.append(env.gtd["robot_position"].clone())
    torch.testing.assert_close(*ends, atol=1e-3, rtol=0.0)


def test_vehicles_of_several_kinds_are_single_vehicles_bit_for_bit() -> None:
    """Numbers of bodies run over all kinds of an environment: with T vehicles, e T + the kind's first + vehicle."""
    many = build(TWO_KINDS, randomize=DRAWN)
    total = 3
    number = torch.arange(float(E * total))
    singles = {kind["name"]: build(robot_name=kind["name"], num_envs=E * total, randomize=DRAWN) for kind in TWO_KINDS}
    slots = {QUAD: [0, 1], "tilted_hexarotor": [2]}
    for env in (many, *singles.values()):
        env.reset()
    for step in range(4):
        given = actions(number + step).view(E, total, 4)
        many.step({name: given[:, columns] for name, columns in slots.items()})
        for env in singles.values():
            env.step(given.flatten(0, 1))
    for name, columns in slots.items():
        rows = torch.arange(E * total).view(E, total)[:, columns].flatten()
        bodies = body_rows(many.kinds[name].bodies)
        assert_same(bodies, {key: singles[name].gtd[key][rows] for key in bodies})


@pytest.mark.parametrize(
    ("env", "kinds"),
    [
        ("dynamic_env", ONE_KIND),
        ("env_with_obstacles", TWO_KINDS),
        pytest.param("forest_env", ONE_KIND, marks=pytest.mark.slow),
        pytest.param("dynamic_env", TWO_KINDS, marks=pytest.mark.slow),
    ],
)
def test_an_environment_is_the_same_alone_and_among_others(env: str, kinds: list[dict[str, Any]]) -> None:
    """With obstacles, wind, gusts, crashes and redrawn starts: nothing depends on another environment."""
    cfg = replace(ENVIRONMENTS.get(env), reset_together=True, vehicle_clearance=0.3)
    results = []
    for num_envs, first in ((E, 0), (1, 2)):
        many = build(kinds, env_name=cfg, num_envs=num_envs, first_env=first, randomize=DRAWN | AIR)
        many.reset()
        ends = 0
        for step in range(12):
            own = torch.arange(first, first + num_envs, dtype=torch.float32)
            given = {
                name: 4.0 * actions(own.unsqueeze(1) + torch.arange(float(group.kind.count)) + step)
                for name, group in many.kinds.items()
            }
            if step == 6:
                given[QUAD][own == 2, 1] = torch.nan  # a crash
            many.step(given if len(kinds) > 1 else given[QUAD])
            ended = many.episode_ends()
            ends += int(ended[-1])
            many.reset(ended | ((own.int() + step) % 5 == 0))
        views = {"": many.gtd, **{name: group.gtd for name, group in many.kinds.items()}}
        tensors = {f"{name}.{key}": value for name, view in views.items() for key, value in view.items()}
        results.append({k: v[-1].clone() for k, v in tensors.items() if not k.endswith("num_obstacles_in_env")})
    assert ends
    assert_same(*results)


@pytest.mark.parametrize("backend", ["warp", "torch"])
def test_the_air_is_one_for_all_vehicles_of_an_environment(backend: str) -> None:
    """Two vehicles with equal states stay equal in the same gusts; the masses of others are drawn for each vehicle."""
    env = build(ONE_KIND, env_name=replace(WIDE, reset_together=True), randomize=AIR | DRAWN, backend=backend)
    env.reset()
    drawn = env.draws()
    assert torch.equal(drawn["effects.constant_wind.x"], drawn["effects.constant_wind.x"][:, :1].expand(E, V))
    assert drawn["effects.constant_wind.x"][:, 0].unique().numel() == E
    assert drawn["body.mass"].unique().numel() == E * V
    alike = build(
        ONE_KIND, env_name=replace(WIDE, reset_together=True), backend=backend,
        randomize=AIR | {"effects.rotor_drag.dx": RandomizeCfg(how="value", low=0.3, high=0.3)},
    )  # fmt: skip
    alike.reset()
    bodies = alike.kinds[QUAD].bodies
    for key in ("robot_position", "robot_orientation", "robot_linvel", "robot_body_angvel"):
        alike.gtd[key].copy_(bodies[key][:1].expand_as(alike.gtd[key]))
    for _ in range(3):
        alike.step(torch.zeros(E, V, 4))
    speed = alike.gtd["robot_linvel"]
    assert torch.equal(speed, speed[:, :1].expand_as(speed))
    assert speed[:, 0, 0].unique().numel() == E


@pytest.mark.parametrize("name", ["env_with_obstacles", "dynamic_env"])
def test_obstacles_are_those_of_the_environment(name: str) -> None:
    """Each vehicle touches, passes and measures what a single vehicle at its place does, also while obstacles move."""
    many, alone = (
        build([{"name": "base_quadrotor_lander", "count": 3}], env_name=name),
        build(robot_name="base_quadrotor_lander", env_name=name),
    )
    many.reset()
    bodies = many.kinds["base_quadrotor_lander"].gtd
    bodies["robot_linvel"][:] = 30.0 * torch.randn(E, 3, 3, generator=torch.Generator().manual_seed(2))
    twists = torch.randn(E, many.cfg.num_assets, 6, generator=torch.Generator().manual_seed(1))
    env_actions = twists if many.cfg.moves else None
    before = {key: value.clone() for key, value in many.gtd.items()}
    many.step(torch.zeros(E, 3, 4), env_actions)
    touched = counted = 0
    for v in range(3):
        alone.reset()
        for key in ("robot_position", "robot_orientation", "robot_linvel", "robot_body_angvel", "rotor_speed"):
            alone.gtd[key].copy_(before[key][:, v])
        alone.gtd["env_asset_state_tensor"].copy_(before["env_asset_state_tensor"])
        alone.step(torch.zeros(E, 4), env_actions)
        for key in ("robot_position", "crashes", "robot_clearance", "surface_height"):
            free = before["vehicle_clearance"][:, v] > 1.0  # of other vehicles, for the 0.6 m of the step
            assert torch.equal(many.gtd[key][:, v][free], alone.gtd[key][free]), key
        counted += int(free.sum())
        touched += int(alone.gtd["crashes"].sum())
        assert torch.equal(many.gtd["env_asset_state_tensor"], alone.gtd["env_asset_state_tensor"])
    assert counted
    assert 0 < touched < 3 * E


def test_a_vehicle_can_be_reset_alone() -> None:
    wind = "effects.constant_wind.x"
    env = build(ONE_KIND, env_name=CLOSE, randomize=DRAWN | {wind: AIR[wind]})
    env.reset()
    air = env.draws()[wind].clone()
    for step in range(3):
        env.step(actions(torch.arange(float(E * V)) + step).view(E, V, 4))
    before = {key: value.clone() for key, value in env.gtd.items()}
    mask = torch.zeros(E, V, dtype=torch.bool)
    mask[1, 2] = True
    env.reset(mask)
    bodies = [key for key in before if before[key].shape[:2] == (E, V) and key != "vehicle_clearance"]
    for key in before.keys() - bodies - {"vehicle_clearance"}:
        assert torch.equal(env.gtd[key], before[key]), key
    for key in bodies:
        assert torch.equal(env.gtd[key][~mask], before[key][~mask]), key
    assert env.gtd["episodes"][mask].tolist() == [1]
    assert torch.equal(env.draws()[wind], air)
    assert env.gtd["sim_steps"][mask].tolist() == [0]
    assert not torch.equal(env.gtd["robot_position"][mask], before["robot_position"][mask])
    with pytest.raises(ShapeError, match=r"expected bool \(E,\) = \(3,\) for environments, or \(E, V\) = \(3, 4\)"):
        env.reset(torch.ones(V, E, dtype=torch.bool))


def gaps(env: EnvManager, radius: float) -> Tensor:
    """Return the distances between balls of all pairs of vehicles, (E, pairs)."""
    place = env.gtd["robot_position"]
    return torch.stack([(place[:, i] - place[:, j]).norm(dim=-1) - 2 * radius for i, j in combinations(range(V), 2)], 1)


def test_starts_keep_their_distance() -> None:
    """Four balls in 2 m: all pairs are ``vehicle_clearance`` apart after a reset of all, and after one of some vehicles."""
    cfg, radius = replace(EMPTY, vehicle_clearance=0.25), 0.1
    free, kept = (
        build([{"name": ball(radius), "count": V}], env_name=each, num_envs=64)
        for each in (replace(EMPTY, vehicle_clearance=0.0), cfg)
    )
    for env, least in ((free, 0.0), (kept, 0.25)):
        env.reset()
        assert gaps(env, radius).min() >= least - 1e-6
        torch.testing.assert_close(env.gtd["vehicle_clearance"].amin(dim=1), gaps(env, radius).amin(dim=1))
    moved = (free.gtd["robot_position"] != kept.gtd["robot_position"]).any(dim=-1)
    assert 0 < moved.sum() < moved.numel()
    assert torch.equal(kept.gtd["robot_state_tensor"][..., :3], kept.gtd["robot_position"])
    for number in range(5):
        mask = torch.rand(64, V, generator=torch.Generator().manual_seed(number)) < 0.4
        kept.reset(mask)
        assert gaps(kept, radius).min() >= 0.25 - 1e-6


def test_a_start_alone_keeps_away_from_drawn_obstacles() -> None:
    """Two balls start anywhere among the obstacles of an environment; these stay, and all are 0.4 m away."""
    drawn = tuple(each for each in CLOSE.assets if each.position_ratio_low != each.position_ratio_high)
    anywhere = replace(ball(0.1).initial_state, position_ratio_low=(0.0,) * 3, position_ratio_high=(1.0,) * 3)
    robot = replace(ball(0.1), initial_state=anywhere)
    env = build([{"name": robot, "count": 2}], env_name=replace(CLOSE, assets=drawn), num_envs=32)
    env.reset()
    obstacles = env.gtd["env_asset_state_tensor"].clone()
    for _ in range(3):
        env.reset(torch.ones(32, 2, dtype=torch.bool))
        assert env.gtd["robot_clearance"].min() >= CLOSE.clearance - 1e-5
    assert torch.equal(env.gtd["env_asset_state_tensor"], obstacles)


def test_too_many_vehicles_for_the_range_of_starts_are_refused() -> None:
    with pytest.raises(ConfigError, match=r"vehicles of robot need 1\.2 m from origin to origin, .* room for about"):
        build([{"name": ball(0.1), "count": 40}], env_name=replace(EMPTY, vehicle_clearance=1.0))


def place(env: EnvManager, offsets: list[float], speeds: list[float], *, beside: float) -> None:
    """Put two vehicles on one line along x, the second ``beside`` it along y, and a third far away."""
    env.reset()
    for v, (x, speed) in enumerate(zip(offsets, speeds, strict=True)):
        env.gtd["robot_position"][:, v] = torch.tensor([x, beside if v == 1 else 0.0, 0.0])
        env.gtd["robot_linvel"][:, v] = torch.tensor([speed, 0.0, 0.0])
    env.gtd["robot_orientation"][:] = torch.tensor([0.0, 0.0, 0.0, 1.0])
    env.gtd["robot_body_angvel"].zero_()


@pytest.mark.parametrize(("beside", "crash"), [(0.0, True), (0.19, True), (0.21, False)])
def test_vehicles_that_pass_through_each_other_in_one_step_crash(beside: float, crash: bool) -> None:
    """At 60 m/s each, two balls of 0.1 m swap sides within a step: a crash of both if they pass within 0.2 m."""
    env = build([{"name": ball(0.1), "count": 3}])
    place(env, [-0.3, 0.3, 50.0], [60.0, -60.0, 0.0], beside=beside)
    env.step(torch.zeros(E, 3, 4))
    x = env.gtd["robot_position"][0, :, 0]
    assert x[0] > 0.2
    assert x[1] < -0.2
    for key in ("crashes", "vehicle_collisions"):
        assert env.gtd[key].tolist() == [[crash, crash, False]] * E
    apart = (env.gtd["robot_position"][:, 0] - env.gtd["robot_position"][:, 1]).norm(dim=-1) - 0.2
    torch.testing.assert_close(env.gtd["vehicle_clearance"][:, 0], apart)
    assert torch.equal(env.gtd["vehicle_clearance"][:, 0], env.gtd["vehicle_clearance"][:, 1])
    assert env.episode_ends().tolist() == [[crash, crash, False]] * E


def test_the_distance_is_that_of_the_nearest_pair() -> None:
    """Among six turned boxes as far apart as they are large, each has the least distance of its pairs, flown as pairs."""
    many = build([{"name": "base_quadrotor", "count": 6}], num_envs=8, env_name=CLOSE)
    many.reset()
    torch.manual_seed(3)
    states = torch.cat([torch.rand(8, 6, 3), torch.nn.functional.normalize(torch.randn(8, 6, 4), dim=-1)], dim=-1)
    pair = build([{"name": "base_quadrotor", "count": 2}], num_envs=8, env_name=CLOSE)
    pair.reset()

    def distances(env: EnvManager, poses: Tensor) -> Tensor:
        assert env.vehicles is not None
        env.vehicles.states[:, :7] = poses.flatten(0, 1)
        env.vehicles.after_scene()
        return env.gtd["vehicle_clearance"].clone()

    nearest = torch.full((8, 6), torch.inf)
    for i, j in combinations(range(6), 2):
        nearest[:, [i, j]] = torch.minimum(nearest[:, [i, j]], distances(pair, states[:, [i, j]]))
    assert torch.equal(distances(many, states), nearest)
    assert (nearest < 0.0).any()
    assert (nearest > 0.0).any()


def test_the_nearest_shape_can_belong_to_a_farther_ball() -> None:
    """Of a plate of 0.4 x 0.4 x 0.04 m, plates 0.55 m and 0.6 m beside it are 0.15 m and 0.2 m away; one 0.5 m above it
    0.46 m. Flags of a touch hold for one step."""
    plate = replace(ROBOTS.get("base_quadrotor"), collision=CollisionCfg(boxes=(BoxCfg(size=(0.4, 0.4, 0.04)),)))
    env = build([{"name": plate, "kind": "plate", "count": 4}])
    env.reset()
    places = torch.tensor([[0.0, 0.0, 0.0], [0.01, 0.1, 0.5], [0.55, 0.0, 0.0], [-0.6, 0.0, 0.0]])
    for above, distances, touches in (
        (0.5, [0.15, 0.46, 0.15, 0.2], []),
        (0.02, [-0.02, -0.02, 0.14, 0.2], [0, 1]),
        (0.5, [0.15, 0.46, 0.15, 0.2], []),
    ):
        places[1, 2] = above
        env.gtd["robot_position"][:] = places
        env.gtd["robot_orientation"][:] = torch.tensor([0.0, 0.0, 0.0, 1.0])
        for key in ("robot_linvel", "robot_body_angvel"):
            env.gtd[key].zero_()
        env.step(torch.zeros(E, 4, 4))
        torch.testing.assert_close(env.gtd["vehicle_clearance"], torch.tensor([distances] * E), atol=2e-3, rtol=0.0)
        assert env.gtd["vehicle_collisions"].tolist() == [[v in touches for v in range(4)]] * E


def test_a_reset_clears_the_collisions_of_the_last_episode() -> None:
    env = build(ONE_KIND)
    env.reset()
    env.gtd.plain("vehicle_collisions").fill_(True)
    env.reset(torch.tensor([[True] + [False] * (V - 1)] * E))
    assert not env.gtd["vehicle_collisions"][:, 0].any()
    assert env.gtd["vehicle_collisions"][:, 1:].all()


def test_vehicles_without_shapes_pass_through_each_other() -> None:
    bodiless = replace(ROBOTS.get("base_quadrotor"), collision=CollisionCfg())
    env = build([{"name": bodiless, "kind": "bodiless", "count": 2}])
    env.reset()
    env.step(torch.zeros(E, 2, 4))
    assert torch.isinf(env.gtd["vehicle_clearance"]).all()
    assert not env.gtd["crashes"].any()


def test_vehicles_of_two_kinds_collide() -> None:
    """A box of 0.2 m edge and a ball of 0.1 m are 0.05 m apart at 0.25 m; at 0.19 m they overlap by 0.01 m."""
    half = 0.1
    box = replace(ROBOTS.get("base_quadrotor"), collision=CollisionCfg(boxes=(BoxCfg(size=(2.0 * half,) * 3),)))
    boxes = {"name": box, "kind": "box", "count": 1}
    env = build([boxes, {"name": ball(0.1), "kind": "ball", "count": 1}])
    env.reset()
    for x, crash in ((half + 0.15, False), (half + 0.09, True)):
        for name, group in env.kinds.items():
            group.gtd["robot_position"][:] = torch.tensor([x if name == "ball" else 0.0, 0.0, 0.0])
            group.gtd["robot_orientation"][:] = torch.tensor([0.0, 0.0, 0.0, 1.0])
            for key in ("robot_linvel", "robot_body_angvel"):
                group.gtd[key].zero_()
        env.step({name: torch.zeros(E, 1, 4) for name in env.kinds})
        for group in env.kinds.values():
            assert group.gtd["crashes"].all() == crash
            expected = torch.full((E, 1), x - half - 0.1)
            torch.testing.assert_close(group.gtd["vehicle_clearance"], expected, atol=2e-3, rtol=0.0)


def test_a_vehicle_at_nan_leaves_the_others_alone() -> None:
    env = build(ONE_KIND)
    env.reset()
    env.gtd["robot_position"][:, 0] = torch.nan
    env.step(torch.zeros(E, V, 4))
    assert env.gtd["crashes"].tolist() == [[True, *[False] * (V - 1)]] * E
    env.reset(env.episode_ends())
    assert torch.isfinite(env.gtd["robot_position"]).all()


def test_the_end_of_one_vehicle_can_end_all() -> None:
    env = build(ONE_KIND, env_name=replace(WIDE, reset_together=True))
    env.reset()
    env.gtd["truncations"][1, 3] = True
    assert env.episode_ends().tolist() == [False, True, False]
    env.reset(env.episode_ends())
    assert env.gtd["episodes"].tolist() == [[0] * V, [1] * V, [0] * V]
    with pytest.raises(ConfigError, match=r"reset_together is true .* Give a mask \(E,\)"):
        env.reset(torch.ones(E, V, dtype=torch.bool))


def test_tasks_of_several_kinds_are_refused() -> None:
    with pytest.raises(CapabilityError, match="task: its rows are vehicles of one kind; here are .*, tilted_hexarotor"):
        Task(task_registry.get("position_setpoint_task"), build(TWO_KINDS))


def test_views_are_guarded_and_writes_act() -> None:
    env = build(ONE_KIND, randomize={})
    drag = build([{"name": "base_quadrotor_with_drag", "count": V}])
    env.reset()
    with pytest.raises(OwnershipError, match="'robot_mass' is read-only"):
        env.gtd["robot_mass"][0] = 1.0
    drag.reset()
    drag.gtd["robot_linvel"][:] = torch.tensor([5.0, 0.0, 0.0])
    key = next(key for key in drag.gtd if key.startswith("effect_"))
    drag.gtd[key][:, 1] = 0.0
    drag.step(torch.zeros(E, V, 4))
    speed = drag.gtd["robot_linvel"][..., 0]
    assert (speed[:, 1] != speed[:, 0]).all()


@pytest.mark.parametrize("kinds", [ONE_KIND, TWO_KINDS])
def test_a_saved_state_goes_on_bit_for_bit(kinds: list[dict[str, Any]]) -> None:
    cfg = replace(CLOSE, reset_together=True)
    env, other = (build(kinds, env_name=cfg, randomize=DRAWN | AIR, seed=seed) for seed in (5, 6))

    def fly(flown: EnvManager, steps: int) -> dict[str, Tensor]:
        for step in range(steps):
            given = {n: actions(torch.full((E, g.kind.count), float(step))) for n, g in flown.kinds.items()}
            flown.step(given if len(kinds) > 1 else given[QUAD])
            flown.reset(flown.episode_ends())
        return {f"{n}.{k}": v.clone() for n, g in flown.kinds.items() for k, v in g.bodies.items()}

    env.reset()
    fly(env, 3)
    state = env.save_state()
    expected = fly(env, 3)
    other.reset()
    other.load_state(state)
    assert_same(fly(other, 3), expected)


def test_an_environment_file_can_hold_the_vehicles(tmp_path: Path) -> None:
    text = (Path(__file__).parents[3] / "aerial_gym/config/environments/empty_env.yaml").read_text(encoding="utf-8")
    file = tmp_path / "two.yaml"
    file.write_text(f"{text}\nrobots: [{{name: base_quadrotor, count: 2}}]\nvehicle_clearance: 0.2\n", encoding="utf-8")
    env = build(env_name=file)
    env.reset()
    assert env.gtd["robot_position"].shape == (E, 2, 3)
    with pytest.raises(ConfigError, match="give either robot_name, or robots"):
        build(env_name=file, robot_name=QUAD)
    with pytest.raises(ConfigError, match="env of task position_setpoint_task: it has robots. Leave them out"):
        task_registry.make_task("position_setpoint_task", num_envs=2, device="cpu", env=str(file))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"robots": [{"name": "snakey", "count": 2}]}, "collision shapes on links"),
        ({"robots": ONE_KIND, "differentiable": True, "backend": "torch"}, "differentiable=True: one vehicle"),
        ({"robots": ONE_KIND, "firmware": "betaflight"}, "firmware = 'betaflight': one vehicle"),
        ({"robots": [*ONE_KIND, *ONE_KIND]}, "two kinds are called 'base_quadrotor_with_imu'"),
        ({"robots": ONE_KIND, "randomize": AIR}, "share its gusts, .* reset_together: true"),
        ({"robots": [QUAD, QUAD]}, "robots, entry 1: found 'base_quadrotor_with_imu', expected {name: "),
        ({"robots": [{"name": QUAD, "number": 2}]}, "robots, entry 1: unknown field 'number'"),
        ({"robots": [{"name": QUAD, "count": 0}]}, "robots, entry 1.*count"),
        (
            {"robots": ONE_KIND, "randomize": CORRELATED},
            "the air belongs to an environment and the rest to its vehicles",
        ),
        ({"robots": ONE_KIND, "controller_name": None}, "robots, entry 1: give a controller"),
        ({}, "give either robot_name, or robots"),
        (
            {"robots": ONE_KIND, "env_name": replace(CLOSE, contact=ContactCfg(friction=0.5))},
            "obstacles push one vehicle",
        ),
    ],
)
def test_what_several_vehicles_cannot_have_is_refused_by_name(options: dict[str, Any], words: str) -> None:
    with pytest.raises(AerialGymError, match=words):
        build(**options)


def test_actions_are_checked() -> None:
    env = build(TWO_KINDS)
    env.reset()
    with pytest.raises(ShapeError, match=f"give a mapping with those of {QUAD}, tilted_hexarotor"):
        env.step(torch.zeros(E, 3, 4))
    with pytest.raises(ShapeError, match="each .* no others"):
        env.step({QUAD: torch.zeros(E, 2, 4)})
    with pytest.raises(ShapeError, match=r"expected \(E, V, U\) = \(3, 1, 4\)"):
        env.step({QUAD: torch.zeros(E, 2, 4), "tilted_hexarotor": torch.zeros(E, 4)})


def test_kinds_can_have_controllers_of_their_own() -> None:
    law = CONTROLLERS.get("lee_position_control")
    robots = [{"name": QUAD, "count": 2}, {"name": QUAD, "kind": "other", "count": 1, "controller": law}]
    env = build(robots)
    assert env.kinds["other"].kind.controller is law
    assert env.kinds[QUAD].kind.controller is CONTROLLERS.get("lee_velocity_control")
