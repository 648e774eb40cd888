"""Race track: gates to be passed in order, poles to avoid, and the draws of both at reset.

Frames: world of each environment, z up; a gate is flown through along its own x, its opening lies in its y and z.
"""

from dataclasses import dataclass
from math import pi

from aerial_gym.config import checks
from aerial_gym.config.checks import Vec3

GATES, POLES = "gates", "poles"  # First two assets of a track: an instance for each gate and for each pole

Vec2 = tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class GatePlaceCfg:
    """Nominal place of a gate."""

    position: Vec3  # Middle of the opening [m], world
    euler: Vec3 = (0.0, 0.0, 0.0)  # ZYX roll, pitch, yaw [rad], within +-2 pi; with yaw 0 it is flown through along x

    def __post_init__(self) -> None:
        checks.require_finite(self, "position")
        checks.require_angles(self, "euler")


@dataclass(frozen=True, kw_only=True)
class LayoutCfg:
    """A whole track drawn at every reset: places in x and y, and yaws; heights are those of the gates and poles as listed.

    One after the other, gates are drawn uniformly where they keep their distances, and are flown through in the direction
    of travel from the one before (the first: from the robot's start), give or take ``yaw_range``. A pole is drawn into the
    corridor between the two if there is room, otherwise anywhere it keeps its distances. Where nothing keeps them, the draw
    that comes closest is taken.

    Source: the rule and the defaults are those of github learnsyslab/lsy_drone_racing, envs/randomize.py, build_random_track_fn
    (there on a grid of 10 cm).
    """

    lower: Vec2  # Lowest x and y of gates and poles [m]
    upper: Vec2  # Highest x and y [m]
    start_distance: float = 1.0  # Least distance of gates and poles to the robot's start [m], >= 0
    gate_distance: float = 1.0  # Least distance between gates [m], >= 0
    pole_to_gate: float = 0.8  # Least distance between a pole and a gate [m], >= 0
    pole_distance: float = 0.3  # Least distance between poles [m], >= 0
    corridor: float = 0.5  # Largest distance of a pole to the line from one gate to the next [m], > 0
    yaw_range: float = 0.75  # Largest angle between a gate and the direction of travel [rad], 0 to pi

    def __post_init__(self) -> None:
        checks.require_finite(self, "lower", "upper")
        checks.require_ordered(self, "lower", "upper")
        checks.require_positive(self, "corridor")
        checks.require_not_negative(self, "start_distance", "gate_distance", "pole_to_gate", "pole_distance")
        checks.require(self, "yaw_range", 0.0 <= self.yaw_range <= pi, "must be 0 to pi rad")


@dataclass(frozen=True, kw_only=True)
class TrackCfg:
    """Gates and poles. A pilot knows their nominal poses: as listed, or as ``layout`` draws them.

    A reset adds uniform offsets to the nominal places.
    """

    gates: tuple[GatePlaceCfg, ...]  # In the order in which they are flown through; at least one
    poles: tuple[Vec3, ...] = ()  # Nominal tops of the poles [m], world
    gate_position_low: Vec3 = (0.0, 0.0, 0.0)  # Lowest offset of a gate [m], world
    gate_position_high: Vec3 = (0.0, 0.0, 0.0)  # Highest offset of a gate [m], world
    gate_euler_low: Vec3 = (0.0, 0.0, 0.0)  # Lowest offset of a gate's roll, pitch, yaw [rad]
    gate_euler_high: Vec3 = (0.0, 0.0, 0.0)  # Highest offset of a gate's roll, pitch, yaw [rad]
    pole_low: Vec3 = (0.0, 0.0, 0.0)  # Lowest offset of a pole [m], world
    pole_high: Vec3 = (0.0, 0.0, 0.0)  # Highest offset of a pole [m], world
    layout: LayoutCfg | None = None  # Random layout of the whole track; None keeps the listed one

    def __post_init__(self) -> None:
        checks.require(self, "gates", bool(self.gates), "needs at least one")
        checks.require_finite(self, "poles")
        checks.require_ranges(self, "gate_position", "gate_euler", "pole")
        holds = self.layout is None or len(self.poles) <= len(self.gates)
        checks.require(self, "poles", holds, "layout draws one pole, at most, on the way to each gate")

    @property
    def counts(self) -> dict[str, int]:
        """Number of instances of each asset of the track, in their order."""
        return {name: count for name, count in ((GATES, len(self.gates)), (POLES, len(self.poles))) if count}
