"""The trainers of this package: PPO, analytic policy gradients, and a student that imitates a trained policy."""

import logging
from typing import TYPE_CHECKING

from aerial_gym.errors import ConfigError
from aerial_gym.rl_training.learner_settings import ApgCfg, DistillCfg, PpoCfg
from aerial_gym.rl_training.settings import TrainingCfg
from aerial_gym.rl_training.trainers.trainer import NativeTrainer

if TYPE_CHECKING:
    import torch

    from aerial_gym.rl_training.learning.learner import Learner
    from aerial_gym.rl_training.policies.actor_critic import ActorCritic
    from aerial_gym.rl_training.ranks import Ranks
    from aerial_gym.task import Task

_log = logging.getLogger(__name__)


class PpoTrainer(NativeTrainer):
    """PPO of this package."""

    name = "ppo"
    summary = "PPO of this package; simulation and learning are one CUDA graph on a GPU"
    several_processes = True
    takes_initial = True

    def prepare(self, device: "torch.device") -> None:
        """Compile the kernels of the networks."""
        from aerial_gym.rl_training.learning.fused import start_triton_early

        start_triton_early(device)

    def make_learner(
        self, cfg: TrainingCfg, task: "Task", network: "ActorCritic", ranks: "Ranks", *, fused: bool = True
    ) -> "Learner":
        """Return the learner; ``fused`` runs the networks in fused kernels where possible."""
        from aerial_gym.rl_training.learning.fused import FusedPpo, fusion_refusal
        from aerial_gym.rl_training.learning.ppo import Ppo

        reason = fusion_refusal(cfg.section(PpoCfg), network, task.device) if fused else "asked for"
        if reason is not None and task.device.type == "cuda":
            _log.info("the networks run as torch operations: %s", reason)
        kind = FusedPpo if reason is None else Ppo
        if cfg.section(PpoCfg).opponents:
            from aerial_gym.rl_training.learning.self_play import SelfPlay

            return SelfPlay(cfg, task, network, ranks, kind=kind)
        return kind(cfg, task, network, ranks)


class ApgTrainer(NativeTrainer):
    """Analytic policy gradients of this package."""

    name = "apg"
    summary = "analytic policy gradients through the simulation, with a short-horizon critic"
    section, settings = "apg", ApgCfg
    differentiable = True

    def make_learner(self, cfg: TrainingCfg, task: "Task", network: "ActorCritic", ranks: "Ranks") -> "Learner":
        """Return the learner; warn if the task has a variant with a reward whose slope does not vanish."""
        from aerial_gym.rl_training.learning.apg import Apg
        from aerial_gym.task import task_registry

        smooth = f"smooth_{cfg.task}"
        if smooth in task_registry.names():
            _log.warning("trainer apg: the reward of %s is flat far from its target. Train with %s", cfg.task, smooth)
        return Apg(cfg, task, network)


class DistillTrainer(NativeTrainer):
    """Distillation of this package."""

    name = "distill"
    summary = "a student learns the actions of a trained policy"
    section, settings = "distill", DistillCfg
    takes_teacher = True

    def check(self, cfg: TrainingCfg) -> None:
        """Raise ``ConfigError`` if the teacher is missing or cannot be read."""
        from aerial_gym.rl_training.policies.load import load_policy

        if cfg.teacher is None:
            raise ConfigError("trainer distill needs a policy to hand on: --teacher RUN, the folder of its training")
        load_policy(cfg.teacher)

    def make_learner(self, cfg: TrainingCfg, task: "Task", network: "ActorCritic", ranks: "Ranks") -> "Learner":
        """Return the learner; raise ``ConfigError`` if the teacher does not fit the task."""
        from aerial_gym.rl_training.learning.distill import Distill
        from aerial_gym.rl_training.policies.load import check_fits, load_policy

        assert cfg.teacher is not None
        teacher, teacher_cfg = load_policy(cfg.teacher, device=task.device)
        check_fits(teacher, task, teacher_cfg.task)
        return Distill(cfg, task, network, teacher)
