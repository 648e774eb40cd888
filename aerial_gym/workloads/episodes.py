"""The workload of ``bench task``: episodes of all phases under small fixed actions.

Letters: E environments, U entries of an action.
"""

import torch
from torch import Tensor

from aerial_gym.task import Task
from aerial_gym.workloads.measure import WorkloadError

STEPS_PER_BATCH = 10  # Task steps per timed batch
CHECKED_STEPS = 32  # Task steps, not timed, that are looked at before and after each repeat
ACTION_SIZE = 0.05  # Largest entry of an action, in the units of the controller
MAX_TERMINATED = 0.05  # Largest share of steps that may end in a crash: beyond it, resets are timed and not flight


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
        del started
        crashed = []
        for _ in range(CHECKED_STEPS):
            observation, reward, terminated, _, _ = self._task.step(self.actions)
            check_step(observation["observations"], reward)
            crashed.append(terminated.float().mean())
        check_crashes(float(torch.stack(crashed).mean()))


def check_step(observation: Tensor, reward: Tensor) -> None:
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
