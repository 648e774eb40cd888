"""Policies learn what only a memory can know, and what only bytes of an image say; trainings with one seed repeat exactly."""

from collections.abc import Callable
from typing import Any, ClassVar

import pytest
import torch
from torch import Tensor

from aerial_gym import Task, task_registry
from aerial_gym.rl_training.evaluation import evaluate
from aerial_gym.rl_training.learning.distill import Distill
from aerial_gym.rl_training.learning.ppo import Ppo
from aerial_gym.rl_training.policies.load import check_fits, make_network, policy_from_payload
from aerial_gym.rl_training.settings import TrainingCfg
from aerial_gym.rl_training.trainers.learners import ApgTrainer, PpoTrainer
from aerial_gym.rl_training.trainers.native import NativeTraining
from tests.repetitions import frequent_values
from tests.unit.rl_training.learning import test_apg, test_ppo
from tests.unit.rl_training.learning.test_ppo import settings
from tests.unit.task.hover import camera_task


class GuessTask:
    """Each episode draws -0.8 or 0.8; an action costs the square of its distance to it. Ages are staggered from the start."""

    num_envs, num_actions, device = 64, 1, torch.device("cpu")
    observation_shapes: ClassVar = {"observations": (1,)}
    length = 5  # Steps of an episode
    truncated = False  # Whether episodes end as truncated, and not as terminated

    def __init__(self) -> None:
        self.generator, self.age = torch.Generator().manual_seed(0), torch.arange(self.num_envs) % self.length
        self.drawn = self._draw()

    def _draw(self) -> Tensor:
        return 0.8 * (2.0 * torch.randint(0, 2, (self.num_envs,), generator=self.generator) - 1.0)

    def observe(self) -> dict[str, Tensor]:
        """Show what was drawn in the first step of an episode, and nothing after it."""
        return {"observations": torch.where(self.age == 0, self.drawn, 0.0).unsqueeze(-1)}

    def reset(self) -> tuple[dict[str, Tensor], dict[str, Tensor]]:
        return self.observe(), {}

    def stagger(self) -> None:
        pass

    def step(self, actions: Tensor) -> tuple[dict[str, Tensor], Tensor, Tensor, Tensor, dict[str, Tensor]]:
        reward = -((actions[:, 0] - self.drawn) ** 2)
        self.age = self.age + 1
        ended = self.age == self.length
        final = torch.zeros(self.num_envs, *self.observation_shapes["observations"])
        info = {"final_observation": final, "episode_return": reward, "episode_length": self.age}
        self.age = torch.where(ended, 0, self.age)
        self.drawn = torch.where(ended, self._draw(), self.drawn)
        no = torch.zeros_like(ended)
        return self.observe(), reward, *((no, ended) if self.truncated else (ended, no)), info


def late_cost(task: GuessTask, iterations: int, **ppo: object) -> float:
    """Return the mean cost of an action after a training, exploration included."""
    numbers = {"horizon": 8, "num_minibatches": 2, "hidden_layers": (16,), "num_epochs": 4, "discount": 0.9}
    rates = {"initial_std": 0.3, "min_std": 0.01, "max_learning_rate": 5e-3}
    cfg = settings(task.num_envs, **numbers, **rates, **ppo)
    learner = Ppo(cfg, task, make_network(cfg, task))
    learner.restart_episodes()
    for _ in range(iterations):
        learner.iterate()
    with torch.no_grad():
        return float(-learner._simulate_segment().reward.mean())


@pytest.mark.slow
def test_a_memory_learns_what_was_shown_before_and_without_one_it_cannot_be_known() -> None:
    """Without a memory the best action is what is seen, 0.8 off in four steps of five: 0.64 * 4 / 5 = 0.512."""
    assert late_cost(GuessTask(), 60, memory=16) < 0.1
    assert late_cost(GuessTask(), 60, memory=0) > 0.5


