"""Target points: constant, random, in sequence, on a closed curve, on an asset, and for a slung load.

Frames: world of each environment, z up. Letters: E environments.
"""

from collections.abc import Callable, Mapping, Sequence
from math import pi

import torch
from torch import Tensor

from aerial_gym.config.checks import Vec3
from aerial_gym.env_manager import EnvManager
from aerial_gym.errors import ConfigError
from aerial_gym.math.random import Purpose, Randomness
from aerial_gym.task.commands.command import COMMANDS, TARGET, Command
from aerial_gym.task.kernels.draws import GoalDraws, UniformDraws
from aerial_gym.task.values import Values


@COMMANDS.register_class("point")
class ConstantPoint(Command):
    """The same point in every episode."""

    def __init__(self, values: Values, env: EnvManager, *, position: Vec3 = (0.0, 0.0, 0.0)) -> None:
        super().__init__(values, env)
        _check_points("point", (position,))
        self._target().copy_(torch.tensor(position))


@COMMANDS.register_class("drawn_point")
class RandomPoint(Command):
    """A point drawn uniformly at every reset; randomly placed obstacles keep clear of it."""

    goal = True

    def __init__(self, values: Values, env: EnvManager, *, low: Vec3, high: Vec3) -> None:
        """Take the lowest and the highest point as shares of the bounds, 0 <= low <= high <= 1."""
        super().__init__(values, env)
        self._goals = make_goals(self._target(), env, low, high, self.name)

    def draw(self, mask: Tensor) -> None:
        """Draw new points."""
        self._goals.draw(mask)


@COMMANDS.register_class("drawn_pose")
class RandomPose(RandomPoint):
    """The point of ``drawn_point`` with a heading, ``target_yaw``, drawn uniformly from a full turn."""

    def __init__(self, values: Values, env: EnvManager, *, low: Vec3, high: Vec3) -> None:
        """Take the lowest and the highest point as shares of the bounds, 0 <= low <= high <= 1."""
        super().__init__(values, env, low=low, high=high)
        yaw = values.declare("target_yaw", unit="rad", frame="world", meaning="heading to have at the target, +-pi")
        self._yaw = UniformDraws(yaw.unsqueeze(-1), [(-pi, pi)], purpose=Purpose.COMMAND, random=env.rows.random)

    def draw(self, mask: Tensor) -> None:
        """Draw new points and headings."""
        super().draw(mask)
        self._yaw.draw(mask)


