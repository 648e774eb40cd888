"""The identification of joints from flights, from files to a study with tables and a robot file."""

from collections.abc import Sequence
from pathlib import Path

from aerial_gym.config import dump_yaml
from aerial_gym.config.robot import RobotCfg
from aerial_gym.sim2real.teststand.flown_joints import FlownJoint, corrected, fit_flown_joints
from aerial_gym.sim2real.teststand.joint_courses import read_course
from aerial_gym.sim2real.teststand.report import Study, Table
from aerial_gym.sim2real.teststand.studies import change, interval


def study_flown_joints(robot: RobotCfg, flights: Sequence[Path], *, bandwidth: float) -> Study:
    """Return the laws of the passive joints of a robot from flights with logged joint angles.

    Raises:
        ConfigError: If the robot has no joints.
        DataError: If a log does not hold what is needed.
    """
    if robot.joints is None:
        fit_flown_joints(robot, [])  # says so
    courses = [read_course(path, robot, bandwidth=bandwidth) for path in flights]
    joints, left_out = fit_flown_joints(robot, courses)
    names = ", ".join(path.name for path in flights)
    rows = tuple(
        (
            joint.name,
            ", ".join(joint.changed) or "nothing",
            joint.chosen,
            interval(joint.declared),
            interval(joint.laws[joint.chosen].error),
            change(joint.declared.value, joint.laws[joint.chosen].error.value),
        )
        for joint in joints
    )
    head = ("joint", "differs", "law", "declared, error [N m]", "fitted, error on what is left out [N m]", "change")
    named = [f"{joint.name}: {what}" for joint in joints for what in joint.changed]
    robot_file = corrected(robot, joints, f"aerial-gym identify joints: {names}")
    return Study(
        title="Joints in flight",
        intro=f"Differs from what is declared: {'; '.join(named) or 'nothing'}. Errors are those of the effort that a joint "
        "must have given, below the bandwidth; flights, or parts of the only one, are left out in turn.",
        mapping={"bandwidth_hz": bandwidth, "joints": [joint.as_mapping() for joint in joints], "left_out": left_out},
        tables=(Table(title="Joints", head=head, rows=rows), *(_numbers(joint) for joint in joints)),
        notes=(
            *(f"left out: {text}" for text in left_out),
            "masses of links and thrusts are taken as declared: 1 % more of a link's inertia is 1 % more of its numbers",
            "intervals hold what scatters within these flights, and no error of what is declared",
        ),
        files={"robot.yaml": dump_yaml(robot_file)},
    )


def _numbers(joint: FlownJoint) -> Table:
    rows = [
        (law.name + " (chosen)" * (law.name == joint.chosen), name, interval(value))
        for law in joint.laws.values()
        for name, value in law.params.items()
    ]
    head = ("law", "number [N m, rad, s]", "95 %")
    return Table(title=f"Candidates for {joint.name}", head=head, rows=tuple(rows))
