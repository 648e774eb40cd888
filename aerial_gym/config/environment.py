"""Environment files: bounds, lamps, obstacles placed inside the bounds at every reset, with their motion, contact, race tracks.

Frames: the environment's own world frame, z up; lengths in metres, angles in radians. A gate is flown through along its own x,
its opening lies in its y and z.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from math import inf, pi
from pathlib import Path
from typing import ClassVar

from aerial_gym.config import checks
from aerial_gym.config.checks import MAX_MADE, NO_SOURCE, Vec3, require, require_not_negative, require_positive
from aerial_gym.config.loader import load
from aerial_gym.config.randomize import RandomizeCfg
from aerial_gym.config.shape import (
    FIRST_INSTANCE_ID,
    GROUND_ID,
    CheckerCfg,
    FamilyCfg,
    PartCfg,
    ShapeCfg,
    absolute_paths,
    require_color,
)
from aerial_gym.config.sim import STANDARD_GRAVITY
from aerial_gym.config.vehicles import NetworkCfg, PayloadCfg, VehiclesCfg
from aerial_gym.errors import ConfigError

GATES, POLES = "gates", "poles"  # First two assets of a track: an instance for each gate and for each pole

# Answer to a request for several vehicles where there can be one
ONE_VEHICLE = "there is one vehicle here; build_env(robots=[{name: ..., count: ...}]) puts several into an environment"

Vec2 = tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class ContactCfg:
    """A spring, a damper and Coulomb friction at every collision sphere; they scale with the robot's mass."""

    friction: float  # Coulomb coefficient, friction per normal force, >= 0

    sinking: float = 1e-3
    """Depth to which the robot's weight on Earth presses one sphere into a surface [m], > 0. The default is the rest offset
    of PhysX in the Aerial Gym Simulator."""

    damping_ratio: float = 1.0  # Damping of the robot's mass on one sphere per critical damping, >= 0; 1: no bounce

    crash_speed: float = 0.0
    """A touch is a crash where the surfaces approach at this speed or faster [m/s], >= 0: every touch with 0, none with inf."""

    def __post_init__(self) -> None:
        require_positive(self, "sinking")
        require_not_negative(self, "friction", "damping_ratio")
        require(self, "crash_speed", self.crash_speed >= 0.0, "must be >= 0; .inf for no crash at all")

    @property
    def stiffness(self) -> float:
        """Spring constant per mass of the robot [1/s²]."""
        return STANDARD_GRAVITY / self.sinking

    @property
    def damping(self) -> float:
        """Damping constant per mass of the robot [1/s]."""
        return 2.0 * self.damping_ratio * self.stiffness**0.5

    @property
    def crash_approach_speed(self) -> float:
        """Approach speed from which a touch is a crash [m/s]; -inf if every touch is one, even when separating."""
        return self.crash_speed if self.crash_speed > 0.0 else -inf


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


MOTIONS = ("none", "twist", "waypoints")  # Kinds of obstacle motion between resets
AT_BOUNDS = ("pass", "bounce", "wrap")  # Behaviours at the bounds of an asset that moves by its twist


@dataclass(frozen=True, kw_only=True)
class MotionCfg:
    """Motion of an asset's instances between resets. Every number is drawn uniformly at reset."""

    kind: str = "none"
    """``none``; ``twist``: straight on and turning, with a twist that the user may overwrite at any time;
    ``waypoints``: back and forth between the place of the reset and a second one, drawn like it."""

    lin_vel_low: Vec3 = (0.0, 0.0, 0.0)  # Lowest velocity of `twist` [m/s], world
    lin_vel_high: Vec3 = (0.0, 0.0, 0.0)  # Highest velocity [m/s], world
    speed: tuple[float, float] = (0.0, 0.0)  # Lowest and highest speed along `waypoints` [m/s], >= 0
    ang_vel_low: Vec3 = (0.0, 0.0, 0.0)  # Lowest angular velocity [rad/s], world; for both
    ang_vel_high: Vec3 = (0.0, 0.0, 0.0)  # Highest angular velocity [rad/s], world
    at_bounds: str = "pass"  # Where `twist` brings the origin to the bounds: `pass` on, `bounce` off, `wrap` around

    def __post_init__(self) -> None:
        checks.require_choice(self, "kind", MOTIONS)
        checks.require_choice(self, "at_bounds", AT_BOUNDS)
        checks.require_ranges(self, "lin_vel", "ang_vel")
        checks.require(self, "speed", 0.0 <= self.speed[0] <= self.speed[1] < inf, "needs 0 <= low <= high < inf")
        still = MotionCfg.__dataclass_fields__
        unused = {
            "none": ("lin_vel_low", "lin_vel_high", "ang_vel_low", "ang_vel_high", "speed", "at_bounds"),
            "twist": ("speed",),
            "waypoints": ("lin_vel_low", "lin_vel_high", "at_bounds"),
        }
        for name in unused[self.kind]:
            checks.require(self, name, getattr(self, name) == still[name].default, f"motion {self.kind!r} ignores it")