@COMMANDS.register_class("sequence")
class PointSequence(Command):
    """Points one after the other: the next one as soon as the robot is near, from the first one at every reset."""

    def __init__(
        self, values: Values, env: EnvManager, *, points: tuple[Vec3, ...], radius: float, loop: bool = False
    ) -> None:
        """Take the points.

        Args:
            points: In order [m].
            radius: Distance that counts as there [m], > 0.
            loop: Whether the first one follows the last one; otherwise that one stays, and ``sequence_done`` is true in every
                step in which the robot is there.
        """
        super().__init__(values, env)
        _check_points("sequence", points)
        if not radius > 0.0:
            raise ConfigError(f"command sequence: radius = {radius!r}: must be > 0")
        self._points, self._radius, self._loop = points, radius, loop
        self._target()
        values.declare("target_index", dtype=torch.int32, meaning="which point or gate is next, from 0 on")
        values.declare("target_reached", dtype=torch.bool, meaning="the robot came to its point in this step")
        values.declare("sequence_done", dtype=torch.bool, meaning="it came to the last one in this step")
        self.reads = (TARGET, "robot_position", "target_index", "target_reached")

    def current_values(self, values: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Return the flags for a reached point and for the end of the sequence."""
        reached = (values[TARGET] - values["robot_position"]).norm(dim=-1) < self._radius
        last = (values["target_index"] == len(self._points) - 1) & (not self._loop)
        return {"target_reached": reached, "sequence_done": reached & last}

    def next_values(self, values: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Return the point of the next step."""
        index = next_index(values, values["target_reached"], len(self._points), loop=self._loop)
        return {"target_index": index, TARGET: row_at_index(index, self._points)}


def make_goals(
    goal: Tensor, env: EnvManager, low: Vec3, high: Vec3, name: str, *, random: Randomness | None = None
) -> GoalDraws:
    """Return the launch that draws a goal (E, 3) between two shares of the bounds; ``name`` is the command's, for errors.
    ``random`` replaces the random numbers of the vehicles."""
    if not all(0.0 <= a <= b <= 1.0 for a, b in zip(low, high, strict=True)):
        raise ConfigError(
            f"command {name}: low = {low!r}, high = {high!r}: needs 0 <= low <= high <= 1 on every axis. "
            "They are shares of the bounds"
        )
    return GoalDraws(goal, bounds=env.rows.bounds, ratios=(low, high), random=env.rows.random, draws=random)


def next_index(values: Mapping[str, Tensor], passed: Tensor, count: int, *, loop: bool) -> Tensor:
    """Return the next index below ``count``, int32, (E,): the first at the start of an episode, one more after a pass."""
    index = values["target_index"] + passed.int()
    index = torch.where(index >= count, 0 if loop else count - 1, index)
    return torch.where(values["begun"], 0, index).int()


def row_at_index(index: Tensor, rows: Sequence[Sequence[float]]) -> Tensor:
    """Return the row of each index, (E, width); without indexing, so that it can be part of a kernel."""
    columns = [torch.full_like(index, 0, dtype=torch.float32) + value for value in rows[0]]
    for i, row in enumerate(rows[1:], start=1):
        columns = [torch.where(index == i, value, old) for value, old in zip(row, columns, strict=True)]
    return torch.stack(columns, dim=-1)


def _check_points(name: str, points: Sequence[Vec3]) -> None:
    if not points or not all(abs(x) < float("inf") for point in points for x in point):
        raise ConfigError(f"command {name}: {points!r}: needs at least one point of finite coordinates")


STATES = "vec_root_tensor"  # Key of the GTD: states of the robot and, behind it, of the assets
ASSET_STATES = "env_asset_state_tensor"  # Key of those of the assets alone, also beside several vehicles


@COMMANDS.register_class("asset")
class AssetPoint(Command):
    """A point at an asset's origin or an offset from it, with the asset's velocity as ``target_velocity``."""

    follows_reset = True

    def __init__(self, values: Values, env: EnvManager, *, name: str, offset: Vec3 = (0.0, 0.0, 0.0)) -> None:
        """Take the asset.

        Args:
            name: Of an asset of the environment that is always there; of several instances the first one.
            offset: From the asset's origin to the target [m], world: it does not turn with the asset.
        """
        super().__init__(values, env)
        kept = [asset.name for asset in env.cfg.assets if asset.keep]
        if name not in kept:
            raise ConfigError(f"command asset: name = {name!r}: must be an asset with keep: true, of {kept}")
        counts = {asset.name: asset.count for asset in env.cfg.assets}
        single = env.vehicles is None
        self._states, self._row = STATES if single else ASSET_STATES, int(single)
        self._row += sum(list(counts.values())[: list(counts).index(name)])
        self._offset = offset
        self._target(moving=True)
        self.reads = (self._states,)

    def current_values(self, values: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Return place and velocity of the target at this instant."""
        state = values[self._states][:, self._row]
        return {TARGET: state[:, :3] + state.new_tensor(self._offset), "target_velocity": state[:, 7:10]}


LOAD_PARAMS = "effect_slung_payload"  # Key of the GTD: mass, length and damping of the load


@COMMANDS.register_class("load_point")
class LoadPoint(Command):
    """``load_target``, drawn uniformly at every reset, for the load; the robot's target is a link's length above it."""

    follows_reset = goal = True

    def __init__(self, values: Values, env: EnvManager, *, low: Vec3, high: Vec3) -> None:
        """Take the lowest and the highest point for the load as shares of the bounds, 0 <= low <= high <= 1."""
        super().__init__(values, env)
        if LOAD_PARAMS not in env.rows.bodies:
            raise ConfigError("command load_point: nothing hangs on the robot. Give it the effect slung_payload")
        load = values.declare("load_target", (3,), unit="m", frame="world", meaning="where to carry the load")
        self._goals = make_goals(load, env, low, high, self.name)
        self._target()
        self.reads = ("load_target", LOAD_PARAMS)

    def current_values(self, values: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Return the robot's position that holds the load at rest at its target."""
        x, y, z = values["load_target"].unbind(-1)
        return {TARGET: torch.stack((x, y, z + values[LOAD_PARAMS][:, 1]), dim=-1)}

    def draw(self, mask: Tensor) -> None:
        """Draw new points."""
        self._goals.draw(mask)


Curve = Callable[[Tensor], tuple[tuple[Tensor, ...], tuple[Tensor, ...]]]
"""From an angle [rad], (E,), to the coordinates of a point of size about 1, and their derivatives with respect to the angle."""


def _circle(angle: Tensor) -> tuple[tuple[Tensor, ...], tuple[Tensor, ...]]:
    cos, sin, zero = torch.cos(angle), torch.sin(angle), torch.zeros_like(angle)
    return (cos, sin, zero), (-sin, cos, zero)


def _lemniscate(angle: Tensor) -> tuple[tuple[Tensor, ...], tuple[Tensor, ...]]:
    """The eight of Gerono, (cos a, sin a cos a)."""
    cos, sin, zero = torch.cos(angle), torch.sin(angle), torch.zeros_like(angle)
    return (cos, sin * cos, zero), (-sin, cos * cos - sin * sin, zero)


def _helix(angle: Tensor) -> tuple[tuple[Tensor, ...], tuple[Tensor, ...]]:
    """A circle that goes up and down once a turn."""
    cos, sin = torch.cos(angle), torch.sin(angle)
    return (cos, sin, sin), (-sin, cos, cos)


CURVES: dict[str, Curve] = {"circle": _circle, "lemniscate": _lemniscate, "helix": _helix}
"""Closed curves, once round in 2 pi."""


@COMMANDS.register_class("trajectory")
class TrajectoryCommand(Command):
    """A target on a closed curve, a function of the time since the episode began; ``target_velocity`` is its derivative."""

    follows_reset = True

    def __init__(
        self, values: Values, env: EnvManager, *, curve: str, size: Vec3, period: float,
        center: Vec3 = (0.0, 0.0, 0.0), random_phase: bool = False,
    ) -> None:  # fmt: skip
        """Take the curve.

        Args:
            curve: ``circle``, ``lemniscate`` or ``helix``.
            size: Half of its extent along each axis [m].
            period: Time once round [s], > 0.
            center: Its middle [m].
            random_phase: Whether every episode begins somewhere else on it, drawn; otherwise at the end of its x axis.
        """
        super().__init__(values, env)
        if curve not in CURVES:
            raise ConfigError(f"command trajectory: no curve {curve!r}. Known: {', '.join(CURVES)}")
        if not 0.0 < period < float("inf"):
            raise ConfigError(f"command trajectory: period = {period!r}: must be > 0 and finite")
        self._curve, self._size, self._center = CURVES[curve], size, center
        self._rate, self._dt = 2.0 * pi / period, env.dt
        self._target(moving=True)
        phase = values.declare("target_phase", (1,), unit="rad", meaning="angle on the curve where the episode began")
        self._phase = UniformDraws(phase, [(0.0, 2.0 * pi)], purpose=Purpose.COMMAND, random=env.rows.random)
        self._random_phase = random_phase
        self.reads = ("target_phase",)

    def current_values(self, values: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Return place and velocity of the target at this instant."""
        time = values["sim_steps"].float() * self._dt
        place, slope = self._curve(self._rate * time + values["target_phase"][:, 0])
        position = [c + s * x for c, s, x in zip(self._center, self._size, place, strict=True)]
        velocity = [self._rate * s * x for s, x in zip(self._size, slope, strict=True)]
        return {TARGET: torch.stack(position, dim=-1), "target_velocity": torch.stack(velocity, dim=-1)}

    def draw(self, mask: Tensor) -> None:
        """Draw where new episodes begin."""
        if self._random_phase:
            self._phase.draw(mask)
