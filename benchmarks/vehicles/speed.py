"""Speed of the physics of several vehicles in an environment, alone and in each other's wakes.

    python -m benchmarks.vehicles.speed --device cuda [--bodies 65536] [--vehicles 8] [--substeps 1] [--json]

All rows have the same number of vehicles: in an environment each, in groups without and with ``downwash``, and in groups of
four that carry a payload. A row times ``EnvManager.fly``, in a CUDA graph on a GPU; ``ratio`` compares its time with that of
the first row. ``collisions`` adds the tests of ground and other vehicles.
"""

import statistics
from dataclasses import dataclass, replace
from typing import Any

import torch
import tyro

from aerial_gym import ENVIRONMENTS, ROBOTS, EnvManager, SimBuilder
from aerial_gym.config.console import json_line
from aerial_gym.config.environment import EnvironmentCfg
from aerial_gym.config.robot import RobotCfg
from aerial_gym.config.vehicles import PayloadCfg
from aerial_gym.interop import resolve_device
from aerial_gym.workloads.measure import (
    WorkloadError,
    device_name,
    make_batch,
    print_figures,
    provenance,
    rate_figures,
    time_launches,
)

SPACE = replace(
    ENVIRONMENTS.get("empty_env"), bounds_lower_low=(-20.0,) * 3, bounds_lower_high=(-20.0,) * 3,
    bounds_upper_low=(20.0,) * 3, bounds_upper_high=(20.0,) * 3, reset_together=True,
)  # fmt: skip
LAUNCHES = 20  # In a CUDA graph


class GroupFlight:
    """Vehicles that hold zero velocity from their random starts on."""

    batches_per_stretch = 20

    def __init__(self, env: EnvManager, *, collisions: bool) -> None:
        """Take a simulation, whose present state is the start."""
        env.reset()
        self.device, self._env = env.device, env
        self._start = env.save_state()
        self.launches_per_batch = LAUNCHES if self.device.type == "cuda" else 1

        def step() -> None:
            env.fly()
            if collisions:
                env.collide()

        self.run_batch = make_batch(step, self.launches_per_batch, self.device)

    def restore(self) -> None:
        """Restore the start."""
        self._env.load_state(self._start)

    def check(self, *, started: bool) -> None:
        """Raise ``WorkloadError`` unless all vehicles are finite and, if ``started``, have moved."""
        place = self._env.gtd["robot_position"]
        if not torch.isfinite(place).all():
            raise WorkloadError("a position is not finite")
        if started and (place == self._start["gtd.robot_position"].view_as(place)).all(dim=-1).any():
            raise WorkloadError("a vehicle did not move")


@dataclass(frozen=True, kw_only=True)
class SpeedOfGroups:
    """Measure a substep of the same number of vehicles, alone and in groups."""

    device: str = "auto"  # Torch device; auto takes the GPU if there is one
    bodies: int = 65536  # Vehicles of all environments
    vehicles: int = 8  # Vehicles of an environment
    substeps: int = 1  # Of 2 ms, in one launch where there is no payload
    repeats: int = 5  # Figures of which the median is printed
    repeat_time_s: float = 0.5  # About how long each is measured [s]
    json: bool = False  # Print one JSON object for each row

    def run(self) -> int:
        """Measure and print; return the exit status."""
        quad = ROBOTS.get("base_quadrotor")
        wake = replace(quad, effects={"downwash": {"force": 0.5, "sigma": 0.3}})
        carry = replace(SPACE, payload=PayloadCfg(mass=0.1, cable_length=1.0))
        cases: dict[str, dict[str, Any]] = {
            f"{self.bodies:,} x 1": {"count": 1},
            f"{self.bodies // self.vehicles:,} x {self.vehicles}": {"count": self.vehicles},
            f"{self.bodies // self.vehicles:,} x {self.vehicles}, downwash": {"count": self.vehicles, "name": wake},
            f"{self.bodies // 4:,} x 4, payload": {"count": 4, "env": carry},
            f"{self.bodies:,} x 1, collisions": {"count": 1, "collisions": True},
            f"{self.bodies // self.vehicles:,} x {self.vehicles}, collisions": {
                "count": self.vehicles, "collisions": True,
            },
        }  # fmt: skip
        first = 0.0
        for case, given in cases.items():
            seconds = self.measure(**given)
            launch = statistics.median(seconds)
            first = first or launch
            row = {
                "case": case, "device": device_name(resolve_device(self.device)), "launch_us": 1e6 * launch,
                "substeps": self.substeps, "ratio": launch / first,
                **rate_figures("steps_per_s", seconds, self.bodies * self.substeps), **provenance("warp-lang"),
            }  # fmt: skip
            if self.json:
                print(json_line(row))
            else:
                print_figures(row, as_json=False)
        return 0

    def measure(
        self,
        *,
        count: int,
        name: str | RobotCfg = "base_quadrotor",
        env: EnvironmentCfg = SPACE,
        collisions: bool = False,
    ) -> list[float]:
        """Return the times of an environment step of groups of ``count`` [s]."""
        group: Any = {"name": name, "count": count, "kind": "quad"}
        env = replace(env, physics_steps_per_env_step=self.substeps)
        built = SimBuilder().build_env(
            sim_name="base_sim_2ms", env_name=env, controller_name="lee_velocity_control", robots=[group],
            num_envs=self.bodies // count, device=self.device, seed=0,
        )  # fmt: skip
        seconds = time_launches(
            GroupFlight(built, collisions=collisions), repeats=self.repeats, repeat_time_s=self.repeat_time_s
        )
        built.close()
        return seconds


if __name__ == "__main__":
    raise SystemExit(tyro.cli(SpeedOfGroups).run())
