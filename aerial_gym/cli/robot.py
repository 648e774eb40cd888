"""``aerial-gym robot``: import of the file of another simulator, check of a robot file, and gains from a bandwidth."""

import json
import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from math import pi
from pathlib import Path
from tempfile import mkdtemp
from typing import TYPE_CHECKING, Annotated

import tyro

from aerial_gym.cli.terminal import open_in_browser, print_table, progress_bar
from aerial_gym.config.console import json_line
from aerial_gym.extras import require

if TYPE_CHECKING:
    from aerial_gym.robots.check import RobotReport, StableStep

TEMPLATES = Path(__file__).parent / "templates"


@dataclass(frozen=True, kw_only=True)
class CheckRobotCmd:
    """Say what a robot can do: hover, thrust to weight, authority about each axis, stable time steps of controllers."""

    robots: Annotated[tuple[str, ...], tyro.conf.Positional] = field(kw_only=False)
    """Registered robots, or robot files (.yaml)."""

    controllers: tuple[str, ...] | None = None  # Registered controllers to fly it with; default: all that have gains
    fly: bool = True  # Find the largest stable time step of each controller by flying; --no-fly answers at once
    picture: Path | None = None  # Draw the rotors of the robot into this file (.png, .svg, .pdf); for one robot
    page: Path | None = None  # Write the report with pictures of the rotors into this file (.html)
    open: bool = False  # Open the page in the browser; a temporary file without --page
    json: bool = False  # Print one JSON object for each robot instead of tables

    def run(self) -> int:
        """Check and print; return 0, or 1 if a robot cannot fly as described."""
        failed = False
        for report in self._reports():
            failed |= bool(report.problems)
            if self.json:
                print(json_line(report.as_mapping()))
            else:
                _print_report(report)
        return int(failed)

    def result(self) -> "tuple[RobotReport, ...]":
        """Return the report of each robot."""
        return tuple(self._reports())

    def _reports(self) -> "Iterator[RobotReport]":
        """Yield the report of each robot, then write the page."""
        from aerial_gym.errors import ConfigError
        from aerial_gym.interop.warp_start import silent_compilations
        from aerial_gym.robots.catalog import robot_by_name
        from aerial_gym.robots.check import check_robot, draw_rotors, rotor_views

        if self.picture is not None and len(self.robots) != 1:
            raise ConfigError(f"--picture takes one robot, and there are {len(self.robots)}. Draw each by itself")
        controllers = self.controllers if self.fly else ()
        if self.picture or self.page or self.open:
            require("the picture of a robot", "matplotlib")
        page = self.page or (Path(mkdtemp()) / "check.html" if self.open else None)
        sections = []
        for name in self.robots:
            robot = robot_by_name(name)
            with progress_bar() as progress, silent_compilations():
                report = check_robot(robot, name=name, controllers=controllers, progress=progress)
                progress("done", 1.0)
            yield report
            if self.picture is not None:
                draw_rotors(robot, self.picture, name=name)
            if page is not None:
                sections.append({"report": report, "rows": _report_rows(report), "views": rotor_views(robot)})
        if page is not None:
            self._write_page(page, sections)

    def _write_page(self, page: Path, sections: list[dict[str, object]]) -> None:
        from aerial_gym.sim2real.report.page import write_page

        write_page(page, "check.html", {"sections": sections, "step_text": _stable_step_text}, TEMPLATES)
        print(page, file=sys.stderr)
        if self.open:
            open_in_browser(page)


def _report_rows(report: "RobotReport") -> list[tuple[str, str]]:
    """Return the quantities of a report and their values as text."""
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
    return rows


def _print_report(report: "RobotReport") -> None:
    from rich.console import Console

    print_table(_report_rows(report), title=f"{report.name}: {report.summary}")
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


