"""Training with our own learner: simulation and updates in one CUDA graph, or step by step on a CPU."""

import logging
from collections import deque
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import torch
from torch import Tensor

from aerial_gym.errors import ConfigError
from aerial_gym.registry.state import check_state, restore, saved
from aerial_gym.rl_training.learning.fused import FusedPpo, why_not_fused
from aerial_gym.rl_training.learning.graph import Repeated
from aerial_gym.rl_training.learning.ppo import GAUGES, SUMS, Ppo
from aerial_gym.rl_training.policies.actor_critic import ActorCritic
from aerial_gym.rl_training.policies.load import body_cfg
from aerial_gym.rl_training.policies.policy import Policy
from aerial_gym.rl_training.run.interruption import Interruption
from aerial_gym.rl_training.run.keeper import Keeper
from aerial_gym.rl_training.run.progress import Progress, Report
from aerial_gym.rl_training.run.run_folder import RunFolder
from aerial_gym.rl_training.settings import TrainingCfg
from aerial_gym.rl_training.trainers.summaries import Scalars
from aerial_gym.task import Task

_log = logging.getLogger(__name__)

LOOK_EVERY = 8
"""Iterations on a GPU between two looks of the host, which is one look behind."""

RECENT_EPISODES = 100
"""Episodes over which returns and lengths are averaged, at least, as far as there are as many."""


def run(
    cfg: TrainingCfg, task: Task, folder: RunFolder, progress: Progress, *, keeper: Keeper, interruption: Interruption
) -> bool:
    """Train until a limit of ``cfg`` is reached or the user interrupts; return whether it was interrupted.

    Args:
        cfg: Settings.
        task: Built task without a graph of its own, reset by the trainer.
        folder: Receives TensorBoard files, where ``tensorboardX`` is installed.
        progress: Told after every look.
        keeper: Keeps checkpoints, and knows where to go on.
        interruption: Whether the user asked to end.

    Raises:
        StorageError: If the disk is full.
        TrainingError: If the training diverged.
        CapabilityError: If the task cannot be held in a CUDA graph.
    """
    training, scalars = Training(cfg, task), Scalars(folder.path / "ppo" / "summaries")
    if keeper.resumes:
        keeper.restore(training.load)
    else:
        keeper.save(training.state(), env_steps=0)
    try:
        while True:
            with interruption.held():
                report = training.advance()
            scalars.add(lambda: training.known | asdict(report) | task.episode_means(), training.env_steps)  # noqa: B023
            if progress.update(report):
                break
            training.learner.time_share.fill_(0.0 if cfg.max_time_s is None else progress.elapsed_s() / cfg.max_time_s)
            if keeper.due:
                keeper.save(training.state(), env_steps=training.env_steps)
        interrupted = False
    except KeyboardInterrupt:
        interrupted = True
    finally:
        scalars.close()
    keeper.save(training.state(), env_steps=training.env_steps)
    return interrupted


def make_network(cfg: TrainingCfg, task: Task) -> ActorCritic:
    """Return a new network for the settings and the observations of a task, on its device; drawn from the seed alone.

    Raises:
        ConfigError: If the task has no observation of a key.
    """
    ppo = cfg.ppo
    spaces = task.observation_space.spaces
    for key in (*ppo.policy_keys, *ppo.critic_keys):
        if key not in spaces:
            raise ConfigError(f"task {cfg.task} has no observation {key!r}. Known: {', '.join(sorted(spaces))}")
    shapes = {key: tuple(space.shape or ()) for key, space in spaces.items()}
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(cfg.seed)
        acting = body_cfg(cfg, {key: shapes[key] for key in ppo.policy_keys})
        judging = body_cfg(cfg, {key: shapes[key] for key in ppo.critic_keys or ppo.policy_keys})
        actor = Policy(acting, task.num_actions, initial_std=ppo.initial_std, head_variance=ppo.head_variance)
        network = ActorCritic(actor, judging if ppo.separate_value_network else None)
    return network.to(task.device)


