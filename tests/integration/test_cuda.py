"""What only a GPU can show: no wait for the host in a step, and a step that a CUDA graph can hold."""

from collections.abc import Callable
from dataclasses import replace

import pytest
import torch
import warp as wp

from aerial_gym import ENVIRONMENTS, ROBOTS, EnvManager, SimBuilder, task_registry
from aerial_gym.config.randomize import RandomizeCfg
from aerial_gym.config.vehicles import NetworkCfg
from aerial_gym.errors import CapabilityError
from aerial_gym.interop import on_torch_stream
from aerial_gym.interop.rows.transport import FEW
from aerial_gym.math.warp_functions import inverse_root, root, unit_quat
from aerial_gym.task import OBSERVATIONS, Task
from aerial_gym.task.terms.term import Term
from tests.builders import simulation
from tests.physics.vehicles import robot_with_memory
from tests.refusals import assert_refused
from tests.unit.interop.rows.test_function import check_transport
from tests.unit.robots.test_initial_state import check_derived, compute_states, motions
from tests.unit.task.hover import camera_task, rich
from tests.unit.task.test_navigation import make_cfg

pytestmark = pytest.mark.skipif(not torch.cuda.is_available(), reason="this machine has no CUDA GPU")


def obstacle_env() -> EnvManager:
    where = {"env": "env_with_obstacles", "num_envs": 64, "device": "cuda:0"}
    env = simulation("base_quadrotor_with_camera", "lee_velocity_control", **where)
    env.reset()
    return env


def assert_without_waits(act: Callable[[], None]) -> None:
    """Do something twice, the second time with an error where torch waits for the host."""
    act()
    torch.cuda.synchronize()
    torch.cuda.set_sync_debug_mode("error")
    try:
        act()
    finally:
        torch.cuda.set_sync_debug_mode("default")


def test_step_render_and_masked_reset_wait_for_nothing() -> None:
    env, actions = obstacle_env(), torch.zeros(64, 4, device="cuda:0")

    def act() -> None:
        env.step(actions)
        env.reset(env.gtd["crashes"] | env.gtd["truncations"])
        env.render()

    assert_without_waits(act)


def make_task(num_envs: int = 256, **options) -> Task:
    return task_registry.make_task("position_setpoint_task", num_envs=num_envs, device="cuda:0", seed=0, **options)


def test_a_captured_step_of_several_vehicles_is_the_eager_step() -> None:
    result = []
    for capture in (False, True):
        task = task_registry.make_task("formation_task", num_envs=64, device="cuda:0", seed=0, capture=capture)
        task.reset(seed=3)
        rows = torch.arange(task.num_envs, device="cuda:0").float().unsqueeze(-1)
        for step in range(60):
            actions = torch.sin(1.7 * rows + torch.arange(4.0, device="cuda:0") + 0.3 * step)
            obs, reward, terminated, truncated, info = task.step(actions)
        assert task.is_captured == capture
        row = {"reward": reward, "ended": terminated | truncated} | info | obs
        result.append({key: value.clone() for key, value in row.items()})
    for key, value in result[0].items():
        assert torch.equal(result[1][key], value), key


def test_what_cannot_be_captured_is_named(monkeypatch: pytest.MonkeyPatch) -> None:

    def waits(robot_position: torch.Tensor) -> torch.Tensor:
        return robot_position * robot_position.sum().item()

    term = Term(name="position_error_world", value=waits, width=3)
    monkeypatch.setitem(OBSERVATIONS._entries, "position_error_world", term)
    task = make_task()
    assert_refused(CapabilityError, "observation term 'position_error_world' cannot be held in a CUDA", task.reset)
    eager = make_task(capture=False)
    eager.reset()
    eager.step(torch.zeros(256, 4, device="cuda:0"))
    assert not eager.is_captured


