"""The workload of ``bench task``: episodes of all phases under small fixed actions, and times of the parts of a step.

Letters: E environments, U entries of an action.
"""

import statistics
import time
from collections.abc import Callable

import torch
from torch import Tensor

from aerial_gym.task import Task
from aerial_gym.workloads.measure import WorkloadError, make_batch, wait_for_device

STEPS_PER_BATCH = 10  # Task steps per timed batch
CHECKED_STEPS = 32  # Task steps, not timed, that are looked at before and after each repeat
ACTION_SIZE = 0.05  # Largest entry of an action, in the units of the controller
MAX_TERMINATED = 0.05  # Largest share of steps that may end in a crash: beyond it, resets are timed and not flight
SPAN_S = 0.02  # Run time of a part for one figure [s]; short, so that robots without reset do not fly far
MAX_CALLS = 50  # Calls of a part in one figure, at most
MIXING_STEPS = 10  # Task steps before each figure, after a reset with episodes of all ages


class Episodes:
    """A task that steps on and on; it resets its environments itself."""

    launches_per_batch = STEPS_PER_BATCH
    batches_per_stretch = 1_000_000_000  # no stretch ends: the task puts each environment back where its episode ends

    def __init__(self, task: Task, *, seed: int) -> None:
        """Take a task and reset it."""
        self.device, self._task = task.device, task
        generator = torch.Generator(device=task.device).manual_seed(seed)
        self.actions = torch.empty(task.num_envs, task.action_space.shape[0], device=task.device)
        self.actions.uniform_(-ACTION_SIZE, ACTION_SIZE, generator=generator)

    def restore(self) -> None:
        """Restart all episodes, at random ages."""
        self._task.reset()
        self._task.stagger()

    def run_batch(self) -> None:
        """Take some task steps."""
        for _ in range(STEPS_PER_BATCH):
            self._task.step(self.actions)

    def check(self, *, started: bool) -> None:
        """Run further steps, and raise ``WorkloadError`` unless the task behaves as expected."""
        crashed = []
        for _ in range(CHECKED_STEPS):
            observation, reward, terminated, _, _ = self._task.step(self.actions)
            check_finite_step(observation["observations"], reward)
            crashed.append(terminated.float().mean())
        check_crashes(float(torch.stack(crashed).mean()))


def check_finite_step(observation: Tensor, reward: Tensor) -> None:
    """Raise ``WorkloadError`` unless observations (E, O) and rewards (E,) are finite."""
    for name, tensor in (("observations", observation), ("rewards", reward)):
        if not torch.isfinite(tensor).all():
            raise WorkloadError(f"{name} are not finite")


def check_crashes(share: float) -> None:
    """Raise ``WorkloadError`` if too large a share of steps ended in a crash."""
    if not share < MAX_TERMINATED:
        raise WorkloadError(
            f"{100 * share:.1f} % of the steps ended in a crash: must stay below {100 * MAX_TERMINATED:g} %"
        )


def time_parts(task: Task, actions: torch.Tensor, *, repeats: int) -> dict[str, float]:
    """Return the median time of each part of a step [s] under actions (E, U): CUDA events on a GPU, the clock on a CPU."""
    times = {}
    for name, call in task.parts().items():
        _mix_episode_ages(task, actions)
        calls = max(1, min(MAX_CALLS, int(SPAN_S / _wall_time_of_last_call(call, 2, task.device))))
        batch = make_batch(call, calls, task.device)
        figures = []
        for _ in range(repeats):
            _mix_episode_ages(task, actions)
            figures.append(
                (_gpu_time(batch) if task.device.type == "cuda" else _wall_time_of_last_call(batch, 1, task.device))
                / calls
            )
        times[name] = statistics.median(figures)
    return times


def _mix_episode_ages(task: Task, actions: torch.Tensor) -> None:
    task.reset()
    task.stagger()
    for _ in range(MIXING_STEPS):
        task.step(actions)


def _wall_time_of_last_call(call: Callable[[], None], times: int, device: torch.device) -> float:
    """Return the wall time [s] of the last of several calls; the first one may compile."""
    spans = []
    for _ in range(times):
        begin = time.perf_counter()
        call()
        wait_for_device(device)
        spans.append(time.perf_counter() - begin)
    return spans[-1]


def _gpu_time(replay: Callable[[], None]) -> float:
    """Return the time that the GPU takes [s]."""
    begin, end = torch.cuda.Event(enable_timing=True), torch.cuda.Event(enable_timing=True)
    torch.cuda.synchronize()
    begin.record()
    replay()
    end.record()
    torch.cuda.synchronize()
    return 1e-3 * begin.elapsed_time(end)
