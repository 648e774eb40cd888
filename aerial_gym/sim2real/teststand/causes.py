"""Possible causes of a changed balance at hover: added weight, a shifted centre of mass or a weak propeller.

Weight, roll, pitch and yaw balance determine the thrusts of four rotors along body z. ``effort`` is the squared speed of a
rotor; thrust is a factor per rotor times that.
Body is x forward, y left, z up. Letters: R rotors (four), P parameters.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from aerial_gym.config.robot import RobotCfg
from aerial_gym.errors import ConfigError
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.findings import Finding

ROTORS = 4
"""Required number of rotors; with more, the mixer determines the distribution of thrust."""


@dataclass(frozen=True, kw_only=True)
class BalanceCause:
    """A candidate cause: it multiplies the baseline effort of each rotor by ``1 + columns params``."""

    name: str
    columns: Array = field(repr=False)  # Linear effect of the parameters on the efforts, (R, P)
    physical: Callable[[Array], dict[str, float]] = field(repr=False)  # Function from fitted to physical parameters
    kind: str  # Class of cause: none, weight, propeller or other
    motor: int | None = None  # Affected rotor from 1; None: all

    @property
    def part(self) -> str:
        """Name of the part at fault: a propeller, whatever its drag, or the candidate itself."""
        return self.name if self.motor is None else f"{self.kind} {self.motor}"


@dataclass(frozen=True, kw_only=True)
class ThrustLayout:
    """Thrusts in balance, relative to weight."""

    carried: Array  # Share of the weight carried by each rotor as declared, (R,)
    shift: Array  # Relative change per metre of centre-of-mass shift along x and y, (R, 2)
    twist: Array  # Relative change per unit of ``sum(spin thrust)``, (R,)
    spin: Array  # Spin of each rotor, (R,)


def thrust_layout(robot: RobotCfg) -> ThrustLayout:
    """Return the thrusts with which four rotors balance a declared vehicle; ``ConfigError`` if they cannot."""
    mounts = robot.mounts.layout
    axes = np.array([mount.axis for mount in mounts])
    if len(mounts) != ROTORS or np.abs(axes[:, :2]).max() > 1e-6 or axes[:, 2].min() <= 0.0:
        raise ConfigError(
            f"the balance at hover needs {ROTORS} rotors that thrust along body z; see mounts.layout of the robot"
        )
    arm = np.array([mount.position for mount in mounts]) - np.array(robot.body.com)
    spin = np.array([float(mount.spin) for mount in mounts])
    rows = np.stack((np.ones(ROTORS), arm[:, 0], arm[:, 1], spin))
    if np.linalg.cond(rows / np.maximum(np.abs(rows).max(axis=1, keepdims=True), 1e-12)) > 1e6:
        raise ConfigError(
            "the four rotors cannot balance weight, roll, pitch and yaw: check mounts.layout of the robot"
        )
    carried, to_x, to_y, to_yaw = np.linalg.inv(rows).T
    if carried.min() <= 0.0:
        raise ConfigError("the declared centre of mass is not between the rotors: check body.com and mounts.layout")
    shift = np.stack((to_x, to_y), axis=1) / carried[:, None]
    return ThrustLayout(carried=carried, shift=shift, twist=to_yaw / carried, spin=spin)


def causes(robot: RobotCfg) -> list[BalanceCause]:
    """Return the candidate causes for a declared vehicle, "none" first and "something else" last.

    Source:
        Derived: total thrust, moments about the centre of mass, and drag torques equal weight, zero and zero. If rotor j
        has the share s of its thrust, and r times its drag torque per thrust, then ``sum(spin T) = (1 - r) spin_j T_j``,
        and its effort is ``T_j / s``.
    """
    layout, mass = thrust_layout(robot), robot.body.mass
    heavier = np.ones((ROTORS, 1))

    def param_columns(params: Array) -> dict[str, float]:
        whole = 1.0 + params[0]
        return {"dm": float(mass * params[0]), "x": float(params[1] / whole), "y": float(params[2] / whole)}

    return [
        BalanceCause(name="none", columns=np.empty((ROTORS, 0)), physical=lambda _: {}, kind="none"),
        BalanceCause(
            name="payload_mass", columns=heavier, physical=lambda p: {"dm": float(mass * p[0])}, kind="weight"
        ),
        BalanceCause(
            name="com_offset",
            columns=layout.shift,
            physical=lambda p: {"x": float(p[0]), "y": float(p[1])},
            kind="weight",
        ),
        BalanceCause(
            name="payload_mass + com_offset",
            columns=np.column_stack((heavier, layout.shift)),
            physical=param_columns,
            kind="weight",
        ),
        *(cause for rotor in range(ROTORS) for cause in _weak(layout, rotor)),
        OTHER,
    ]


OTHER = BalanceCause(name="something else", columns=np.eye(ROTORS), physical=lambda _: {}, kind="other")
"""Any other change: two causes at once, or one that is not listed."""


def cause_probabilities(possible: Sequence[BalanceCause]) -> Array:
    """Return the prior probability of each candidate.

    "none" has one half. The other classes share the rest equally, and the candidates of a class share its part.

    Source:
        Jeffreys (1961), Theory of probability, section 5.0: one half for no change. Scott, Berger (2010), Bayes and
        empirical-Bayes multiplicity adjustment in the variable-selection problem, Annals of Statistics 38: shared
        probability accounts for the number of candidates.
    """
    kinds = [cause.kind for cause in possible]
    num_others = len(set(kinds)) - 1
    return np.array([0.5 if kind == "none" else 0.5 / (num_others * kinds.count(kind)) for kind in kinds])


def _weak(layout: ThrustLayout, rotor: int) -> list[BalanceCause]:
    """Return two weak propellers: one whose drag torque falls with its thrust, and one with free drag torque."""
    name, one = f"weak_motor {rotor + 1}", np.eye(ROTORS)[:, rotor : rotor + 1]

    def with_yaw(params: Array) -> dict[str, float]:
        thrust = 1.0 + layout.twist[rotor] * params[1]
        drag = 1.0 - params[1] / (layout.spin[rotor] * layout.carried[rotor] * thrust)
        return {"scale": float(thrust / (thrust + params[0])), "torque_ratio": float(drag)}

    return [
        BalanceCause(
            name=name,
            columns=one,
            physical=lambda p: {"scale": float(1.0 / (1.0 + p[0]))},
            kind="propeller",
            motor=rotor + 1,
        ),
        BalanceCause(
            name=f"{name} + torque_ratio",
            columns=np.column_stack((one, layout.twist)),
            physical=with_yaw,
            kind="propeller",
            motor=rotor + 1,
        ),
    ]


def tell_apart(candidates: Sequence[str]) -> list[Finding]:
    """Return the experiments that distinguish the candidates."""
    if len(candidates) < 2:
        return []
    weak = [name for name in candidates if name.startswith("weak_motor")]
    payload = [name for name in candidates if name.startswith("payload_mass")]
    findings = []
    if payload and len(payload) < len(candidates):
        findings.extend((Finding("weigh_vehicle"), Finding("measure_thrust")))
    if weak and len(weak) < len(candidates):
        findings.append(Finding("turn_with_gyro"))
    if weak:
        findings.append(Finding("swap_propeller"))
    return findings
