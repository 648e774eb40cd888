"""Smooth tracks through points that every episode draws: piecewise polynomials of minimum snap, in closed form.

With K points and the same time T between neighbours the integral of the squared fourth derivative is least for polynomials of
degree 7 that meet with six equal derivatives; a track begins and ends with zero velocity, acceleration and jerk. Its value at a
time is then a sum over the points with weights that depend on the share of the time alone, ``p(t) = sum_k w_k(t / T) p_k``.
T belongs to the track: the shortest at which all Bernstein control points of velocity and acceleration are within their
limits. The polynomials are then within them too, as they lie in the convex hull of their control points.
Source: Mellinger, Kumar (2011), Minimum snap trajectory generation and control for quadrotors, eq. 6; Farouki (2012), The
Bernstein polynomial basis, section 3.
Frames: world of each environment, z up. Letters: E environments, K points, S = K - 1 segments.
"""

from collections.abc import Mapping
from math import comb, factorial, inf

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from aerial_gym.config.robot import Vec3
from aerial_gym.env_manager import EnvManager
from aerial_gym.errors import ConfigError
from aerial_gym.math.random import Purpose
from aerial_gym.task.commands.command import COMMANDS, TARGET, Command
from aerial_gym.task.commands.points import row_at_index
from aerial_gym.task.kernels.draws import UniformDraws
from aerial_gym.task.values import Values

Array = NDArray[np.float64]

DEGREE = 7

MOST_POINTS = 10  # Of a track: each adds to the length of a kernel


def minimum_snap_weights(num_points: int) -> Array:
    """Return the coefficients of the weights of each point, (S, 8, K): of ``u^j``, 0 <= u <= 1, in each segment. Every segment
    takes one unit of time; derivatives are with respect to that."""
    segments = num_points - 1
    rows, given = [], []

    def add_equation(where: list[tuple[int, float, float]], order: int, point: int | None = None) -> None:
        """Add the equation that a sum of derivatives, (segment, u, sign) each, equals a point, or zero."""
        row = np.zeros((segments, DEGREE + 1))
        for segment, u, sign in where:
            row[segment] += sign * _power_derivatives(u, order)
        rows.append(row.ravel())
        given.append(np.eye(num_points)[point] if point is not None else np.zeros(num_points))

    for k in range(segments):
        add_equation([(k, 0.0, 1.0)], 0, k)
        add_equation([(k, 1.0, 1.0)], 0, k + 1)
    for order in (1, 2, 3):
        add_equation([(0, 0.0, 1.0)], order)
        add_equation([(segments - 1, 1.0, 1.0)], order)
    for k in range(segments - 1):
        for order in range(1, DEGREE):
            add_equation([(k, 1.0, 1.0), (k + 1, 0.0, -1.0)], order)
    return np.linalg.solve(np.array(rows), np.array(given)).reshape(segments, DEGREE + 1, num_points)


def _power_derivatives(u: float, order: int) -> Array:
    """Return the derivatives of ``u^j``, (8,)."""
    powers = range(DEGREE + 1)
    return np.array([factorial(j) / factorial(j - order) * u ** (j - order) if j >= order else 0.0 for j in powers])


def derivative_weights(coefficients: Array) -> Array:
    """Return the coefficients of the derivative, (S, degree, K), of (S, degree + 1, K)."""
    degree = coefficients.shape[1] - 1
    return coefficients[:, 1:] * np.arange(1, degree + 1)[:, None]


def control_point_weights(coefficients: Array) -> Array:
    """Return the weights of the points in each control point of the Bernstein form, (S (degree + 1), K)."""
    degree = coefficients.shape[1] - 1
    to_bernstein = [
        [comb(i, j) / comb(degree, j) if j <= i else 0.0 for j in range(degree + 1)] for i in range(degree + 1)
    ]
    return np.einsum("ij,sjk->sik", np.array(to_bernstein), coefficients).reshape(-1, coefficients.shape[2])


