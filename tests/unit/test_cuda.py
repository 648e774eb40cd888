"""What only a GPU can show: no wait for the host in a step, and a step that a CUDA graph can hold."""

import pytest
import torch

from aerial_gym import SimBuilder, task_registry

pytestmark = pytest.mark.skipif(not torch.cuda.is_available(), reason="this machine has no CUDA GPU")


def obstacle_env(num_envs: int = 64):
    env = SimBuilder().build_env(
        sim_name="base_sim",
        env_name="env_with_obstacles",
        robot_name="base_quadrotor_with_camera",
        controller_name="lee_velocity_control",
        num_envs=num_envs,
        device="cuda:0",
        seed=0,
    )
    env.reset()
    return env


def test_step_render_and_masked_reset_wait_for_nothing() -> None:
    env, actions = obstacle_env(), torch.zeros(64, 4, device="cuda:0")
    env.step(actions)
    env.post_reward_calculation_step()
    torch.cuda.synchronize()
    torch.cuda.set_sync_debug_mode("error")
    try:
        env.step(actions)
        env.post_reward_calculation_step()
    finally:
        torch.cuda.set_sync_debug_mode("default")


def test_a_task_step_can_be_captured_and_its_randomness_advances() -> None:
    task = task_registry.make_task("position_setpoint_task", num_envs=256, device="cuda:0", seed=0)
    task.reset()
    actions = torch.zeros(256, 4, device="cuda:0")
    stream = torch.cuda.Stream()
    stream.wait_stream(torch.cuda.current_stream())
    with torch.cuda.stream(stream):
        for _ in range(3):
            task.step(actions)
    torch.cuda.current_stream().wait_stream(stream)
    graph = torch.cuda.CUDAGraph()
    graph.register_generator_state(task.env.generator)
    with torch.cuda.graph(graph):
        task.step(actions)
    task.env.gtd["sim_steps"].fill_(task.cfg.episode_len_steps - 1)
    graph.replay()
    first = task.env.gtd["robot_position"].clone()
    task.env.gtd["sim_steps"].fill_(task.cfg.episode_len_steps - 1)
    graph.replay()
    assert (first != task.env.gtd["robot_position"]).any(dim=-1).all()
