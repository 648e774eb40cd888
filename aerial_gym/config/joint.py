"""Joints of a vehicle: their links' masses, springs, drives and end stops.

A robot file describes the vehicle in its reference pose as if it were rigid: ``body`` is all of it, and hubs, centres and axes
are in body axes. The numbers of joints are for the reference pose too, in body axes: a joint at its coordinate
``reference`` changes nothing.
SI units; coordinates of revolute joints in rad, of prismatic ones in m.
"""

from dataclasses import dataclass
from math import inf, isclose, isfinite, sqrt

from aerial_gym.config import checks
from aerial_gym.config.checks import NO_SOURCE, Vec3
from aerial_gym.config.shape import BASE
from aerial_gym.errors import ConfigError

DRIVE_MODES = ("position", "velocity", "effort")


@dataclass(frozen=True, kw_only=True)
class LinkCfg:
    """Mass and inertia of a joint's link; the base has the rest of the vehicle's mass."""

    mass: float  # [kg], > 0
    com: Vec3  # Centre of mass from the body origin [m], body axes, reference pose

    inertia: tuple[Vec3, Vec3, Vec3]
    """About that centre of mass [kg m²], body axes, reference pose; symmetric, none of the principal moments negative or
    more than the sum of the others. Zero for a mass that is a point."""

    def __post_init__(self) -> None:
        checks.require(self, "mass", 0.0 < self.mass < inf, "must be > 0 and finite; leave out a link without mass")
        checks.require_finite(self, "com")
        checks.require_inertia(self, may_vanish=True)


@dataclass(frozen=True, kw_only=True)
class CreepCfg:
    """A Maxwell element (spring and dashpot in series) parallel to a joint's spring: it relaxes under constant load."""

    stiffness: float  # Of the spring [N m/rad], > 0
    time: float  # After which 63 % of its effort are gone [s], > 0

    def __post_init__(self) -> None:
        checks.require_positive(self, "stiffness", "time")


@dataclass(frozen=True, kw_only=True)
class SpringCfg:
    """A passive joint: ``preload - (k + k2 |q - rest|) (q - rest) - damping q' - friction sign(q')``, plus creep."""

    stiffness: float = 0.0  # k [N m/rad], >= 0
    quadratic: float = 0.0  # k2 [N m/rad²], >= 0
    damping: float = 0.0  # [N m s/rad], >= 0
    friction: float = 0.0  # Dry friction [N m], >= 0: it holds the joint against less
    rest: float = 0.0  # [rad]
    preload: float = 0.0  # Torque at the rest angle [N m], such as against the weight of an arm
    creep: tuple[CreepCfg, ...] = ()  # Elements that relax; all have where an episode begins

    def __post_init__(self) -> None:
        checks.require_not_negative(self, "stiffness", "quadratic", "damping", "friction")
        checks.require_finite(self, "rest", "preload")


@dataclass(frozen=True, kw_only=True)
class DriveCfg:
    """A joint that follows a command: one more entry of the action."""

    mode: str
    """``position``: ``stiffness (command - q) - damping q'``; ``velocity``: ``damping (command - q')``; ``effort``: the
    command itself. In rad, rad/s and N m."""

    stiffness: float = 0.0  # [N m/rad], > 0 in position mode, and only there
    damping: float = 0.0  # [N m s/rad], > 0 in velocity mode, >= 0 in position mode
    limit: float  # Largest effort [N m], > 0
    command_range: tuple[float, float]  # Lowest and highest command

    def __post_init__(self) -> None:
        checks.require_choice(self, "mode", DRIVE_MODES)
        checks.require_not_negative(self, "stiffness", "damping")
        checks.require_positive(self, "limit")
        low, high = self.command_range
        checks.require(self, "command_range", isfinite(low) and isfinite(high) and low < high, "needs low < high")
        holds = (self.stiffness > 0.0) == (self.mode == "position")
        checks.require(self, "stiffness", holds, "must be > 0 in position mode, and only there")
        checks.require(self, "damping", self.mode != "velocity" or self.damping > 0.0, "must be > 0 in velocity mode")
        holds = self.mode != "effort" or self.damping == 0.0
        checks.require(self, "damping", holds, "must be 0 in effort mode. Give the joint a spring: {damping: ...}")


