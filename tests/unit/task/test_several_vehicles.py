"""Tasks of several vehicles: rows, shared ends and rewards, neighbours, collisions."""

from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import Tensor

from aerial_gym import ENVIRONMENTS, SimBuilder, Task, task_registry
from aerial_gym.config.task_terms import ImageCfg, ObservationCfg, TerminationCfg
from aerial_gym.config.vehicles import NetworkCfg
from aerial_gym.errors import ConfigError
from aerial_gym.math.quaternion import quat_rotate_inverse
from aerial_gym.task.step.row_kernels import StepKernel
from tests.unit.task.hover import begin

E, V = 3, 4
WIDE = replace(
    ENVIRONMENTS.get("empty_env"), bounds_lower_low=(-500.0,) * 3, bounds_lower_high=(-500.0,) * 3,
    bounds_upper_low=(500.0,) * 3, bounds_upper_high=(500.0,) * 3,
)  # fmt: skip
FORMATION = task_registry.get("formation_task")
ROWS = 3  # Vehicles of the formation task


def far_apart(num_envs: int, num_vehicles: int) -> Task:
    """Return the position task in a wide space, where most episodes end by their distance from the target."""
    cfg = replace(task_registry.get("position_setpoint_task"), episode_len_steps=12, num_vehicles=num_vehicles)
    far = {"far_away": TerminationCfg(term="far_from_target", kind="crash", params={"distance": 500.0})}
    noisy = replace(cfg.observations["policy"][0], noise_std=0.1, delay_steps=(0, 3))
    cfg = replace(cfg, env=WIDE, terminations=far, observations={"policy": (noisy, *cfg.observations["policy"][1:])})
    robots: list[dict[str, Any]] = [{"name": cfg.robot, "count": num_vehicles}]
    given: dict[str, Any] = {"robots": robots} if num_vehicles > 1 else {"robot_name": cfg.robot}
    env = SimBuilder().build_env(
        sim_name=cfg.sim,
        env_name=WIDE,
        **given,
        controller_name=cfg.controller,
        num_envs=num_envs,
        device="cpu",
        seed=3,
    )
    return Task(cfg, env)


def actions(task: Task, step: int, first_row: int = 0) -> Tensor:
    rows = torch.arange(first_row, first_row + task.num_envs)
    return torch.sin(1.7 * rows.unsqueeze(-1) + torch.arange(4.0) + 0.3 * step)


def fly(task: Task, steps: int, first_row: int = 0) -> list[dict[str, Tensor]]:
    """Return observations, rewards, ends and numbers of each step."""
    observation, _ = task.reset()
    results = [dict(observation)]
    for step in range(steps):
        observation, reward, terminated, truncated, info = task.step(actions(task, step, first_row))
        flags = {"reward": reward, "terminated": terminated, "truncated": truncated}
        results.append({key: value.clone() for key, value in (observation | flags | info).items()})
    return results


def assert_equal(one: list[dict[str, Tensor]], other: list[dict[str, Tensor]], rows: slice = slice(None)) -> None:
    for step, (a, b) in enumerate(zip(one, other, strict=True)):
        different = [key for key in a if key in b and not torch.equal(a[key], b[key][rows])]
        assert not different, f"step {step}"


def test_vehicles_far_apart_are_single_vehicles_bit_for_bit() -> None:
    several, single = fly(far_apart(E, V), 30), fly(far_apart(E * V, 1), 30)
    assert sum(int(each["truncated"].sum()) for each in single[1:]) > E * V  # of ends by the length of the episode
    assert any(each["terminated"].any() for each in single[1:])
    assert_equal(single, several)


@pytest.mark.slow
@pytest.mark.usefixtures("optimise_kernels")
def test_an_environment_alone_equals_that_of_many() -> None:
    many = begin("formation_task", 4, seed=1)
    alone = begin("formation_task", 1, seed=1, first_env=2)
    rows = slice(2 * ROWS, 3 * ROWS)
    assert_equal(fly(alone, 60, first_row=2 * ROWS), fly(many, 60), rows)


def formation(num_envs: int = 3, **changes: Any) -> Task:
    cfg = replace(FORMATION, **changes)
    return Task(cfg, begin("formation_task", num_envs).env)


def own_rewards(task: Task) -> Tensor:
    return task.values.own["own_rewards"].sum(-1)


