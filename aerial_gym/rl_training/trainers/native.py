"""Training with a learner of our own: simulation and updates in one CUDA graph, or step by step on a CPU."""

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import asdict
from typing import Any, Generic, TypeVar

import torch

from aerial_gym.config.storage import read_archive
from aerial_gym.errors import CapabilityError, ConfigError
from aerial_gym.interop import record_graph
from aerial_gym.registry.state import check_state, copy_tensors, restore_tensors
from aerial_gym.rl_training.learning.learner import SUMS, Learner
from aerial_gym.rl_training.policies.actor_critic import ActorCritic
from aerial_gym.rl_training.policies.load import find_checkpoint, load_initial_weights
from aerial_gym.rl_training.run.progress import Report
from aerial_gym.rl_training.run.training_run import TrainingRun
from aerial_gym.rl_training.settings import TrainingCfg
from aerial_gym.rl_training.trainers.summaries import TensorboardScalars
from aerial_gym.task import Task

WARM_UP_ITERATIONS = 2  # Iterations before the recording, for compilation and memory; they count as others


class IterationGraph:
    """Repeated calls of a function without waits on fixed tensors; on CUDA a recorded graph."""

    def __init__(
        self, iterate: Callable[[], None], device: torch.device, *, generator: torch.Generator, joined: bool = False,
        capture: bool = True,
    ) -> None:  # fmt: skip
        """Take the function, the generator that it draws from, whether it talks to other processes, whether to record it."""
        self._iterate, self._device, self._generator = iterate, device, generator
        # NCCL has a thread that polls events: a recording that forbids this to all threads would fail.
        self._forbids = "thread_local" if joined else "global"
        self._graph: torch.cuda.CUDAGraph | None = None
        self._warm = 0
        self._stream = torch.cuda.Stream(device) if capture and device.type == "cuda" else None

    @property
    def is_captured(self) -> bool:
        """Whether an iteration is the replay of a graph by now."""
        return self._graph is not None

    def __call__(self) -> None:
        """Run it once; on a GPU not waited for."""
        if self._stream is None:
            self._iterate()
        elif self._warm < WARM_UP_ITERATIONS:
            self._warm += 1
            self._stream.wait_stream(torch.cuda.current_stream(self._device))
            with torch.cuda.stream(self._stream):
                self._iterate()
            torch.cuda.current_stream(self._device).wait_stream(self._stream)
        else:
            self._record().replay()

    def _record(self) -> torch.cuda.CUDAGraph:
        """Return the graph; raise ``CapabilityError`` if something in an iteration waits for the GPU."""
        if self._graph is None:
            graph = torch.cuda.CUDAGraph()
            graph.register_generator_state(self._generator)
            try:
                with record_graph(graph, self._device, errors=self._forbids):
                    self._iterate()
            except RuntimeError as error:
                reason = str(error).strip().splitlines()[0]
                raise CapabilityError(
                    f"this training cannot be held in a CUDA graph: {reason}. Terms and rewards must not use .item(), print "
                    "or branch on tensors; or train on the CPU"
                ) from error
            self._graph = graph
        return self._graph


AnyLearner = TypeVar("AnyLearner", bound=Learner)

LOOK_EVERY = 8  # Iterations on a GPU between two reads by the host, whose numbers are one read old
OWN_STATE = ("learner", "generator", "task")  # Keys of a state that differ between processes; all others are common
RECENT_EPISODES = 100  # Episodes over which returns and lengths are averaged, at least, as far as there are as many