def test_a_captured_navigation_step_is_the_eager_step() -> None:
    result = []
    for capture in (False, True):
        cfg = task_registry.get("navigation_task")
        limits = replace(cfg.curriculum, check_after=100, raise_above=0.0, lower_below=0.0)
        env = simulation(cfg.robot, cfg.controller, sim=cfg.sim, env=cfg.env, num_envs=64, device="cuda:0")
        noiseless = tuple(replace(entry, noise_std=0.0) for entry in cfg.observations["policy"])
        sizes = {"episode_len_steps": 10, "success_radius": 11.0, "observations": {"policy": noiseless}}
        cfg = make_cfg(cfg, curriculum=limits, **sizes)
        task = Task(cfg, env, capture=capture)
        task.reset(seed=3)
        g = torch.Generator(device="cuda:0").manual_seed(1)
        levels = []
        for _ in range(25):
            obs, reward, *_ = task.step(2.0 * torch.rand(64, 4, device="cuda:0", generator=g) - 1.0)
            levels.append(int(env.gtd["curriculum_level"]))
        result.append((obs["observations"].clone(), reward.clone(), levels, task.target_position.clone()))
        assert task.is_captured == capture
    torch.testing.assert_close(result[1][3], result[0][3])
    torch.testing.assert_close(result[1][1], result[0][1], rtol=1e-3, atol=1e-2)
    close = (result[1][0] - result[0][0]).abs() < 1e-3
    assert close.float().mean() > 0.999  # a pixel at an edge may see the one or the other side
    assert result[1][2] == result[0][2]
    assert result[0][2][-1] > result[0][2][0]


@pytest.mark.parametrize("maker", [rich, camera_task])
def test_a_captured_step_with_all_that_a_task_remembers_is_the_eager_step(maker: Callable[..., Task]) -> None:
    result = []
    for capture in (False, True):
        task = maker(64, seed=3, device="cuda:0", capture=capture)
        task.reset(seed=3)
        number = torch.arange(64, device="cuda:0")
        for step in range(12):
            task.env.gtd["sim_steps"].masked_fill_((number + step) % 4 == 0, task.cfg.episode_len_steps)
            actions = 0.3 * torch.sin(number.float().unsqueeze(-1) + step + torch.arange(4.0, device="cuda:0"))
            obs, reward, terminated, _, info = task.step(actions)
        assert task.is_captured == capture
        row = {"reward": reward, "ended": terminated} | info | obs
        row |= {key: torch.tensor(value) for key, value in task.episode_means().items()}
        result.append({key: value.clone().float() for key, value in row.items()})
    for key, value in result[0].items():
        close = (result[1][key] - value).abs() <= 1e-2 + 1e-3 * value.abs()
        assert close.float().mean() > 0.995, key  # a pixel at an edge may see the one or the other side


def replay_from_start(env: EnvManager, step: Callable[[], None], steps: int, *, capture: bool) -> None:
    """Run a step several times from the start with seed 5, as a recorded graph on request."""
    replay = step
    for _ in range(3):
        step()
    if capture:
        graph = torch.cuda.CUDAGraph()
        torch.cuda.synchronize()
        with torch.cuda.graph(graph):
            step()
        replay = graph.replay
    env.restart(5)
    env.reset()
    for _ in range(steps):
        replay()


def test_a_captured_step_with_effects_that_remember_is_the_eager_step() -> None:
    result = []
    for capture in (False, True):
        env = simulation(
            robot_with_memory(), "lee_velocity_control", num_envs=64, device=torch.device("cuda:0"), seed=5
        )
        env.reset()
        actions, mask = torch.zeros(64, 4, device="cuda:0"), torch.arange(64, device="cuda:0") % 3 == 0

        def step(env=env, actions=actions, mask=mask) -> None:
            env.step(actions)
            env.reset(mask & (env.gtd["sim_steps"] == 12))

        replay_from_start(env, step, 20, capture=capture)
        result.append(env.gtd["robot_linvel"].clone())
    torch.testing.assert_close(result[1], result[0], rtol=1e-4, atol=1e-4)


