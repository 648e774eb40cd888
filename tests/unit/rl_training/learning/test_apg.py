"""Analytic policy gradients: their window return against loops, their gradient against differences, a short training.
A student learns what its teacher does, also from less than the teacher sees, and goes on from a checkpoint.
"""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import pytest
import torch
from torch import Tensor

from aerial_gym import Task, task_registry
from aerial_gym.config.randomize import RandomizeCfg
from aerial_gym.config.task_terms import ObservationCfg
from aerial_gym.errors import CapabilityError, ConfigError
from aerial_gym.rl_training import Policy, TrainingCfg, evaluate, load_settings, settings_for, train
from aerial_gym.rl_training.learning.apg import Apg, check_differentiable, window_return
from aerial_gym.rl_training.learning.distill import Distill
from aerial_gym.rl_training.learning.learner import clamp_action
from aerial_gym.rl_training.policies.body import NetworkBodyCfg
from aerial_gym.rl_training.policies.load import load_policy, make_network
from aerial_gym.rl_training.trainers.learners import ApgTrainer
from tests.refusals import assert_refused
from tests.unit.task.hover import build_task

F64 = torch.float64
GAMMA = 0.9


def settings(num_envs: int = 32, **apg: object) -> TrainingCfg:
    cfg = load_settings(settings_for("apg", "position_setpoint_task", device="cpu"))
    cfg = replace(cfg, num_envs=num_envs, device="cpu", max_time_s=None, max_env_steps=100_000)
    return replace(cfg, apg=replace(cfg.apg, **{"horizon": 8} | apg))


def test_the_return_of_a_window_is_that_of_its_episodes_judged_where_they_continue() -> None:
    generator = torch.Generator().manual_seed(0)
    steps, rows = 9, 40
    reward, value = (torch.randn(steps, rows, generator=generator, dtype=F64) for _ in range(2))
    terminated = torch.rand(steps, rows, generator=generator) < 0.15
    ended = terminated | (torch.rand(steps, rows, generator=generator) < 0.15)
    expected = torch.zeros(rows, dtype=F64)
    for row in range(rows):
        k = 0
        for t in range(steps):
            expected[row] += GAMMA**k * float(reward[t, row])
            k += 1
            if (ended[t, row] or t == steps - 1) and not terminated[t, row]:
                expected[row] += GAMMA**k * float(value[t, row])
            k = 0 if ended[t, row] else k
    result = window_return(reward, value, terminated, ended, discount=GAMMA)
    torch.testing.assert_close(result, expected, atol=1e-12, rtol=0.0)