@dataclass(frozen=True, kw_only=True)
class EndsCfg:
    """Soft ends of a joint's range: beyond them a spring with a damper pushes back, and never pulls."""

    low: float  # Lowest coordinate without an end [rad]
    high: float  # Highest [rad]
    stiffness: float  # [N m/rad], > 0
    damping: float = 0.0  # [N m s/rad], >= 0

    def __post_init__(self) -> None:
        checks.require_finite(self, "low", "high")
        checks.require(self, "low", self.low < self.high, f"must be below high = {self.high!r}")
        checks.require_positive(self, "stiffness")
        checks.require_not_negative(self, "damping")


@dataclass(frozen=True, kw_only=True)
class JointCfg:
    """One joint of one degree of freedom; a universal joint is two, the first without a link."""

    name: str  # By which mounts and other joints name its link
    parent: str = BASE  # Parent: the joint whose link carries it, or `base`
    kind: str = "revolute"  # `revolute` or `prismatic`
    axis: Vec3  # Unit vector that it turns about or moves along, body axes, reference pose
    position: Vec3  # A point of the axis from the body origin [m], body axes, reference pose
    reference: float = 0.0  # Its coordinate in the reference pose [rad] or [m]
    link: LinkCfg | None = None  # Mass of its link besides joints and rotors; none if not given
    spring: SpringCfg | None = None  # Passive torque; none if not given
    drive: DriveCfg | None = None  # Commanded torque, likewise
    ends: EndsCfg | None = None  # Soft ends of its range, likewise
    initial: tuple[float, float] | None = None  # Range of its coordinate at a reset; `reference` if not given
    initial_rate: tuple[float, float] = (0.0, 0.0)  # Likewise its rate

    def __post_init__(self) -> None:
        checks.require(self, "name", self.name not in ("", BASE), f"{BASE!r} is the body itself. Choose another name")
        checks.require_choice(self, "kind", ("revolute", "prismatic"))
        checks.require_finite(self, "axis", "position", "reference", "initial", "initial_rate")
        length = sqrt(sum(a * a for a in self.axis))
        checks.require(self, "axis", isclose(length, 1.0, abs_tol=1e-6), "must have length 1")
        checks.require(self, "initial", self.initial_range[0] <= self.initial_range[1], "needs low <= high")
        checks.require(self, "initial_rate", self.initial_rate[0] <= self.initial_rate[1], "needs low <= high")

    @property
    def initial_range(self) -> tuple[float, float]:
        """Range from which a reset draws its coordinate."""
        return (self.reference, self.reference) if self.initial is None else self.initial


@dataclass(frozen=True, kw_only=True)
class JointsCfg:
    """All joints, in the order of joint states."""

    layout: tuple[JointCfg, ...]  # Joints, each after its parent
    floating: bool = True  # Whether the base flies; else it is held where a reset puts it
    source: str = NO_SOURCE  # Source of the numbers

    def __post_init__(self) -> None:
        known = [BASE]
        if not self.layout:
            raise ConfigError("JointsCfg.layout: needs at least one joint. Leave joints out for a rigid vehicle")
        for joint in self.layout:
            if joint.name in known:
                raise ConfigError(f"JointsCfg.layout: two joints are named {joint.name!r}")
            if joint.parent not in known:
                rule = f"must be {BASE} or a joint before it"
                raise ConfigError(f"JointsCfg.layout: {joint.name} sits on {joint.parent!r}: {rule}")
            known.append(joint.name)
        carriers = {joint.parent for joint in self.layout}
        for joint in self.layout:
            if joint.link is None and joint.name not in carriers:
                raise ConfigError(
                    f"JointsCfg.layout: {joint.name} carries no mass and no joint: nothing would hold it. Give it a link"
                )

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the joints."""
        return tuple(joint.name for joint in self.layout)

    @property
    def link_names(self) -> tuple[str, ...]:
        """Names of the links: the base, then one of each joint."""
        return (BASE, *self.names)

    def note_on_rigidity(self, consequence: str) -> str:
        """Return a note that a command treats the vehicle as rigid, with the consequence."""
        return (
            f"its joints ({', '.join(self.names)}) are held in the reference pose here, and the vehicle taken as rigid: "
            f"{consequence} (docs/guides/articulated_vehicles.md)"
        )

    def link_number(self, name: str) -> int:
        """Return the number of a link: 0 of the base, k + 1 of joint k; raise ``ConfigError`` without such a link."""
        if name not in self.link_names:
            raise ConfigError(f"no link {name!r}: the links are {', '.join(self.link_names)}")
        return self.link_names.index(name)

    @property
    def drive_joints(self) -> tuple[int, ...]:
        """Numbers of the joints with a drive, in the order of their commands."""
        return tuple(k for k, joint in enumerate(self.layout) if joint.drive is not None)