@dataclass(frozen=True, kw_only=True)
class LampCfg:
    """A lamp that shines to all sides alike. At the distance r a white surface that faces it has the brightness I c / r²."""

    position: Vec3  # Position [m], world. The lamp itself is not seen and throws no shadow; a shape around it would

    intensity: float
    """I: brightness of a white surface that faces it, times the squared distance [m²], > 0; brightness 1 is that of full
    sun and sky, and the brightest that a pixel can show."""

    color: Vec3 = (1.0, 1.0, 1.0)  # c: red, green, blue of the light, each 0 to 1

    def __post_init__(self) -> None:
        checks.require_finite(self, "position")
        checks.require_positive(self, "intensity")
        require_color(self, "color")


__all__ = [
    "AT_BOUNDS", "FIRST_INSTANCE_ID", "MOTIONS", "AssetCfg", "CheckerCfg", "ContactCfg", "EnvironmentCfg", "FamilyCfg",
    "LampCfg", "MotionCfg", "PartCfg", "ShapeCfg", "load_environment",
]  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class AssetCfg:
    """One kind of obstacle: its shapes, how many, and where a reset puts them."""

    name: str  # Name in messages, unique in its environment
    shapes: tuple[ShapeCfg, ...] = ()  # Each instance is one of these, drawn once at construction with equal chances
    family: FamilyCfg | None = None  # Family of generated shapes, in place of a list
    count: int  # Instances in every environment, >= 1

    keep: bool = False
    """Whether it is always present; the others can be reduced in number (curriculum). Only ``clearance`` goes first:
    what has no place beside the robot is parked, also if it is kept."""

    semantic_id: int = -1  # Segmentation id, 0 to 99; -1 for the instance's own id (100 + its row in the environment)
    position_ratio_low: Vec3  # Lowest position of the shape's origin as a share of the bounds (0 lower, 1 upper face)
    position_ratio_high: Vec3  # Highest position, likewise

    offset: Vec3 = (0.0, 0.0, 0.0)
    """Added to the position [m], world. A wall whose ratio puts its centre on a face of the bounds has half its
    thickness along the outward normal here, so that its inner face lies exactly on the bound."""

    euler_low: Vec3 = (0.0, 0.0, 0.0)  # Lowest ZYX roll, pitch, yaw [rad], within +-2 pi
    euler_high: Vec3 = (0.0, 0.0, 0.0)  # Highest roll, pitch, yaw [rad], within +-2 pi
    motion: MotionCfg = field(default_factory=MotionCfg)  # Motion of the instances between resets

    def __post_init__(self) -> None:
        checks.require(self, "name", bool(self.name), "must not be empty")
        if bool(self.shapes) == (self.family is not None):
            checks.refuse(f"AssetCfg {self.name!r}: give shapes, at least one, or a family, and not both")
        try:
            checks.require_count(self, "count", most=MAX_MADE)
            rule = f"must be 0 to {FIRST_INSTANCE_ID - 1}, or -1 for the instance's own id"
            checks.require(self, "semantic_id", -1 <= self.semantic_id < FIRST_INSTANCE_ID, rule)
            checks.require_finite(self, "offset")
            checks.require_ranges(self, "position_ratio", "euler")
            checks.require_angles(self, "euler_low", "euler_high")
        except ConfigError as error:
            raise ConfigError(f"asset {self.name!r}: {error}") from None


