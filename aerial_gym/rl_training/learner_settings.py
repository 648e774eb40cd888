"""Settings of networks and learners: one class for each algorithm.

All trainers with PPO share ``PpoCfg``; the modules of ``adapters`` translate it for other libraries.
Letters: E environments.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

from aerial_gym.config.checks import MAX_MADE, require, require_count, require_not_negative, require_positive
from aerial_gym.errors import ConfigError


@dataclass(frozen=True, kw_only=True)
class LearnerCfg:
    """Settings of networks and rollouts that all learners share."""

    hidden_layers: tuple[int, ...]  # Widths of the hidden layers, each >= 1
    separate_value_network: bool = False  # Whether the value has separate hidden layers
    activation: str = "elu"  # `elu`, `relu` or `tanh`
    memory: int = 0  # Size of a gated recurrent unit after the hidden layers; 0: none. `ppo` only

    policy_keys: tuple[str, ...] = ("observations",)
    """Inputs of the policy by key of the observation: vectors, images (C, H, W). Only ``ppo`` takes other keys."""

    critic_keys: tuple[str, ...] = ()  # Inputs of the value; default: the policy's. With separate value network

    sets: Mapping[str, int] = field(default_factory=dict)
    """Numbers of an entity by the keys that are sets of entities, such as ``neighbours: 7``; attention pools their features.
    The last number of an entity says whether it is there. ``ppo`` only."""

    initial_std: float = 1.0  # Standard deviation of the actions before learning, in units of the action, > 0

    min_std: float = 0.05
    """Lower bound of the learned standard deviation, > 0. rl-games adds 1e-5 to variances: far below 0.05 its divergence
    and so its learning rate are wrong."""

    head_variance: float = 1.0
    """Initial variance of the weights of the action layer, times its width, > 0. Small: first actions are near zero."""

    horizon: int  # Steps of every environment per update, >= 1
    max_grad_norm: float = 1.0  # Largest norm of the gradient, > 0
    normalize_observation: bool = True  # Whether observations are normalised by their running mean and deviation

    def __post_init__(self) -> None:
        require_positive(self, "initial_std", "head_variance", "max_grad_norm")
        require_count(self, "horizon")
        name = type(self).__name__
        require(self, "activation", self.activation in ("elu", "relu", "tanh"), "must be elu, relu or tanh")
        require(self, "memory", 0 <= self.memory <= MAX_MADE, f"must be >= 0 and at most {MAX_MADE:,}")
        if not self.policy_keys or (self.critic_keys and not self.separate_value_network):
            raise ConfigError(
                f"{name}: policy_keys = {self.policy_keys!r}, critic_keys = {self.critic_keys!r}: the policy must see "
                "something; a critic with keys of its own needs separate_value_network"
            )
        holds = bool(self.hidden_layers) and all(1 <= width <= MAX_MADE for width in self.hidden_layers)
        require(self, "hidden_layers", holds, f"needs widths >= 1 and at most {MAX_MADE:,}")


@dataclass(frozen=True, kw_only=True)
class ReturnCfg(LearnerCfg):
    """Settings of learners from rewards."""

    discount: float  # Discount gamma, 0 < gamma < 1
    gae_lambda: float  # Weight lambda of generalised advantage estimation, 0 <= lambda <= 1
    bound_coef: float = 0.0  # Weight of the penalty on action means outside [-1.1, 1.1]; not with Sample Factory, >= 0
    reward_scale: float = 1.0  # Factor on the reward that the learner sees, > 0
    normalize_value: bool = True  # Whether returns are normalised by their running mean and deviation

    def __post_init__(self) -> None:
        super().__post_init__()
        require_positive(self, "reward_scale")
        require_not_negative(self, "bound_coef")
        require(self, "discount", 0.0 < self.discount < 1.0, "must be between 0 and 1")
        require(self, "gae_lambda", 0.0 <= self.gae_lambda <= 1.0, "must be from 0 to 1")


@dataclass(frozen=True, kw_only=True)
class PpoCfg(ReturnCfg):
    """Settings of proximal policy optimisation."""

    num_minibatches: int  # Number of minibatches of the horizon times E samples; must divide them, >= 1
    num_epochs: int  # Passes over the samples per update, >= 1
    learning_rate: float  # Initial learning rate of Adam, > 0. It adapts to `kl_threshold`, up to `max_learning_rate`

    max_learning_rate: float
    """Initial upper bound of the learning rate, > 0. It falls linearly with the elapsed share of time or steps, whichever is
    larger. On a CPU, trainings with ``max_env_steps`` alone repeat bit for bit."""

    end_learning_rate: float  # Final upper bound of the learning rate, > 0
    kl_threshold: float  # Target divergence between old and new policy [nat], > 0
    clip_range: float = 0.2  # Clip range of the probability ratio, > 0
    clip_value: bool = False  # Whether the change of the value is clipped to `clip_range` as well

    value_coef: float
    """Weight of the value loss as the library defines it, > 0; in ``ppo`` the loss is half the mean squared error."""

    entropy_coef: float = 0.0  # Weight of the entropy bonus, >= 0

    opponents: int = 0
    """Number of past policies that each side of a self-play keeps as opponents; 0: the evader of ``pursuit_task`` flees by
    its rule. ``ppo`` only, in one process."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require(self, "opponents", 0 <= self.opponents <= MAX_MADE, f"must be >= 0 and at most {MAX_MADE:,}")
        require(self, "opponents", not (self.opponents and self.memory), "self-play needs policies without memory")
        require_positive(
            self, "learning_rate", "max_learning_rate", "end_learning_rate", "kl_threshold", "clip_range", "value_coef"
        )
        require_count(self, "num_minibatches", "num_epochs")
        require_not_negative(self, "entropy_coef")

    def learning_rate_limit(self, share: float) -> float:
        """Return the upper bound of the learning rate after a share, 0 to 1, of the training."""
        return self.max_learning_rate + (self.end_learning_rate - self.max_learning_rate) * min(max(share, 0.0), 1.0)


