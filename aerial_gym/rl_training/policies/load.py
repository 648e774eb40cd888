"""Read trained policies from checkpoints of any trainer, without its library, and initial weights of another training.

Letters: O entries of an observation, H width of the first layer.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any, Protocol

import torch
from torch import Tensor, nn
from torch.nn.functional import pad

from aerial_gym.config.storage import read_archive
from aerial_gym.errors import ConfigError
from aerial_gym.interop import resolve_device, usual_settings
from aerial_gym.rl_training.learner_settings import PpoCfg
from aerial_gym.rl_training.policies.actor_critic import ActorCritic
from aerial_gym.rl_training.policies.body import LIMIT, NetworkBodyCfg, RunningNormalizer
from aerial_gym.rl_training.policies.catalog import policy_path
from aerial_gym.rl_training.policies.policy import Policy
from aerial_gym.rl_training.run.run_folder import RunFolder, run_folder_of_checkpoint
from aerial_gym.rl_training.settings import TrainingCfg
from aerial_gym.rl_training.trainers.catalog import TRAINERS
from aerial_gym.task import Task


class PolicyShapes(Protocol):
    """A policy with known observations and actions."""

    @property
    def shapes(self) -> Mapping[str, tuple[int, ...]]:
        """Shapes of its inputs for one environment, by key of the observation."""
        ...

    @property
    def num_actions(self) -> int:
        """Number of entries of an action."""
        ...


def check_fits(policy: PolicyShapes, task: Task, trained_on: str) -> None:
    """Raise ``ConfigError`` if observations or actions of a policy and a task differ."""
    spaces, actions = task.observation_space, task.action_space
    assert actions.shape is not None
    has = {key: tuple(spaces[key].shape or ()) for key in spaces.spaces}
    if any(has.get(key) != shape for key, shape in policy.shapes.items()) or policy.num_actions != actions.shape[0]:
        raise ConfigError(
            f"policy of {trained_on}: takes {format_shapes(policy.shapes)} and gives {policy.num_actions} actions; this "
            f"task has {format_shapes(has)} and {actions.shape[0]}. Give it the task, robot and controller of its training"
        )


def format_shapes(shapes: Mapping[str, tuple[int, ...]]) -> str:
    """Return keys and shapes as text."""
    return ", ".join(f"{' x '.join(str(n) for n in shape)} {key}" for key, shape in sorted(shapes.items()))


@usual_settings
def load_policy(source: str | Path, *, device: str | torch.device = "cpu") -> tuple[Policy, TrainingCfg]:
    """Return the policy and the settings of a run folder, of one checkpoint in it, or of ``pretrained/NAME``.

    Raises:
        ConfigError: If there is no such run or checkpoint or device, or it does not hold the network of its settings.
    """
    file, cfg = find_checkpoint(source)
    payload = read_archive(file, "checkpoint")
    return policy_from_payload(payload, cfg, where=str(file)).to(resolve_device(device)), cfg


def find_checkpoint(source: str | Path) -> tuple[Path, TrainingCfg]:
    """Return the given checkpoint, or the last one of a run folder, and the settings of the run."""
    source = policy_path(source)
    folder = RunFolder(source) if source.is_dir() else run_folder_of_checkpoint(source)
    return folder.last_checkpoint() if source.is_dir() else source, folder.config()


def policy_from_payload(payload: Mapping[str, Any], cfg: TrainingCfg, *, where: str) -> Policy:
    """Return the policy in the payload of a checkpoint; ``where`` is named in errors."""
    model = payload.get("model")
    if not isinstance(model, Mapping) or not all(isinstance(value, Tensor) for value in model.values()):
        raise ConfigError(f"checkpoint {where}: holds no network")
    return TRAINERS.get(cfg.trainer).policy(payload, cfg, where=where)


EVADER = "evader"  # Observation group of a learned evader, and its networks in a checkpoint


def evader_settings(cfg: TrainingCfg) -> TrainingCfg:
    """Return the settings of the evader of a self-play: those of the pursuers with observations of its own."""
    keys = {"policy_keys": (EVADER,), "critic_keys": (EVADER,) if cfg.section(PpoCfg).separate_value_network else ()}
    return replace(cfg, ppo=replace(cfg.section(PpoCfg), sets={}, **keys))


@usual_settings
def load_evader(source: str | Path, *, device: str | torch.device = "cpu") -> Policy:
    """Return the evader of a self-play, from its run folder or a checkpoint in it.

    Raises:
        ConfigError: If there is no such run or checkpoint or device, or it holds no evader.
    """
    file, cfg = find_checkpoint(source)
    evader = read_archive(file, "checkpoint").get(EVADER)
    if evader is None:
        raise ConfigError(f"{file}: holds no evader. Train one: --task pursuit_task --set ppo.opponents=8")
    return native_policy(evader, evader_settings(cfg), where=str(file)).to(resolve_device(device))


def native_policy(payload: Mapping[str, Any], cfg: TrainingCfg, *, where: str) -> Policy:
    """Return the policy in a checkpoint of a learner of this package."""
    model, network = payload["model"], payload.get("network") or {}
    state = {name.removeprefix("actor."): value for name, value in model.items() if name.startswith("actor.")}
    _check_finite(state.items(), where)
    try:
        shapes = {str(key): tuple(int(size) for size in network["shapes"][key]) for key in cfg.learner.policy_keys}
        body = replace(body_cfg(cfg, shapes), limit=float(network.get("limit", LIMIT)))
        policy = Policy(body, int(network["num_actions"]))
        policy.load_state_dict(state)
    except (KeyError, TypeError, ValueError, RuntimeError) as error:
        reason = str(error).strip().splitlines()[-1].strip()
        raise ConfigError(f"{where}: does not hold the network of its settings ({reason})") from None
    return _freeze_weights(policy)


def body_cfg(cfg: TrainingCfg, shapes: Mapping[str, tuple[int, ...]]) -> NetworkBodyCfg:
    """Return the settings of a policy's body for observations of these shapes."""
    learner = cfg.learner
    return NetworkBodyCfg(
        shapes=shapes, hidden_layers=learner.hidden_layers, activation=learner.activation, memory=learner.memory,
        normalize=learner.normalize_observation,
        sets={key: width for key, width in learner.sets.items() if key in shapes},
    )  # fmt: skip


