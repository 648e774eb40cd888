"""Report on a robot file: its numbers, and warnings about implausible ones.

Frames: body is x forward, y left, z up. Letters: R rotors.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from itertools import combinations
from math import dist, inf, sqrt

import torch

from aerial_gym.config.checks import NO_SOURCE
from aerial_gym.config.robot import BoxCfg, CapsuleCfg, CollisionShape, RobotCfg
from aerial_gym.config.sim import STANDARD_GRAVITY
from aerial_gym.control import CONTROLLERS
from aerial_gym.control.allocation import Allocation, allocation_matrix
from aerial_gym.control.gains import apparent_gravity
from aerial_gym.control.hover import trim_axes
from aerial_gym.errors import ConfigError, UnknownNameError
from aerial_gym.interop import one_thread
from aerial_gym.physics import vehicle_from_config
from aerial_gym.physics.model import check_effects
from aerial_gym.physics.rotor_maps import rotor_state_for_thrust
from aerial_gym.robots.check.flights import StableStep, TailRotorModel, largest_stable_steps, tail_rotor_model
from aerial_gym.sensors.mounts import mounted_sensors

AXES = ("x", "y", "z")

SPEED_OF_SOUND = 340.0  # In air of 15 °C [m/s]: no propeller's tips are faster
LITTLE_MARGIN = 1.3  # Thrust to weight below which a vehicle leans by 40 degrees at most, `acos(1 / 1.3)`
ROUND_OFF = 1e-6  # Of a share of the weight, or of the weight times a metre


@dataclass(frozen=True, kw_only=True)
class RobotReport:
    """A robot that could be built, in numbers."""

    name: str  # Registered name, or path of the file
    summary: str  # Of the robot file
    mass_kg: float
    inertia_kg_m2: tuple[tuple[float, ...], ...]
    num_rotors: int
    hover_thrust_n: tuple[float, ...]  # Of each rotor at hover in still air, as the allocation gives it, (R,)
    hover_share: float  # Largest hover thrust of all rotors as a share of the thrust range, 0 to 1
    thrust_to_weight: float  # Largest thrust along body z without torque, per weight
    rank: int  # Number of independent forces and torques: 4 for flat multirotors, 6 with thrust in every direction
    force_n: tuple[float, ...]  # Largest symmetric force along x, y, z at hover without torque
    torque_n_m: tuple[float, ...]  # Largest symmetric torque about x, y, z at hover
    angular_acceleration_rad_s2: tuple[float, ...]  # Of that torque
    first_at_limit: tuple[int | None, ...]  # Rotor, from 1 on, that limits force and torque along x, y, z, or None
    stable_steps: tuple[StableStep, ...]  # Largest time steps, by controller
    problems: tuple[str, ...]  # Why it cannot fly as described; none of a robot that can
    warnings: tuple[str, ...]  # Warnings about implausible numbers

    def __repr__(self) -> str:
        hover = f"{self.mass_kg:.4g} kg, {self.num_rotors} rotors, hovers at {self.hover_share:.0%} of the thrust range"
        remarks = [f"problem: {each}" for each in self.problems] + [f"note: {each}" for each in self.warnings]
        return "; ".join([f"RobotReport {self.name}: {hover}, thrust to weight {self.thrust_to_weight:.2f}", *remarks])

    def as_mapping(self) -> dict[str, object]:
        """Return everything as JSON takes it."""
        return asdict(self)


def check_robot(
    robot: RobotCfg, *, name: str, controllers: Sequence[str] | None = None, gravity: float = STANDARD_GRAVITY,
    progress: Callable[[str, float], None] = lambda _text, _share: None,
) -> RobotReport:  # fmt: skip
    """Return hover, control authority by the robot's own allocation, and the stable time steps of its controllers.

    Args:
        controllers: Registered controllers to fly it with; all that have gains if not given, none of ``()``.
        progress: Receives the present controller and the share that is done.
    """
    check_effects(robot)
    vehicle = vehicle_from_config(robot, num_envs=1, dtype=torch.float64)
    allocation, matrix = Allocation(vehicle, gravity), allocation_matrix(vehicle, gravity)[0]
    weight = robot.body.mass * gravity
    held = robot.body.mass * apparent_gravity(robot.control, robot.body.mass, gravity)
    low, high = allocation.low[0], allocation.high[0]
    tail = tail_rotor_model(robot, matrix.numpy(), low.numpy(), high.numpy(), gravity=gravity)
    if tail is None:
        hover = allocation.inverse[0, :, 2] * held
        wrench, ratio = matrix @ hover, allocation.largest_thrust() / weight
        authority, limiting = allocation.wrench_authority(held), allocation.rotor_at_limit_by_axis(held).tolist()
    else:
        asked = tail.unknowns_of_lift(held)
        hover, matrix = torch.from_numpy(tail.rotor_thrusts(asked)), torch.from_numpy(tail.columns)
        wrench, ratio = tail.wrench(asked), tail.largest_lift() / weight
        given, limiting = zip(
            (0.0, None), (0.0, None), *(tail.control_margin(held, axis) for axis in range(4)), strict=True
        )
        authority = torch.tensor(given, dtype=matrix.dtype)
    ends = tuple(
        rotor + 1 if given > 0.0 and rotor is not None else None
        for rotor, given in zip(limiting, authority.tolist(), strict=True)
    )
    problems = (
        *_hover_problems(hover, low, high, wrench, held, weight), *_problems_of_coupling(matrix),
        *_sensor_problems(robot),
    )  # fmt: skip
    if controllers is None:
        controllers = [n for n in sorted(CONTROLLERS) if trim_axes(c := CONTROLLERS.get(n)) and c.gains is None]
    flown = {name: CONTROLLERS.get(name) for name in (controllers if not problems else ())}
    with one_thread():
        steps = largest_stable_steps(robot, flown, gravity=gravity, progress=progress)
    turn = authority[3:] / vehicle.inertia[0].diagonal()
    return RobotReport(
        name=name,
        summary=robot.summary,
        mass_kg=robot.body.mass,
        inertia_kg_m2=robot.body.inertia,
        num_rotors=robot.num_rotors,
        hover_thrust_n=tuple(hover.tolist()),
        hover_share=float(((hover - low) / (high - low)).max()),
        thrust_to_weight=ratio,
        rank=int(torch.linalg.matrix_rank(matrix, rtol=1e-6)),
        force_n=tuple(authority[:3].tolist()),
        torque_n_m=tuple(authority[3:].tolist()),
        angular_acceleration_rad_s2=tuple(turn.tolist()),
        first_at_limit=ends,
        stable_steps=tuple(steps),
        problems=problems,
        warnings=(
            *(_rigid_warnings(robot) if tail is None else _tail_warnings(tail, held, controllers)),
            *_plausibility_warnings(robot),
            *_control_warnings(inf if robot.control.buoyancy else ratio, turn.tolist()),
            *_step_warnings(steps),
            *_source_warnings(robot),
        ),
    )


def _hover_problems(
    hover: torch.Tensor, low: torch.Tensor, high: torch.Tensor, wrench: torch.Tensor, held: float, weight: float
) -> Iterator[str]:
    """Yield the reasons against hover: rotors beyond their limits, or a residual force or torque."""
    for number, (thrust, least, most) in enumerate(zip(hover.tolist(), low.tolist(), high.tolist(), strict=True), 1):
        if not least <= thrust <= most:
            yield (
                f"to hover, rotor {number} must give {thrust:.3g} N, but its limits are {least:.3g} to {most:.3g} N: change "
                "its thrust_range or thrust_map, the mass, or the centre of mass"
            )
    left = ((wrench - held * torch.eye(6, dtype=wrench.dtype)[2]) / weight).tolist()
    for row, share in enumerate(left):
        if abs(share) > ROUND_OFF:
            kind, unit = ("force along", "N") if row < 3 else ("torque about", "N m")
            yield (
                f"at hover a {kind} {AXES[row % 3]} of {share * weight:.3g} {unit} is left over that no thrusts take away: "
                "check positions, axes and spins of the mounts, and the centre of mass"
            )


def _problems_of_coupling(matrix: torch.Tensor) -> Iterator[str]:
    """Yield the linearly dependent rows among lift, roll, pitch and yaw of an effectiveness matrix (6, R)."""
    rows, names = matrix[2:], ("lift", "torque about x", "torque about y", "torque about z")
    size = rows.norm(dim=-1, keepdim=True)
    unit = torch.where(size > ROUND_OFF * size.max(), rows / size, 0.0)
    share = (unit @ torch.linalg.pinv(unit, rtol=ROUND_OFF)).diagonal().tolist()  # 1 of an independent row, 0 of none
    together = [name for name, part in zip(names, share, strict=True) if ROUND_OFF < part < 1.0 - ROUND_OFF]
    if together:
        yield (
            f"{' and '.join(together)} come only together, so that it cannot be steered: check the spins of the mounts (rotors "
            "that turn one way all on one side?) and their positions"
        )


def _sensor_problems(robot: RobotCfg) -> Iterator[str]:
    """Yield the reasons why sensors cannot be mounted: a missing or wrong file, or an impossible setting of the mount."""
    for mount in robot.sensor_mounts:
        try:
            mounted_sensors([mount])
        except (ConfigError, UnknownNameError) as error:
            yield f"sensor {mount.key}: {error}"


def _control_warnings(ratio: float, turn: Sequence[float]) -> Iterator[str]:
    if ratio < LITTLE_MARGIN:
        yield f"thrust to weight is {ratio:.2f}: little is left to climb, lean and turn with"
    for axis, acceleration in zip(AXES, turn, strict=True):
        if acceleration <= 0.0:
            yield f"nothing turns it about {axis} at hover: controllers leave that axis alone"


def _step_warnings(steps: Sequence[StableStep]) -> Iterator[str]:
    for step in steps:
        if step.refused is None and step.largest_s is None:
            yield f"{step.controller} does not bring it to rest at any time step: give other gains (control:)"
        elif step.little_margin:
            yield f"{step.controller} has less than 6 dB of gain margin at every time step: lower its frequencies (control:)"


def _source_warnings(robot: RobotCfg) -> Iterator[str]:
    parts = {"body": robot.body, "rotor": robot.rotor, **robot.rotors, "mounts": robot.mounts, "joints": robot.joints}
    parts |= {"collision": robot.collision, "battery": robot.battery}
    missing = [name for name, part in parts.items() if part is not None and part.source == NO_SOURCE]
    if missing := [*missing, *(["effects"] if robot.effects and not robot.effects_source else [])]:
        yield f"{NO_SOURCE} of the numbers of {', '.join(missing)}: say where they come from (source: data sheet, scale, ...)"


def _rigid_warnings(robot: RobotCfg) -> Iterator[str]:
    if robot.joints is not None:
        yield robot.joints.note_on_rigidity("hover, authority and time steps are those of a vehicle that does not bend")


def _tail_warnings(tail: TailRotorModel, held: float, controllers: Sequence[str] | None) -> Iterator[str]:
    asked = tail.unknowns_of_lift(held)
    yield (
        f"its tail leans by {tail.tail_angle(asked):.3g} rad at hover, which takes the torque about z, and the vehicle by "
        f"{tail.roll(asked):.3g} rad about x against the side force"
    )
    if controllers is None or controllers:
        yield "time steps are flown with joints.tail_servo, which holds the heading: controllers command rotors"


def _plausibility_warnings(robot: RobotCfg) -> Iterator[str]:
    """Yield warnings about implausible numbers of the robot file."""
    extent = max(
        (*(dist(m.position, robot.body.com) for m in robot.mounts.layout), *map(_shape_reach, robot.collision.shapes))
    )
    for axis in range(3):
        gyration = sqrt(robot.body.inertia[axis][axis] / robot.body.mass)
        if gyration > extent:
            yield (
                f"inertia about {AXES[axis]}: radius of gyration {gyration:.3g} m, but the vehicle reaches {extent:.3g} m: "
                "check the units of mass, inertia and positions"
            )
    types = {id(rotor): rotor for rotor in robot.rotor_types}.values()
    for rotor in types:
        tip = rotor_state_for_thrust(rotor, rotor.thrust_range[1]) * (rotor.radius or 0.0)
        if rotor.mode == "speed" and tip > SPEED_OF_SOUND:
            yield (
                f"at {rotor.thrust_range[1]:g} N tips would move at {tip:.0f} m/s, faster than sound: thrust_map is per "
                "(rad/s)², that per (rev/s)² is divided by (2 pi)²"
            )
    yield from _propeller_overlaps(robot)


def _shape_reach(shape: CollisionShape) -> float:
    """Return the largest distance of a collision shape from the body origin [m]."""
    if isinstance(shape, BoxCfg):
        size = 0.5 * dist(shape.size, (0.0, 0.0, 0.0))
    else:
        size = shape.radius + (0.5 * shape.height if isinstance(shape, CapsuleCfg) else 0.0)
    return dist(shape.center, (0.0, 0.0, 0.0)) + size


def _propeller_overlaps(robot: RobotCfg) -> Iterator[str]:
    """Yield pairs of propellers that turn in one plane and would touch."""
    mounts = list(enumerate(zip(robot.mounts.layout, robot.rotor_types, strict=True), 1))
    for (one, (a, first)), (other, (b, second)) in combinations(mounts, 2):
        room = (first.radius or -inf) + (second.radius or -inf) - dist(a.position, b.position)
        across = sum((p - q) * n for p, q, n in zip(a.position, b.position, a.axis, strict=True))
        if room > 0.0 and a.axis == b.axis and abs(across) < 1e-3:
            yield f"propellers {one} and {other} overlap by {room:.3g} m: check positions and radius"