@dataclass(frozen=True, kw_only=True)
class EnvironmentCfg:
    """A box of space with its obstacles. Each environment draws its bounds uniformly at reset."""

    ABSENT: ClassVar[Mapping[str, str]] = {"vehicles": "it is called robots: [{name: ..., count: ...}]"}
    """Fields that files of other simulators have."""

    summary: str  # One line for people who choose an environment
    physics_steps_per_env_step: int  # Physics steps for which an action is held, >= 1
    bounds_lower_low: Vec3  # Lowest lower corner of the bounds [m], world
    bounds_lower_high: Vec3  # Highest lower corner [m], world; below `bounds_upper_low` on every axis
    bounds_upper_low: Vec3  # Lowest upper corner [m], world
    bounds_upper_high: Vec3  # Highest upper corner [m], world
    assets: tuple[AssetCfg, ...] = ()  # Obstacles; an empty list is open space
    track: TrackCfg | None = None  # Race track; its gates and poles are the first assets, `gates` and `poles`, all kept

    clearance: float = 0.0
    """A reset leaves at least this much room around the robot's collision shapes [m], >= 0; 0 asks for nothing.
    It moves or parks obstacles whose place is drawn; those whose place is given, such as walls, stay."""

    ground_height: float | None = None
    """Height of the ground [m], world; none in open air. Touching it is a crash (see ``contact``), ``robot_clearance``
    counts it, and every sensor sees it as a plane without end. It is no asset: it has no row and is never moved."""

    ceiling_height: float | None = None
    """Height of the ceiling [m], world, for effects on the rotors near it; none in open air. It is nothing to touch or see: put
    a wall there for that."""

    ground_semantic_id: int = GROUND_ID  # Segmentation id of the ground, 0 to 99
    ground_color: Vec3 = (0.42, 0.45, 0.36)  # Red, green, blue of the ground, each 0 to 1
    ground_checker: CheckerCfg | None = None  # Fields of a second colour on the ground

    contact: ContactCfg | None = None
    """Contact law of ground and obstacles, and the touches that are crashes; without it, there is no contact force and every
    touch is a crash. Contact that pushes is found at the poses after each substep alone."""

    robots: tuple[VehiclesCfg, ...] = field(default=(), repr=False)  # a state of release 0.1 has the digest of its repr
    """Vehicles of every environment (docs/concepts/several_vehicles.md); none for the one of the call, as a task has it."""

    vehicle_clearance: float = field(default=0.0, repr=False)  # likewise
    """Least room between two vehicles at their starts [m], >= 0, between balls that hold their collision shapes."""

    reset_together: bool = field(default=False, repr=False)  # likewise
    """Whether the end of one vehicle's episode ends those of all in its environment."""

    network: NetworkCfg | None = field(default=None, repr=False)  # likewise
    """Network by which several vehicles know each other's place and velocity (keys ``neighbour_...``); none by default."""

    payload: PayloadCfg | None = field(default=None, repr=False)  # likewise
    """Payload that all vehicles of an environment carry together on cables; None without one."""

    lamps: tuple[LampCfg, ...] = ()
    """Lights at a point, in colour images beside the sun and the sky of the sensor; none cost nothing, each of them a ray per
    pixel that it lights where the sensor has shadows."""

    randomize: Mapping[str, RandomizeCfg] = field(default_factory=dict)
    """Robot quantities drawn at every reset here, such as the wind, in addition to those of the robot file; a name here
    replaces the robot's."""

    source: str = NO_SOURCE  # Source of the numbers

    def __post_init__(self) -> None:
        checks.require_finite(self, "ground_height", "ceiling_height")
        ground, ceiling = self.ground_height, self.ceiling_height
        holds = ground is None or ceiling is None or ceiling > ground
        checks.require(self, "ceiling_height", holds, f"must be above ground_height = {ground!r}")
        if self.contact is not None and self.ground_height is None and not self.assets:
            checks.refuse("EnvironmentCfg.contact: there is nothing to touch. Give ground_height or assets")
        require_color(self, "ground_color")
        holds = 0 <= self.ground_semantic_id < FIRST_INSTANCE_ID
        checks.require(self, "ground_semantic_id", holds, f"must be 0 to {FIRST_INSTANCE_ID - 1}")
        checks.require_not_negative(self, "clearance", "vehicle_clearance")
        checks.require_count(self, "physics_steps_per_env_step", most=MAX_MADE)
        checks.require_ranges(self, "bounds_lower", "bounds_upper")
        holds = all(low < high for low, high in zip(self.bounds_lower_high, self.bounds_upper_low, strict=True))
        rule = f"must lie below bounds_upper_low = {self.bounds_upper_low} on every axis"
        checks.require(self, "bounds_lower_high", holds, rule)
        self._check_track()
        names = [asset.name for asset in self.assets]
        for name in names:
            if names.count(name) > 1:
                checks.refuse(f"EnvironmentCfg.assets: two are called {name!r}. Give each its own name")

    def _check_track(self) -> None:
        counts = {} if self.track is None else self.track.counts
        asset_counts = {asset.name: asset.count for asset in self.assets[: len(counts)] if asset.keep}
        if asset_counts != counts or list(asset_counts) != list(counts):
            needed = ", ".join(f"{name} (count: {count}, keep: true)" for name, count in counts.items())
            checks.refuse(f"EnvironmentCfg.track: its gates and poles are the first assets: needs {needed}")

    @property
    def moves(self) -> bool:
        """Whether any asset moves between resets."""
        return any(asset.motion.kind != "none" for asset in self.assets)

    @property
    def ground_part(self) -> PartCfg | None:
        """The ground as a part of the scene; None without ground."""
        if self.ground_height is None:
            return None
        plane = ShapeCfg(kind="plane", color=self.ground_color, checker=self.ground_checker)
        return PartCfg(shape=plane, position=(0.0, 0.0, self.ground_height), semantic_id=self.ground_semantic_id)

    @property
    def num_assets(self) -> int:
        """Number of instances A in every environment."""
        return sum(asset.count for asset in self.assets)

    @property
    def num_kept(self) -> int:
        """Number of instances that are always present."""
        return sum(asset.count for asset in self.assets if asset.keep)


def load_environment(path: str | Path) -> EnvironmentCfg:
    """Return the environment in a YAML file; its mesh, URDF and robot files are taken relative to that file."""
    folder = Path(path).resolve().parent
    cfg = load(EnvironmentCfg, path)
    assets = (
        replace(asset, shapes=tuple(absolute_paths(shape, folder) for shape in asset.shapes)) for asset in cfg.assets
    )
    robots = (
        replace(each, name=str(folder / each.name)) if each.name.endswith((".yaml", ".yml")) else each
        for each in cfg.robots
    )
    return replace(cfg, assets=tuple(assets), robots=tuple(robots))
