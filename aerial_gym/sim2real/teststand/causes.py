"""What can change the balance of a hovering vehicle: a weight, a shifted centre of mass, a weak propeller.

Four rotors along body z are shared out by the balance alone: weight, roll, pitch and yaw give their four thrusts. ``effort`` is
the squared speed of a rotor; its thrust is a factor of its own times that.
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
"""With more, the mixer shares out the thrust, and not the balance."""


@dataclass(frozen=True, kw_only=True)
class Cause:
    """One candidate: what it does to the effort of each rotor over its baseline, ``1 + columns params``."""

    name: str
    columns: Array = field(repr=False)
    """(R, P)."""

    physical: Callable[[Array], dict[str, float]] = field(repr=False)
    """Parameters of the effects from those of the columns."""

    kind: str
    """What a person would look for: none, weight, propeller, other."""

    motor: int | None = None
    """Rotor concerned, from 1."""

    @property
    def part(self) -> str:
        """What is at fault: a propeller, whatever its drag does; else the candidate itself."""
        return self.name if self.motor is None else f"{self.kind} {self.motor}"


@dataclass(frozen=True, kw_only=True)
class Layout:
    """Thrusts that balance the vehicle, relative to its weight."""

    carried: Array
    """Weight that each rotor carries as declared, (R,)."""

    shift: Array
    """Change per metre that the centre of mass moves along x and y, over ``carried``, (R, 2)."""

    twist: Array
    """Change per sum of ``spin thrust``, over ``carried``, (R,)."""

    spin: Array
    """(R,)."""


def layout_of(robot: RobotCfg) -> Layout:
    """Return how four rotors carry a declared vehicle.

    Raises:
        ConfigError: If the vehicle is not balanced by four rotors that thrust along body z.
    """
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
    return Layout(carried=carried, shift=shift, twist=to_yaw / carried, spin=spin)


def causes(robot: RobotCfg) -> list[Cause]:
    """Return the candidates for a declared vehicle, "none" first and "something else" last.

    Source:
        Derived: sums of thrust, of thrust times place about the centre of mass, and of drag torques are weight, zero and zero.
        Where rotor j has the share s of its thrust and r times its drag torque per thrust, the sum of ``spin T`` is
        ``(1 - r) spin_j T_j``, and its effort is ``T_j / s``.
    """
    layout, mass = layout_of(robot), robot.body.mass
    heavier = np.ones((ROTORS, 1))

    def placed(params: Array) -> dict[str, float]:
        whole = 1.0 + params[0]
        return {"dm": float(mass * params[0]), "x": float(params[1] / whole), "y": float(params[2] / whole)}

    return [
        Cause(name="none", columns=np.empty((ROTORS, 0)), physical=lambda _: {}, kind="none"),
        Cause(name="payload_mass", columns=heavier, physical=lambda p: {"dm": float(mass * p[0])}, kind="weight"),
        Cause(
            name="com_offset",
            columns=layout.shift,
            physical=lambda p: {"x": float(p[0]), "y": float(p[1])},
            kind="weight",
        ),
        Cause(
            name="payload_mass + com_offset",
            columns=np.column_stack((heavier, layout.shift)),
            physical=placed,
            kind="weight",
        ),
        *(cause for rotor in range(ROTORS) for cause in _weak(layout, rotor)),
        OTHER,
    ]


OTHER = Cause(name="something else", columns=np.eye(ROTORS), physical=lambda _: {}, kind="other")
"""Any change at all: two causes at once, or one that is not listed."""


def priors(possible: Sequence[Cause]) -> Array:
    """Return the probability of each candidate before any log is seen.

    One half is for none. The other kinds share the other half equally, and the candidates of a kind share what it has.

    Source:
        Jeffreys (1961), Theory of probability, section 5.0: one half for no change. Scott, Berger (2010), Bayes and
        empirical-Bayes multiplicity adjustment in the variable-selection problem, Annals of Statistics 38: what candidates
        share out among them accounts for how many were tried.
    """
    kinds = [cause.kind for cause in possible]
    others = len(set(kinds)) - 1
    return np.array([0.5 if kind == "none" else 0.5 / (others * kinds.count(kind)) for kind in kinds])


def _weak(layout: Layout, rotor: int) -> list[Cause]:
    """Return a weak propeller whose drag torque falls with its thrust, and one whose drag torque is free."""
    name, one = f"weak_motor {rotor + 1}", np.eye(ROTORS)[:, rotor : rotor + 1]

    def with_yaw(params: Array) -> dict[str, float]:
        thrust = 1.0 + layout.twist[rotor] * params[1]
        drag = 1.0 - params[1] / (layout.spin[rotor] * layout.carried[rotor] * thrust)
        return {"scale": float(thrust / (thrust + params[0])), "torque_ratio": float(drag)}

    return [
        Cause(
            name=name,
            columns=one,
            physical=lambda p: {"scale": float(1.0 / (1.0 + p[0]))},
            kind="propeller",
            motor=rotor + 1,
        ),
        Cause(
            name=f"{name} + torque_ratio",
            columns=np.column_stack((one, layout.twist)),
            physical=with_yaw,
            kind="propeller",
            motor=rotor + 1,
        ),
    ]


def tell_apart(candidates: Sequence[str]) -> list[Finding]:
    """Return the experiments that tell candidates apart."""
    if len(candidates) < 2:
        return []
    weak = [name for name in candidates if name.startswith("weak_motor")]
    payload = [name for name in candidates if name.startswith("payload_mass")]
    found = []
    if payload and len(payload) < len(candidates):
        found.extend((Finding("weigh_vehicle"), Finding("measure_thrust")))
    if weak and len(weak) < len(candidates):
        found.append(Finding("turn_with_gyro"))
    if weak:
        found.append(Finding("swap_propeller"))
    return found