@COMMANDS.register_class("polynomial")
class Polynomial(Command):
    """A target on a track of minimum snap through drawn points; at its end it stays. Velocity and acceleration go with it."""

    follows_reset = True

    def __init__(
        self, values: Values, env: EnvManager, *, size: Vec3, max_speed: float, max_acceleration: float,
        points: int = 5, center: Vec3 = (0.0, 0.0, 0.0),
    ) -> None:  # fmt: skip
        """Take the random points and the limits.

        Args:
            size: Half of the box in which the points of each episode are drawn, uniformly [m], >= 0, not all 0.
            max_speed: Limit of the target's speed [m/s], > 0.
            max_acceleration: Limit of its acceleration [m/s²], > 0.
            points: How many, K, 2 to 10.
            center: The middle of the box [m].
        """
        super().__init__(values, env)
        if not 2 <= points <= MOST_POINTS:
            raise ConfigError(f"command polynomial: points = {points!r}: must be 2 to {MOST_POINTS}")
        if not all(0.0 <= half < inf for half in size) or not any(size):
            raise ConfigError(f"command polynomial: size = {size!r}: must be >= 0 and finite, and not all 0")
        for name, limit in (("max_speed", max_speed), ("max_acceleration", max_acceleration)):
            if not 0.0 < limit < inf:
                raise ConfigError(f"command polynomial: {name} = {limit!r}: must be > 0 and finite")
        place = minimum_snap_weights(points)
        velocity = derivative_weights(place)
        self._num_points, self._dt = points, env.dt
        self._rows = [form.reshape(points - 1, -1).tolist() for form in (place, velocity, derivative_weights(velocity))]
        self._limits = [
            (torch.tensor(control_point_weights(form), dtype=torch.float32, device=env.device), limit)
            for form, limit in ((velocity, max_speed), (derivative_weights(velocity), max_acceleration))
        ]
        self._target(moving=True)
        values.declare("target_acceleration", (3,), unit="m/s²", frame="world", meaning="acceleration of the target")
        self._points = values.declare(
            "track_points", (3 * points,), unit="m", frame="world", meaning="points of the track: all x, all y, all z"
        )
        self._time = values.declare("track_time", unit="s", meaning="from a point of the track to the next one")
        self._time.fill_(1.0)
        ranges = [(c - half, c + half) for c, half in zip(center, size, strict=True) for _ in range(points)]
        self._draws = UniformDraws(self._points, ranges, purpose=Purpose.COMMAND, random=env.rows.random)
        self.reads = ("track_points", "track_time")

    def current_values(self, values: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Return place, velocity and acceleration of the target at this instant."""
        points, time = values["track_points"], values["track_time"]
        last = self._num_points - 1
        share = (values["sim_steps"].float() * self._dt / time).clamp(0.0, float(last))
        segment = share.floor().clamp(0.0, float(last - 1))
        u = (share - segment).unsqueeze(-1)
        names = (TARGET, "target_velocity", "target_acceleration")
        buffers = {}
        for order, (name, rows) in enumerate(zip(names, self._rows, strict=True)):
            weights = self._point_weights(row_at_index(segment.int(), rows), u, DEGREE - order)
            axes = [(weights * points[:, i * self._num_points : (i + 1) * self._num_points]).sum(-1) for i in range(3)]
            buffers[name] = torch.stack(axes, dim=-1) / (time**order).unsqueeze(-1)
        return buffers

    def _point_weights(self, coefficients: Tensor, u: Tensor, degree: int) -> Tensor:
        """Return the weight of each point, (E, K), by Horner's rule."""
        width = self._num_points
        weights = coefficients[:, degree * width :]
        for j in reversed(range(degree)):
            weights = weights * u + coefficients[:, j * width : (j + 1) * width]
        return weights

    def draw(self, mask: Tensor) -> None:
        """Draw the tracks of new episodes, and find their times."""
        self._draws.draw(mask)
        points = self._points.view(-1, 3, self._num_points)
        shortest = torch.full_like(self._time, self._dt)  # where all points are the same
        for order, (weights, limit) in enumerate(self._limits, start=1):
            at = sum(weights[:, None, k] * points[:, None, :, k] for k in range(self._num_points))
            assert isinstance(at, Tensor)  # (E, control points, 3)
            largest = at.square().sum(-1).amax(-1).sqrt()
            shortest = torch.maximum(shortest, (largest / limit) ** (1.0 / order))
        self._time.copy_(torch.where(mask, shortest, self._time))
