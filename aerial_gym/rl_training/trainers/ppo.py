"""Training with proximal policy optimisation of this package."""

import logging
from typing import TYPE_CHECKING

from aerial_gym.rl_training.learner_settings import PpoCfg
from aerial_gym.rl_training.settings import TrainingCfg
from aerial_gym.rl_training.trainers.trainer import NativeTrainer

if TYPE_CHECKING:
    import torch

    from aerial_gym.rl_training.learning.ppo import Ppo
    from aerial_gym.rl_training.ranks import Ranks
    from aerial_gym.rl_training.trainers.native import NativeTraining
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

    def make_training(
        self, cfg: TrainingCfg, task: "Task", ranks: "Ranks | None" = None, *, fused: bool = True
    ) -> "NativeTraining[Ppo]":
        """Return a new training; ``fused`` runs the networks in fused kernels where possible."""
        from aerial_gym.rl_training.learning.fused import FusedPpo, fusion_refusal
        from aerial_gym.rl_training.learning.ppo import Ppo
        from aerial_gym.rl_training.policies.load import make_network
        from aerial_gym.rl_training.ranks import ALONE
        from aerial_gym.rl_training.trainers.native import NativeTraining

        network = make_network(cfg, task)
        reason = fusion_refusal(cfg.section(PpoCfg), network, task.device) if fused else "asked for"
        if reason is not None and task.device.type == "cuda":
            _log.info("the networks run as torch operations: %s", reason)
        return NativeTraining(cfg, task, (FusedPpo if reason is None else Ppo)(cfg, task, network, ranks or ALONE))
