"""The measured side: what flights have in the band, and what their sensors and kinematics say in every row.

Letters: E rows, C channels, R rotors.
"""

from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np
import torch
from scipy import ndimage
from torch import Tensor

from aerial_gym.config.sim import STANDARD_GRAVITY
from aerial_gym.math.quaternion import quat_rotate_inverse
from aerial_gym.sim2real.arrays import Array, Indices
from aerial_gym.sim2real.logs.checks.conventions import body_rate_of
from aerial_gym.sim2real.logs.flights import Flight
from aerial_gym.sim2real.logs.signals import edge_rows, lowpass, lowpass_columns
from aerial_gym.sim2real.predict.channels import Channel
from aerial_gym.sim2real.predict.nonzero import not_zero
from aerial_gym.sim2real.predict.rows.rotor_estimate import RotorEstimate
from aerial_gym.sim2real.predict.scene import heights, other_along

ROWS_PER_BAND = 5.0
"""Rows are evaluated at this many times the bandwidth."""

THINNED_HZ = 50.0
"""Rows per second below which no log is thinned: it has few, and its forces are often derived from a velocity."""

PREFILTER = 0.4
"""Before, they are low-passed at this share of that rate: 0.4 % of the amplitude at the bandwidth goes, and as much is left of
what would be folded to it."""

SAMPLES_PER_BAND = 3.0
"""Residuals are kept at about this many times the bandwidth."""

FAR_ABOVE = np.array([0.0, 0.0, 1e3])
"""Where a vehicle is taken to be whose log has no position [m], world: away from the ground."""

SETTLE_S = 0.5
"""Dropped at the start where rotor speeds are simulated from commands [s]."""


def thinned(flight: Flight, bandwidth: float) -> int:
    """Return how many rows of a log are one row that is evaluated."""
    return max(1, int(flight.rate / max(ROWS_PER_BAND * bandwidth, THINNED_HZ)))


