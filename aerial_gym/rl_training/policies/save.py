"""Policies that Stable-Baselines3, skrl or rsl_rl trained, saved as run folders that evaluate, play and export take.

Letters: B rows, O entries of an observation, U of an action.
"""

from collections.abc import Callable
from importlib import metadata
from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from aerial_gym.errors import ConfigError
from aerial_gym.interop import usual_settings
from aerial_gym.rl_training.policies.body import EPSILON
from aerial_gym.rl_training.policies.load import policy_from_weights
from aerial_gym.rl_training.policies.policy import Policy
from aerial_gym.rl_training.run.run_folder import RunFolder
from aerial_gym.rl_training.settings import TrainingCfg
from aerial_gym.sensors.encoder.file import ACTIVATIONS
from aerial_gym.task import task_registry

NO_LIMIT = 1e30  # Limit of a normaliser that does not clamp
CHECKED, LARGEST_DIFFERENCE = 256, 1e-4  # Observations of the comparison, and the largest difference of actions


class PolicyParts(NamedTuple):
    """Parts of a policy that another library trained."""

    layers: tuple[nn.Module, ...]  # Modules of the policy, in the order of their calls
    act: Callable[[Tensor], Any]  # Its action without exploration, (B, U), for observations (B, O) on the CPU
    normalizer: tuple[Any, Any, float] | None = None  # Mean and divisor, (O,), and the limit; None without one


@torch.no_grad()
@usual_settings
def save_policy(
    learner: Any, out: str | Path, *, task: str, robot: str | None = None, controller: str | None = None,
    encoder: str | None = None,
) -> Policy:  # fmt: skip
    """Write the policy of another library into a run folder, and return it; a policy saved there before is replaced.

    Args:
        learner: Stable-Baselines3: the algorithm (PPO, A2C). skrl: the agent. rsl_rl: the runner.
        out: Run folder for ``aerial-gym evaluate``, ``play`` and ``export``; the library's own files may be there as well.
        task: Task, robot, controller and encoder of the training, as for ``task_registry.make_task``.

    Raises:
        ConfigError: If the policy is no network of linear layers from ``observations`` to actions, or a training is there.
        UnknownNameError: If the task is not registered.
    """
    task_registry.get(task)
    library, learned = _read(learner)
    layers, activation = _linear_layers(learned.layers, library)
    mean, divisor, limit = learned.normalizer or (None, None, NO_LIMIT)
    mean, divisor = (None if each is None else torch.as_tensor(each).float().cpu() for each in (mean, divisor))
    numbers = {"hidden_layers": [layer.out_features for layer in layers[:-1]], "activation": activation, "horizon": 1}
    cfg = TrainingCfg(
        summary=f"a policy of {library}", task=task, trainer="other_library", num_envs=1, max_env_steps=1, robot=robot,
        controller=controller, encoder=encoder, numbers={**numbers, "normalize_observation": mean is not None},
        source=f"{library} {metadata.version(library)}",
    )  # fmt: skip
    weights = [(layer.weight.cpu(), layer.bias.cpu()) for layer in layers]
    var = None if divisor is None else divisor**2 - EPSILON
    policy = policy_from_weights((weights, mean, var), cfg, where=str(out), limit=limit)
    seen = torch.randn(CHECKED, layers[0].in_features, generator=torch.Generator().manual_seed(0))
    seen = seen if mean is None or divisor is None else mean + 2.0 * divisor * seen
    difference = policy({"observations": seen}) - torch.as_tensor(learned.act(seen)).cpu().clamp(-1.0, 1.0)
    policy.reset()
    if not float(largest := difference.abs().max()) <= LARGEST_DIFFERENCE:
        raise _refusal(library, f"its actions are up to {float(largest):.2g} from those of its linear layers")
    folder = RunFolder(out)
    if folder.config_file.exists() and folder.config().trainer == cfg.trainer:
        folder.config_file.unlink()
    folder.create(cfg)
    state = {f"actor.{name}": tensor for name, tensor in policy.state_dict().items()}
    shapes = {key: list(shape) for key, shape in policy.shapes.items()}
    network = {"shapes": shapes, "num_actions": policy.num_actions, "limit": limit}
    folder.write_checkpoint(0, {"model": state, "network": network})
    return policy


