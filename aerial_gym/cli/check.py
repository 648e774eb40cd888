"""``aerial-gym robot check``: check of a robot file before training."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from aerial_gym.cli.progress import progress_bar
from aerial_gym.config.console import json_line

if TYPE_CHECKING:
    from aerial_gym.robots.check import RobotReport, StableStep


@dataclass(frozen=True, kw_only=True)
class CheckCmd:
    """Say what a robot can do: hover, thrust to weight, authority about each axis, stable time steps of controllers."""

    robots: Annotated[tuple[str, ...], tyro.conf.Positional]
    """Registered robots, or robot files (.yaml)."""

    controllers: tuple[str, ...] | None = None
    """Registered controllers to fly it with; all that have gains if not given."""

    fly: bool = True
    """Find the largest stable time step of each controller by flying; --no-fly answers at once."""

    picture: Path | None = None
    """Draw the rotors of the robot into this file (.png, .svg, .pdf); for one robot."""

    json: bool = False
    """Print one JSON object for each robot instead of tables."""

    def run(self) -> int:
        """Check and print; return 0, or 1 if a robot cannot fly as described."""
        from aerial_gym.errors import ConfigError
        from aerial_gym.robots.catalog import robot_by_name
        from aerial_gym.robots.check import check_robot, draw_rotors

        if self.picture is not None and len(self.robots) != 1:
            raise ConfigError(f"--picture takes one robot, and there are {len(self.robots)}. Draw each by itself")
        controllers = self.controllers if self.fly else ()
        failed = False
        for name in self.robots:
            robot = robot_by_name(name)
            with progress_bar() as progress:
                report = check_robot(robot, name=name, controllers=controllers, progress=progress)
                progress("done", 1.0)
            failed |= bool(report.problems)
            if self.json:
                print(json_line(report.as_mapping()))
            else:
                _print(report)
            if self.picture is not None:
                draw_rotors(robot, self.picture, name=name)
        return int(failed)


def _print(report: "RobotReport") -> None:
    from rich.console import Console
    from rich.table import Table

    console = Console(markup=False)
    table = Table(
        title=f"{report.name}: {report.summary}", title_justify="left", box=None, pad_edge=False, show_header=False
    )
    hover = ", ".join(f"{thrust:.3g}" for thrust in report.hover_thrust_n)
    table.add_row("mass", f"{report.mass_kg:.4g} kg")
    table.add_row("hover thrust of each rotor", f"{hover} N, {report.hover_share:.0%} of the range at most")
    table.add_row("thrust to weight", f"{report.thrust_to_weight:.2f}")
    table.add_row("independent forces and torques", str(report.rank))
    limits = [f" (rotor {rotor})" if rotor is not None else "" for rotor in report.first_at_limit]
    for quantity, values, unit, ends in (
        ("force along x, y, z at hover", report.force_n, "N", limits[:3]),
        ("torque about x, y, z at hover", report.torque_n_m, "N m", limits[3:]),
        ("angular acceleration", report.angular_acceleration_rad_s2, "rad/s²", ["", "", ""]),
    ):
        table.add_row(quantity, ", ".join(f"{v:.3g}{end}" for v, end in zip(values, ends, strict=True)) + f" {unit}")
    console.print(table)
    if report.stable_steps:
        steps = Table(title="largest stable time step, flown", title_justify="left", box=None, pad_edge=False)
        steps.add_column("controller")
        steps.add_column("dt")
        for step in report.stable_steps:
            steps.add_row(step.controller, step_text(step))
        console.print(steps)
    for kind, sentences in (("problem", report.problems), ("note", report.warnings)):
        for sentence in sentences:
            console.print(f"{kind}: {sentence}")


def step_text(step: "StableStep") -> str:
    """Return a stable time step for people."""
    if step.refused is not None:
        return f"refused: {step.refused}"
    if step.largest_s is None:
        return "none"
    return f"{'at least ' if step.at_least else ''}{1e3 * step.largest_s:.3g} ms"
