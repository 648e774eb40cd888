"""Self-play of pursuers and an evader: each side learns against present and past policies of the other one.

An iteration is an update of the pursuers and one of the evader, so that a training stays one CUDA graph. An environment
draws its opponents at the start of an episode: one of the kept policies, the present one included, and for the pursuers
the evader's rule too. The kept policies are a uniform sample of the whole training (fictitious play).
The game has zero sum: the evader's reward is the negative mean reward of its pursuers.
Letters: E environments, V pursuers of each, B = E V rows, K kept past policies, U entries of an action.

Source:
    Heinrich, Lanctot, Silver (2015), Fictitious self-play in extensive-form games, ICML, section 3; sample of past policies:
    Vitter (1985), Random sampling with a reservoir, ACM Transactions on Mathematical Software 11(1), algorithm R.
"""

from collections.abc import Mapping
from typing import cast

import torch
from torch import Tensor

from aerial_gym.errors import ConfigError
from aerial_gym.registry.state import add_prefix
from aerial_gym.rl_training.learner_settings import PpoCfg
from aerial_gym.rl_training.learning.learner import Learner
from aerial_gym.rl_training.learning.ppo import Ppo
from aerial_gym.rl_training.policies.actor_critic import ActorCritic
from aerial_gym.rl_training.policies.load import EVADER, evader_settings, make_network
from aerial_gym.rl_training.policies.policy import Policy
from aerial_gym.rl_training.policies.pursuit import set_evader
from aerial_gym.rl_training.ranks import ALONE, Ranks
from aerial_gym.rl_training.settings import TrainingCfg
from aerial_gym.task import Task
from aerial_gym.task.commands.evader import ACTION
from aerial_gym.task.task import Observation, StepResult

KEEP_EVERY = 10  # Iterations between two policies that may be kept
RULE = -1  # Opponent number of the evader's rule


class OpponentPool:
    """The present policy of a side and K past ones, and the opponent that each environment has drawn."""

    def __init__(self, policy: Policy, size: int, num_envs: int, *, with_rule: bool) -> None:
        self._policy = policy
        self._present = {**dict(policy.named_parameters()), **dict(policy.named_buffers())}
        self._kept = {name: torch.stack([value.detach()] * (size + 1)) for name, value in self._present.items()}
        device = policy.head.weight.device
        self._first = RULE if with_rule else 0
        self._offered = torch.zeros((), dtype=torch.int64, device=device)  # Policies that could be kept so far
        self._places = torch.arange(1, size + 1, device=device)
        self.choice = torch.full((num_envs,), self._first, device=device)
        """Opponent of each environment, (E,): 0 is the present policy, 1 to K are past ones, -1 is the rule."""

    def draw(self, begins: Tensor, generator: torch.Generator) -> None:
        """Draw opponents of the environments in which an episode begins, bool (E,), all with equal probability."""
        number = self._offered.clamp(max=len(self._places)) + 1 - self._first
        share = torch.rand(begins.shape, generator=generator, device=begins.device)
        drawn = (share * number).long().minimum(number - 1) + self._first
        self.choice.copy_(torch.where(begins, drawn, self.choice))

    def update(self, is_due: Tensor, generator: torch.Generator) -> None:
        """Take the present policy as opponent 0, and where ``is_due``, bool (), keep it with probability K / n."""
        size = len(self._places)
        share = torch.rand((), generator=generator, device=is_due.device)
        drawn = (share * (self._offered + 1)).long()
        place = torch.where(self._offered < size, self._offered, drawn) + 1
        taken = torch.cat((torch.ones_like(is_due).view(1), is_due & (self._places == place)))
        for name, kept in self._kept.items():
            mask = taken.view(-1, *[1] * (kept.ndim - 1))
            kept.copy_(torch.where(mask, self._present[name].detach(), kept))
        self._offered.add_(is_due.long())

    def actions(self, observation: Mapping[str, Tensor], choice: Tensor) -> Tensor:
        """Return the actions (N, U) of the chosen opponents, (N,); all policies are evaluated as one batch."""

        def act(weights: dict[str, Tensor]) -> Tensor:
            return torch.func.functional_call(self._policy, weights, (observation,))

        actions = torch.func.vmap(act)(self._kept)  # (K + 1, N, U)
        return actions.take_along_dim(choice.clamp_min(0).view(1, -1, 1), dim=0)[0]

    def state_tensors(self) -> dict[str, Tensor]:
        """Return the tensors of a saved state; they keep their memory."""
        return {"choice": self.choice, "offered": self._offered} | add_prefix("kept", self._kept)


class _Side:
    """The task as one side sees it: rows of that side, with the other one flown by its opponents."""

    def __init__(self, play: "SelfPlay", task: Task) -> None:
        self.play, self.device = play, task.device
        self.num_envs, self.num_actions = task.num_envs, task.num_actions
        self.observation_shapes = task.observation_shapes

    def rows(self, value: Tensor) -> Tensor:
        """Return the rows of this side."""
        return value

    def step(self, action: Tensor) -> StepResult:
        """Advance by an action of this side."""
        evaders = self.play.evader_pool
        seen = {key: value[:: self.play.num_vehicles] for key, value in self.play.seen.items()}
        return self.play.advance(action, evaders.actions(seen, evaders.choice), evaders.choice != RULE)


