"""``aerial-gym robot check``: check of a robot file before training."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from aerial_gym.cli.terminal import print_table, progress_bar
from aerial_gym.config.console import json_line

if TYPE_CHECKING:
    from aerial_gym.robots.check import RobotReport, StableStep


@dataclass(frozen=True, kw_only=True)
class CheckRobotCmd:
    """Say what a robot can do: hover, thrust to weight, authority about each axis, stable time steps of controllers."""

    robots: Annotated[tuple[str, ...], tyro.conf.Positional]  # Registered robots, or robot files (.yaml)

    controllers: tuple[str, ...] | None = None
    """Registered controllers to fly it with; all that have gains if not given."""

    fly: bool = True  # Find the largest stable time step of each controller by flying; --no-fly answers at once
    picture: Path | None = None  # Draw the rotors of the robot into this file (.png, .svg, .pdf); for one robot
    json: bool = False  # Print one JSON object for each robot instead of tables

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
                _print_report(report)
            if self.picture is not None:
                draw_rotors(robot, self.picture, name=name)
        return int(failed)


def _print_report(report: "RobotReport") -> None:
    from rich.console import Console

    hover = ", ".join(f"{thrust:.3g}" for thrust in report.hover_thrust_n)
    rows = [
        ("mass", f"{report.mass_kg:.4g} kg"),
        ("hover thrust of each rotor", f"{hover} N, {report.hover_share:.0%} of the range at most"),
        ("thrust to weight", f"{report.thrust_to_weight:.2f}"),
        ("independent forces and torques", str(report.rank)),
    ]
    limits = [f" (rotor {rotor})" if rotor is not None else "" for rotor in report.first_at_limit]
    for quantity, values, unit, ends in (
        ("force along x, y, z at hover", report.force_n, "N", limits[:3]),
        ("torque about x, y, z at hover", report.torque_n_m, "N m", limits[3:]),
        ("angular acceleration", report.angular_acceleration_rad_s2, "rad/s²", ["", "", ""]),
    ):
        rows.append((quantity, ", ".join(f"{v:.3g}{end}" for v, end in zip(values, ends, strict=True)) + f" {unit}"))
    print_table(rows, title=f"{report.name}: {report.summary}")
    if report.stable_steps:
        steps = [(step.controller, _stable_step_text(step)) for step in report.stable_steps]
        print_table(steps, ("controller", "dt"), title="largest stable time step, flown")
    for kind, sentences in (("problem", report.problems), ("note", report.warnings)):
        for sentence in sentences:
            Console(markup=False).print(f"{kind}: {sentence}")


def _stable_step_text(step: "StableStep") -> str:
    if step.refused is not None:
        return f"refused: {step.refused}"
    if step.largest_s is None:
        return "none"
    return f"{'at least ' if step.at_least else ''}{1e3 * step.largest_s:.3g} ms"