@dataclass(frozen=True, kw_only=True)
class ApgCfg(ReturnCfg):
    """Settings of the short-horizon actor-critic with analytic policy gradients.

    Defaults of the critic: Xu et al. (2022), table 4.
    """

    separate_value_network: bool = True  # Must be true

    learning_rate: float
    """Initial learning rate of the policy, > 0. It falls linearly with the elapsed share of time or steps, whichever is
    larger."""

    end_learning_rate: float  # Final learning rate, > 0

    terminal_value: bool = False
    """Whether the return includes the value of the last state of a window or of a truncated episode. If not, the critic
    does not learn, and a window must be as long as the delay from an action to its reward."""

    gae_lambda: float = 0.95  # Weight lambda of the returns of the critic, 0 <= lambda <= 1
    critic_learning_rate: float = 2.0e-3  # Initial learning rate of the critic, > 0; it falls with that of the policy
    critic_epochs: int = 16  # Passes of the critic over the samples of a window, >= 1
    critic_minibatches: int = 4  # Number of minibatches of the critic per pass, >= 1

    target_share: float = 0.8
    """Update rate of the target critic per window, > 0 and <= 1: one minus the kept share, which Xu et al. (2022) call 0.2."""

    capture: bool = True  # Whether a window and its updates are one CUDA graph on a GPU

    def __post_init__(self) -> None:
        super().__post_init__()
        require_positive(self, "learning_rate", "end_learning_rate", "critic_learning_rate", "target_share")
        require_count(self, "critic_epochs", "critic_minibatches")
        require(self, "target_share", self.target_share <= 1.0, "must be at most 1")
        own_pace = "must be true, the critic learns at its own pace"
        require(self, "separate_value_network", self.separate_value_network, own_pace)
        require(self, "memory", not self.memory, "apg has policies without memory. Train with ppo")


@dataclass(frozen=True, kw_only=True)
class DistillCfg(LearnerCfg):
    """Settings of a student that imitates a teacher."""

    num_minibatches: int  # Number of minibatches of environments, >= 1
    num_epochs: int  # Passes over a rollout, >= 1

    learning_rate: float
    """Initial learning rate, > 0. It falls linearly with the elapsed share of time or steps, whichever is larger."""

    end_learning_rate: float  # Final learning rate, > 0

    def __post_init__(self) -> None:
        super().__post_init__()
        require_positive(self, "learning_rate", "end_learning_rate")
        require_count(self, "num_minibatches", "num_epochs")
        if self.separate_value_network:
            raise ConfigError("DistillCfg.separate_value_network = True: distill has no value network. Leave it out")