def _read(learner: Any) -> tuple[str, PolicyParts]:
    """Return the name under which the learner's library is installed, and the parts of its policy."""
    for kind in type(learner).__mro__:
        library, read = READERS.get(kind.__module__.split(".")[0], ("", None))
        if read is not None:
            try:
                return library, read(learner)
            except (AttributeError, KeyError, TypeError) as error:
                raise _refusal(library, f"{type(learner).__name__} has no such network ({error})") from None
    rule = "must be an algorithm of Stable-Baselines3, an agent of skrl or a runner of rsl_rl"
    raise ConfigError(f"learner {type(learner).__name__}: {rule}")


def _read_stable_baselines3(algorithm: Any) -> PolicyParts:
    policy, env = algorithm.policy, algorithm.get_vec_normalize_env()

    def act(seen: Tensor) -> Any:
        given = seen.numpy() if env is None else env.normalize_obs(seen.numpy())
        return algorithm.predict(given, deterministic=True)[0]

    layers = (policy.mlp_extractor.policy_net, policy.action_net)
    if env is None or not env.norm_obs:
        return PolicyParts(layers, act)
    return PolicyParts(layers, act, (env.obs_rms.mean, (env.obs_rms.var + env.epsilon) ** 0.5, env.clip_obs))


def _read_skrl(agent: Any) -> PolicyParts:
    network, scaler = agent.models["policy"], agent._observation_preprocessor
    device = next(network.parameters()).device

    def act(seen: Tensor) -> Tensor:
        outputs = network.act({"observations": scaler(seen.to(device))}, role="policy")
        return outputs[-1].get("mean_actions", outputs[0])

    if not hasattr(scaler, "running_mean"):
        return PolicyParts((network,), act)
    divisor = scaler.running_variance.sqrt() + scaler.epsilon
    return PolicyParts((network,), act, (scaler.running_mean, divisor, scaler.clip_threshold))


def _read_rsl_rl(runner: Any) -> PolicyParts:
    actor = runner.alg.actor
    if list(actor.obs_groups) != ["observations"]:
        raise _refusal("rsl-rl-lib", f"its actor sees {', '.join(actor.obs_groups)}")
    device, scaler = next(actor.parameters()).device, actor.obs_normalizer

    def act(seen: Tensor) -> Tensor:
        return actor({"observations": seen.to(device)})

    if not hasattr(scaler, "eps"):
        return PolicyParts((actor.mlp,), act)
    return PolicyParts((actor.mlp,), act, (scaler.mean, scaler.std + scaler.eps, NO_LIMIT))


READERS: dict[str, tuple[str, Callable[[Any], PolicyParts]]] = {
    "stable_baselines3": ("stable-baselines3", _read_stable_baselines3),
    "skrl": ("skrl", _read_skrl),
    "rsl_rl": ("rsl-rl-lib", _read_rsl_rl),
}
"""By the name under which a library is imported: that under which it is installed, and the reader of its learners."""


def _linear_layers(modules: tuple[nn.Module, ...], library: str) -> tuple[list[nn.Linear], str]:
    """Return the linear layers, and the name of the activation between all of them."""
    leaves = [leaf for module in modules for leaf in module.modules() if not list(leaf.children())]
    layers = [leaf for leaf in leaves if isinstance(leaf, nn.Linear) and leaf.bias is not None]
    kinds = {type(leaf) for leaf in leaves if leaf not in layers} - {nn.Flatten, nn.Identity}
    names = [name for name, kind in ACTIVATIONS.items() if kinds == {kind}]
    if not names or len(layers) < 2:
        raise _refusal(library, f"it has {', '.join(dict.fromkeys(type(leaf).__name__ for leaf in leaves))}")
    return layers, names[0]


def _refusal(library: str, reason: str) -> ConfigError:
    return ConfigError(
        f"policy of {library}: {reason}. It must be linear layers with one of the activations {', '.join(ACTIVATIONS)} "
        "between them, from observations to mean actions without tanh, such as those of PPO"
    )