def test_a_captured_step_of_vehicles_that_sense_each_other_is_the_eager_step_and_waits_for_nothing() -> None:
    """Two kinds with cameras and a network: step, reset by mask, render; and a CPU draws the same images."""
    cfg = replace(ENVIRONMENTS.get("env_with_obstacles"), network=NetworkCfg(dropout=0.2, latency_s=0.02))
    kinds = [
        {"name": "base_quadrotor_with_coarse_camera", "kind": "camera", "count": 3},
        {"name": "base_quadrotor_with_lidar", "kind": "lidar", "count": 2},
    ]
    result = []
    for device, capture in (("cpu", False), ("cuda:0", False), ("cuda:0", True)):
        env = SimBuilder().build_env(
            sim_name="base_sim", env_name=cfg, controller_name="lee_velocity_control", robots=kinds, num_envs=4,
            device=device, seed=5,
        )  # fmt: skip
        env.reset()
        zero = {name: torch.zeros(4, group.kind.count, 4, device=device) for name, group in env.kinds.items()}
        mask = torch.arange(20, device=device).view(4, 5) % 3 == 0

        def step(env=env, zero=zero, mask=mask) -> None:
            env.step(zero)
            env.reset(mask & (env.kinds["camera"].gtd["sim_steps"][:, :1] == 3))
            env.render()

        if device != "cpu":
            assert_without_waits(step)
        replay_from_start(env, step, 6, capture=capture)
        result.append({
            f"{name}.{key}": value.cpu().clone() for name, group in env.kinds.items()
            for key, value in group.gtd.items() if key.startswith("neighbour_") or key.endswith("_pixels")
        })  # fmt: skip
    for key, value in result[1].items():
        assert torch.equal(result[2][key], value), key
        close = (result[0][key].float() - value.float()).abs() <= 1e-2 + 1e-3 * value.float().abs()
        assert close.float().mean() > 0.98, key  # a pixel at an edge may see the one or the other side


RANDOMIZE = {
    "body.mass": RandomizeCfg(low=0.8, high=1.2),
    "body.com": RandomizeCfg(how="offset", low=(-0.01, -0.01, 0.0), high=(0.01, 0.01, 0.0)),
    "rotor.thrust_map": RandomizeCfg(each_rotor=True, distribution="normal", mean=1.0, std=0.03, low=0.9, high=1.1),
    "rotor.time_constant": RandomizeCfg(low=0.8, high=1.2, each_rotor=True),
    "effects.rotor_drag.dx": RandomizeCfg(how="value", distribution="log_uniform", low=0.05, high=0.2),
    "effects.gusts.std": RandomizeCfg(how="value", low=0.5, high=1.0),
    "effects.imu_bias.az": RandomizeCfg(how="value", low=-1.0, high=1.0),
    "effects.imu_misalignment.roll": RandomizeCfg(how="value", low=-0.1, high=0.1),
    "gains.position": RandomizeCfg(low=0.9, high=1.1),
}


def make_random_task(num_envs: int, *, capture: bool, **numbers: int) -> Task:
    cfg = replace(task_registry.get("position_setpoint_task"), num_envs=num_envs, randomize=RANDOMIZE)
    options = {"num_envs": num_envs, "device": "cuda:0", "seed": 3, "randomize": RANDOMIZE, **numbers}
    env = simulation("base_quadrotor_with_imu", cfg.controller, sim=cfg.sim, env=cfg.env, **options)
    return Task(cfg, env, capture=capture)


def roll_out(task: Task, first: int = 0, steps: int = 12) -> list[dict[str, torch.Tensor]]:
    """Return the task's outputs and random draws of each step; episodes of some environments end on the way."""
    task.reset(seed=3)
    number = torch.arange(first, first + task.num_envs, device="cuda:0")
    actions = torch.sin(number.float().unsqueeze(-1) + torch.arange(4.0, device="cuda:0")).clamp(-0.5, 0.5)
    result = []
    for step in range(steps):
        task.env.gtd["sim_steps"].masked_fill_((number + step) % 3 == 0, task.cfg.episode_len_steps)
        obs, reward, *_ = task.step(actions)
        keys = ("robot_position", "robot_linvel", "robot_mass", "drawn_parameters", "episodes", "rotor_speed")
        keys += ("robot_imu_errors",)
        row = {"observations": obs["observations"], "reward": reward} | {key: task.env.gtd[key] for key in keys}
        result.append({key: value.clone() for key, value in row.items()})
    return result


def test_a_captured_step_of_a_randomised_robot_is_the_eager_step() -> None:
    eager, captured = (roll_out(make_random_task(64, capture=capture)) for capture in (False, True))
    for a, b in zip(eager, captured, strict=True):
        assert torch.equal(a["drawn_parameters"], b["drawn_parameters"])
        assert torch.equal(a["episodes"], b["episodes"])
        for key in a:
            torch.testing.assert_close(b[key], a[key], rtol=1e-3, atol=1e-3, msg=key)
    assert (captured[-1]["drawn_parameters"] != captured[0]["drawn_parameters"]).any()


@pytest.mark.parametrize("capture", [False, True])
def test_an_environment_is_the_same_among_few_many_and_alone_on_a_gpu(capture: bool) -> None:
    few, many = (roll_out(make_random_task(n, capture=capture)) for n in (4, 8192))
    alone = roll_out(make_random_task(1, capture=capture, first_env=2), 2)
    for a, b, c in zip(few, many, alone, strict=True):
        for key in a:
            assert torch.equal(a[key], b[key][:4]), key
            assert torch.equal(c[key], b[key][2:3]), key


