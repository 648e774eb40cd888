"""What a training needs to know: task, trainer, limits, and numbers of networks and learners.

One set of names for all that learn by PPO; the modules of ``adapters`` translate them for other libraries.
Letters: E environments.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from math import inf
from pathlib import Path
from typing import TypeVar

from aerial_gym.config import CONFIG_DIR
from aerial_gym.config.checks import MAX_MADE, require_count, require_positive
from aerial_gym.config.extends import load_extended
from aerial_gym.config.loader import convert
from aerial_gym.errors import ConfigError
from aerial_gym.interop import resolve_device
from aerial_gym.rl_training.trainers.catalog import TRAINERS, trainers_with

TRAINING_CONFIGS = CONFIG_DIR / "training"
"""Folder of the settings that come with the package: ``TRAINER_TASK.yaml``, the task without its ``_task``;
``TRAINER_TASK_cpu.yaml`` where a CPU asks for others."""


@dataclass(frozen=True, kw_only=True)
class LearnerCfg:
    """Numbers of networks and segments that all learners have."""

    hidden_layers: tuple[int, ...]
    """Widths of the hidden layers, each >= 1."""

    separate_value_network: bool = False
    """Whether the value has hidden layers of its own instead of sharing those of the policy."""

    activation: str = "elu"
    """``elu``, ``relu`` or ``tanh``."""

    memory: int = 0
    """Numbers of a gated recurrent unit behind the hidden layers; 0: none. ``ppo`` only."""

    policy_keys: tuple[str, ...] = ("observations",)
    """Keys of the observation that the policy sees: vectors, images (C, H, W); others than ``observations`` with ``ppo``."""

    critic_keys: tuple[str, ...] = ()
    """Keys that the value sees; empty: those of the policy. ``ppo`` with ``separate_value_network`` only."""

    initial_std: float = 1.0
    """Standard deviation of the actions before learning, in units of the action, > 0."""

    min_std: float = 0.05
    """Smallest standard deviation to which they may be learned, > 0. Far below 0.05, rl-games measures the divergence of
    its policies wrongly (it adds 1e-5 to variances), and the learning rate with it."""

    head_variance: float = 1.0
    """Variance of the first weights of the layer that gives the actions, times its width, > 0; small: learning starts with
    actions near zero."""

    horizon: int
    """Steps of every environment per update, >= 1."""

    max_grad_norm: float = 1.0
    """Largest norm of the gradient, > 0."""

    normalize_observation: bool = True
    """Whether observations are normalised by their running mean and deviation."""

    def __post_init__(self) -> None:
        require_positive(self, "initial_std", "head_variance", "max_grad_norm")
        require_count(self, "horizon")
        name = type(self).__name__
        if self.activation not in ("elu", "relu", "tanh"):
            raise ConfigError(f"{name}.activation = {self.activation!r}: must be elu, relu or tanh")
        if not 0 <= self.memory <= MAX_MADE:
            raise ConfigError(f"{name}.memory = {self.memory!r}: must be >= 0 and at most {MAX_MADE:,}")
        if not self.policy_keys or (self.critic_keys and not self.separate_value_network):
            raise ConfigError(
                f"{name}: policy_keys = {self.policy_keys!r}, critic_keys = {self.critic_keys!r}: the policy must see "
                "something; a critic with keys of its own needs separate_value_network"
            )
        if not self.hidden_layers or not all(1 <= width <= MAX_MADE for width in self.hidden_layers):
            raise ConfigError(
                f"{name}.hidden_layers = {self.hidden_layers!r}: needs widths >= 1 and at most {MAX_MADE:,}"
            )


@dataclass(frozen=True, kw_only=True)
class ReturnCfg(LearnerCfg):
    """Numbers of all that learn from rewards."""

    discount: float
    """Discount gamma, 0 < gamma < 1."""

    gae_lambda: float
    """Weight lambda of generalised advantage estimation, 0 <= lambda <= 1."""

    bound_coef: float = 0.0
    """Weight of the penalty on action means outside [-1.1, 1.1]; not with Sample Factory, >= 0."""

    reward_scale: float = 1.0
    """Factor on the reward that the learner sees, > 0."""

    normalize_value: bool = True
    """Whether returns are normalised by their running mean and deviation."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require_positive(self, "reward_scale")
        name = type(self).__name__
        if not 0.0 <= self.bound_coef < inf:
            raise ConfigError(f"{name}.bound_coef = {self.bound_coef!r}: must be >= 0 and finite")
        if not 0.0 < self.discount < 1.0:
            raise ConfigError(f"{name}.discount = {self.discount!r}: must be between 0 and 1")
        if not 0.0 <= self.gae_lambda <= 1.0:
            raise ConfigError(f"{name}.gae_lambda = {self.gae_lambda!r}: must be from 0 to 1")


