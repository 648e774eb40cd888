"""Base classes of trainers: all that training, evaluation and commands must know about one.

A subclass imports its library only in ``prepare`` and ``run``, so a policy can be read without the library.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from aerial_gym.errors import ConfigError
from aerial_gym.extras import require
from aerial_gym.rl_training.learner_settings import LearnerCfg, PpoCfg
from aerial_gym.rl_training.settings import TRAINING_CONFIGS, TrainingCfg

if TYPE_CHECKING:
    import torch
    from torch import Tensor

    from aerial_gym.rl_training.learning.learner import Learner
    from aerial_gym.rl_training.policies.actor_critic import ActorCritic
    from aerial_gym.rl_training.policies.load import Weights
    from aerial_gym.rl_training.policies.policy import Policy
    from aerial_gym.rl_training.ranks import Ranks
    from aerial_gym.rl_training.run.training_run import TrainingRun
    from aerial_gym.rl_training.trainers.native import NativeTraining
    from aerial_gym.task import Task


class Trainer(ABC):
    """A way to train policies."""

    name: ClassVar[str]  # Registered name
    summary: ClassVar[str]  # One line for `aerial-gym list trainers`
    package: ClassVar[str] = ""  # Name under which its library is imported; empty without one
    distribution: ClassVar[str] = ""  # Name under which its library is installed; a run folder notes its version

    section: ClassVar[str] = "ppo"
    """Field of ``TrainingCfg`` with its numbers; ``numbers`` for settings of a class that ``TrainingCfg`` does not know."""

    settings: ClassVar[type[LearnerCfg]] = PpoCfg  # Class of its numbers
    settings_folder: ClassVar[Path] = TRAINING_CONFIGS  # Folder of its settings by task, `TRAINER_TASK.yaml`
    several_processes: ClassVar[bool] = False  # Whether several processes can learn together
    takes_teacher: ClassVar[bool] = False  # Whether it needs a trained policy, `TrainingCfg.teacher`
    takes_initial: ClassVar[bool] = False  # Whether it can begin with networks of another run, `TrainingCfg.initial`
    any_inputs: ClassVar[bool] = False  # Whether it trains with memory, images and separate critic keys
    differentiable: ClassVar[bool] = False  # Whether it needs gradients through the task
    captures_task: ClassVar[bool | None] = None  # Whether the task records a CUDA graph of its step; None: on GPUs
    earlier_checkpoints: ClassVar[tuple[str, ...]] = ()  # Glob patterns of checkpoints of earlier versions

    def require(self) -> None:
        """Raise ``MissingDependencyError`` if its library is not installed."""
        if self.package:
            require(f"trainer {self.name!r}", self.package)

    def check(self, cfg: TrainingCfg) -> None:
        """Raise the error of settings that cannot be trained, before anything is written."""

    def prepare(self, device: "torch.device") -> None:
        """Import the library and compile kernels, before the task is built."""

    @abstractmethod
    def run(self, run: "TrainingRun") -> bool:
        """Train until a limit of the settings is reached or the user interrupts; return whether it was interrupted.

        Raises:
            StorageError: If the disk is full.
            TrainingError: If the training diverged.
        """

    def policy(self, payload: Mapping[str, Any], cfg: TrainingCfg, *, where: str) -> "Policy":
        """Return the policy in a checkpoint, by default the networks under ``actor.`` in its ``model``.

        Args:
            payload: The checkpoint; its ``model`` is the state of the networks.
            cfg: Settings of its run.
            where: Named in errors.

        Raises:
            ConfigError: If it does not hold the network of the settings.
        """
        from aerial_gym.rl_training.policies.load import native_policy

        return native_policy(payload, cfg, where=where)


class NativeTrainer(Trainer):
    """A trainer with a learner of this package: simulation and updates are one CUDA graph on a GPU."""

    any_inputs = True
    captures_task = False

    @abstractmethod
    def make_learner(self, cfg: TrainingCfg, task: "Task", network: "ActorCritic", ranks: "Ranks") -> "Learner":
        """Return the learner of a new network."""

    def make_training(
        self, cfg: TrainingCfg, task: "Task", ranks: "Ranks | None" = None, **options: Any
    ) -> "NativeTraining[Any]":
        """Return a new training; ``options`` are those of ``make_learner``."""
        from aerial_gym.rl_training.policies.load import make_network
        from aerial_gym.rl_training.ranks import ALONE
        from aerial_gym.rl_training.trainers.native import NativeTraining

        learner = self.make_learner(cfg, task, make_network(cfg, task), ranks or ALONE, **options)
        return NativeTraining(cfg, task, learner)

    def run(self, run: "TrainingRun") -> bool:
        """Repeat the learner until the end; return whether it was interrupted."""
        return self.make_training(run.cfg, run.task, run.ranks).run(run)


class LibraryTrainer(Trainer):
    """A trainer of another library, with policies of linear layers."""

    adapter: ClassVar[str]  # Module with `train`, which takes a `TrainingRun`; the only one that imports the library

    def prepare(self, device: "torch.device") -> None:
        """Import the library."""
        import_module(self.adapter)

    def run(self, run: "TrainingRun") -> bool:
        """Train with the runner of the library; return whether it was interrupted."""
        return import_module(self.adapter).train(run)

    @abstractmethod
    def weights(self, model: "Mapping[str, Tensor]", num_hidden: int) -> "Weights":
        """Return layers, mean and variance of the observation; raise ``KeyError`` if ``model`` lacks one of them."""

    def policy(self, payload: Mapping[str, Any], cfg: TrainingCfg, *, where: str) -> "Policy":
        """Return the policy with the weights in the library's network."""
        from aerial_gym.rl_training.policies.load import policy_from_weights

        layers = cfg.learner.hidden_layers
        try:
            weights = self.weights(payload["model"], len(layers))
        except KeyError as error:
            raise ConfigError(f"{where}: no {error} in it; it is no {self.name} checkpoint of {layers}") from None
        return policy_from_weights(weights, cfg, where=where)