class ColumnTask(GuessTask):
    """A bright column stands left or right in the image, beside a vector that says nothing."""

    num_envs, length, truncated = 32, 4, True
    observation_shapes: ClassVar = {"observations": (2,), "depth": (1, 8, 12)}

    def observe(self) -> dict[str, Tensor]:
        image = torch.zeros(32, 1, 8, 12, dtype=torch.uint8)
        image[torch.arange(32), 0, :, 2 + 7 * (self.drawn > 0.0)] = 255
        return {"observations": torch.zeros(32, 2), "depth": image}


@pytest.mark.slow
def test_an_image_tells_what_a_vector_does_not() -> None:
    """Without it the best action is 0, which costs 0.64; the final image is that of the step before, as the task gives none."""
    assert late_cost(ColumnTask(), 40, policy_keys=("observations", "depth")) < 0.1
    assert late_cost(ColumnTask(), 40, policy_keys=("observations",)) > 0.6


@pytest.mark.slow
def test_a_task_with_a_camera_is_trained_with_a_memory_and_a_critic_that_sees_better() -> None:
    keys = {"policy_keys": ("observations", "depth"), "critic_keys": ("observations", "exact")}
    cfg = settings(8, memory=6, horizon=4, num_minibatches=2, num_epochs=1, hidden_layers=(8,), **keys)
    with camera_task(8, capture=False) as task:
        training = PpoTrainer().make_training(cfg, task)
        for _ in range(2):
            training.advance()
        state = training.state()
        policy = policy_from_payload(state, cfg, where="test")
        check_fits(policy, task, cfg.task)
        assert (set(policy.shapes), evaluate(policy, task).num_starts) == ({"observations", "depth"}, 8)
        again = PpoTrainer().make_training(cfg, task)
        again.load(state)
        assert again.env_steps == training.env_steps == 2 * 4 * 8


Make = Callable[[TrainingCfg, Task], NativeTraining[Any]]
SHARED = {"separate_value_network": False, "entropy_coef": 1e-3}


def make_distillation(cfg: TrainingCfg, task: Task) -> NativeTraining[Any]:
    return NativeTraining(cfg, task, Distill(cfg, task, make_network(cfg, task), test_apg.damping()))


TRAININGS: dict[str, tuple[TrainingCfg, Make]] = {
    "ppo, separate": (test_ppo.settings(), PpoTrainer().make_training),
    "ppo, shared": (test_ppo.settings(separate_value_network=False, clip_value=True), PpoTrainer().make_training),
    "ppo, recurrent": (test_ppo.settings(memory=8, normalize_observation=True), PpoTrainer().make_training),
    "ppo, recurrent and shared": (test_ppo.settings(memory=8, **SHARED), PpoTrainer().make_training),
    "apg": (test_apg.settings(), ApgTrainer().make_training),
    "apg, a critic": (test_apg.settings(terminal_value=True, normalize_value=True), ApgTrainer().make_training),
    "distill": (test_apg.student_settings(), make_distillation),
}


@pytest.mark.parametrize("name", frequent_values(TRAININGS, ("ppo, recurrent and shared", "apg, a critic", "distill")))
def test_a_training_repeats_bit_for_bit_and_goes_on_as_if_it_had_not_stopped(name: str) -> None:
    cfg, make = TRAININGS[name]
    chosen = {"differentiable": True} if cfg.trainer == "apg" else {"capture": False}

    def train(iterations: int, state: dict[str, object] | None = None) -> tuple[dict[str, object], list[object]]:
        with task_registry.make_task(cfg.task, num_envs=cfg.num_envs, device="cpu", seed=0, **chosen) as task:
            training = make(cfg, task)
            if state is not None:
                training.load(state)
            reports = [(training.advance(), training.gauges()) for _ in range(iterations)]
            return training.state(), reports

    whole, reports = train(4)
    torch.manual_seed(99)  # nothing comes from torch's own generator
    first, before = train(2)
    second, after = train(2, first)
    assert reports[:2] == before
    assert [gauges for _, gauges in reports] == [gauges for _, gauges in before + after]
    for part in ("model", "learner", "task"):
        for name, tensor in whole[part].items():
            assert torch.equal(tensor, second[part][name]), name