class Dataset:
    """Flights whose rows are evaluated at once, one after the other."""

    def __init__(
        self,
        flights: Sequence[Flight],
        *,
        rotors: Sequence[RotorEstimate | None],
        bandwidth: float,
        channels: Sequence[Channel],
        every_row: bool,
    ) -> None:
        """Take flights.

        Args:
            flights: With what was measured.
            rotors: Rotor speeds of each from which it is predicted; None where none were measured.
            bandwidth: Of the comparison [Hz].
            channels: What is compared.
            every_row: Whether all rows of the log are kept instead of thinning them to the band.
        """
        self.flights, self.bandwidth, self.channels = tuple(flights), bandwidth, tuple(channels)
        self.stride = [1 if every_row else thinned(f, bandwidth) for f in flights]
        self.kept = [self._kept_rows(f, s, every_row) for f, s in zip(flights, self.stride, strict=True)]
        self.measured = [self._measure(index) for index in range(len(flights))]
        self.times = [flight.time[kept] for flight, kept in zip(flights, self.kept, strict=True)]
        states = [self._state_rows(index) for index in range(len(flights))]
        self.state = {name: torch.cat([state[name] for state in states]) for name in states[0]}
        ends = np.cumsum([0, *(state["attitude"].shape[0] for state in states)])
        self.spans = [slice(int(a), int(b)) for a, b in pairwise(ends)]
        self.flight = np.repeat(np.arange(len(flights)), np.diff(ends))
        ends = np.cumsum([0, *(time.size for time in self.times)])
        self.kept_spans = [slice(int(a), int(b)) for a, b in pairwise(ends)]
        self.row_times = [flight.time[::stride] for flight, stride in zip(flights, self.stride, strict=True)]
        others = [torch.from_numpy(other_along(f)[::s]) for f, s in zip(flights, self.stride, strict=True)]
        rows = [state["attitude"].shape[0] for state in states]
        self.heights, self.other = heights(flights, rows), torch.cat(others)
        self.simulated = all(flight.rotor_speed is None for flight in flights)
        turning = [(i, rotor) for i, rotor in enumerate(rotors) if rotor is not None]
        self.speed = torch.cat([self.thinned(i, rotor.speed) for i, rotor in turning]) if turning else None
        self.unsure_speed = (
            torch.cat([self._of_modes(i, rotor, self.thinned) for i, rotor in turning], dim=1) if turning else None
        )

        accelerometers = all(flight.specific_force is not None for flight in flights)
        self.force = (
            torch.cat([self._thin(i, "specific_force") for i in range(len(flights))]) if accelerometers else None
        )
        # Where there is no accelerometer, the force is derived from the velocity, without the errors of one.
        felt = torch.tensor([flight.accelerometer for flight in flights])
        self.felt_force = felt[torch.from_numpy(self.flight)].unsqueeze(1)
        kept = [felt[index].expand(time.size, 1) for index, time in enumerate(self.times)]
        self.felt_force_kept = torch.cat(kept)
        self.acceleration = torch.cat([self._derivative(i, "lin_vel") for i in range(len(flights))])
        self.ang_acc = torch.cat([self._derivative(i, "ang_vel") for i in range(len(flights))])
        self.spin_up = torch.cat([self.derivative_of(i, rotor.speed) for i, rotor in turning]) if turning else None
        self.unsure_spin_up = (
            torch.cat([self._of_modes(i, rotor, self.derivative_of) for i, rotor in turning], dim=1)
            if turning
            else None
        )
        implied = (self._implied_force, self._implied_jerk, self._implied_rate)
        self._implied = np.concatenate(
            [np.concatenate([of(i).T for i in range(len(flights))], axis=1) for of in implied]
        )

    @staticmethod
    def _of_modes(index: int, rotor: RotorEstimate, at_rows: Callable[[int, Array], Tensor]) -> Tensor:
        """Return what is unsure of a flight's rotors at its rows, mode by mode, (R, E, R)."""
        return torch.stack([at_rows(index, mode) for mode in rotor.unsure])

    def slow(self, index: int, rows: Array) -> Array:
        """Return values at the rows of a flight (E, any) in the band, (rows kept, any)."""
        stride = self.stride[index]
        return lowpass(rows, self.flights[index].rate / stride, self.bandwidth)[self.kept[index] // stride]

    def kinematics(self, *, force_late: float = 0.0, rate_late: float = 0.0) -> tuple[Tensor, Tensor, Tensor]:
        """Return what attitude and velocity imply at the rows kept, (T, 3) each, in the band, later by some seconds.

        Specific force [m/s²], by how much it changes with the delay of the velocity alone [m/s³], angular velocity [rad/s].
        """
        flights = len(self.flights)
        forces = self.in_band(self._implied[:6], [force_late] * flights)
        rates = self.in_band(self._implied[6:], [rate_late] * flights)
        force, jerk, rate = (torch.from_numpy(rows).T for rows in (forces[:3], forces[3:], rates))
        return force, jerk, rate

    def in_band(self, columns: Array, late: Sequence[float] | None = None) -> Array:
        """Return values at the rows of all flights (K, E) in the band, (K, rows kept); what is zero stays so.

        ``late``: by how much later they come in each flight [s]; None: as they are.
        """
        moving = np.flatnonzero(not_zero(columns, axis=1))
        found = np.zeros((len(columns), self.kept_spans[-1].stop))
        for index, (span, to) in enumerate(zip(self.spans, self.kept_spans, strict=True)):
            stride = self.stride[index]
            rate, seconds = self.flights[index].rate / stride, 0.0 if late is None else late[index]
            slow = lowpass_columns(columns[moving, span], rate, self.bandwidth, late=seconds)
            found[moving, to] = slow[:, self.kept[index] // stride]
        return found

    def _measure(self, index: int) -> Array:
        """Return the measured channels of a flight in the band, (rows kept, C)."""
        flight = self.flights[index]
        sources = {
            "specific_force": (flight.specific_force, False),
            "angular_acceleration": (flight.ang_vel, True),
            "rotor_speed": (flight.rotor_speed, False),
            "kinematic_force": (flight.specific_force, False),
            "kinematic_rate": (flight.ang_vel, False),
        }
        parts = []
        for kind in dict.fromkeys(channel.kind for channel in self.channels):
            values, derivative = sources[kind]
            assert values is not None
            parts.append(lowpass(values, flight.rate, self.bandwidth, derivative=derivative)[self.kept[index]])
        return np.concatenate(parts, axis=1)

    def _kept_rows(self, flight: Flight, stride: int, every_row: bool) -> Indices:
        """Return the rows of the log at which residuals are kept: multiples of the stride, without the ends."""
        edge = edge_rows(flight.rate, self.bandwidth)
        start = edge if flight.rotor_command is None else max(edge, round(SETTLE_S * flight.rate))
        step = 1 if every_row else stride * max(1, round(flight.rate / stride / (SAMPLES_PER_BAND * self.bandwidth)))
        rows = np.arange(-(-start // step) * step, flight.num_rows - edge, step)
        if flight.on_ground is None or every_row:  # a spectrum needs all of them
            return rows
        near = edge_rows(flight.rate, self.bandwidth)  # the low-pass spreads the jolt of a touch as it spreads an end
        touched = np.asarray(ndimage.maximum_filter1d(flight.on_ground, 2 * near + 1), dtype=bool)
        return rows[np.logical_not(touched[rows])]

    def _state_rows(self, index: int) -> dict[str, Tensor]:
        attitude = self._thin(index, "attitude")
        return {
            "position": self._thin(index, "position"),
            "attitude": attitude / attitude.norm(dim=1, keepdim=True),
            "lin_vel": self._thin(index, "lin_vel"),
            "ang_vel": self._thin(index, "ang_vel"),
        }

    def _thin(self, index: int, name: str) -> Tensor:
        values = getattr(self.flights[index], name)
        if values is None:
            unknown = FAR_ABOVE if name == "position" else np.zeros(3)
            values = np.tile(unknown, (self.flights[index].num_rows, 1))
        return self.thinned(index, values)

    def _derivative(self, index: int, name: str) -> Tensor:
        """Return the derivative of a quantity at the rows of a flight, (E, any); zeros where the log lacks it."""
        values = getattr(self.flights[index], name)
        return self.derivative_of(index, np.zeros((self.flights[index].num_rows, 3)) if values is None else values)

    def derivative_of(self, index: int, values: Array) -> Tensor:
        """Return the derivative of values in all rows of the log at the rows of a flight, (E, any)."""
        slow = lowpass(values, self.flights[index].rate, self._wide(index), derivative=True)
        return torch.from_numpy(np.ascontiguousarray(slow[:: self.stride[index]]))

    def _wide(self, index: int) -> float:
        """Return the band of derivatives [Hz]: wider than the comparison, unless the angular velocity is itself derived."""
        flight = self.flights[index]
        return PREFILTER * flight.rate / self.stride[index] if flight.gyro else self.bandwidth

    def _implied_force(self, index: int) -> Tensor:
        """Return ``R^T (v' + g e_z)`` [m/s²], body, (E, 3): what an accelerometer without errors reads."""
        acceleration = self.acceleration[self.spans[index]].clone()
        acceleration[:, 2] += STANDARD_GRAVITY
        attitude = self._thin(index, "attitude")
        return quat_rotate_inverse(attitude / attitude.norm(dim=1, keepdim=True), acceleration)

    def _implied_jerk(self, index: int) -> Tensor:
        """Return ``R^T v''`` [m/s³], body, (E, 3): by how much that force changes with the delay of the velocity alone."""
        acceleration = self.acceleration[self.spans[index]].numpy()
        rate = self.flights[index].rate / self.stride[index]
        jerk = torch.from_numpy(lowpass(acceleration, rate, self.bandwidth, derivative=True))
        attitude = self._thin(index, "attitude")
        return quat_rotate_inverse(attitude / attitude.norm(dim=1, keepdim=True), jerk)

    def _implied_rate(self, index: int) -> Tensor:
        """Return the angular velocity that the attitude implies [rad/s], body, (E, 3)."""
        flight = self.flights[index]
        rate = body_rate_of(flight.attitude, flight.rate, self._wide(index))
        return torch.from_numpy(np.ascontiguousarray(rate[:: self.stride[index]]))

    def thinned(self, index: int, values: Array) -> Tensor:
        """Return every n-th row of values that were low-passed below half of that rate."""
        stride = self.stride[index]
        if stride > 1:
            values = lowpass(values, self.flights[index].rate, PREFILTER * self.flights[index].rate / stride)[::stride]
        return torch.from_numpy(np.ascontiguousarray(values))