@dataclass(frozen=True, kw_only=True)
class TuneCmd:
    """Say with which ``control:`` a robot meets a bandwidth and a damping, with its lag and dead time."""

    robot: Annotated[str, tyro.conf.Positional]
    """Registered robot, or robot file (.yaml); its effects motor_time_constant, motor_asymmetry and actuation_delay count."""

    attitude_hz: float  # Bandwidth of roll, pitch and yaw [1/s]: where the answer is 0.71 of what is wanted
    position_hz: float  # Bandwidth along x, y, z [1/s]
    damping: float = 0.8  # Damping ratio of both loops, 0.3 to 1
    dt_s: float = 0.01  # Time step of the control law [s]
    json: bool = False  # Print one JSON object instead of YAML

    def run(self) -> int:
        """Tune and print; return 0, or 1 if the sampled loop would not come to rest."""
        from aerial_gym.robots.catalog import robot_by_name
        from aerial_gym.robots.tune import tune_robot

        robot = robot_by_name(self.robot)
        tuning = tune_robot(
            robot, name=self.robot, attitude=2.0 * pi * self.attitude_hz,
            position=2.0 * pi * self.position_hz, damping=self.damping, dt=self.dt_s,
        )  # fmt: skip
        names = ("attitude_frequency", "attitude_damping", "position_frequency", "position_damping")
        rows = {name: [round(number, 6) for number in getattr(tuning.control, name)] for name in names}
        if self.json:
            loop = {"lag_s": tuning.lag, "delay_s": tuning.delay}
            print(json.dumps(rows | loop | {"yaw_limited": tuning.yaw_limited, "radius": tuning.radius}))
        else:
            yaw = "; yaw is slower than asked, as the rotors give no more torque" if tuning.yaw_limited else ""
            loop = f"# rotor lag {tuning.lag:.4g} s, dead time {tuning.delay:.4g} s"
            print(f"{loop}; spectral radius {tuning.radius:.6f}{yaw}")
            if robot.joints is not None:
                print(f"# {robot.joints.note_on_rigidity('gains are those for a vehicle that does not bend')}")
            print("control:")
            print("\n".join(f"  {name}: {numbers}" for name, numbers in rows.items()))
            print(f'  source: "{tuning.control.source}"')
        return int(tuning.radius > 1.0)


@dataclass(frozen=True, kw_only=True)
class ImportRobotCmd:
    """Write a robot file (.yaml) from a URDF, MJCF or SDF file; one that cannot be flown is refused with the reason."""

    file: Annotated[Path, tyro.conf.Positional]  # URDF, MJCF or SDF file
    out: Path  # Robot file to write (.yaml)

    rotors_of: str | None = None
    """Robot, by name or file, whose rotor type these are; where the file has no rotors, its mounts are taken too."""

    spins: tuple[int, ...] = ()
    """1 or -1 for each rotor, in the order of the file and in place of what it says: 1 turns positively about the thrust."""

    lag_s: float | None = None
    """First-order lag of thrusts that follow at once in the file, and of rotors in `properties` of a URDF [s]."""

    rotor_links: str | None = None
    """Regular expression of links that are rotors, in a URDF without motors; names with motor, rotor or prop if not given."""

    joints: bool = False  # Let revolute, continuous and prismatic joints move; otherwise all are welded at zero
    accept_losses: bool = False  # Import a vehicle although its wings, or the joints that tilt its rotors, are left out
    summary: str | None = None  # One line for people who choose a robot

    def run(self) -> int:
        """Import, write and list unused elements; return the exit status."""
        from aerial_gym.robots.catalog import robot_by_name
        from aerial_gym.robots.importers import RotorHints, import_robot

        rotor_robot = None if self.rotors_of is None else robot_by_name(self.rotors_of)
        hints = RotorHints(
            rotors_of=rotor_robot, spins=self.spins, lag=self.lag_s, joints=self.joints,
            accept_losses=self.accept_losses,
        )  # fmt: skip
        if self.rotor_links is not None:
            hints = replace(hints, rotor_links=self.rotor_links)
        imported = import_robot(self.file, hints)
        if self.summary is not None:
            imported = replace(imported, robot=replace(imported.robot, summary=self.summary))
        self.out.write_text(imported.as_file(self.file.name), encoding="utf-8", errors="surrogateescape")
        for line in imported.lines():
            print(line, file=sys.stderr)
        print(self.out)
        return 0


