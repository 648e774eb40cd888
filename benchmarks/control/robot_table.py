"""Limits of every registered robot: the table of ``docs/results/robots.md``.

    python -m benchmarks.control.robot_table [--write docs/results/robots.md] [--robots NAME ...]

One row for each robot with its own flight behaviour, by ``aerial-gym robot check``. Hover and authority follow from the file.
The largest stable time steps are flown: 8 disturbed starts a time step, 60 s and 400 steps each, backend `auto` on the CPU.
Robots with joints count as rigid in their reference pose, and have one row for all modes of their drives.
"""

import platform
from dataclasses import dataclass
from pathlib import Path

import torch
import tyro
import warp

from aerial_gym.config.sim import STANDARD_GRAVITY
from aerial_gym.robots import ROBOTS
from aerial_gym.robots.check import RobotReport, check_robot
from aerial_gym.robots.check.flights import make_tail_servo
from benchmarks.control.control_flights import robots_by_dynamics
from benchmarks.markdown import insert_between_marks, table

BEGIN, END = "<!-- table: begin, by python -m benchmarks.control.robot_table -->", "<!-- table: end -->"


def table_robots() -> list[str]:
    """Return the robots of the table: rigid ones that fly differently, and those with joints in one mode of their drives."""
    bend = list(robots_by_dynamics(bend=True))
    alike = {name: next(first for first in bend if name == first or name in robot_variants(first)) for name in bend}
    return [*robots_by_dynamics(), *dict.fromkeys(alike.values())]


def robot_variants(name: str) -> list[str]:
    """Return the registered robots that differ from one in sensors, shapes, effects, starts or drives only."""
    first = ROBOTS.get(name)
    same = [other for other in ROBOTS if (r := ROBOTS.get(other)).body == first.body and r.mounts == first.mounts]
    return [other for other in same if other != name and ROBOTS.get(other).rotor_types == first.rotor_types]


def robots_table(reports: list[RobotReport]) -> str:
    """Return a row for each robot."""
    lines = []
    for report in reports:
        inertia = ", ".join(f"{report.inertia_kg_m2[i][i]:.4g}" for i in range(3))
        turn = ", ".join(f"{a:.3g}" for a in report.angular_acceleration_rad_s2)
        mass, lift, hover = f"{report.mass_kg:.4g}", f"{report.thrust_to_weight:.2f}", f"{report.hover_share:.0%}"
        cells = (f"`{report.name}`", report.num_rotors, mass, inertia, lift, hover, report.rank, turn)
        lines.append((*cells, _largest_steps(report)))
    heads = ("robot", "rotors", "mass [kg]", "inertia [kg m²]", "thrust to weight", "hover", "rank")
    return table((*heads, "angular acceleration [rad/s²]", "largest stable dt"), lines)


def _largest_steps(report: RobotReport) -> str:
    """Return the smallest of the largest stable time steps and its controller, of those that fit."""
    fitting = [step for step in report.stable_steps if step.refused is None]
    if not fitting:
        return "-"
    worst, robot = min(fitting, key=lambda step: step.largest_s or 0.0), ROBOTS.get(report.name)
    if worst.largest_s is None:
        largest = f"none (`{worst.controller}`)"
    else:
        largest = "100 ms or more" if worst.at_least else f"{1e3 * worst.largest_s:.3g} ms (`{worst.controller}`)"
    moves = robot.joints is None or make_tail_servo(robot, 0.0, STANDARD_GRAVITY) is not None
    return largest if moves else f"held rigid: {largest}"


@dataclass(frozen=True, kw_only=True)
class RobotTableCmd:
    """Print the limits of every registered robot."""

    write: Path | None = None  # Page with the marks, which receives the table
    robots: tuple[str, ...] = ()  # Only these

    def run(self) -> None:
        """Print the table, or put it between the marks of a page."""
        torch.set_num_threads(1)
        names = [name for name in table_robots() if not self.robots or name in self.robots]
        versions = f"{platform.machine()} CPU, torch {torch.__version__.split('+')[0]}, Warp {warp.config.version}."
        reports = [check_robot(ROBOTS.get(name), name=name) for name in names]
        text = f"{robots_table(reports)}\n\n{versions}"
        if self.write is None:
            print(text)
        else:
            insert_between_marks(self.write, BEGIN, END, text)


if __name__ == "__main__":
    tyro.cli(RobotTableCmd, description=__doc__).run()