@dataclass(frozen=True, kw_only=True)
class PpoCfg(ReturnCfg):
    """Numbers of Proximal Policy Optimisation."""

    num_minibatches: int
    """Parts into which the horizon times E samples are split; must divide them, >= 1."""

    num_epochs: int
    """Passes over the samples per update, >= 1."""

    learning_rate: float
    """Step of Adam at first, > 0; it adapts to ``kl_threshold``, up to the following."""

    max_learning_rate: float
    """Largest learning rate at first, > 0; it falls linearly with the share of the time or steps that is used, whichever is
    larger. Trainings with ``max_env_steps`` alone repeat bit for bit on a CPU; time does not."""

    end_learning_rate: float
    """Largest learning rate at the end, > 0."""

    kl_threshold: float
    """Divergence between old and new policy about which the learning rate adapts [nat], > 0."""

    clip_range: float = 0.2
    """Range of the probability ratio, > 0."""

    clip_value: bool = False
    """Whether the change of the value is clipped to ``clip_range`` as well."""

    value_coef: float
    """Weight of the value loss as the library defines it, > 0; in ``ppo`` the loss is half the mean squared error."""

    entropy_coef: float = 0.0
    """Weight of the entropy bonus, >= 0."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require_positive(
            self, "learning_rate", "max_learning_rate", "end_learning_rate", "kl_threshold", "clip_range", "value_coef"
        )
        require_count(self, "num_minibatches", "num_epochs")
        if not 0.0 <= self.entropy_coef < inf:
            raise ConfigError(f"PpoCfg.entropy_coef = {self.entropy_coef!r}: must be >= 0 and finite")

    def max_learning_rate_at(self, share: float) -> float:
        """Return the largest learning rate after a share, 0 to 1, of the training."""
        return self.max_learning_rate + (self.end_learning_rate - self.max_learning_rate) * min(max(share, 0.0), 1.0)


@dataclass(frozen=True, kw_only=True)
class ApgCfg(ReturnCfg):
    """Numbers of the short-horizon actor-critic with analytic policy gradients."""

    separate_value_network: bool = True
    """Always: the value has hidden layers of its own."""

    learning_rate: float
    """Step of Adam of the policy at first, > 0; it falls linearly with the share of the time or steps that is used,
    whichever is larger."""

    end_learning_rate: float
    """That at the end, > 0."""

    terminal_value: bool = False
    """Whether the value of the last state of a window, and of an episode that was truncated, counts as well. If not, the
    critic learns nothing, and windows must be as long as an action takes to show in the reward."""

    gae_lambda: float = 0.95
    """Weight lambda of the returns from which the critic learns, 0 <= lambda <= 1. This and the following numbers of the critic
    are those of Xu et al. (2022), table 4."""

    critic_learning_rate: float = 2.0e-3
    """Step of Adam of the critic at first, > 0; it falls in the same proportion as that of the policy."""

    critic_epochs: int = 16
    """Passes of the critic over the samples of a window, >= 1."""

    critic_minibatches: int = 4
    """Parts into which the samples of a window are split for it, >= 1."""

    target_share: float = 0.8
    """Share of the critic that the one that judges the ends of windows takes over after every window, > 0 and <= 1: 1 less the
    share of the old one that is kept, 0.2 in Xu et al. (2022)."""

    capture: bool = True
    """Whether a window and its updates are held in one CUDA graph on a GPU."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require_positive(self, "learning_rate", "end_learning_rate", "critic_learning_rate", "target_share")
        require_count(self, "critic_epochs", "critic_minibatches")
        if self.target_share > 1.0:
            raise ConfigError(f"ApgCfg.target_share = {self.target_share!r}: must be at most 1")
        if not self.separate_value_network:
            raise ConfigError("ApgCfg.separate_value_network = False: must be true, the critic learns at its own pace")
        if self.memory:
            raise ConfigError(f"ApgCfg.memory = {self.memory!r}: apg has policies without memory. Train with ppo")


