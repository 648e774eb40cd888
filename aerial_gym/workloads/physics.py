"""``aerial-gym bench physics``: substeps of the physics alone, without task, sensors or resets.

Letters: E environments, R rotors, P parameters of an effect, U entries of an action.
"""

import statistics
from dataclasses import dataclass

from aerial_gym.config.set_option import SetOption


@dataclass(frozen=True, kw_only=True)
class PhysicsBench:
    """Measure how many substeps of how many environments the physics takes per second."""

    backend: str = "warp"  # Registered physics backend: warp, torch or mujoco
    device: str = "auto"  # Torch device; auto takes the GPU if there is one
    num_envs: int = 4096  # Environments stepped side by side
    substeps: int = 1  # Substeps in one launch
    integrator: str = "euler"  # Stepper: euler or rk4
    controller: str = "rotor_speed_control"  # Registered controller, run in every substep; default: the bare plant
    robot: str = "base_quadrotor"  # Registered robot, or a robot file; effects in the file are not used
    effects: tuple[str, ...] = ("rotor_drag",)  # Registered effects, each a moderate size away from neutral
    threads: int | None = None  # Threads on the CPU; torch's own number if not given
    repeats: int = 5  # Figures of which the median is printed
    repeat_time_s: float = 0.5  # About how long each is measured [s]
    dt_s: float = 0.002  # Length of a substep [s]
    set: SetOption = ()  # Setting of the robot, such as robot.body.mass=0.3; can be repeated
    json: bool = False  # Print one JSON object

    def run(self) -> int:
        """Measure and print; return the exit status."""
        from aerial_gym.workloads.measure import print_figures

        print_figures(self.measure(), as_json=self.json)
        return 0

    def measure(self) -> dict[str, object]:
        """Return the figures with everything they depend on."""
        from aerial_gym.config.changes import Changes
        from aerial_gym.interop import resolve_device
        from aerial_gym.robots.catalog import robot_by_name
        from aerial_gym.workloads.flight import make_flight
        from aerial_gym.workloads.measure import (
            device_name,
            packages_of_backend,
            provenance,
            rate_figures,
            require_at_least,
            time_launches,
            torch_threads,
        )

        require_at_least(1, num_envs=self.num_envs, substeps=self.substeps)
        device, changes = resolve_device(self.device), Changes(self.set)
        robot = changes.apply("robot", robot_by_name(self.robot))
        changes.finish()
        versions = provenance(*packages_of_backend(self.backend))
        with torch_threads(self.threads) as threads:  # no progress bar: its thread would take part of a measured core
            names = ("backend", "controller", "effects", "integrator", "num_envs", "substeps")
            flight = make_flight(
                **{name: getattr(self, name) for name in names}, robot=robot, dt=self.dt_s, device=device
            )
            seconds = time_launches(flight, repeats=self.repeats, repeat_time_s=self.repeat_time_s)
        return {
            "case": "physics", "backend": self.backend, "device": device_name(device), "num_envs": self.num_envs,
            "substeps": self.substeps, "integrator": self.integrator, "controller": self.controller,
            "robot": self.robot, "effects": list(self.effects), "settings": list(self.set),
            "dt_s": self.dt_s, "threads": threads, **rate_figures("steps_per_s", seconds, self.num_envs * self.substeps),
            "launch_us": 1e6 * statistics.median(seconds), **versions,
        }  # fmt: skip