@pytest.mark.parametrize("resets", [pytest.param(False, marks=pytest.mark.slow), True])
def test_the_gradient_of_a_window_is_its_difference(resets: bool) -> None:
    """With respect to weights of the policy, by central differences in float64; with resets, each row ends in the window."""
    cfg = settings(3, horizon=6, bound_coef=1e-3, terminal_value=True)
    limit = 4 if resets else 500
    task = build_task(replace(task_registry.get(cfg.task), episode_len_steps=limit), 3, gradients=F64)
    learner = make_learner(cfg, task)
    state = learner.generator.get_state()

    def loss() -> Tensor:
        learner.generator.set_state(state)
        observation, _ = task.reset(seed=5)
        if resets:
            task.env.gtd["sim_steps"].copy_(torch.arange(3))
        learner._observation = observation
        window = learner._simulate_window()
        assert bool(window.ended.any()) == resets
        return learner._policy_loss(window)[0]

    parameters = [learner.network.actor.head.weight, learner.network.actor.body.layers[0].weight]
    analytic = torch.autograd.grad(loss(), parameters)
    step = 1e-5
    for parameter, gradient in zip(parameters, analytic, strict=True):
        flat = parameter.data.view(-1)
        for place in range(0, flat.numel(), flat.numel() // 7):
            kept, sides = float(flat[place]), []
            for side in (step, -step):
                flat[place] = kept + side
                with torch.no_grad():
                    sides.append(float(loss()))
            flat[place] = kept
            difference = (sides[0] - sides[1]) / (2.0 * step)
            assert float(gradient.reshape(-1)[place]) == pytest.approx(difference, rel=1e-6, abs=1e-9)


def make_learner(cfg: TrainingCfg, task: Task) -> Apg:
    network = make_network(cfg, task)
    torch.manual_seed(0)
    torch.nn.init.normal_(network.value_head.weight, std=0.3)
    torch.nn.init.normal_(network.actor.head.weight, std=0.3)
    learner = Apg(cfg, task, network.double())
    learner.target.double()
    learner.restart_episodes()
    return learner


@pytest.mark.slow
def test_the_slow_critic_judges_and_follows() -> None:
    cfg = settings(16, target_share=0.25, terminal_value=True)
    with task_registry.make_task(cfg.task, num_envs=16, device="cpu", differentiable=True) as task:
        training = ApgTrainer().make_training(cfg, task)
        learner = training.learner
        before = [p.clone() for p in learner._critics[1].parameters()]
        training.advance()
        pairs = zip(before, learner._critics[1].parameters(), learner._critics[0].parameters(), strict=True)
        for old, slow, fast in pairs:
            torch.testing.assert_close(slow.data, old + 0.25 * (fast.data - old), atol=1e-6, rtol=0.0)
            assert not torch.equal(slow.data, fast.data)


def test_beyond_the_bound_an_action_may_come_back_and_go_no_further() -> None:
    """Loss slopes of both signs inside, above and below; what is not finite is 0."""
    action = torch.tensor([[0.5, 2.0, 2.0, -2.0, -2.0, 0.0]], requires_grad=True)
    slope = torch.tensor([[-3.0, -3.0, 3.0, -3.0, 3.0, float("nan")]])
    result = clamp_action(action)
    (gradient,) = torch.autograd.grad(result, action, slope)
    assert result.tolist() == [[0.5, 1.0, 1.0, -1.0, -1.0, 0.0]]
    assert gradient.tolist() == [[-3.0, 0.0, 3.0, -3.0, 0.0, 0.0]]


def test_without_terminal_value_no_critic_learns_and_none_is_asked() -> None:
    cfg = settings(16)
    ways = []
    for weight in (0.0, 100.0):
        with task_registry.make_task(cfg.task, num_envs=16, device="cpu", seed=0, differentiable=True) as task:
            training = ApgTrainer().make_training(cfg, task)
            learner = training.learner
            for head in (learner.network.value_head, learner.target.value_head):
                torch.nn.init.constant_(head.weight, weight)
            before = [p.clone() for p in learner._critics[0].parameters()]
            training.advance()
            assert all(torch.equal(a, b) for a, b in zip(before, learner._critics[0].parameters(), strict=True))
            ways.append(learner._actor_adam.weights.clone())
    assert torch.equal(*ways)


def test_a_row_that_goes_astray_teaches_nothing() -> None:
    cfg = settings(4)
    with task_registry.make_task(cfg.task, num_envs=4, device="cpu", differentiable=True) as task:
        training = ApgTrainer().make_training(cfg, task)
        training.advance()
        backend = task.env.robot_manager.differentiable
        backend.state.lin_vel[1] = float("inf")
        before = training.learner.network.actor.head.weight.clone()
        training.advance()
        assert bool(training.learner.network.actor.head.weight.isfinite().all())
        assert not torch.equal(training.learner.network.actor.head.weight, before)


def test_a_window_with_joints_is_no_cuda_graph() -> None:
    cfg = replace(settings(2), task="position_setpoint_task_morphy")
    with task_registry.make_task(cfg.task, num_envs=2, device="cpu", differentiable=True) as task:
        check_differentiable(task, cfg)
        task.device = torch.device("cuda")
        assert_refused(CapabilityError, r"robot with joints.* Give capture: false", check_differentiable, task, cfg)
        check_differentiable(task, replace(cfg, apg=replace(cfg.apg, capture=False)))


def test_what_has_no_gradient_is_refused_by_name() -> None:
    cfg = settings(2)
    drawn = {"body.mass": RandomizeCfg(low=0.8, high=1.2)}
    randomized = build_task(replace(task_registry.get(cfg.task), randomize=drawn), 2, gradients=torch.float32)
    for task, message in (
        (task_registry.make_task(cfg.task, num_envs=2, device="cpu"), f"{cfg.task} has no gradients"),
        (randomized, r"draws body.mass at resets, .* Take them out of randomize, or train with ppo"),
    ):
        assert_refused(CapabilityError, message, ApgTrainer().make_training, cfg, task)


def test_a_task_with_a_flat_reward_is_told_of_its_smooth_one(caplog: pytest.LogCaptureFixture) -> None:
    for task_name in ("position_setpoint_task", "smooth_position_setpoint_task"):
        cfg = replace(settings(2), task=task_name)
        with task_registry.make_task(cfg.task, num_envs=2, device="cpu", differentiable=True) as task:
            ApgTrainer().make_training(cfg, task)
    told = [record.getMessage() for record in caplog.records if "flat" in record.getMessage()]
    assert len(told) == 1
    assert told[0].endswith("Train with smooth_position_setpoint_task")


def test_settings_that_do_not_fit_are_refused() -> None:
    cfg = settings()
    ppo = load_settings(settings_for("ppo", "position_setpoint_task", device="cpu")).ppo
    assert_refused(ConfigError, "trainer apg needs numbers under apg", replace, cfg, ppo=ppo)
    assert_refused(ConfigError, "trainer ppo needs numbers under ppo", replace, cfg, trainer="ppo")
    for change, message in (
        ({"memory": 8}, "apg has policies without memory. Train with ppo"),
        ({"separate_value_network": False}, "must be true"),
        ({"target_share": 1.5}, "must be at most 1"),
    ):
        assert_refused(ConfigError, message, replace, cfg.apg, **change)


UPDATES = 30  # About 8 s of one core: half of what brings the error to 0.02 m


@pytest.mark.slow
def test_seconds_of_training_bring_the_robot_to_its_target() -> None:
    """Within 0.25 m in the last second, metres away untrained: twice as far as the furthest of five seeds (0.11 m)."""
    cfg = load_settings(settings_for("apg", "smooth_position_setpoint_task"))
    steps = cfg.num_envs * cfg.apg.horizon
    cfg = replace(cfg, device="cpu", seed=1, max_time_s=None, max_env_steps=UPDATES * steps)
    with (
        task_registry.make_task(cfg.task, num_envs=64, device="cpu", seed=9) as fresh,
        task_registry.make_task(cfg.task, num_envs=cfg.num_envs, device="cpu", seed=1, differentiable=True) as task,
    ):
        training = ApgTrainer().make_training(cfg, task)
        policy = training.learner.network.actor
        before = evaluate(policy, fresh)
        assert before.final_error_mean_m is None or before.final_error_mean_m > 1.0
        for _ in range(UPDATES):
            training.advance()
        result = evaluate(policy, fresh)
    assert result.crash_rate == 0.0
    assert result.final_error_mean_m < 0.25


SENSED = tuple(ObservationCfg(term=term) for term in ("position_error_world", "attitude"))


def student_settings(num_envs: int = 64, **distill: object) -> TrainingCfg:
    cfg = load_settings(settings_for("distill", "position_setpoint_task", device="cpu"))
    cfg = replace(cfg, num_envs=num_envs, device="cpu", max_time_s=None, max_env_steps=30_000)
    return replace(cfg, distill=replace(cfg.distill, **{"horizon": 16} | distill))


def hover(**changes: int) -> Task:
    """The position task, with a group that lacks velocities."""
    cfg = task_registry.get("position_setpoint_task")
    return build_task(replace(cfg, observations={**cfg.observations, "sensed": SENSED}, **changes), 64)


def damping() -> Policy:
    """A teacher whose actions are a function of everything, velocities above all."""
    body = {"hidden_layers": (13,), "activation": "tanh", "normalize": False}
    teacher = Policy(NetworkBodyCfg(shapes={"observations": (13,)}, **body), 4)
    with torch.no_grad():
        layer = teacher.body.layers[0]
        layer.weight.copy_(torch.eye(13))
        layer.bias.zero_()
        teacher.head.weight.zero_()
        for action, (position, velocity) in enumerate(((1, 8), (0, 7), (2, 12), (2, 9))):
            teacher.head.weight[action, position], teacher.head.weight[action, velocity] = 0.2, -0.6
    return teacher.requires_grad_(False)


def difference(iterations: int, **distill: object) -> float:
    cfg, task = student_settings(**distill), hover()
    learner = Distill(cfg, task, make_network(cfg, task), damping())
    learner.restart_episodes()
    for _ in range(iterations):
        learner.iterate()
    return float(learner.gauges[learner.GAUGES.index("difference")])


@pytest.mark.slow
def test_a_student_who_sees_the_same_comes_to_do_the_same() -> None:
    quick = {"num_epochs": 4, "end_learning_rate": 5e-4}
    assert difference(30, learning_rate=5e-3, **quick) < 0.5 * difference(30, learning_rate=1e-9, num_epochs=1)


def test_what_is_learned_from_is_what_was_flown(monkeypatch: pytest.MonkeyPatch) -> None:
    cfg, task = student_settings(policy_keys=("sensed",), memory=8, horizon=12), hover(episode_len_steps=5)
    learner = Distill(cfg, task, make_network(cfg, task), damping())
    learner.restart_episodes()
    flown: list[torch.Tensor] = []
    step = task.step
    monkeypatch.setattr(task, "step", lambda actions: (flown.append(actions.clone()), step(actions))[1])
    led = torch.arange(64) < 1
    for _ in range(2):
        flown.clear()
        with torch.no_grad():
            seen, begins, memory, wanted = learner._simulate_segment(led)
            prepared = learner.network.actor.body.network_inputs(seen)
            distribution, _ = learner.network.sequence_outputs(prepared, memory, begins)
        assert begins[1:].any(dim=0).all()
        torch.testing.assert_close(torch.stack(flown)[:, 1:], distribution.mean[:, 1:].clamp(-1.0, 1.0))
        assert torch.equal(torch.stack(flown)[:, 0], wanted[:, 0])


def test_the_teacher_flies_first_and_the_student_in_the_end() -> None:
    cfg, task = student_settings(), hover()
    learner = Distill(cfg, task, make_network(cfg, task), damping())
    learner.restart_episodes()
    flown = []
    for _ in range(30_000 // (64 * 16)):
        learner.iterate()
        flown.append(float(learner.gauges[-1]))
    assert flown[0] == pytest.approx(1.0)
    assert all(after <= before for before, after in pairwise(flown))
    assert flown[len(flown) // 2 + 1 :] == [0.0] * len(flown[len(flown) // 2 + 1 :])


def test_a_policy_is_handed_on_through_run_folders(tmp_path) -> None:
    ppo = load_settings(settings_for("ppo", "position_setpoint_task", device="cpu"))
    ppo = replace(ppo, num_envs=64, device="cpu", max_time_s=None, max_env_steps=5_000)
    train(ppo, tmp_path / "ppo", show_progress=False)
    cfg = replace(student_settings(), teacher=str(tmp_path / "ppo"), max_env_steps=8 * 64 * 16)
    result = train(cfg, tmp_path / "student", show_progress=False)
    policy, its_cfg = load_policy(tmp_path / "student")
    assert (its_cfg.teacher, result.env_steps) == (str(tmp_path / "ppo"), 8 * 64 * 16)
    assert policy.shapes == {"observations": (13,)}


def test_what_does_not_fit_is_refused(tmp_path: Path) -> None:
    assert_refused(
        ConfigError, "distill needs a policy", train, student_settings(), tmp_path / "run", show_progress=False
    )
    with pytest.raises(ConfigError, match="nowhere"):
        train(replace(student_settings(), teacher=str(tmp_path / "nowhere")), tmp_path / "run", show_progress=False)
    assert not (tmp_path / "run").exists()
    ppo = load_settings(settings_for("ppo", "position_setpoint_task", device="cpu"))
    assert_refused(ConfigError, "trainer ppo has none. Use distill", replace, ppo, teacher="runs/hover")
    assert_refused(ConfigError, "distill has no value network", student_settings, separate_value_network=True)