@dataclass(frozen=True, kw_only=True)
class DistillCfg(LearnerCfg):
    """Numbers of a student that learns to do what its teacher does."""

    num_minibatches: int
    """Parts into which the environments are split, >= 1."""

    num_epochs: int
    """Passes over a segment, >= 1."""

    learning_rate: float
    """Step of Adam at first, > 0; it falls linearly with the share of the time or steps that is used, whichever is larger."""

    end_learning_rate: float
    """That at the end, > 0."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require_positive(self, "learning_rate", "end_learning_rate")
        require_count(self, "num_minibatches", "num_epochs")
        if self.separate_value_network:
            raise ConfigError(
                "DistillCfg.separate_value_network = True: nothing values what a student does. Leave it out"
            )


Section = TypeVar("Section", bound=LearnerCfg)

ALIKE = {
    "dce_navigation_task": "navigation_task",
    "position_setpoint_task_acceleration_sim2real": "position_setpoint_task_sim2real",
    "position_setpoint_task_morphy_paper": "position_setpoint_task_morphy",
    "position_setpoint_task_morphy_stiff": "position_setpoint_task_morphy",
    "radar_navigation_task": "lidar_navigation_task",
    "radar_navigation_task_held": "lidar_navigation_task",
    "racing_random_track_task": "racing_task",
}
"""Tasks that are trained with the settings of another one, as long as they have none of their own."""

SECTIONS = ("ppo", "apg", "distill", "numbers")
"""Fields of ``TrainingCfg`` with the numbers of a learner; a training has one of them."""


@dataclass(frozen=True, kw_only=True)
class TrainingCfg:
    """One training: written as ``config.yaml`` into its run folder, from which it can be repeated."""

    summary: str = ""
    """One line for people who choose settings."""

    task: str
    """Registered task."""

    trainer: str
    """Registered trainer."""

    num_envs: int
    """Environments side by side, in each process if there are several, >= 1."""

    device: str = "auto"
    """Torch device; auto takes the GPU if there is one."""

    seed: int = 0
    """Seed of the task and of the trainer, >= 0."""

    robot: str | None = None
    """Registered robot, or a robot file, in place of the task's own."""

    controller: str | None = None
    """Registered controller in place of the task's own."""

    backend: str | None = None
    """Registered physics backend in place of the sim's own."""

    encoder: str | None = None
    """Encoder file, or one that comes with the package, in place of the task's own; a run folder keeps a copy of a file."""

    torch_threads: int | None = None
    """Threads of torch on the CPU, >= 1; None leaves torch's own choice."""

    max_time_s: float | None = None
    """The training ends after this time, start-up included [s], > 0."""

    max_env_steps: int | None = None
    """The training ends after this many environment steps in all sessions and processes together, >= 1."""

    checkpoint_every_s: float = 30.0
    """Time between checkpoints [s], > 0."""

    teacher: str | None = None
    """Run folder of a training, or one checkpoint in it, whose policy ``distill`` hands on."""

    initial: str | None = None
    """Run folder of a training with ``ppo``, or one checkpoint in it, with whose networks ``ppo`` begins; what is seen besides
    stands behind what those saw, and counts for nothing at first."""

    ppo: PpoCfg | None = None
    """Numbers of the learner, of every trainer but the following."""

    apg: ApgCfg | None = None
    """Those of ``apg``."""

    distill: DistillCfg | None = None
    """Those of ``distill``."""

    numbers: Mapping[str, object] | None = None
    """Those of a trainer with settings of its own class, by the fields of that class."""

    source: str
    """Where the numbers come from."""

    @cached_property
    def learner(self) -> LearnerCfg:
        """Numbers of its trainer."""
        trainer = TRAINERS.get(self.trainer)
        return convert(trainer.settings, getattr(self, trainer.section), trainer.section)

    def section(self, kind: type[Section]) -> Section:
        """Return the numbers of its trainer as settings of a class."""
        found = self.learner
        assert isinstance(found, kind)
        return found

    def __post_init__(self) -> None:
        require_positive(self, "checkpoint_every_s")
        trainer = TRAINERS.get(self.trainer)
        for name in ("max_time_s", "max_env_steps", "torch_threads"):
            value = getattr(self, name)
            if value is not None and not 0 < value < inf:
                raise ConfigError(f"TrainingCfg.{name} = {value!r}: must be > 0 and finite")
        if self.max_time_s is None and self.max_env_steps is None:
            raise ConfigError("TrainingCfg: give max_time_s, max_env_steps or both, or the training never ends")
        require_count(self, "num_envs")
        if not 0 <= self.seed < 2**32:  # NumPy takes no larger one
            raise ConfigError(f"TrainingCfg.seed = {self.seed!r}: must be >= 0 and less than 2**32")
        if [name for name in SECTIONS if getattr(self, name) is not None] != [trainer.section]:
            raise ConfigError(
                f"TrainingCfg: trainer {self.trainer} needs its numbers under {trainer.section}, and no others"
            )
        if self.teacher is not None and not trainer.takes_teacher:
            raise ConfigError(
                f"TrainingCfg.teacher = {self.teacher}: trainer {self.trainer} has none. "
                f"Use {trainers_with('takes_teacher')}"
            )
        if self.initial is not None and not trainer.takes_initial:
            raise ConfigError(
                f"TrainingCfg.initial = {self.initial}: trainer {self.trainer} begins anew. "
                f"Use {trainers_with('takes_initial')}"
            )
        learner = self.learner
        special = learner.memory or learner.critic_keys
        special = special or learner.policy_keys != ("observations",)
        if special and not trainer.any_inputs:
            raise ConfigError(f"TrainingCfg: memory, policy_keys and critic_keys need trainer ppo, not {self.trainer}")
        if self.ppo is None:
            return
        samples, parts = self.num_envs * self.ppo.horizon, self.ppo.num_minibatches
        if samples % parts:
            raise ConfigError(
                f"TrainingCfg: num_envs * horizon = {samples} samples cannot be split into num_minibatches = {parts}"
            )


def settings_for(trainer: str, task: str, *, device: str = "auto") -> Path:
    """Return the file of settings of a trainer for a task and a device.

    A task without settings of its own gets those of the one in ``ALIKE``, or of the position task, and a level of a race
    (``.toml``) those of ``racing_task``; the file's name is printed with the run. On a CPU those for a CPU come first.

    Raises:
        UnknownNameError: If there is no such trainer.
    """
    folder = TRAINERS.get(trainer).settings_folder
    like = "racing_task" if task.endswith(".toml") else ALIKE.get(task, task)
    tasks = (task, like, "position_setpoint_task")
    found = [folder / f"{trainer}_{name.removesuffix('_task')}.yaml" for name in tasks]
    own = next((path for path in found if path.exists()), found[-1])
    for_cpu = [path.with_name(f"{path.stem}_cpu.yaml") for path in (own, *found[:2])]
    on_cpu = next((path for path in for_cpu if path.exists()), None)
    return own if on_cpu is None or resolve_device(device).type != "cpu" else on_cpu


def load_settings(path: str | Path) -> TrainingCfg:
    """Return the training in a YAML file, which may extend another (``config.extends``)."""
    return load_extended(TrainingCfg, path, family="training")