def test_vehicles_share_the_mean_reward() -> None:
    task = formation(crash_reward=None, share_reward=True)
    task.reset()
    for step in range(5):
        _, reward, *_ = task.step(actions(task, step))
        by_env = reward.view(-1, ROWS)
        assert torch.equal(by_env, by_env[:, :1].expand_as(by_env))
        torch.testing.assert_close(by_env[:, 0], own_rewards(task).view(-1, ROWS).mean(1), rtol=0.0, atol=1e-6)
    assert own_rewards(task).unique().numel() == task.num_envs
    selfish = formation(crash_reward=None)
    selfish.reset()
    _, reward, *_ = selfish.step(actions(selfish, 0))
    torch.testing.assert_close(reward, own_rewards(selfish), rtol=0.0, atol=1e-6)


def test_a_reward_is_shared_only_where_episodes_end_together() -> None:
    with pytest.raises(ConfigError, match="share_reward needs an environment with reset_together: true"):
        task_registry.make_task("position_setpoint_task", device="cpu", settings=["task.share_reward=true"])


def test_a_touch_ends_the_episode_of_all_and_counts_as_a_collision() -> None:
    task = begin("formation_task", 3)
    bodies, state = task.env.rows.bodies, task.env.robot_manager.tensors.state
    state.position[4] = state.position[3] + torch.tensor([0.2, 0.0, 0.0])  # two of environment 1
    before = bodies["robot_position"].clone()
    _, reward, terminated, _, info = task.step(torch.zeros(9, 4))
    assert terminated.view(3, 3).tolist() == [[False] * 3, [True] * 3, [False] * 3]
    assert info["collisions"].nonzero().flatten().tolist() == [3, 4]
    assert info["crashes"].view(3, 3).any(1).tolist() == [False, True, False]
    assert (reward.view(3, 3)[1] < -9.0).all()
    assert bodies["episodes"].tolist() == [0, 0, 0, 1, 1, 1, 0, 0, 0]
    stay = [0, 1, 2, 6, 7, 8]
    assert (bodies["robot_position"] - before).norm(dim=-1)[stay].max() < 0.05
    assert bodies["sim_steps"].tolist() == [1, 1, 1, 0, 0, 0, 1, 1, 1]
    means = task.episode_means()
    assert (means["episodes"], means["ended/collision"], means["ended/contact"]) == (3.0, 1.0, 0.0)


@pytest.mark.parametrize(("vehicles", "successes"), [("", [False, True, False]), ("any", [True, True, False])])
def test_a_success_is_that_of_all_unless_any_is_enough(vehicles: str, successes: list[bool]) -> None:
    there = TerminationCfg(term="at_target", kind="success", params={"radius": 0.5}, vehicles=vehicles)
    task = formation(terminations={"there": there})
    task.reset()
    state = task.env.robot_manager.tensors.state
    for row in (0, 3, 4, 5):
        state.position[row] = task.target_position[row]
    *_, info = task.step(torch.zeros(9, 4))
    assert info["successes"].view(3, 3).tolist() == [[each] * 3 for each in successes]


def test_non_finite_numbers_of_one_vehicle_end_its_environment_alone(caplog: pytest.LogCaptureFixture) -> None:
    task = begin("formation_task", 2)
    given = torch.zeros(6, 4)
    given[1] = torch.nan
    _, reward, terminated, truncated, info = task.step(given)
    assert terminated.tolist() == [True, True, True, False, False, False]
    assert not truncated.any()
    assert info["non_finite"].tolist() == [False, True, False, False, False, False]
    assert reward.isfinite().all()
    assert "environment 0, vehicle 1, episode 0, step 1" in caplog.text


def test_vehicles_are_reset_one_by_one_where_they_do_not_end_together() -> None:
    task = far_apart(E, V)
    task.reset()
    bodies = task.env.rows.bodies
    position = task.env.robot_manager.tensors.state.position
    position[5] = torch.tensor([400.0, 400.0, 400.0])  # 693 m from the target
    before = position.clone()
    _, _, terminated, _, _ = task.step(torch.zeros(E * V, 4))
    assert terminated[5]
    assert bodies["episodes"].tolist() == terminated.int().tolist()
    assert (position[5] - before[5]).norm() > 1.0
    assert task.env.random.episode.tolist() == [0] * E  # those of the environments go on


