"""Identification of joints from flights: fits, tables and a corrected robot file.

With logged joint angles, each joint is fitted separately (``flown_joints``). Without any, all are fitted together to the
body's motion (``hidden_joints``).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from aerial_gym.config import dump_yaml
from aerial_gym.config.robot import RobotCfg
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.json_values import plain, select_fields
from aerial_gym.sim2real.judge.analysis import LoopResult
from aerial_gym.sim2real.judge.outcome import NOTHING_NAMED
from aerial_gym.sim2real.logs.readers.csv_lines import find_header, read_lines
from aerial_gym.sim2real.logs.readers.flight_log import read_flights
from aerial_gym.sim2real.logs.recording import FlightLog, split_flight_number
from aerial_gym.sim2real.logs.signals import log_at_equal_steps
from aerial_gym.sim2real.progress import Progress, silent
from aerial_gym.sim2real.statistics import Rms
from aerial_gym.sim2real.teststand.joints.angle_logs import JointResult, LogJointFit, fit_flown_joints, require_joints
from aerial_gym.sim2real.teststand.joints.body_motion_fit import fit_hidden_joints
from aerial_gym.sim2real.teststand.joints.joint_motion import read_joint_motion
from aerial_gym.sim2real.teststand.joints.joint_simulation import body_motion
from aerial_gym.sim2real.teststand.report import ReportTable, Study, interval_text, relative_change_text

BANDWIDTH_HZ = 15.0  # Default bandwidth of the identification [Hz]
OF_RATE = 0.199  # Largest bandwidth as a share of the log rate: a fifth, with a margin for time errors


@dataclass(frozen=True, kw_only=True)
class FlightJointStudy:
    """Results for the joints of a robot."""

    joints: tuple[JointResult, ...]
    channels: dict[str, tuple[Rms, Rms]]  # Errors of the body's motion before and after, without logged angles
    left_out: tuple[Finding, ...]

    @property
    def fits_with_angles(self) -> list[LogJointFit]:
        """Return the results of joints with logged angles."""
        return [joint for joint in self.joints if isinstance(joint, LogJointFit)]

    @property
    def joints_with_changes(self) -> tuple[JointResult, ...]:
        """Return the joints that differ from their declaration."""
        return tuple(joint for joint in self.joints if joint.changed)

    @property
    def notes(self) -> tuple[Finding, ...]:
        """Return findings on joints left out, and on the errors before and after."""
        errors = []
        for one in self.fits_with_angles:
            values = {"before_n_m": one.declared_error.value, "after_n_m": one.laws[one.chosen].error.value}
            errors.append(Finding("joint_effort", one.name, values))
        if self.channels:
            pairs = {name: [before.value, after.value] for name, (before, after) in self.channels.items()}
            errors = [Finding("joints_felt", "", {"errors_before_and_after": pairs})]
        return (*self.left_out, *errors)

    def as_mapping(self) -> dict[str, object]:
        """Return the values for JSON."""
        joints = [joint.fits_as_mapping() for joint in self.fits_with_angles] or plain(self.joints)
        return {"joints": joints, **select_fields(self, "left_out", "channels")}

    def correct_robot(self, robot: RobotCfg, source: str) -> RobotCfg:
        """Return the robot with corrected joint springs."""
        if robot.joints is None or not self.joints_with_changes:
            return robot
        springs = {joint.name: joint.spring for joint in self.joints_with_changes}
        layout = tuple(replace(one, spring=springs.get(one.name, one.spring)) for one in robot.joints.layout)
        return replace(robot, joints=replace(robot.joints, layout=layout, source=f"{robot.joints.source}; {source}"))

    def add_to_verdict(self, judged: LoopResult) -> LoopResult:
        """Return the result of the closed loop with these joints in its verdict and robot."""
        kind = judged.verdict.verdict
        verdict = replace(
            judged.verdict,
            verdict="explained" if self.joints_with_changes and kind in NOTHING_NAMED else kind,
            joint_findings=tuple(joint.finding for joint in self.joints_with_changes),
            joints=tuple(joint.as_mapping() for joint in self.joints),
            notes=(*self.notes, *judged.verdict.notes),
        )
        return replace(
            judged, verdict=verdict, corrected=self.correct_robot(judged.corrected, "aerial-gym close-loop --joints")
        )


def fit_joints_to_flights(
    robot: RobotCfg, flights: Sequence[Path], *, bandwidth: float = BANDWIDTH_HZ, progress: Progress = silent
) -> FlightJointStudy:
    """Return the passive joints' parameters fitted to logs in the package's own layout."""
    require_joints(robot)
    logs = read_flights(flights)
    if any(_has_joint_angles(log) for log in logs):
        logged, left_out = fit_flown_joints(robot, [read_joint_motion(log, robot, bandwidth=bandwidth) for log in logs])
        return FlightJointStudy(joints=tuple(logged), channels={}, left_out=tuple(left_out))
    motions = [body_motion(robot, log_at_equal_steps(log), bandwidth=bandwidth) for log in logs]
    fit = fit_hidden_joints(robot, motions, bandwidth=bandwidth, progress=progress)
    return FlightJointStudy(joints=fit.joints, channels=fit.channels, left_out=())


def _has_joint_angles(log: FlightLog) -> bool:
    if log.lines is None:  # a binary log
        return False
    header = find_header(read_lines(Path(split_flight_number(log.path)[0])), "t")
    return header is not None and any(name.startswith("joint_") for name in header.names)


def study_flown_joints(
    robot: RobotCfg, flights: Sequence[Path], *, bandwidth: float, progress: Progress = silent
) -> Study:
    """Return a study of the passive joints' laws from flights; raises the errors of ``fit_joints_to_flights``."""
    study = fit_joints_to_flights(robot, flights, bandwidth=bandwidth, progress=progress)
    names = ", ".join(path.name for path in flights)
    corrected = study.correct_robot(robot, f"aerial-gym identify joints: {names}")
    changes = [f"{joint.name}: {name}" for joint in study.joints_with_changes for name in joint.changed]
    errors = "No log has joint angles: all joints are fitted to the motion of the body below the bandwidth"
    if study.fits_with_angles:
        errors = "Errors are those of the joint effort below the bandwidth"
    assumption = Finding("links_as_declared") if study.fits_with_angles else Finding("thrust_scale_fitted")
    return Study(
        title="Joints in flight",
        intro=f"Differences from the declaration: {'; '.join(changes) or 'nothing'}. {errors}. Flights, or parts of a single "
        "one, are left out in turn.",
        mapping={"bandwidth_hz": bandwidth, **study.as_mapping()},
        tables=_tables_with_angles(study.fits_with_angles) if study.fits_with_angles else _tables_without_angles(study),
        notes=(*study.left_out, assumption, Finding("intervals_of_flights")),
        files={"robot.yaml": dump_yaml(corrected)},
    )


