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

ROTORS = 4  # Required number of rotors; with more, the mixer determines the distribution of thrust


@dataclass(frozen=True)
class BalanceCause:
    """A candidate cause: it multiplies the baseline effort of each rotor by ``1 + columns params``."""

    name: str
    kind: str  # Class of cause: none, weight, propeller or other
    columns: Array = field(repr=False)  # Linear effect of the parameters on the efforts, (R, P)
    physical: Callable[[Array], dict[str, float]] = field(repr=False)  # Function from fitted to physical parameters
    motor: int | None = None  # Affected rotor from 1; None: all

    @property
    def part(self) -> str:
        """Name of the part at fault: a propeller, whatever its drag, or the candidate itself."""
        return self.name if self.motor is None else f"{self.kind} {self.motor}"


@dataclass(frozen=True, kw_only=True)
class ThrustsInBalance:
    """Thrusts in balance, relative to weight."""

    carried: Array  # Share of the weight carried by each rotor as declared, (R,)
    shift: Array  # Relative change per metre of centre-of-mass shift along x and y, (R, 2)
    twist: Array  # Relative change per unit of ``sum(spin thrust)``, (R,)
    spin: Array  # Spin of each rotor, (R,)


def thrusts_in_balance(robot: RobotCfg) -> ThrustsInBalance:
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
    return ThrustsInBalance(carried=carried, shift=shift, twist=to_yaw / carried, spin=spin)


def candidate_causes(robot: RobotCfg) -> list[BalanceCause]:
    """Return the candidate causes for a declared vehicle, "none" first and "something else" last.

    Source:
        Derived: total thrust, moments about the centre of mass, and drag torques equal weight, zero and zero. If rotor j
        has the share s of its thrust, and r times its drag torque per thrust, then ``sum(spin T) = (1 - r) spin_j T_j``,
        and its effort is ``T_j / s``.
    """
    layout, mass = thrusts_in_balance(robot), robot.body.mass
    heavier = np.ones((ROTORS, 1))

    def payload_and_offset(params: Array) -> dict[str, float]:
        whole = 1.0 + params[0]
        return {"dm": float(mass * params[0]), "x": float(params[1] / whole), "y": float(params[2] / whole)}

    return [
        BalanceCause("none", "none", np.empty((ROTORS, 0)), lambda _: {}),
        BalanceCause("payload_mass", "weight", heavier, lambda p: {"dm": float(mass * p[0])}),
        BalanceCause("com_offset", "weight", layout.shift, lambda p: {"x": float(p[0]), "y": float(p[1])}),
        BalanceCause(
            "payload_mass + com_offset", "weight", np.column_stack((heavier, layout.shift)), payload_and_offset
        ),
        *(cause for rotor in range(ROTORS) for cause in _weak_propellers(layout, rotor)),
        OTHER,
    ]


OTHER = BalanceCause("something else", "other", np.eye(ROTORS), lambda _: {})
"""Any other change: two causes at once, or one that is not listed."""


def prior_probabilities_of_causes(possible: Sequence[BalanceCause]) -> Array:
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


def _weak_propellers(layout: ThrustsInBalance, rotor: int) -> list[BalanceCause]:
    """Return two weak propellers: one whose drag torque falls with its thrust, and one with free drag torque."""
    name, one = f"weak_motor {rotor + 1}", np.eye(ROTORS)[:, rotor : rotor + 1]

    def scale(params: Array) -> dict[str, float]:
        return {"scale": float(1.0 / (1.0 + params[0]))}

    def scale_and_torque_ratio(params: Array) -> dict[str, float]:
        thrust = 1.0 + layout.twist[rotor] * params[1]
        drag = 1.0 - params[1] / (layout.spin[rotor] * layout.carried[rotor] * thrust)
        return {"scale": float(thrust / (thrust + params[0])), "torque_ratio": float(drag)}

    both, number = np.column_stack((one, layout.twist)), rotor + 1
    return [
        BalanceCause(name, "propeller", one, scale, number),
        BalanceCause(f"{name} + torque_ratio", "propeller", both, scale_and_torque_ratio, number),
    ]


def experiments_for_causes(candidates: Sequence[str]) -> list[Finding]:
    """Return the experiments that distinguish the candidates."""
    if len(candidates) < 2:
        return []
    weak, payload = (sum(name.startswith(kind) for name in candidates) for kind in ("weak_motor", "payload_mass"))
    codes = ["weigh_vehicle", "measure_thrust"] if 0 < payload < len(candidates) else []
    codes += ["turn_with_gyro"] if 0 < weak < len(candidates) else []
    return [Finding(code) for code in (*codes, *(["swap_propeller"] if weak else []))]