class Training:
    """A learner, repeated, and what the host knows of it."""

    def __init__(self, cfg: TrainingCfg, task: Task, *, fused: bool = True) -> None:
        """Make network and learner, and start all episodes; where it can, and unless not ``fused``, in kernels of its own."""
        self._cfg, self._task = cfg, task
        network = make_network(cfg, task)
        reason = why_not_fused(cfg.ppo, network, task.device) if fused else "asked for"
        if reason is not None and task.device.type == "cuda":
            _log.info("the networks run as torch operations: %s", reason)
        self.learner = (FusedPpo if reason is None else Ppo)(cfg, task, network)
        self.learner.begin()
        self._repeat = Repeated(self.learner.iterate, task.device, generator=self.learner.generator)
        self.env_steps = 0
        """Environment steps in all sessions; the host counts them by itself."""
        self.iterations = 0
        """Iterations of this session."""
        self.known: dict[str, float] = {}
        """``GAUGES`` at the last look."""
        self._numbers = _Told(self.learner)
        self._recent: deque[list[float]] = deque([[0.0] * len(SUMS)])

    def advance(self) -> Report:
        """Iterate, on a GPU several times without waiting, and return what is known: on a GPU that of the call before."""
        per_iteration, limit = self._cfg.num_envs * self._cfg.ppo.horizon, self._cfg.max_env_steps
        for _ in range(1 if self._task.device.type == "cpu" else LOOK_EVERY):
            self._repeat()
            self.iterations += 1
            self.env_steps += per_iteration
            if limit is not None and self.env_steps >= limit:
                break
        numbers = self._numbers.look()
        _ = self._task.num_non_finite if self._task.device.type == "cpu" else 0
        return self._report(numbers)

    def _report(self, numbers: list[float]) -> Report:
        recent, self.known = self._recent, dict(zip(GAUGES, numbers[len(SUMS) :], strict=True))
        recent.append(numbers[: len(SUMS)])
        while len(recent) > 2 and recent[-1][1] - recent[1][1] >= RECENT_EPISODES:
            recent.popleft()
        episodes, total, length = (recent[-1][i] - recent[0][i] for i in (1, 2, 3))
        return Report(
            env_steps=self.env_steps,
            episode_return=total / episodes if episodes else None,
            episode_length=length / episodes if episodes else None,
        )

    def gauges(self) -> dict[str, float]:
        """Return the numbers of the last update, by name; waits for the device."""
        return dict(zip(GAUGES, self.learner.gauges.tolist(), strict=True))

    def state(self) -> dict[str, Any]:
        """Return all that is needed to go on bit for bit; waits for the device."""
        network = self.learner.network
        return {
            "model": saved(network.state_dict()),
            "network": {
                "shapes": {key: list(shape) for key, shape in network.shapes.items()},
                "num_actions": network.actor.num_actions,
            },
            "learner": saved(self.learner.state_tensors()),
            "generator": self.learner.generator.get_state(),
            "task": {name: value for name, value in self._task.save_state().items() if not _is_image(value)},
            "env_steps": self.env_steps,
        }

    def load(self, state: Mapping[str, Any]) -> None:
        """Go on from what ``state`` returned."""
        self.learner.network.load_state_dict(state["model"])
        own = self.learner.state_tensors()
        check_state(state["learner"], own)
        restore(state["learner"], own)
        self.learner.generator.set_state(state["generator"])
        now = self._task.save_state()
        self._task.load_state({name: state["task"].get(name, now[name]) for name in now})
        self.env_steps = int(state["env_steps"])
        self._recent = deque([self.learner.sums.tolist()])


def _is_image(tensor: Tensor) -> bool:
    """Say whether a tensor of a task's state holds images, (E, S, H, W): they are large, and seen anew with the next step."""
    return tensor.ndim >= 4


class _Told:
    """The learner's numbers on the host: on a GPU they are copied while it goes on, and read at the next look."""

    def __init__(self, learner: Ppo) -> None:
        self._learner = learner
        self._cuda = learner.sums.device.type == "cuda"
        self._places = [
            torch.zeros(len(SUMS) + len(GAUGES), dtype=torch.float64, pin_memory=self._cuda) for _ in range(2)
        ]
        self._events = [torch.cuda.Event() for _ in range(2)] if self._cuda else []
        self._looks = 0

    def look(self) -> list[float]:
        """Return ``SUMS`` and ``GAUGES``; on a GPU those of the look before, for which it waits."""
        new, old = self._looks % 2, (self._looks + 1) % 2
        self._looks += 1
        numbers = torch.cat((self._learner.sums, self._learner.gauges))
        self._places[new].copy_(numbers, non_blocking=True)
        if not self._cuda:
            return self._places[new].tolist()
        self._events[new].record()
        if self._looks > 1:
            self._events[old].synchronize()
        return self._places[old].tolist()