def make_network(cfg: TrainingCfg, task: Task) -> ActorCritic:
    """Return a new network for the settings and the observations of a task, on its device; drawn from the seed alone."""
    learner = cfg.learner
    shapes = task.observation_shapes
    for key in (*learner.policy_keys, *learner.critic_keys, *learner.sets):
        if key not in shapes:
            raise ConfigError(f"task {cfg.task} has no observation {key!r}. Known: {', '.join(sorted(shapes))}")
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(cfg.seed)
        acting = body_cfg(cfg, {key: shapes[key] for key in learner.policy_keys})
        judging = body_cfg(cfg, {key: shapes[key] for key in learner.critic_keys or learner.policy_keys})
        actor = Policy(acting, task.num_actions, initial_std=learner.initial_std, head_variance=learner.head_variance)
        network = ActorCritic(actor, judging if learner.separate_value_network else None)
    return network.to(task.device)


def _freeze_weights(policy: Policy) -> Policy:
    policy.requires_grad_(False)
    return policy.eval()


def _check_finite(tensors: Iterable[tuple[str, Tensor]], where: str) -> None:
    for name, tensor in tensors:
        if not bool(tensor.isfinite().all()):
            bad = int((~tensor.isfinite()).sum())
            raise ConfigError(
                f"{where}: {name} holds {bad} numbers that are NaN or infinite: the training diverged. "
                "Take an earlier checkpoint"
            )


Weights = tuple[list[tuple[Tensor, Tensor]], Tensor | None, Tensor | None]  # Layers; mean and variance, or None