def test_vehicles_that_end_together_do_so_at_unequal_ages() -> None:
    """The oldest one decides, and an adapter that sets ages gives all vehicles of an environment one age."""
    task = begin("formation_task", 3, seed=1)
    age = task.env.gtd["sim_steps"]
    age[1, 2] = task.cfg.episode_len_steps
    *_, terminated, truncated, info = task.step(torch.zeros(3 * ROWS, 4))
    ended = torch.arange(3).repeat_interleave(ROWS) == 1
    assert torch.equal(terminated | truncated, ended)
    assert torch.equal(info["timeouts"] | info["successes"], ended)
    task.set_ages(torch.arange(3 * ROWS))
    assert age.tolist() == [[first] * ROWS for first in (0, ROWS, 2 * ROWS)]


def test_the_tension_of_a_cable_is_that_of_the_own_vehicle() -> None:
    task = begin("team_payload_task", 2, seed=1)
    own, every = (task.values.find(name, "the test") for name in ("payload_tension", "all_payload_tension"))
    task.env.gtd["payload_tension"][:] = torch.arange(6.0).view(2, 3)
    task._around.refresh()
    assert own.tolist() == list(range(6))
    assert every[4].tolist() == [3.0, 4.0, 5.0]


def test_racers_start_apart() -> None:
    task = begin("race_of_four_task", 64, seed=1)
    place, (hull,) = task.env.gtd["robot_position"], task.env.vehicles.slots.hulls
    apart = torch.cdist(place, place) + torch.eye(4) * 1e3
    assert apart.min() - 2.0 * hull >= 0.1 - 1e-6


@pytest.mark.parametrize("task", ["position_setpoint_task", "race_of_four_task"])
def test_a_condition_for_several_vehicles_needs_several_that_end_together(task: str) -> None:
    given = "task.terminations.late={term: far_from_target, kind: crash, vehicles: any, params: {distance: 9.0}}"
    with pytest.raises(ConfigError, match="terminations.late.vehicles: needs several vehicles that end together"):
        task_registry.make_task(task, num_envs=1, device="cpu", settings=[given])


def test_neighbours_are_the_nearest_in_the_own_frame() -> None:
    several = replace(
        FORMATION, observations={"policy": (ObservationCfg(term="nearest_vehicles", params={"count": 2}),)}
    )
    task = Task(several, begin("formation_task", 4).env)
    task.reset()
    for step in range(8):
        observation, *_ = task.step(actions(task, step))
    bodies = task.env.rows.bodies
    position, velocity = (bodies[key].view(-1, ROWS, 3) for key in ("robot_position", "robot_linvel"))
    level = bodies["robot_vehicle_orientation"]
    for row in range(task.num_envs):
        env, own = divmod(row, ROWS)
        indices = [v for v in range(ROWS) if v != own]
        indices.sort(key=lambda v: float((position[env, v] - position[env, own]).norm()))
        for k, other in enumerate(indices):
            shown = observation["observations"][row, 7 * k : 7 * k + 7]
            for part, values in ((shown[:3], position), (shown[3:6], velocity)):
                expected = quat_rotate_inverse(
                    level[row : row + 1], (values[env, other] - values[env, own]).unsqueeze(0)
                )
                torch.testing.assert_close(part, expected[0], rtol=0.0, atol=1e-5)
            assert shown[6] == 1.0


def test_more_neighbours_than_vehicles_are_refused() -> None:
    wrong = {"policy": (ObservationCfg(term="nearest_vehicles", params={"count": 3}),)}
    with pytest.raises(ConfigError, match="count = 3: each vehicle has 2 others"):
        formation(observations=wrong)


def test_the_critic_sees_all_vehicles_of_its_environment() -> None:
    cfg = replace(
        FORMATION, observations=FORMATION.observations | {"all": (ObservationCfg(term="all_robot_position"),)}
    )
    task = Task(cfg, begin("formation_task", 2).env)
    observation, _ = task.reset()
    for step in range(3):
        observation, *_ = task.step(actions(task, step))
    position = task.env.rows.bodies["robot_position"].view(2, 1, 3 * ROWS).expand(-1, ROWS, -1).flatten(0, 1)
    assert torch.equal(observation["all"], position)


