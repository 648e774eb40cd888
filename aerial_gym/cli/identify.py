"""``aerial-gym identify``: numbers of a robot file from bench measurements, with intervals and held-out errors."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from rich.console import Console

from aerial_gym.cli.terminal import print_table, progress_bar
from aerial_gym.config.console import json_line
from aerial_gym.errors import ConfigError

if TYPE_CHECKING:
    from aerial_gym.config.robot import RobotCfg
    from aerial_gym.sim2real.logs.readers.mapping import LogMapping
    from aerial_gym.sim2real.teststand.report import Study
    from aerial_gym.sim2real.teststand.tables import Bench


@dataclass(frozen=True, kw_only=True)
class StudyCmd:
    """Base of the commands: where the results go."""

    out: Path | None = None  # Folder for report.md, result.json, figures and corrected files; nothing if not given
    json: bool = False  # Print one JSON object on stdout instead of tables

    def report(self, study: "Study", inputs: tuple[Path, ...]) -> int:
        """Write the results to the folder, if there is one, and print them; return the exit status."""
        from aerial_gym.sim2real.teststand.report import write_study
        from aerial_gym.sim2real.wording import render_findings, text

        if self.out is not None:
            write_study(self.out, study, {"command": f"identify {study.title}", **vars(self)}, inputs)
        if self.json:
            print(json_line(render_findings(study.mapping), allow_nan=False))
            return 0
        console = Console(markup=False)
        console.print(f"{study.title}. {study.intro}")
        for part in study.tables:
            print_table(part.rows, part.head, title=part.title)
        for note in study.notes:
            console.print(f"note: {text(note)}")
        if self.out is not None:
            console.print(
                f"written: {', '.join(f'{self.out}/{name}' for name in ('report.md', 'result.json', *study.files))}"
            )
        return 0


@dataclass(frozen=True, kw_only=True)
class MotorCmd(StudyCmd):
    """Thrust and torque maps from static tests, time constants, slew limits and delay from step responses."""

    files: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """CSV tables: speed, thrust and torque at rest, or time, commanded and measured speed; told apart by their columns."""

    num_motors: int = 1  # Motors whose thrust and torque were measured together

    columns: dict[str, str] = field(default_factory=dict)
    """Column by quantity where the usual name is not used: speed, thrust, torque, time, command, measured."""

    units: dict[str, str] = field(default_factory=dict)
    """Unit by quantity where the name does not tell it: rad/s, rpm, rev/s; N, mN, gf, kgf; N m, mN m, gf cm; s, ms, us."""

    robot: str | None = None  # Registered robot or robot file that gets the new rotor numbers (robot.yaml in --out)

    def run(self) -> int:
        """Identify and print; return the exit status."""
        from aerial_gym.sim2real.teststand.studies import study_motor

        if self.num_motors < 1:
            raise ConfigError(f"num_motors = {self.num_motors}: must be at least 1")
        with progress_bar() as progress:
            benches = _read_benches(self.files, self.columns, self.units)
            progress("fitting maps and lags, each also without every row or step", 0.1)
            study = study_motor(benches, num_motors=self.num_motors, robot=_optional_robot(self.robot))
        return self.report(study, self.files)


@dataclass(frozen=True, kw_only=True)
class JointCmd(StudyCmd):
    """The law of a compliant joint from the record of a load that is let go: spring, damping, creep."""

    file: Annotated[Path, tyro.conf.Positional]  # CSV table: time and angle of the joint, from before the release on
    release_s: float = 0.0  # Time of the release in the file [s]
    columns: dict[str, str] = field(default_factory=dict)  # Column by quantity without its usual name: time, angle
    units: dict[str, str] = field(default_factory=dict)  # Unit by quantity if not in the name: s, ms, us; rad, deg

    def run(self) -> int:
        """Identify and print; return the exit status."""
        from aerial_gym.sim2real.teststand.studies import study_joint

        with progress_bar() as progress:
            (bench,) = _read_benches((self.file,), self.columns, self.units)
            progress("fitting springs and creep, each also without every block of time", 0.1)
            study = study_joint(bench, release=self.release_s)
        return self.report(study, (self.file,))


@dataclass(frozen=True, kw_only=True)
class JointsCmd(StudyCmd):
    """Stiffness, damping, rest angle and dry friction of a robot's joints from flights, with or without their angles logged."""

    robot: Annotated[str, tyro.conf.Positional]  # Registered robot, or a robot file (.yaml), with joints

    flights: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """Flight logs of the package's own layout, with a column joint_NAME, or joint_1 to joint_D, for each joint [rad]. If no log
    has any, all joints are fitted by what the body felt, which takes minutes."""

    bandwidth_hz: float = 15.0  # Efforts are compared below this frequency [Hz]; at most a fifth of the logs' rate

    def run(self) -> int:
        """Identify and print; return the exit status."""
        from aerial_gym.robots.catalog import robot_by_name
        from aerial_gym.sim2real.teststand.joints.flights import study_flown_joints

        robot = robot_by_name(self.robot)
        with progress_bar() as progress:
            progress("reading flights, and fitting every joint", 0.1)
            study = study_flown_joints(robot, self.flights, bandwidth=self.bandwidth_hz, progress=progress)
        return self.report(study, self.flights)


