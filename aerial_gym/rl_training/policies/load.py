"""A trained policy as a plain function: observation normaliser, multi-layer perceptron, clamp to the action space.

It needs neither trainer installed and is an ordinary ``torch.nn.Module``, so that it can be exported.
Letters: E environments, O entries of an observation, U entries of an action.
"""

from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path

import torch
from torch import Tensor, nn

from aerial_gym.errors import ConfigError
from aerial_gym.rl_training.run import checkpoint
from aerial_gym.rl_training.run.run_folder import RunFolder, run_folder_of
from aerial_gym.rl_training.settings import TrainingCfg
from aerial_gym.task import Task

NORMALIZER_EPSILON = 1e-5
"""Added to the variance by both libraries (``RunningMeanStd``, ``RunningMeanStdInPlace``)."""

NORMALIZER_LIMIT = 5.0
"""Both libraries clamp the normalised observation to this."""

ACTIVATIONS = {"elu": nn.ELU, "relu": nn.ReLU, "tanh": nn.Tanh}
"""By the name in the settings."""


def check_fits(policy: "Policy", task: Task, cfg: TrainingCfg) -> None:
    """Raise ``ConfigError`` if a policy does not take the observations of a task, or does not give its actions."""
    space, actions = task.observation_space["observations"], task.action_space
    assert space.shape is not None
    assert actions.shape is not None
    if (policy.num_observations, policy.num_actions) != (space.shape[0], actions.shape[0]):
        raise ConfigError(
            f"policy of {cfg.task}: takes {policy.num_observations} observations and gives {policy.num_actions} actions; this "
            f"task has {space.shape[0]} and {actions.shape[0]}. Give it the task, robot and controller of its training"
        )


class Policy(nn.Module):
    """The mean action of a trained policy, ``clamp(W_n ... f(W_1 n(o) + b_1) ... + b_n)``, deterministic."""

    mean: Tensor
    std: Tensor

    def __init__(
        self, layers: list[tuple[Tensor, Tensor]], *, mean: Tensor, std: Tensor, limit: float, activation: str
    ) -> None:
        """Take weights (out, in) and biases (out,) of all layers and the normaliser ``clamp((o - mean) / std, +-limit)``."""
        super().__init__()
        parts: list[nn.Module] = []
        for weight, bias in layers:
            linear = nn.Linear(weight.shape[1], weight.shape[0])
            linear.weight.data.copy_(weight)
            linear.bias.data.copy_(bias)
            parts += [linear, ACTIVATIONS[activation]()]
        self.network = nn.Sequential(*parts[:-1])
        self.register_buffer("mean", mean.float())
        self.register_buffer("std", std.float())
        self.limit = limit
        self.num_observations, self.num_actions = mean.shape[0], layers[-1][1].shape[0]
        self.requires_grad_(False)
        self.eval()

    def forward(self, observation: Tensor) -> Tensor:
        """Return actions (E, U) in [-1, 1] for observations (E, O)."""
        normal = ((observation - self.mean) / self.std).clamp(-self.limit, self.limit)
        return self.network(normal).clamp(-1.0, 1.0)


def load_policy(source: str | Path, *, device: str | torch.device = "cpu") -> tuple[Policy, TrainingCfg]:
    """Return the policy and the settings of a run folder, or of one checkpoint inside a run folder.

    Raises:
        ConfigError: If there is no such run or checkpoint, or it does not hold the network of its settings.
    """
    source = Path(source)
    folder = RunFolder(source) if source.is_dir() else run_folder_of(source)
    file = folder.last_checkpoint() if source.is_dir() else source
    cfg = folder.config()
    policy = policy_from_state(_read(file), cfg, where=str(file))
    return policy.to(device), cfg


def policy_from_state(state: Mapping[str, Tensor], cfg: TrainingCfg, *, where: str) -> Policy:
    """Return the policy in the model state of either trainer; ``where`` is named in errors."""
    reader = _read_rl_games if cfg.trainer == "rl_games" else _read_sample_factory
    try:
        layers, mean, var = reader(state, len(cfg.ppo.hidden_layers))
    except KeyError as error:
        raise ConfigError(
            f"{where}: no {error} in it; it is no {cfg.trainer} checkpoint of {cfg.ppo.hidden_layers}"
        ) from None
    for kind, tensor in [
        *((f"layer {i}", t) for i, pair in enumerate(layers) for t in pair),
        ("mean", mean),
        ("var", var),
    ]:
        if tensor is not None and not bool(tensor.isfinite().all()):
            bad = int((~tensor.isfinite()).sum())
            raise ConfigError(
                f"{where}: {kind} holds {bad} numbers that are NaN or infinite: the training diverged. "
                "Take an earlier checkpoint"
            )
    num_in = layers[0][0].shape[1]
    if mean is None or var is None:
        mean, std = torch.zeros(num_in), torch.ones(num_in)
    else:
        std = (var.double() + NORMALIZER_EPSILON).sqrt()
    for (_, bias), (weight, _) in pairwise(layers):
        if bias.shape[0] != weight.shape[1]:
            raise ConfigError(f"{where}: layers of widths {bias.shape[0]} and {weight.shape[1]} do not fit together")
    limit = NORMALIZER_LIMIT if cfg.ppo.normalize_observation else float("inf")
    return Policy(layers, mean=mean, std=std, limit=limit, activation=cfg.ppo.activation)


Weights = tuple[list[tuple[Tensor, Tensor]], Tensor | None, Tensor | None]
"""Layers, mean and variance of the observation."""


def _layer(state: Mapping[str, Tensor], prefix: str) -> tuple[Tensor, Tensor]:
    return state[f"{prefix}.weight"], state[f"{prefix}.bias"]


def _read_rl_games(state: Mapping[str, Tensor], num_hidden: int) -> Weights:
    state = {key.removeprefix("_orig_mod."): value for key, value in state.items()}  # prefix of a compiled model
    layers = [_layer(state, f"a2c_network.actor_mlp.{2 * i}") for i in range(num_hidden)]
    normalizer = "running_mean_std.running_"
    return [*layers, _layer(state, "a2c_network.mu")], state.get(f"{normalizer}mean"), state.get(f"{normalizer}var")


def _read_sample_factory(state: Mapping[str, Tensor], num_hidden: int) -> Weights:
    encoder = "actor_encoder" if any(key.startswith("actor_encoder.") for key in state) else "encoder"
    layers = [_layer(state, f"{encoder}.encoders.obs.mlp_head.{2 * i}") for i in range(num_hidden)]
    normalizer = "obs_normalizer.running_mean_std.running_mean_std.obs.running_"
    head = _layer(state, "action_parameterization.distribution_linear")
    return [*layers, head], state.get(f"{normalizer}mean"), state.get(f"{normalizer}var")


def _read(path: Path) -> Mapping[str, Tensor]:
    model = checkpoint.load(path).get("model")
    if not isinstance(model, Mapping) or not all(isinstance(value, Tensor) for value in model.values()):
        raise ConfigError(f"checkpoint {path}: holds no network")
    return model
