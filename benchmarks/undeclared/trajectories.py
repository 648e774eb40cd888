"""Reference flights: families of smooth paths, seeded at random.

A family gives the shape: position relative to the start, yaw and excitation on a time grid. ``plan_flight`` scales it to a
top speed, differentiates it and lifts it off the ground. Every path starts at rest. Letters: T times.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import make_interp_spline

from benchmarks.undeclared.vehicle import Array

MAX_ACCELERATION = 6.5  # Largest acceleration of a reference [m/s²]: 33 degrees of tilt in level flight
MAX_YAW_RATE = 2.0  # Largest yaw rate of a reference [rad/s]
LOWEST_HEIGHT = 5.0  # Lowest point of a reference [m], where none is asked for: far from any ground effect


@dataclass(frozen=True, kw_only=True)
class TrajectoryShape:
    """Path, heading and excitation drawn by a trajectory family."""

    path: Array  # Position, world, (T, 3); scaled afterwards
    yaw: Array  # Heading [rad], (T,)

    excite: Array | float = 0.0
    """Added to commands: angular rate [rad/s] (3), vertical acceleration [m/s²] (1), body, (T, 4)."""


@dataclass(frozen=True, kw_only=True)
class Reference:
    """Setpoints of the autopilot over time; the first axis is time."""

    position: Array  # [m], world, (T, 3)
    velocity: Array  # [m/s], world, (T, 3)
    acceleration: Array  # [m/s²], world, (T, 3)
    jerk: Array  # [m/s³], world, (T, 3)
    yaw: Array  # [rad], not wrapped, (T,)
    yaw_rate: Array  # [rad/s], (T,)
    excite: Array  # As in ``TrajectoryShape``, (T, 4)


def smooth_step(x: Array) -> Array:
    """Return ``35 x^4 - 84 x^5 + 70 x^6 - 20 x^7`` of x held in [0, 1]: three derivatives vanish at both ends."""
    x = np.clip(x, 0.0, 1.0)
    return x**4 * (35.0 + x * (-84.0 + x * (70.0 - 20.0 * x)))


def _multisine(t: Array, rng: np.random.Generator, *, low: float, high: float, count: int, slope: float) -> Array:
    """Return ``count`` sines between ``low`` and ``high`` [Hz], amplitude f^-slope, largest value 1, (T,)."""
    edges = np.geomspace(low, high, count + 1)
    freq, phase = rng.uniform(edges[:-1], edges[1:]), rng.uniform(0.0, 2.0 * np.pi, count)
    wave = np.sin(2.0 * np.pi * np.outer(t, freq) + phase) @ freq**-slope
    return wave / np.abs(wave).max()


def _excitation(t: Array, rng: np.random.Generator, *, rate: float, yaw_rate: float, acceleration: float) -> Array:
    """Return multisines of 0.8 to 6 Hz in the commands, (T, 4)."""
    waves = [_multisine(t, rng, low=0.8, high=6.0, count=10, slope=0.3) for _ in range(4)]
    return np.stack(waves, axis=1) * (rate, rate, yaw_rate, acceleration) * smooth_step(t / 1.0)[:, None]


def _smooth_moves(
    t: Array, rng: np.random.Generator, targets: Callable[[int], Array], *, move: float, hold: float
) -> Array:
    """Return smooth moves between targets: leg k ends at ``targets(k)`` after ``move`` s, then rests ``hold`` s."""
    path, here = np.zeros((len(t), len(targets(0)))), np.zeros(len(targets(0)))
    start, leg = 0.2 * rng.uniform(), 0
    while start < t[-1]:
        goal = targets(leg)
        path += smooth_step((t - start) / move)[:, None] * (goal - here)
        here, start, leg = goal, start + move + hold, leg + 1
    return path


def _phase_ramp(t: Array, rate: float) -> Array:
    """Return a phase [rad] that starts at rest and runs at ``rate`` [rad/s] after 1.5 s."""
    speed = smooth_step(t / 1.5)
    step = np.diff(t, prepend=t[0])
    return rate * np.cumsum(0.5 * (speed + np.concatenate(([0.0], speed[:-1]))) * step)


def multisine(t: Array, rng: np.random.Generator) -> TrajectoryShape:
    """Sines in all axes and in yaw, with excitation of the commands on top."""
    start = smooth_step(t / 1.5)[:, None]
    path = [_multisine(t, rng, low=0.12, high=0.7, count=7, slope=1.3) * size for size in (1.0, 1.0, 0.5)]
    yaw = 2.0 * start[:, 0] * _multisine(t, rng, low=0.06, high=0.5, count=6, slope=1.0)
    excite = _excitation(t, rng, rate=1.2, yaw_rate=0.8, acceleration=2.0)
    return TrajectoryShape(path=start * np.stack(path, axis=1), yaw=yaw, excite=excite)


def waypoints(t: Array, rng: np.random.Generator) -> TrajectoryShape:
    """A quintic spline through random points 1.7 s apart, with the heading going its own way."""
    knots = np.arange(0.0, t[-1] + 1.7 + 1e-9, 1.7)
    if len(knots) < 3:
        knots = np.linspace(0.0, 2.0 * t[-1], 3)
    points = rng.uniform((-3.5, -3.5, -1.5, -2.5), (3.5, 3.5, 1.5, 2.5), (len(knots), 4))
    points[0] = 0.0
    rest = [(1, np.zeros(4)), (2, np.zeros(4))]
    curve = make_interp_spline(knots, points, k=5, bc_type=(rest, rest))(t)
    return TrajectoryShape(path=curve[:, :3], yaw=curve[:, 3])


def vertical(t: Array, rng: np.random.Generator) -> TrajectoryShape:
    """Climbs and descents of several lengths, drifting sideways, with the heading turning all round."""
    height = _smooth_moves(t, rng, lambda k: rng.uniform((1.5,), (3.5,)) * (1 - k % 2), move=1.5, hold=0.3)
    drift = [smooth_step(t / 1.5) * _multisine(t, rng, low=0.1, high=0.4, count=4, slope=1.0) for _ in range(2)]
    yaw = _phase_ramp(t, rng.choice((-0.8, 0.8)))
    excite = _excitation(t, rng, rate=0.4, yaw_rate=0.4, acceleration=1.5)
    return TrajectoryShape(path=np.stack((*drift, height[:, 0]), axis=1), yaw=yaw, excite=excite)


def hover_steps(t: Array, rng: np.random.Generator) -> TrajectoryShape:
    """Hover with short moves and turns between rests, and excitation of the commands."""
    corner = (-1.3, -1.3, -0.8, -1.2)
    curve = _smooth_moves(t, rng, lambda _: rng.uniform(corner, np.negative(corner)), move=1.2, hold=0.8)
    excite = _excitation(t, rng, rate=0.8, yaw_rate=0.6, acceleration=1.0)
    return TrajectoryShape(path=curve[:, :3], yaw=curve[:, 3], excite=excite)


def hover(t: Array, rng: np.random.Generator) -> TrajectoryShape:
    """Hover, as still as a pilot holds it: a slow wander of a few centimetres, the heading as it is, no excitation."""
    path = [smooth_step(t / 1.5) * _multisine(t, rng, low=0.1, high=0.3, count=4, slope=1.0) for _ in range(3)]
    return TrajectoryShape(path=np.stack(path, axis=1), yaw=np.zeros(len(t)))


def yaw_turn(t: Array, rng: np.random.Generator) -> TrajectoryShape:
    """Hover with a turn of the heading one way, and in the second half back."""
    shape, half = hover(t, rng), t[-1] / 2.0
    turn = np.where(t < half, _phase_ramp(t, 1.2), 0.0)
    back = _phase_ramp(np.maximum(t - half, 0.0), 1.2)
    turned = turn[t < half][-1]
    return replace(shape, yaw=rng.choice((-1.0, 1.0)) * np.where(t < half, turn, turned - back))


def rate_steps(t: Array, rng: np.random.Generator) -> TrajectoryShape:
    """Hover with random steps of the commanded body rates and of the vertical acceleration, of 0.2 to 0.6 s each."""
    sizes = (1.2, 1.2, 0.6, 1.5)  # [rad/s] (3), [m/s²]
    steps = np.zeros((len(t), 4))
    for column, size in enumerate(sizes):
        ends = np.cumsum(rng.uniform(0.2, 0.6, len(t)))
        levels = size * rng.choice((-1.0, 0.0, 1.0), len(ends))
        steps[:, column] = levels[np.searchsorted(ends, t)]
    return replace(hover(t, rng), excite=steps * smooth_step(t / 1.0)[:, None])


def low_hover(t: Array, rng: np.random.Generator) -> TrajectoryShape:
    """Rests at several heights, half of them the lowest, with small moves and a little excitation."""
    low, high = np.array([-0.5, -0.5, 0.0, -0.8]), np.array([0.5, 0.5, 0.5, 0.8])
    curve = _smooth_moves(t, rng, lambda k: rng.uniform(low, high) * (1.0, 1.0, k % 2, 1.0), move=1.0, hold=1.2)
    excite = _excitation(t, rng, rate=0.4, yaw_rate=0.4, acceleration=0.3)
    return TrajectoryShape(path=curve[:, :3], yaw=curve[:, 3], excite=excite)


def low_passes(t: Array, rng: np.random.Generator) -> TrajectoryShape:
    """Passes from side to side that touch the lowest height at every second end."""
    side, high = rng.uniform((1.5, -0.8), (2.0, 0.8)), rng.uniform(0.3, 0.8, 64)
    curve = _smooth_moves(
        t, rng, lambda k: np.array([*(side * (-1.0) ** k), high[k % 64] * (k // 2 % 2), 0.8 * k]), move=1.6, hold=0.3
    )
    return TrajectoryShape(
        path=curve[:, :3], yaw=curve[:, 3], excite=_excitation(t, rng, rate=0.2, yaw_rate=0.2, acceleration=0.2)
    )


def figure_eight(t: Array, rng: np.random.Generator) -> TrajectoryShape:
    """A lying eight with changing height, in a random direction, the heading swinging to both sides."""
    phase, turn = _phase_ramp(t, rng.uniform(1.1, 1.4)), rng.uniform(-np.pi, np.pi)
    along, across = np.sin(phase), 0.5 * np.sin(2.0 * phase)
    x, y = np.cos(turn) * along - np.sin(turn) * across, np.sin(turn) * along + np.cos(turn) * across
    yaw = rng.uniform(1.5, 2.5) * np.sin(0.6 * phase)
    return TrajectoryShape(
        path=np.stack((x, y, 0.25 * np.sin(1.5 * phase)), axis=1), yaw=yaw, excite=np.zeros((len(t), 4))
    )


def square(t: Array, rng: np.random.Generator) -> TrajectoryShape:
    """Fast legs from corner to corner at two heights; the heading turns by a quarter at each."""
    side, sense = 4.0 * np.array([[1, 0, 0.2], [1, 1, 0], [0, 1, 0.2], [0, 0, 0]]), rng.choice((-1.0, 1.0))
    corner = side * (1.0, sense, 1.0)
    path = _smooth_moves(
        t, rng, lambda k: np.array([*corner[k % 4], 0.5 * np.pi * sense * (k + 1)]), move=2.1, hold=0.25
    )
    return TrajectoryShape(path=path[:, :3], yaw=path[:, 3])


def lissajous(t: Array, rng: np.random.Generator) -> TrajectoryShape:
    """Three sines whose frequencies have no common multiple; the heading turns steadily."""
    phase, ratio = _phase_ramp(t, rng.uniform(1.0, 1.3)), rng.uniform((1.15, 0.6), (1.35, 0.8))
    path = np.stack((np.sin(phase), 1.0 - np.cos(ratio[0] * phase), 0.4 * np.sin(ratio[1] * phase)), axis=1)
    return TrajectoryShape(path=path, yaw=rng.choice((-0.6, 0.6)) * phase)


Family = Callable[[Array, np.random.Generator], TrajectoryShape]
FAMILIES: dict[str, tuple[Family, tuple[float, float]]] = {
    "multisine": (multisine, (3.0, 4.0)),
    "waypoints": (waypoints, (4.0, 5.0)),
    "vertical": (vertical, (2.5, 3.0)),
    "hover_steps": (hover_steps, (1.5, 2.0)),
    "hover": (hover, (0.05, 0.1)),
    "figure_eight": (figure_eight, (3.5, 5.0)),
    "square": (square, (3.5, 4.5)),
    "lissajous": (lissajous, (3.0, 4.5)),
    "yaw_turn": (yaw_turn, (0.05, 0.1)),
    "rate_steps": (rate_steps, (0.05, 0.1)),
    "low_hover": (low_hover, (0.8, 1.2)),
    "low_passes": (low_passes, (2.0, 3.0)),
}
"""Each with the range from which the top speed of a flight is drawn [m/s]."""

TRAIN_FAMILIES = ("multisine", "waypoints", "vertical", "hover_steps")
TEST_FAMILIES = ("figure_eight", "square", "lissajous")


def plan_flight(
    family: str,
    *,
    duration: float,
    rate: float,
    settle: float,
    rng: np.random.Generator,
    lowest: float = LOWEST_HEIGHT,
    scale: float = 1.0,
    ceiling: float | None = None,
) -> Reference:
    """Return a flight of ``duration`` [s] at ``rate`` [Hz], after ``settle`` [s] of hover at its start.

    The path is scaled to a drawn top speed, or less where that would exceed ``MAX_ACCELERATION``, and then by ``scale``.
    Its lowest point is at ``lowest`` [m]; under a ``ceiling`` [m] the path is upside down: the highest is that far below.
    """
    t = np.arange(round(duration * rate) + 1) / rate
    draw, top_speed = FAMILIES[family]
    shape = draw(t, rng)
    speed, acceleration = _largest_derivative(shape.path, 1, rate), _largest_derivative(shape.path, 2, rate)
    path = shape.path * min(rng.uniform(*top_speed) / speed, MAX_ACCELERATION / acceleration) * scale
    yaw = shape.yaw * min(1.0, MAX_YAW_RATE / max(_largest_derivative(shape.yaw[:, None], 1, rate), 1e-9))
    path[:, 2] += lowest - path[:, 2].min()
    if ceiling is not None:
        path[:, 2] = ceiling - path[:, 2]
    rows, excite = round(settle * rate), np.broadcast_to(shape.excite, (len(t), 4))
    position, heading, excite = (_hold_first(x, rows) for x in (path, yaw + rng.uniform(-np.pi, np.pi), excite))
    velocity = np.gradient(position, 1.0 / rate, axis=0)
    acceleration = np.gradient(velocity, 1.0 / rate, axis=0)
    return Reference(
        position=position,
        velocity=velocity,
        acceleration=acceleration,
        jerk=np.gradient(acceleration, 1.0 / rate, axis=0),
        yaw=heading,
        yaw_rate=np.gradient(heading, 1.0 / rate),
        excite=excite,
    )


def _largest_derivative(path: Array, order: int, rate: float) -> float:
    """Return the largest norm of a derivative of ``path``, by differences."""
    return float(np.linalg.norm(np.diff(path, n=order, axis=0), axis=1).max() * rate**order)


def _hold_first(values: Array, rows: int) -> Array:
    """Return ``values`` with its first row repeated ``rows`` more times in front."""
    return np.concatenate((np.repeat(values[:1], rows, axis=0), values))


def stack_references(references: list[Reference]) -> Reference:
    """Return the references of F flights as one, with shapes (T, F, ...)."""
    names = Reference.__dataclass_fields__
    return Reference(**{name: np.stack([getattr(r, name) for r in references], axis=1) for name in names})