def test_tensors_of_environments_have_rows_of_vehicles() -> None:
    cfg = replace(FORMATION, observations={"policy": (ObservationCfg(term="obstacle_position"),)})
    task = Task(cfg, begin("formation_task", 2).env)
    observation, _ = task.reset()
    assert torch.equal(
        observation["observations"], task.env.gtd["obstacle_position"].flatten(1).repeat_interleave(ROWS, 0)
    )


def test_places_need_one_for_each_vehicle() -> None:
    with pytest.raises(ConfigError, match="3 starts and 3 targets: needs one of each for all 2 vehicles"):
        task_registry.make_task("formation_task", num_envs=2, device="cpu", settings=["task.num_vehicles=2"])


def test_starts_that_leave_a_payload_behind_are_refused() -> None:
    starts = ["task.command.params.starts=[[0,0,3],[1,0,3],[0,1,3]]"]
    with pytest.raises(ConfigError, match="starts would leave the payload behind"):
        task_registry.make_task("team_payload_task", num_envs=2, device="cpu", settings=starts)


def test_several_vehicles_refuse_a_curriculum_of_obstacles_that_stay() -> None:
    settings = ["task.num_vehicles=2"]
    with pytest.raises(ConfigError, match="its curriculum changes obstacles"):
        task_registry.make_task("lidar_navigation_task", num_envs=2, device="cpu", settings=settings)


def test_the_way_leads_through_the_door() -> None:
    task = begin("formation_task", 2)
    own, bodies = task.values.own, task.env.rows.bodies
    door = torch.tensor([0.0, 0.0, 1.5])
    position, target = bodies["robot_position"], task.target_position
    expected = (door - position).norm(dim=-1) + (target - door).norm(dim=-1)
    torch.testing.assert_close(own["way_to_target"], expected)
    task.env.robot_manager.tensors.state.position[:] = torch.tensor([1.0, 0.0, 1.0])
    task.step(torch.zeros(6, 4))
    assert not any(isinstance(part, StepKernel) and part.reason for part in task._judge.parts)


def test_a_saved_state_goes_on_bit_for_bit() -> None:
    task, other = begin("formation_task", 3, seed=4), begin("formation_task", 3, seed=5)
    for step in range(5):
        task.step(actions(task, step))
    other.load_state(task.save_state())
    for step in range(5, 10):
        for a, b in zip(task.step(actions(task, step))[:4], other.step(actions(other, step))[:4], strict=True):
            for key in a if isinstance(a, dict) else [None]:
                assert torch.equal(a if key is None else a[key], b if key is None else b[key])


def test_vehicles_observe_their_network_and_their_cameras() -> None:
    """The keys of the network are terms by their names; image frames of a vehicle that starts are those at its start."""
    keys = [f"neighbour_{name}" for name in ("range", "bearing", "velocity", "age", "in_sight")]
    cfg = replace(
        FORMATION, env=replace(ENVIRONMENTS.get(FORMATION.env), network=NetworkCfg(dropout=0.5)), episode_len_steps=7,
        observations={"policy": tuple(ObservationCfg(term=key) for key in keys)},
        images={"depth": ImageCfg(dtype="float32", history=2)},
    )  # fmt: skip
    env = SimBuilder().build_env(
        sim_name=cfg.sim, env_name=cfg.env, robots=[{"name": "base_quadrotor_with_coarse_camera", "count": ROWS}],
        controller_name=cfg.controller, num_envs=E, device="cpu", seed=3,
    )  # fmt: skip
    task = Task(cfg, env)
    task.reset()
    ends = 0
    for step in range(40):
        observation, _, terminated, truncated, _ = task.step(4.0 * actions(task, step).clamp(-0.25, 0.25))
        bodies = env.rows.bodies
        expected = torch.cat([bodies[key].flatten(1).float() for key in keys], dim=1)
        assert torch.equal(observation["observations"], expected)
        assert observation["depth"].shape == (E * ROWS, 2, 24, 40)
        begun = terminated | truncated
        ends += int(begun.sum())
        assert torch.equal(observation["depth"][begun, 0], observation["depth"][begun, 1])
    assert 0 < ends < 40 * E * ROWS
    assert (env.gtd["neighbour_age"] > 0.0).any()