def test_a_masked_reset_of_a_randomised_robot_waits_for_nothing() -> None:
    env = make_random_task(64, capture=False).env
    env.reset()
    actions, mask = torch.zeros(64, 4, device="cuda:0"), torch.arange(64, device="cuda:0") % 3 == 0

    def act() -> None:
        env.step(actions)
        env.reset(mask)

    assert_without_waits(act)


@pytest.mark.parametrize("num_rows", [1, 33, 65, FEW - 1, FEW, FEW + 33])
def test_rows_arrive_as_they_are_on_a_gpu(num_rows: int) -> None:
    check_transport(num_rows, "cuda:0")
    check_derived(num_rows, "cuda:0")


def test_derived_states_are_the_same_among_few_and_many_on_a_gpu() -> None:
    """Bit for bit: how a row comes to memory changes none of its numbers."""
    many = compute_states(motions(65_536, "cuda:0"), beside=1)
    for num_envs in (3, 33, FEW):
        few = compute_states(motions(num_envs, "cuda:0"), beside=1)
        assert all(torch.equal(few[name], many[name][:num_envs]) for name in many)


@wp.kernel(enable_backward=False)
def take_roots(
    x: wp.array[float], q: wp.array[wp.quat], root_out: wp.array[float], inverse_out: wp.array[float],
    unit_out: wp.array[wp.quat],
):  # fmt: skip
    i = wp.tid()
    root_out[i] = root(x[i])
    inverse_out[i] = inverse_root(x[i])
    unit_out[i] = unit_quat(q[i])


def test_roots_are_as_near_as_they_say() -> None:
    """Over 60 decades, relative to float64; the root of zero is zero; quaternions without a direction are NaN, as in torch."""
    x = torch.logspace(-30.0, 30.0, 1 << 20, device="cuda:0")
    q = torch.randn(len(x), 4, device="cuda:0")
    x[0], q[0], q[1] = 0.0, 0.0, torch.nan
    roots, inverses, units = torch.empty_like(x), torch.empty_like(x), torch.empty_like(q)
    with on_torch_stream(x):
        views = [wp.from_torch(x), wp.from_torch(q, dtype=wp.quat), wp.from_torch(roots), wp.from_torch(inverses)]
        wp.launch(take_roots, dim=len(x), inputs=views, outputs=[wp.from_torch(units, dtype=wp.quat)], device="cuda:0")
    assert roots[0] == 0.0
    assert units[:2].isnan().all()
    exact = x[1:].double().sqrt()
    torch.testing.assert_close(roots[1:].double(), exact, rtol=2.4e-7, atol=0.0)
    torch.testing.assert_close(inverses[1:].double(), 1.0 / exact, rtol=2.4e-7, atol=0.0)
    assert float((units[2:].double().norm(dim=-1) - 1.0).abs().max()) < 5e-7


@pytest.mark.parametrize("capture", [False, True])
def test_a_written_payload_acts_in_the_next_step_of_a_task(capture: bool) -> None:
    """Environment 1 carries a fifth of the mass more from the fourth step on, and sinks."""
    cfg = replace(task_registry.get("position_setpoint_task"), num_envs=2)
    robot = replace(ROBOTS.get(cfg.robot), effects={"payload_mass": {"dm": 0.0}}, effects_source="test")
    env = simulation(robot, cfg.controller, sim=cfg.sim, env=cfg.env, device="cuda:0")
    task = Task(cfg, env, capture=capture)
    task.reset(seed=0)
    actions = torch.zeros(2, task.num_actions, device="cuda:0")
    for _ in range(3):
        task.step(actions)
    mass, speed = env.gtd["robot_mass"].clone(), env.gtd["robot_linvel"][:, 2].clone()
    env.gtd["effect_payload_mass"][1] = 0.2 * float(mass[0])
    for _ in range(5):
        task.step(actions)
    assert task.is_captured is capture
    torch.testing.assert_close(env.gtd["robot_mass"], mass * torch.tensor([1.0, 1.2], device="cuda:0"))
    sinks = env.gtd["robot_linvel"][:, 2] - speed
    assert float(sinks[1]) < float(sinks[0]) - 0.02