def _tables_with_angles(joints: Sequence[LogJointFit]) -> tuple[ReportTable, ...]:
    rows = []
    for joint in joints:
        before, after = joint.declared_error, joint.laws[joint.chosen].error
        numbers = interval_text(before), interval_text(after), relative_change_text(before.value, after.value)
        rows.append((joint.name, ", ".join(joint.changed) or "nothing", joint.chosen, *numbers))
    head = ("joint", "differs", "law", "declared, error [N m]", "fitted, held-out error [N m]", "change")
    return ReportTable("Joints", head, rows), *(_table_of_laws(joint) for joint in joints)


def _table_of_laws(joint: LogJointFit) -> ReportTable:
    rows = [
        (law.name + " (chosen)" * (law.name == joint.chosen), name, interval_text(value))
        for law in joint.laws.values()
        for name, value in law.params.items()
    ]
    return ReportTable(f"Candidates for {joint.name}", ("law", "parameter [N m, rad, s]", "95 %"), rows)


def _tables_without_angles(study: FlightJointStudy) -> tuple[ReportTable, ...]:
    numbers = []
    for joint in study.joints:
        for name, value in joint.params.items():
            declared, differs = f"{joint.declared[name]:.4g}", "yes" if name in joint.changed else "no"
            numbers.append((joint.name, name, declared, interval_text(value), differs))
    errors = [
        (name, interval_text(before), interval_text(after), relative_change_text(before.value, after.value))
        for name, (before, after) in study.channels.items()
    ]
    head = ("channel [m/s², rad/s²]", "declared, error", "fitted, held-out error", "change")
    return (
        ReportTable("Joints", ("joint", "parameter [N m, rad, s]", "declared", "fitted, 95 %", "differs"), numbers),
        ReportTable("Motion of the body", head, errors),
    )