def policy_from_weights(weights: Weights, cfg: TrainingCfg, *, where: str, limit: float = LIMIT) -> Policy:
    """Return a policy of linear layers and a normaliser with its limit; ``where`` is named in errors."""
    layers, mean, var = weights
    told = [(f"layer {i}", tensor) for i, pair in enumerate(layers) for tensor in pair]
    _check_finite([*told, *(() if mean is None or var is None else (("mean", mean), ("var", var)))], where)
    for (_, bias), (weight, _) in pairwise(layers):
        if bias.shape[0] != weight.shape[1]:
            raise ConfigError(f"{where}: layers of widths {bias.shape[0]} and {weight.shape[1]} do not fit together")
    shapes = {"observations": (layers[0][0].shape[1],)}
    hidden = tuple(bias.shape[0] for _, bias in layers[:-1])
    known = mean is not None and var is not None
    body = NetworkBodyCfg(
        shapes=shapes, hidden_layers=hidden, activation=cfg.learner.activation, normalize=known, limit=limit
    )
    policy = Policy(body, layers[-1][1].shape[0])
    for linear, (weight, bias) in zip([*list(policy.body.layers)[::2], policy.head], layers, strict=True):
        assert isinstance(linear, nn.Linear)
        linear.weight.data.copy_(weight)
        linear.bias.data.copy_(bias)
    if mean is not None and var is not None:
        normalizer = policy.body.normalizers["observations"]
        assert isinstance(normalizer, RunningNormalizer)
        normalizer.set_statistics(mean, var)
    return _freeze_weights(policy)


FIRST_LAYER = ".layers.0.weight"  # End of the name of a first layer (H, O)
NORMALISED = (".mean", ".var")  # Suffixes of the names of normaliser statistics, (O,)


def load_initial_weights(
    network: ActorCritic, model: Mapping[str, Tensor], shapes: Mapping[str, Sequence[int]], *, where: str
) -> None:
    """Load the weights ``model`` of another network with input ``shapes`` by key; ``where`` is named in errors.

    Each key may have more inputs here, behind those of the other network. Their weights are zero, so that at first it acts
    like the other one. Their normaliser starts at mean 0 and deviation 1 and adapts slowly, as its sample count is large.
    """
    own = network.state_dict()
    if own.keys() != model.keys():
        raise ConfigError(
            f"{where}: has other networks than these settings ask for. Give the settings of its training (--config)"
        )
    firsts = {"actor.body": network.actor.body, "own_body": network.own_body}
    widths = {
        f"{name}{FIRST_LAYER}": (body.input_widths(shapes), body.input_widths(body.cfg.shapes))
        for name, body in firsts.items()
        if body is not None
    }
    network.load_state_dict({name: _add_inputs(name, model[name], own[name], widths.get(name), where) for name in own})


def _add_inputs(
    name: str, given: Tensor, own: Tensor, widths: tuple[list[int], list[int]] | None, where: str
) -> Tensor:
    """Return numbers in the shape of ``own``; ``widths`` of a first layer are those of its keys, given and own."""
    if widths is None and given.ndim == own.ndim == 1 and name.endswith(NORMALISED):
        widths = [len(given)], [len(own)]
    if widths is None and given.shape == own.shape:
        return given
    before, after = widths or ([], [])
    pairs = list(zip(before, after, strict=True))
    holds = (*given.shape[:-1], sum(before)) == given.shape and (*own.shape[:-1], sum(after)) == own.shape
    if not holds or given.shape[:-1] != own.shape[:-1] or any(one > other for one, other in pairs):
        raise ConfigError(
            f"{where}: {name} has shape {tuple(given.shape)}, here {tuple(own.shape)}. Only inputs may be added: give "
            "the settings of its training (--config), and a task with its actions whose observations begin with its own"
        )
    fill = 1.0 if name.endswith(".var") else 0.0
    parts = zip(given.split(before, dim=-1), pairs, strict=True)
    return torch.cat([pad(part, (0, wide - narrow), value=fill) for part, (narrow, wide) in parts], dim=-1)
