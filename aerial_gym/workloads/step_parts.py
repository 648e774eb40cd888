"""Times of the parts of a task step."""

import statistics
import time
from collections.abc import Callable

import torch

from aerial_gym.task import Task
from aerial_gym.workloads.measure import make_batch

SPAN_S = 0.02  # Run time of a part for one figure [s]; short, so that robots without reset do not fly far
MAX_CALLS = 50  # Calls of a part in one figure, at most
MIXING_STEPS = 10  # Task steps before each figure, after a reset with episodes of all ages


def time_parts(task: Task, actions: torch.Tensor, *, repeats: int) -> dict[str, float]:
    """Return the median time of each part of a step [s] under actions (E, U): CUDA events on a GPU, the clock on a CPU."""
    times = {}
    for name, call in task.parts().items():
        _mix_episode_ages(task, actions)
        calls = max(1, min(MAX_CALLS, int(SPAN_S / _clock_time(call, 2, task.device))))
        batch = make_batch(call, calls, task.device)
        figures = []
        for _ in range(repeats):
            _mix_episode_ages(task, actions)
            figures.append(
                (_gpu_time(batch) if task.device.type == "cuda" else _clock_time(batch, 1, task.device)) / calls
            )
        times[name] = statistics.median(figures)
    return times


def _mix_episode_ages(task: Task, actions: torch.Tensor) -> None:
    task.reset()
    task.stagger()
    for _ in range(MIXING_STEPS):
        task.step(actions)


def _clock_time(call: Callable[[], None], times: int, device: torch.device) -> float:
    """Return the time of a call [s] without the first of several, which may compile."""
    spans = []
    for _ in range(times):
        begin = time.perf_counter()
        call()
        if device.type == "cuda":
            torch.cuda.synchronize(device)
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