@dataclass(frozen=True, kw_only=True)
class FromLogCmd:
    """Write a robot file from flight logs: what they state, what the flights show, and questions for the rest."""

    logs: Annotated[tuple[str, ...], tyro.conf.Positional]
    """Logs of one vehicle in any format, FILE#2 for one flight of several. Turns about all axes show the rotors."""

    out: Path  # Robot file to write (.yaml); the mapping of commands goes beside it (.mapping.yaml)
    mass_kg: Annotated[float | None, tyro.conf.arg(aliases=("--mass",))] = None  # Mass of the vehicle with battery [kg]
    arm_m: float | None = None  # Distance of the rotors from the centre [m], where the log does not state it
    frame: str | None = None
    """Places and spins of the rotors, if the log does not state them: the name of a frame such as quad_x, or a robot file."""

    mapping: str | None = None  # Mapping of CSV files, or of further topics: a name or a file (.yaml)
    json: bool = False  # Print one JSON object instead of text

    def run(self) -> int:
        """Write the file, and print open questions and the origin of each number; return the exit status."""
        from aerial_gym.errors import ConfigError
        from aerial_gym.robots.catalog import robot_by_name
        from aerial_gym.robots.drafts.draft import LABELS, robot_yaml_with_origins
        from aerial_gym.sim2real.logs.readers.mapping import find_mapping
        from aerial_gym.sim2real.teststand.vehicle_from_log import draft_vehicle

        if not self.logs:
            raise ConfigError("robot from-log needs at least one log")
        if self.out.suffix not in (".yaml", ".yml"):
            raise ConfigError(f"--out {self.out}: must end in .yaml")
        mapping = None if self.mapping is None else find_mapping(self.mapping)
        with progress_bar() as progress:
            progress("reading logs", 0.1)
            draft = draft_vehicle(self.logs, mass=self.mass_kg, arm=self.arm_m, frame=self.frame, mapping=mapping)
        name = ", ".join(Path(log).name for log in self.logs)
        self.out.write_text(robot_yaml_with_origins(draft, name=name), encoding="utf-8")
        robot_by_name(self.out)  # the file loads
        written = [self.out]
        if draft.mapping:
            written.append(self.out.with_suffix(".mapping.yaml"))
            written[-1].write_text(draft.mapping, encoding="utf-8")
        if self.json:
            values = {key: {"value": each.value, "origin": each.origin} for key, each in draft.values.items()}
            print(json_line({
                "values": values, "rotors": draft.layout_origin, "spins": list(draft.spins), "places_m": draft.places.tolist(),
                "questions": list(draft.questions), "notes": list(draft.notes), "written": [str(path) for path in written],
            }))  # fmt: skip
            return 0
        kinds = Counter(each.kind for each in draft.values.values())
        print(
            f"{self.out}: of {len(draft.values)} numbers {', '.join(f'{kinds[kind]} {kind}' for kind in sorted(kinds))}"
        )
        for question in draft.questions:
            print(f"question: {question}")
        unit = "of full thrust" if draft.force_mode else "per squared speed"
        rows = [(LABELS[key].format(unit), f"{each.value:.4g}", each.origin) for key, each in draft.values.items()]
        print_table(rows, ("number", "value", "origin"))
        print(f"rotors: {draft.layout_origin}")
        for sentence in draft.notes:
            print(f"note: {sentence}")
        print(f"written: {', '.join(map(str, written))}")
        mapping = written[1] if draft.mapping else self.mapping
        print(f"next: aerial-gym replay {self.out} ANOTHER_FLIGHT{'' if mapping is None else f' --mapping {mapping}'}")
        return 0
