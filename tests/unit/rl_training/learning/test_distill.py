"""A student learns what its teacher does, also from less than the teacher sees, and goes on from a checkpoint."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import pytest
import torch

from aerial_gym import Task, task_registry
from aerial_gym.config.task_terms import ObservationCfg
from aerial_gym.errors import ConfigError
from aerial_gym.rl_training import Policy, TrainingCfg, load_settings, settings_for, train
from aerial_gym.rl_training.learning.distill import Distill
from aerial_gym.rl_training.policies.body import NetworkBodyCfg
from aerial_gym.rl_training.policies.load import load_policy, make_network
from tests.refusals import assert_refused
from tests.unit.task.hover import build_task

SENSED = tuple(ObservationCfg(term=term) for term in ("position_error_world", "attitude"))


def settings(num_envs: int = 64, **distill: object) -> TrainingCfg:
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
    cfg, task = settings(**distill), hover()
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
    cfg, task = settings(policy_keys=("sensed",), memory=8, horizon=12), hover(episode_len_steps=5)
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
    cfg, task = settings(), hover()
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
    cfg = replace(settings(), teacher=str(tmp_path / "ppo"), max_env_steps=8 * 64 * 16)
    result = train(cfg, tmp_path / "student", show_progress=False)
    policy, its_cfg = load_policy(tmp_path / "student")
    assert (its_cfg.teacher, result.env_steps) == (str(tmp_path / "ppo"), 8 * 64 * 16)
    assert policy.shapes == {"observations": (13,)}


def test_what_does_not_fit_is_refused(tmp_path: Path) -> None:
    assert_refused(ConfigError, "distill needs a policy", train, settings(), tmp_path / "run", show_progress=False)
    with pytest.raises(ConfigError, match="nowhere"):
        train(replace(settings(), teacher=str(tmp_path / "nowhere")), tmp_path / "run", show_progress=False)
    assert not (tmp_path / "run").exists()
    ppo = load_settings(settings_for("ppo", "position_setpoint_task", device="cpu"))
    assert_refused(ConfigError, "trainer ppo has none. Use distill", replace, ppo, teacher="runs/hover")
    assert_refused(ConfigError, "distill has no value network", settings, separate_value_network=True)
