"""What vehicles of an environment know of each other by their network, in closed form, and whether they see each other."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import Tensor

from aerial_gym import ENVIRONMENTS, ROBOTS, EnvManager, SimBuilder
from aerial_gym.config.environment import AssetCfg, ShapeCfg
from aerial_gym.config.vehicles import NetworkCfg
from aerial_gym.errors import ConfigError
from aerial_gym.math.quaternion import quat_from_euler, quat_rotate_inverse
from tests.unit.env_manager.test_batch_independence import assert_same

E, V = 3, 4
EMPTY = ENVIRONMENTS.get("empty_env")
KEYS = ("range", "bearing", "velocity", "age", "in_sight")
NEIGHBOURS = torch.tensor([[j for j in range(V) if j != i] for i in range(V)])


def build(*counts: int, env: Any = EMPTY, network: NetworkCfg | None = None, **options: Any) -> EnvManager:
    names = ("base_quadrotor", "tilted_hexarotor")
    robots = [{"name": name, "count": count} for name, count in zip(names, counts or (V,), strict=False)]
    given = {"sim_name": "base_sim", "controller_name": "no_control", "num_envs": E, "device": "cpu", "seed": 7}
    return SimBuilder().build_env(
        **given | options, env_name=replace(env, network=network or NetworkCfg()), robots=robots
    )


def step(env: EnvManager) -> None:
    zero = {name: torch.zeros(env.num_envs, g.kind.count, g.robot_manager.num_actions) for name, g in env.kinds.items()}
    env.step(zero if len(zero) > 1 else next(iter(zero.values())))


def reception(env: EnvManager, kind: str = "base_quadrotor") -> dict[str, Tensor]:
    return {key: env.kinds[kind].gtd[f"neighbour_{key}"].clone() for key in KEYS}


def positions(env: EnvManager) -> tuple[Tensor, Tensor]:
    """Return positions and velocities of all vehicles of one kind, (E, V, 3) each."""
    return env.gtd["robot_position"].clone(), env.gtd["robot_linvel"].clone()


def expect(env: EnvManager, place: Tensor, velocity: Tensor) -> dict[str, Tensor]:
    """Return range, bearing and velocity of the others in states (E, V, 3), as each vehicle is now."""
    own, attitude = positions(env), env.gtd["robot_orientation"].unsqueeze(2).expand(-1, -1, V - 1, -1)
    away, speed = (x[:, NEIGHBOURS] - y.unsqueeze(2) for x, y in zip((place, velocity), own, strict=True))
    distance = away.norm(dim=-1)
    return {
        "range": distance,
        "bearing": quat_rotate_inverse(attitude, away / distance.unsqueeze(-1)),
        "velocity": quat_rotate_inverse(attitude, speed),
    }


def assert_known(env: EnvManager, place: Tensor, velocity: Tensor) -> None:
    result = reception(env)
    for key, expected in expect(env, place, velocity).items():
        torch.testing.assert_close(result[key], expected, atol=2e-5, rtol=2e-5, msg=key)


def shake(env: EnvManager, seed: int) -> None:
    """Give all vehicles of the first kind drawn attitudes and velocities."""
    draw = torch.Generator().manual_seed(seed)
    env.gtd["robot_orientation"][:] = quat_from_euler(2.0 * torch.rand(E, V, 3, generator=draw) - 1.0)
    env.gtd["robot_linvel"][:] = 6.0 * torch.rand(E, V, 3, generator=draw) - 3.0


def test_range_bearing_and_velocity_are_those_of_the_states() -> None:
    """At the start and after each step, in the own body frame; a vehicle dead ahead is at bearing (1, 0, 0)."""
    env = build()
    env.reset()
    assert env.gtd["neighbour_bearing"].shape == (E, V, V - 1, 3)
    assert env.kinds["base_quadrotor"].bodies["neighbour_range"].shape == (E * V, V - 1)
    assert_known(env, *positions(env))
    for seed in range(3):
        shake(env, seed)
        step(env)
        assert_known(env, *positions(env))
        assert (reception(env)["age"] == 0.0).all()
        assert reception(env)["in_sight"].all()
    env.gtd["robot_position"][:] = torch.arange(float(V)).view(1, V, 1) * torch.tensor([2.0, 0.0, 0.0])
    env.gtd["robot_orientation"][:] = torch.tensor([0.0, 0.0, 0.0, 1.0])
    for key in ("robot_linvel", "robot_body_angvel"):
        env.gtd[key].zero_()
    step(env)
    ahead = torch.where(torch.arange(V).unsqueeze(1) < NEIGHBOURS, 1.0, -1.0)
    torch.testing.assert_close(reception(env)["bearing"][..., 0], ahead.expand(E, V, V - 1), atol=1e-5, rtol=0.0)


@pytest.mark.parametrize("steps", [1, 3])
def test_a_message_is_late_by_its_latency(steps: int) -> None:
    """Until so many steps have passed a vehicle knows the state at the start; its own state is always that of now."""
    env = build(network=NetworkCfg(latency_s=0.01 * steps + 0.002), sim_name="base_sim")
    latency = round((0.01 * steps + 0.002) / env.dt)
    assert latency == steps
    env.reset()
    past = [positions(env)]
    for number in range(1, 7):
        shake(env, number)
        step(env)
        past.append(positions(env))
        late = min(latency, number)
        assert_known(env, *past[number - late])
        torch.testing.assert_close(reception(env)["age"], torch.full((E, V, V - 1), late * env.dt))


def test_messages_are_lost_at_their_rate_and_the_last_one_is_kept() -> None:
    """Of 36 x 300 messages a share of 0.3 ± 5 standard deviations is lost; losses of pairs and steps are independent."""
    rate, count = 0.3, 300
    env = build(network=NetworkCfg(dropout=rate))
    env.reset()
    last, losses = positions(env), []
    held_place, held_velocity = (x[:, NEIGHBOURS] for x in last)
    for number in range(count):
        shake(env, number)
        step(env)
        env.gtd["crashes"].zero_()
        lost = reception(env)["age"] > 0.0
        place, velocity = (x[:, NEIGHBOURS] for x in positions(env))
        held_place = torch.where(lost.unsqueeze(-1), held_place, place)
        held_velocity = torch.where(lost.unsqueeze(-1), held_velocity, velocity)
        away = held_place - env.gtd["robot_position"].unsqueeze(2)
        torch.testing.assert_close(reception(env)["range"], away.norm(dim=-1), atol=2e-5, rtol=2e-5)
        losses.append(lost)
    lost = torch.stack(losses).float()
    total = lost.numel()
    assert abs(lost.mean() - rate) < 5.0 * (rate * (1.0 - rate) / total) ** 0.5
    deviation = rate * (1.0 - rate)
    both_ways = (lost[:, :, 0, 0] - rate) * (lost[:, :, 1, 0] - rate)  # from 1 to 0, and from 0 to 1
    in_a_row = (lost[1:] - rate) * (lost[:-1] - rate)
    by_one = (lost[..., 0] - rate) * (lost[..., 1] - rate)  # to one vehicle, from two
    for product in (both_ways, in_a_row, by_one):
        assert product.mean().abs() < 5.0 * deviation / product.numel() ** 0.5


def test_the_age_counts_the_steps_since_the_last_message() -> None:
    env = build(network=NetworkCfg(dropout=0.5))
    env.reset()
    ages = torch.zeros(E, V, V - 1)
    for _ in range(30):
        step(env)
        result = reception(env)["age"]
        torch.testing.assert_close(result, torch.where(result == 0.0, 0.0, ages + env.dt))
        ages = result
    assert (ages > env.dt).any()


WALL = AssetCfg(
    name="wall", count=1, keep=True, shapes=(ShapeCfg(kind="box", size=(0.2, 2.0, 2.0)),),
    position_ratio_low=(0.5, 0.5, 0.5), position_ratio_high=(0.5, 0.5, 0.5),
)  # fmt: skip
BEHIND = replace(EMPTY, assets=(WALL,))


def line_up(env: EnvManager, ends: Sequence[Sequence[float]]) -> None:
    """Put two vehicles at rest at two ends."""
    for v, end in enumerate(ends):
        env.gtd["robot_position"][:, v] = torch.tensor(end)
    for key in ("robot_linvel", "robot_body_angvel"):
        env.gtd[key].zero_()
    step(env)


def test_a_wall_blocks_the_line_of_sight() -> None:
    """A ray swept over the edge of a wall of 1 m half width: blocked below it, free above, and free on one side of it."""
    env = build(2, env=BEHIND)
    env.reset()
    for y in (0.0, 0.5, 0.95, 1.05, 1.5, -0.95, -1.05):
        line_up(env, [[-1.5, y, 0.0], [1.5, y, 0.0]])
        assert (reception(env)["in_sight"] == (abs(y) > 1.0)).all(), y
    line_up(env, [[-1.5, 0.95, 0.95], [1.5, 0.95, 0.95]])  # at a corner
    assert not reception(env)["in_sight"].any()
    line_up(env, [[0.5, 0.0, 0.0], [1.5, 0.0, 0.0]])
    assert reception(env)["in_sight"].all()
    line_up(env, [[-1.5, 0.0, 0.0], [1.5, 2.2, 0.0]])  # passes the wall's plane at y = 1.1 m
    assert reception(env)["in_sight"].all()


def test_the_ground_blocks_the_line_of_sight_of_vehicles_below_it() -> None:
    env = build(2, env=replace(EMPTY, ground_height=0.0))
    env.reset()
    line_up(env, [[-1.0, 0.0, 0.5], [1.0, 0.0, 0.5]])
    assert reception(env)["in_sight"].all()
    line_up(env, [[-1.0, 0.0, 0.5], [1.0, 0.0, -0.5]])
    assert not reception(env)["in_sight"].any()


def test_messages_need_a_line_of_sight_where_the_network_does() -> None:
    env = build(2, env=BEHIND, network=NetworkCfg(needs_line_of_sight=True))
    env.reset()
    line_up(env, [[-1.5, 1.2, 0.0], [1.5, 1.2, 0.0]])
    line_up(env, [[-1.5, 0.0, 0.0], [1.5, 0.0, 0.0]])
    torch.testing.assert_close(reception(env)["age"], torch.full((E, 2, 1), env.dt))
    torch.testing.assert_close(
        reception(env)["range"], torch.full((E, 2, 1), (9.0 + 1.2**2) ** 0.5), atol=2e-3, rtol=0.0
    )


def test_an_episode_begins_with_the_states_at_its_start() -> None:
    """Of the vehicle that starts and of those that know it; all others keep what they know, bit for bit."""
    env = build(network=NetworkCfg(dropout=0.5, latency_s=0.02))
    env.reset()
    for number in range(5):
        shake(env, number)
        step(env)
    before, mask = reception(env), torch.zeros(E, V, dtype=torch.bool)
    mask[1, 2] = True
    env.reset(mask)
    after, exact = reception(env), expect(env, *positions(env))
    fresh = mask.unsqueeze(2) | mask[:, NEIGHBOURS]
    for key in exact:
        torch.testing.assert_close(after[key][fresh], exact[key][fresh], atol=2e-5, rtol=2e-5)
        assert torch.equal(after[key][~fresh], before[key][~fresh])
    assert (after["age"][fresh] == 0.0).all()
    assert fresh.sum() == 2 * (V - 1)
    start = positions(env)
    step(env)
    away = (start[0][1, 2] - env.gtd["robot_position"][1, 0]).norm()
    torch.testing.assert_close(reception(env)["range"][1, 0, 1], away, atol=2e-5, rtol=2e-5)


def test_a_vehicle_at_nan_leaves_what_others_know_finite() -> None:
    env = build()
    env.reset()
    env.gtd["robot_position"][:, 0] = torch.nan
    for _ in range(2):
        step(env)
    result = reception(env)
    assert all(each[:, 1:].isfinite().all() for each in result.values())
    torch.testing.assert_close(result["age"][:, 1:, 0], torch.full((E, V - 1), 2.0 * env.dt))


def test_kinds_know_each_other_and_an_environment_knows_the_same_alone() -> None:
    """Two kinds with losses and latency: columns run over all kinds; environment 2 alone, and of three."""
    results = []
    for num_envs, first in ((E, 0), (1, 2)):
        env = build(
            2, 1, network=NetworkCfg(dropout=0.4, latency_s=0.01), num_envs=num_envs, first_env=first,
            env=ENVIRONMENTS.get("env_with_obstacles"),
        )  # fmt: skip
        env.reset()
        for number in range(6):
            step(env)
            if number == 2:
                env.reset(torch.arange(first, first + num_envs) == 2)
        tensors = {f"{kind}.{key}": each[-1] for kind in env.kinds for key, each in reception(env, kind).items()}
        assert tensors["tilted_hexarotor.range"].shape == (1, 2)
        results.append(tensors)
    assert_same(*results)


def test_a_saved_state_goes_on_bit_for_bit() -> None:
    env, other = (build(network=NetworkCfg(dropout=0.4, latency_s=0.02), seed=seed) for seed in (1, 2))
    env.reset()
    for _ in range(4):
        step(env)
    state = env.save_state()
    other.reset()
    other.load_state(state)
    for flown in (env, other):
        for _ in range(4):
            step(flown)
    assert_same(reception(env), reception(other))


def test_a_network_is_checked() -> None:
    for name, value in (("latency_s", -1.0), ("dropout", 1.0)):
        with pytest.raises(ConfigError, match=rf"NetworkCfg.{name} = "):
            NetworkCfg(**{name: value})
    assert "neighbour_range" not in SimBuilder().build_env(
        sim_name="base_sim", env_name=EMPTY, controller_name="no_control", num_envs=1, device="cpu",
        robots=[{"name": ROBOTS.get("base_quadrotor"), "count": 2}],
    ).gtd  # fmt: skip