@dataclass(frozen=True, kw_only=True)
class HoverCmd(StudyCmd):
    """The thrust coefficient from hover; with --baseline, what changed the balance: a payload or a weak propeller."""

    flights: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """Flight logs that hover for a while: with measured rotor speeds, or with --baseline with speeds or commands."""

    baseline: tuple[Path, ...] = ()
    """Hovers of the same airframe as it is declared. The flights are then compared with these: the share of each rotor, their
    sum, and which of payload_mass, com_offset and weak_motor explains the change."""

    test: tuple[Path, ...] = ()
    """With --baseline: further hovers like the flights. They count for what is named, and the parameters, which come from the
    flights alone, are judged on them; without them each flight is left out in turn."""

    repeats: tuple[Path, ...] = ()
    """With --baseline: hovers under any conditions. Names that differ only in the number at the end are one condition, and
    show how much its logs scatter. Logs named elsewhere are left out."""

    added_mass_kg: float | None = None
    """With --baseline: mass of the flights less that of the baseline [kg], if it was weighed; 0: there is no payload."""

    robot: str | None = None
    """Registered robot or robot file: its mass, its thrust map to compare with, and places and spin of its rotors."""

    mass_kg: float | None = None  # Mass of the vehicle [kg]; that of the robot if not given
    mass_std_kg: float = 0.0  # Standard deviation of the mass [kg]: it widens the interval

    mapping: str | None = None
    """Layout of the logs: a name (idsia_nanodrone) or a mapping file (.yaml); the package's own layout if not given."""

    def run(self) -> int:
        """Identify and print; return the exit status."""
        from aerial_gym.sim2real.logs.readers.mapping import find_mapping

        robot = _optional_robot(self.robot)
        layout = None if self.mapping is None else find_mapping(self.mapping)
        study = self._study_balance(robot, layout) if self.baseline else self._study_thrust(robot, layout)
        return self.report(study, (*self.baseline, *self.flights, *self.test, *self.repeats))

    def _study_thrust(self, robot: "RobotCfg | None", layout: "LogMapping | None") -> "Study":
        from aerial_gym.sim2real.teststand.studies import study_hover

        if self.test or self.repeats or self.added_mass_kg is not None:
            raise ConfigError("--test, --repeats and --added-mass-kg compare flights with a baseline: give --baseline")
        mass = self.mass_kg if self.mass_kg is not None else (None if robot is None else robot.body.mass)
        if mass is None:
            raise ConfigError("identify hover needs a mass: give --robot or --mass-kg")
        with progress_bar() as progress:
            progress("reading flights", 0.1)
            return study_hover(self.flights, layout=layout, mass=mass, mass_std=self.mass_std_kg, robot=robot)

    def _study_balance(self, robot: "RobotCfg | None", layout: "LogMapping | None") -> "Study":
        from aerial_gym.sim2real.teststand.studies import study_balance

        if robot is None:
            raise ConfigError("identify hover --baseline needs the places and spin of the rotors: give --robot")
        if self.mass_kg is not None or self.mass_std_kg:
            raise ConfigError(
                "--mass-kg and --mass-std-kg give a thrust coefficient; with --baseline the mass is the robot's"
            )
        more = {"test": self.test, "repeats": self.repeats, "added_mass": self.added_mass_kg}
        with progress_bar() as progress:
            progress("reading flights", 0.1)
            return study_balance(self.baseline, self.flights, layout=layout, robot=robot, **more)


