"""New networks for a training."""

import torch

from aerial_gym.errors import ConfigError
from aerial_gym.rl_training.policies.actor_critic import ActorCritic
from aerial_gym.rl_training.policies.load import body_cfg
from aerial_gym.rl_training.policies.policy import Policy
from aerial_gym.rl_training.settings import TrainingCfg
from aerial_gym.task import Task


def make_network(cfg: TrainingCfg, task: Task) -> ActorCritic:
    """Return a new network for the settings and the observations of a task, on its device; drawn from the seed alone.

    Raises:
        ConfigError: If the task has no observation of a key.
    """
    learner = cfg.learner
    shapes = task.observation_shapes
    for key in (*learner.policy_keys, *learner.critic_keys):
        if key not in shapes:
            raise ConfigError(f"task {cfg.task} has no observation {key!r}. Known: {', '.join(sorted(shapes))}")
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(cfg.seed)
        acting = body_cfg(cfg, {key: shapes[key] for key in learner.policy_keys})
        judging = body_cfg(cfg, {key: shapes[key] for key in learner.critic_keys or learner.policy_keys})
        actor = Policy(acting, task.num_actions, initial_std=learner.initial_std, head_variance=learner.head_variance)
        network = ActorCritic(actor, judging if learner.separate_value_network else None)
    return network.to(task.device)