class NativeTraining(Generic[AnyLearner]):
    """Iterations of a learner, and its numbers on the host."""

    def __init__(self, cfg: TrainingCfg, task: Task, learner: AnyLearner) -> None:
        self.cfg, self.task, self.learner = cfg, task, learner
        self._ranks = learner.ranks
        if task.curriculum is not None and self._ranks.joined:
            task.curriculum.of_all = self._ranks.sum_
        learner.restart_episodes()
        learner.copy_tensors_from_leader()
        self._repeat = IterationGraph(
            learner.iterate, task.device, generator=learner.generator, joined=self._ranks.joined,
            capture=learner.captures,
        )  # fmt: skip
        self.env_steps = 0  # Environment steps in all sessions and processes; the host counts them by itself
        self.iterations = 0  # Iterations of this session
        self.known: dict[str, float] = {}  # Gauges of the learner at the last read
        self._numbers = _HostNumbers(self.learner)
        self._recent: deque[list[float]] = deque([[0.0] * len(SUMS)])

    def run(self, run: TrainingRun) -> bool:
        """Train as ``Trainer.run`` states; TensorBoard files need ``tensorboardX``."""
        keeper, progress = run.keeper, run.progress
        scalars = TensorboardScalars(run.folder.path / self.cfg.trainer / "summaries")
        if keeper.resumes:
            keeper.restore(self.load, own=OWN_STATE)
        else:
            if self.cfg.initial is not None:
                self.load_initial_weights(self.cfg.initial)
            keeper.save(self.state(), env_steps=0, own=OWN_STATE)
        interrupted = ended = False
        try:
            while not ended:
                with run.interruption.defer():
                    report = self.advance()
                scalars.add(lambda: self.known | asdict(report) | self.task.episode_means(), self.env_steps)  # noqa: B023
                ended = progress.update(report)
                if not ended:
                    self.learner.time_share.fill_(progress.time_share)
                    if keeper.due:
                        keeper.save(self.state(), env_steps=self.env_steps, own=OWN_STATE)
        except KeyboardInterrupt:
            interrupted = True
        finally:
            scalars.close()
        keeper.save(self.state(), env_steps=self.env_steps, own=OWN_STATE)
        return interrupted

    def advance(self) -> Report:
        """Iterate, on a GPU several times without waiting, and return the numbers, on a GPU those of the call before."""
        per_iteration = self.learner.segments * self.task.num_envs * self.cfg.learner.horizon * self._ranks.size
        limit = self.cfg.max_env_steps
        for _ in range(LOOK_EVERY if self.task.device.type == "cuda" and self.learner.captures else 1):
            self._repeat()
            self.iterations += 1
            self.env_steps += per_iteration
            if limit is not None and self.env_steps >= limit:
                break
        numbers = self._numbers.copy_to_host()
        _ = self.task.num_non_finite if self.task.device.type == "cpu" else 0
        return self._progress_report(numbers)

    def _progress_report(self, numbers: list[float]) -> Report:
        recent, self.known = self._recent, dict(zip(self.learner.GAUGES, numbers[len(SUMS) :], strict=True))
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
        return dict(zip(self.learner.GAUGES, self.learner.gauges.tolist(), strict=True))

    def state(self) -> dict[str, Any]:
        """Return all that is needed to go on bit for bit; waits for the device."""
        return {
            **_network_state(self.learner.network),
            **{name: _network_state(network) for name, network in self.learner.other_networks.items()},
            "learner": copy_tensors(self.learner.state_tensors()),
            "generator": self.learner.generator.get_state(),
            # without images (E, S, H, W), which the next step rewrites
            "task": {name: value for name, value in self.task.save_state().items() if value.ndim < 4},
            "env_steps": self.env_steps,
        }

    def load_initial_weights(self, source: str) -> None:
        """Load initial weights from a run folder or a checkpoint; raise ``ConfigError`` if they do not match."""
        file, cfg = find_checkpoint(source)
        saved = read_archive(file, "checkpoint")
        if cfg.trainer != self.cfg.trainer or not isinstance(saved.get("model"), Mapping):
            raise ConfigError(f"{file}: holds no networks of a training with {self.cfg.trainer}")
        load_initial_weights(self.learner.network, saved["model"], saved["network"]["shapes"], where=str(file))
        self.learner.copy_tensors_from_leader()

    def load(self, state: Mapping[str, Any]) -> None:
        """Resume from a result of ``state``."""
        self.learner.network.load_state_dict(state["model"])
        for name, network in self.learner.other_networks.items():
            network.load_state_dict(state[name]["model"])
        if "learner" in state:  # absent for a rank new to the run, which keeps its initial state
            own = self.learner.state_tensors()
            check_state(state["learner"], own)
            restore_tensors(state["learner"], own)
            self.learner.generator.set_state(state["generator"])
            now = self.task.save_state()
            self.task.load_state({name: state["task"].get(name, now[name]) for name in now})
        self.learner.copy_tensors_from_leader()
        self.env_steps = int(state["env_steps"])
        self._recent = deque([self.learner.sums.tolist()])


def _network_state(network: ActorCritic) -> dict[str, Any]:
    shapes = {key: list(shape) for key, shape in network.shapes.items()}
    return {
        "model": copy_tensors(network.state_dict()),
        "network": {"shapes": shapes, "num_actions": network.actor.num_actions},
    }


class _HostNumbers:
    """The learner's numbers on the host; on a GPU they are copied asynchronously and read one call later."""

    def __init__(self, learner: Learner) -> None:
        self._learner = learner
        self._cuda = learner.sums.device.type == "cuda"
        self._buffers = [
            torch.zeros(len(SUMS) + len(learner.GAUGES), dtype=torch.float64, pin_memory=self._cuda) for _ in range(2)
        ]
        self._events = [torch.cuda.Event(blocking=True) for _ in range(2)] if self._cuda else []
        self._copies = 0

    def copy_to_host(self) -> list[float]:
        """Return sums and gauges; on a GPU those of the call before, for which it waits."""
        new, old = self._copies % 2, (self._copies + 1) % 2
        self._copies += 1
        numbers = torch.cat((self._learner.sums, self._learner.gauges))
        if not self._cuda:
            return numbers.tolist()
        self._buffers[new].copy_(numbers, non_blocking=True)
        self._events[new].record(torch.cuda.current_stream(self._learner.sums.device))
        if self._copies > 1:
            self._events[old].synchronize()
        return self._buffers[old].tolist()
