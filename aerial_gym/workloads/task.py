"""``aerial-gym bench task``: whole task steps, with observation, reward and resets."""

import statistics
from dataclasses import dataclass

from aerial_gym.config.set_option import SetOption


@dataclass(frozen=True, kw_only=True)
class TaskBench:
    """Measure how many environment steps of a task are taken per second."""

    task: str = "position_setpoint_task"  # Registered task, a task file (.yaml), or module:Name or file.py:Name
    num_envs: int = 4096  # Environments stepped side by side
    device: str = "auto"  # Torch device; auto takes the GPU if there is one
    backend: str | None = None  # Registered physics backend (aerial-gym list backends); that of the sim if not given
    threads: int | None = None  # Threads on the CPU; torch's own number if not given
    repeats: int = 5  # Figures of which the median is printed
    repeat_time_s: float = 0.5  # About how long each is measured [s]
    seed: int = 0  # Seed of the task and of the actions
    set: SetOption = ()  # Setting of task, robot, env or sim, such as robot.body.mass=0.3; can be repeated
    parts: bool = False  # Also time physics, collision, reset of 1 % of the environments and rendering, each alone
    json: bool = False  # Print one JSON object

    def run(self) -> int:
        """Measure and print; return the exit status."""
        from aerial_gym.workloads.measure import print_figures

        print_figures(self.measure(), as_json=self.json)
        return 0

    def measure(self) -> dict[str, object]:
        """Return the figures with everything they depend on."""
        from aerial_gym.interop import resolve_device
        from aerial_gym.task import task_registry
        from aerial_gym.workloads.episodes import Episodes, time_parts
        from aerial_gym.workloads.measure import (
            device_name,
            packages_of_backend,
            provenance,
            rate_figures,
            time_launches,
            torch_threads,
        )

        device = resolve_device(self.device)
        options = {"num_envs": self.num_envs, "seed": self.seed, "backend": self.backend, "settings": self.set}
        versions = provenance(*packages_of_backend(self.backend))
        with (
            torch_threads(self.threads) as threads,
            task_registry.make_task(self.task, **options, device=device) as task,
        ):
            episodes = Episodes(task, seed=self.seed)
            seconds = time_launches(episodes, repeats=self.repeats, repeat_time_s=self.repeat_time_s)
            captured, rows = task.is_captured, task.num_envs
            parts = time_parts(task, episodes.actions, repeats=self.repeats) if self.parts else {}
        return {
            "case": "task", "task": self.task, "backend": self.backend or "auto", "device": device_name(device),
            "num_envs": self.num_envs, "threads": threads, "captured": captured, "settings": list(self.set),
            **rate_figures("env_steps_per_s", seconds, rows), "step_us": 1e6 * statistics.median(seconds),
            **{f"{name}_us": 1e6 * span for name, span in parts.items()}, **versions,
        }  # fmt: skip