@dataclass(frozen=True, kw_only=True)
class InertiaCmd(StudyCmd):
    """The inertia of a body from throws by hand with a flywheel that spins up in the air."""

    throws: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """Logs of throws with gyro, accelerometer and the speed of the flywheel, one throw each, in any log format."""

    mass_kg: float | None = None  # Mass of the body [kg], without the device if that is thrown alone too
    wheel_inertia_kg_m2: float | None = None  # Inertia of the flywheel about its axis [kg m²]: rotor and propeller

    device: tuple[Path, ...] = ()
    """Throws of the device alone: IMU, battery and flywheel. Its inertia is then taken from that of the body."""

    device_mass_kg: float | None = None  # Mass of the device [kg]
    proof: tuple[Path, ...] = ()  # Throws of the device on a body of known inertia, in place of --wheel-inertia-kg-m2
    proof_mass_kg: float | None = None  # Mass of the proof body [kg]

    proof_inertia_kg_m2: tuple[float, float, float] | None = None
    """Moments of inertia of the proof body about the x, y and z axes of the IMU [kg m²]."""

    def run(self) -> int:
        """Identify and print; return the exit status."""
        from aerial_gym.sim2real.teststand.inertia_study import ThrowSeries, study_inertia

        if not self.throws:
            raise ConfigError("identify inertia needs at least one log of a throw")
        device = ThrowSeries(paths=self.device, mass=self.device_mass_kg) if self.device else None
        proof = ThrowSeries(paths=self.proof, mass=self.proof_mass_kg, inertia=self.proof_inertia_kg_m2)
        with progress_bar() as progress:
            progress("reading throws", 0.1)
            study = study_inertia(
                ThrowSeries(paths=self.throws, mass=self.mass_kg),
                device,
                proof if self.proof else None,
                self.wheel_inertia_kg_m2,
            )
        return self.report(study, (*self.throws, *self.device, *self.proof))


@dataclass(frozen=True, kw_only=True)
class IdentifyCmd:
    """Identify rotors, joints or thrust from bench tables and flights, or the inertia of a body from throws by hand."""

    subject: tyro.conf.OmitArgPrefixes[
        tyro.conf.OmitSubcommandPrefixes[
            Annotated[MotorCmd, tyro.conf.subcommand("motor")]
            | Annotated[JointCmd, tyro.conf.subcommand("joint")]
            | Annotated[JointsCmd, tyro.conf.subcommand("joints")]
            | Annotated[HoverCmd, tyro.conf.subcommand("hover")]
            | Annotated[InertiaCmd, tyro.conf.subcommand("inertia")]
        ]
    ]
    """What is identified."""

    def run(self) -> int:
        """Identify and print; return the exit status."""
        return self.subject.run()


def _read_benches(files: tuple[Path, ...], columns: dict[str, str], units: dict[str, str]) -> "list[Bench]":
    from aerial_gym.sim2real.teststand.tables import KNOWN, read_columns

    for quantity in (*columns, *units):
        if quantity not in KNOWN:
            raise ConfigError(f"no quantity {quantity!r}. Known: {', '.join(KNOWN)}")
    if not files:
        raise ConfigError("give at least one CSV file")
    return [read_columns(path, given=columns, units=units) for path in files]


def _optional_robot(name: str | None) -> "RobotCfg | None":
    from aerial_gym.robots.catalog import robot_by_name

    return None if name is None else robot_by_name(name)