class _EvaderSide(_Side):
    """The evader's rows: one for each environment."""

    def __init__(self, play: "SelfPlay", task: Task) -> None:
        super().__init__(play, task)
        self.num_envs, self.num_actions = task.env.num_envs, task.values.own[ACTION].shape[1]

    def rows(self, value: Tensor) -> Tensor:
        """Return the row of the first pursuer of each environment, which holds what all of them share."""
        return value[:: self.play.num_vehicles]

    def step(self, action: Tensor) -> StepResult:
        """Advance by an action of the evader."""
        pursuers, count = self.play.pursuer_pool, self.play.num_vehicles
        flown = pursuers.actions(self.play.seen, pursuers.choice.repeat_interleave(count))
        learned = torch.ones(self.num_envs, dtype=torch.bool, device=self.device)
        observation, reward, terminated, truncated, info = self.play.advance(flown, action, learned)
        own = {name: self.rows(value) for name, value in info.items()}
        own["episode_return"] = self._opposite(info["episode_return"])
        seen = {key: self.rows(value) for key, value in observation.items()}
        return seen, self._opposite(reward), self.rows(terminated), self.rows(truncated), own

    def _opposite(self, reward: Tensor) -> Tensor:
        return -reward.view(-1, self.play.num_vehicles).mean(dim=1)


class SelfPlay(Learner):
    """Proximal policy optimisation of two sides in turns. ``network`` is that of the pursuers.

    Returns and lengths of episodes are those in which pursuers end while they learn; a part of such an episode was flown
    while the evader learned.
    """

    GAUGES = (*Ppo.GAUGES, *(f"evader_{name}" for name in Ppo.GAUGES))
    segments = 2

    def __init__(
        self, cfg: TrainingCfg, task: Task, network: ActorCritic, ranks: Ranks = ALONE, *, kind: type[Ppo] = Ppo
    ) -> None:
        """Take the pursuers' network; ``kind`` is the class of the learner of each side."""
        if ACTION not in task.values.own or EVADER not in task.observation_shapes:
            raise ConfigError(
                f"ppo.opponents: {cfg.task} has no evader that learns. Train pursuit_task, or give the task the command "
                "evader and a group of observations named evader"
            )
        if ranks.joined:
            raise ConfigError("ppo.opponents: self-play learns in one process. Leave torchrun out")
        super().__init__(cfg, task, network, ranks)
        self.num_vehicles, size, envs = task.num_vehicles, cfg.section(PpoCfg).opponents, task.env.num_envs
        self._evader_cfg = evader_settings(cfg)
        self._views = (_Side(self, task), _EvaderSide(self, task))
        sides = (cast(Task, view) for view in self._views)
        self._pursuers = kind(cfg, next(sides), network, ranks)
        evader_view = next(sides)
        self._evader = kind(self._evader_cfg, evader_view, make_network(self._evader_cfg, evader_view), ranks)
        self.pursuer_pool = OpponentPool(network.actor, size, envs, with_rule=False)
        self.evader_pool = OpponentPool(self._evader.network.actor, size, envs, with_rule=True)
        self._count = torch.zeros((), dtype=torch.int64, device=task.device)  # Iterations
        self.sums = self._pursuers.sums
        for learner in (self._pursuers, self._evader):
            learner.generator, learner.time_share = self.generator, self.time_share
        self.seen: Observation = {}  # Present observation of all rows

    @property
    def other_networks(self) -> Mapping[str, ActorCritic]:
        """Return the evader's network."""
        return {EVADER: self._evader.network}

    @property
    def keys(self) -> set[str]:
        """Return the keys of both sides."""
        return {*self._pursuers.keys, *self._evader.keys}

    def restart_episodes(self) -> None:
        """Restart every episode, at random ages."""
        super().restart_episodes()
        self.seen = self._observation
        for learner, view in zip((self._pursuers, self._evader), self._views, strict=True):
            learner._observation = {key: view.rows(self.seen[key]).clone() for key in learner.keys}

    def iterate(self) -> None:
        """Update the pursuers, then the evader, from a segment each."""
        with torch.no_grad():
            is_due = self._count % KEEP_EVERY == KEEP_EVERY - 1
            for pool in (self.pursuer_pool, self.evader_pool):
                pool.update(is_due, self.generator)
            self._count.add_(1)
        for learner, view in zip((self._pursuers, self._evader), self._views, strict=True):
            for key, value in learner._observation.items():
                value.copy_(view.rows(self.seen[key]))
            learner.iterate()
        self.sums[0].add_(self._task.num_envs * self._cfg.learner.horizon)  # the evader's segment
        self._evader.sums[0].copy_(self.sums[0])
        self.gauges.copy_(torch.cat((self._pursuers.gauges, self._evader.gauges)))

    def advance(self, action: Tensor, evader: Tensor, learned: Tensor) -> StepResult:
        """Advance the task by actions of pursuers, (B, U), and of evaders, (E, U); these replace the rule where ``learned``."""
        set_evader(self._task, evader, learned)
        result = self._task.step(action)
        observation, _, terminated, truncated, _ = result
        for key, value in self.seen.items():
            value.copy_(observation[key])
        begins = (terminated | truncated)[:: self.num_vehicles]
        for pool in (self.pursuer_pool, self.evader_pool):
            pool.draw(begins, self.generator)
        return result

    def state_tensors(self) -> dict[str, Tensor]:
        """Return the tensors of a saved state besides networks and task; they keep their memory."""
        parts = {
            "pursuers": self._pursuers, "evader": self._evader, "pursuer_pool": self.pursuer_pool,
            "evader_pool": self.evader_pool,
        }  # fmt: skip
        entries = {"count": self._count} | add_prefix("seen", self.seen)
        for name, part in parts.items():
            entries |= add_prefix(name, part.state_tensors())
        return entries
