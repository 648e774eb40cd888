"""Measured data of the flights in the comparison band, and the sensor readings that kinematics imply.

Letters: E rows, C channels, R rotors.
"""

from collections import OrderedDict
from collections.abc import Callable, Sequence
from functools import partial
from itertools import pairwise

import numpy as np
import torch
from torch import Tensor

from aerial_gym.config.sim import STANDARD_GRAVITY
from aerial_gym.math.quaternion import quat_rotate_inverse
from aerial_gym.sim2real.arrays import Array, Indices, has_nonzero
from aerial_gym.sim2real.logs.checks.conventions import body_rate_from_attitude
from aerial_gym.sim2real.logs.flights import Flight
from aerial_gym.sim2real.logs.rotor_model import SETTLE_S
from aerial_gym.sim2real.logs.signals import lowpass, lowpass_columns, num_edge_rows
from aerial_gym.sim2real.predict.channels import Channel
from aerial_gym.sim2real.predict.rows.rotor_estimate import RotorEstimate
from aerial_gym.sim2real.predict.scene import other_vehicle_track, surface_heights

ROWS_PER_BAND = 5.0  # Rate of the evaluated rows in bandwidths
THINNED_HZ = 50.0  # Least rate of the evaluated rows [Hz]: slow logs, often with derived forces, are not thinned
PREFILTER = 0.4  # Cut-off before thinning, as a share of the new rate; removes 0.4 % at the bandwidth
SAMPLES_PER_BAND = 3.0  # Approximate rate of the residuals in bandwidths
KEPT_DELAYS = 2  # Number of cached delays: of the present model, and of a changed one
FAR_ABOVE = np.array([0.0, 0.0, 1e3])  # Position if a log has none [m], world: far from the ground


def row_stride(flight: Flight, bandwidth: float) -> int:
    """Return the thinning factor of a log: log rows per evaluated row."""
    return max(1, int(flight.rate / max(ROWS_PER_BAND * bandwidth, THINNED_HZ)))


def rows_at_times(flight: Flight, time: Array) -> Indices:
    """Return the row indices of a flight at times [s], (T,)."""
    return np.round(time * flight.rate).astype(int)


def _slices_of_sizes(sizes: Sequence[int]) -> list[slice]:
    """Return the slices of parts of these sizes in sequence."""
    return [slice(int(a), int(b)) for a, b in pairwise(np.cumsum([0, *sizes]))]


def _slice_if_regular(places: Indices) -> slice | Indices:
    """Return equidistant ascending indices as a slice, which makes no copy; others as they are."""
    steps = np.diff(places)
    if not steps.size or (steps != steps[0]).any():
        return places
    return slice(int(places[0]), int(places[-1]) + 1, int(steps[0]))


class Dataset:
    """Flights whose rows are evaluated in one batch, in sequence."""

    def __init__(
        self, flights: Sequence[Flight], *, rotors: Sequence[RotorEstimate | None], bandwidth: float,
        channels: Sequence[Channel], every_row: bool,
    ) -> None:  # fmt: skip
        """Load the flights with the rotor speeds of the prediction; ``every_row``: without thinning to the band."""
        self.flights, self.bandwidth, self.channels = tuple(flights), bandwidth, tuple(channels)
        self.stride = [1 if every_row else row_stride(f, bandwidth) for f in flights]
        pairs, places = list(zip(flights, self.stride, strict=True)), range(len(flights))
        self.kept = [self._residual_rows(flight, stride, every_row) for flight, stride in pairs]
        self._kept_places = [_slice_if_regular(kept // own) for kept, own in zip(self.kept, self.stride, strict=True)]
        self.measured = [self._channels_in_band(place) for place in places]
        self.times = [flight.time[kept] for flight, kept in zip(flights, self.kept, strict=True)]
        self.row_times = [flight.time[::stride] for flight, stride in pairs]
        self.spans, self.kept_spans = (
            _slices_of_sizes([time.size for time in times]) for times in (self.row_times, self.times)
        )
        rows = [time.size for time in self.row_times]
        self.flight = np.repeat(np.arange(len(flights)), rows)

        def join_flights(values: Callable[[int], Tensor]) -> Tensor:
            return torch.cat([values(place) for place in places])

        names = ("position", "attitude", "lin_vel", "ang_vel")
        self.state = {name: join_flights(partial(self._quantity_at_rows, name)) for name in names}
        self.state["attitude"] /= self.state["attitude"].norm(dim=1, keepdim=True)
        self.heights = surface_heights(flights, rows)
        self.other = torch.cat([torch.from_numpy(other_vehicle_track(flight)[::stride]) for flight, stride in pairs])
        self.simulated = all(flight.rotor_speed is None for flight in flights)
        accelerometers = all(flight.specific_force is not None for flight in flights)
        self.force = join_flights(partial(self._quantity_at_rows, "specific_force")) if accelerometers else None
        # Without an accelerometer the force is derived from the velocity, and has no accelerometer errors.
        felt = torch.tensor([flight.accelerometer for flight in flights])
        self.felt_force = felt[torch.from_numpy(self.flight)].unsqueeze(1)
        self.felt_force_kept = join_flights(lambda place: felt[place].expand(self.times[place].size, 1))
        self.acceleration, self.ang_acc = (
            join_flights(partial(self._derivative, name)) for name in ("lin_vel", "ang_vel")
        )
        self.speed, self.unsure_speed = self._rotor_motion(rotors, self.thin_rows)
        self.spin_up, self.unsure_spin_up = self._rotor_motion(rotors, self.derivative_at_rows)
        implied = (self._kinematic_force, self._force_derivatives, self._kinematic_rate)
        self._implied = np.concatenate([join_flights(reading).numpy().T for reading in implied])
        self._delayed = dict[int, OrderedDict[float, Tensor]]()

    @staticmethod
    def _rotor_motion(
        rotors: Sequence[RotorEstimate | None], at_rows: Callable[[int, Array], Tensor]
    ) -> tuple[Tensor, Tensor] | tuple[None, None]:
        """Return rotor speeds (E, R) or their derivative, and the uncertainty by mode, (R, E, R); None without any."""
        known = [(place, rotor) for place, rotor in enumerate(rotors) if rotor is not None]
        if not known:
            return None, None
        modes = [torch.stack([at_rows(place, mode) for mode in rotor.unsure]) for place, rotor in known]
        return torch.cat([at_rows(place, rotor.speed) for place, rotor in known]), torch.cat(modes, dim=1)

    def lowpass_kept_rows(self, index: int, rows: Array) -> Array:
        """Return low-passed values of a flight's rows (E, any) at the kept rows, (rows kept, any)."""
        stride = self.stride[index]
        return lowpass(rows, self.flights[index].rate / stride, self.bandwidth)[self.kept[index] // stride]

    def kinematic_force(self, late: float, *, ahead: float = 0.0) -> Tensor:
        """Return the specific force by kinematics [m/s²], (T, 3), with a delay ``late`` [s].

        ``ahead``: lead of the velocity [s], to second order: noise correlates with the error of the first order.
        """
        force, jerk, snap = self._kinematics_with_delay(slice(9), late).T.split(3, dim=1)
        return force + ahead * jerk + 0.5 * ahead**2 * snap if ahead else force

    def kinematic_rate(self, late: float) -> Tensor:
        """Return the angular velocity by kinematics [rad/s], (T, 3), with a delay ``late`` [s]."""
        return self._kinematics_with_delay(slice(9, 12), late).T

    def _kinematics_with_delay(self, columns: slice, late: float) -> Tensor:
        """Return low-passed columns of the implied readings with a delay [s], (K, T); the last two are cached."""
        kept = self._delayed.setdefault(columns.stop, OrderedDict[float, Tensor]())
        if late not in kept:
            kept[late] = torch.from_numpy(self.columns_in_band(self._implied[columns], [late] * len(self.flights)))
            if len(kept) > KEPT_DELAYS:
                kept.popitem(last=False)
        kept.move_to_end(late)
        return kept[late]

    def columns_in_band(self, columns: Array, late: Sequence[float] | None = None) -> Array:
        """Return low-passed columns (K, E) at the kept rows, (K, T), with a delay per flight [s]; zeros stay exactly 0."""
        nonzero = has_nonzero(columns, axis=1)
        moving = slice(None) if nonzero.all() else np.flatnonzero(nonzero)  # a slice makes no copy
        matrix = np.zeros((len(columns), self.kept_spans[-1].stop))
        alike: dict[tuple[int, float, float], list[int]] = {}  # flights that one filter serves, which is faster
        for index, span in enumerate(self.spans):
            rate, seconds = self.flights[index].rate / self.stride[index], 0.0 if late is None else late[index]
            alike.setdefault((span.stop - span.start, rate, seconds), []).append(index)
        for (count, rate, seconds), places in alike.items():
            parts = [columns[moving, self.spans[index]] for index in places]
            rows = parts[0] if len(parts) == 1 else np.concatenate(parts)
            slow = lowpass_columns(rows, rate, self.bandwidth, late=seconds)
            for own, index in zip(slow.reshape(len(places), -1, count), places, strict=True):
                matrix[moving, self.kept_spans[index]] = own[:, self._kept_places[index]]
        return matrix

    def _channels_in_band(self, index: int) -> Array:
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

    def _residual_rows(self, flight: Flight, stride: int, every_row: bool) -> Indices:
        """Return the log rows of the residuals: multiples of the stride, without the ends and ground contacts."""
        edge = num_edge_rows(flight.rate, self.bandwidth)
        start = edge if flight.rotor_command is None else max(edge, round(SETTLE_S * flight.rate))
        step = 1 if every_row else stride * max(1, round(flight.rate / stride / (SAMPLES_PER_BAND * self.bandwidth)))
        rows = np.arange(-(-start // step) * step, flight.num_rows - edge, step)
        excluded = None if every_row else flight.rows_without_comparison(edge)  # a spectrum needs every row
        return rows if excluded is None else rows[~excluded[rows]]

    def _quantity_at_rows(self, name: str, index: int) -> Tensor:
        values = getattr(self.flights[index], name)
        if values is None:
            unknown = FAR_ABOVE if name == "position" else np.zeros(3)
            values = np.tile(unknown, (self.flights[index].num_rows, 1))
        return self.thin_rows(index, values)

    def _derivative(self, name: str, index: int) -> Tensor:
        """Return the derivative of a quantity at the rows of a flight, (E, any); 0 if it was not logged."""
        values = getattr(self.flights[index], name)
        return self.derivative_at_rows(index, np.zeros((self.flights[index].num_rows, 3)) if values is None else values)

    def derivative_at_rows(self, index: int, values: Array) -> Tensor:
        """Return the derivative of values in all log rows at the rows of a flight, (E, any)."""
        slow = lowpass(values, self.flights[index].rate, self._derivative_bandwidth(index), derivative=True)
        return torch.from_numpy(np.ascontiguousarray(slow[:: self.stride[index]]))

    def _derivative_bandwidth(self, index: int) -> float:
        """Return the bandwidth of derivatives [Hz], wider than the comparison's unless the angular velocity is derived.

        In a narrow one, what the rotation of the body brings into the band is lost, and the band's edge is filtered twice.
        """
        flight = self.flights[index]
        measured = flight.gyro or flight.accelerometer  # also where rotors are too slow for torques
        return PREFILTER * flight.rate / self.stride[index] if measured else self.bandwidth

    def _kinematic_force(self, index: int) -> Tensor:
        """Return ``R^T (v' + g e_z)`` [m/s²], body, (E, 3): the reading of an ideal accelerometer."""
        acceleration = self.acceleration[self.spans[index]].clone()
        acceleration[:, 2] += STANDARD_GRAVITY
        return quat_rotate_inverse(self.state["attitude"][self.spans[index]], acceleration)

    def _force_derivatives(self, index: int) -> Tensor:
        """Return ``R^T v''`` [m/s³] and its rate of change with v alone [m/s⁴], body, (E, 6): terms of the velocity's lead."""
        acceleration, attitude = self.acceleration[self.spans[index]].numpy(), self.state["attitude"][self.spans[index]]
        rate, rows = self.flights[index].rate / self.stride[index], [acceleration]
        for _ in range(2):
            rows.append(lowpass(rows[-1], rate, self.bandwidth, derivative=True))
        return torch.cat([quat_rotate_inverse(attitude, torch.from_numpy(part)) for part in rows[1:]], dim=1)

    def _kinematic_rate(self, index: int) -> Tensor:
        """Return the angular velocity implied by the attitude [rad/s], body, (E, 3)."""
        flight = self.flights[index]
        rate = body_rate_from_attitude(flight.attitude, flight.rate, self._derivative_bandwidth(index))
        return torch.from_numpy(np.ascontiguousarray(rate[:: self.stride[index]]))

    def thin_rows(self, index: int, values: Array) -> Tensor:
        """Return values at every n-th row, low-passed below half the new rate."""
        stride = self.stride[index]
        if stride > 1:
            values = lowpass(values, self.flights[index].rate, PREFILTER * self.flights[index].rate / stride)[::stride]
        return torch.from_numpy(np.ascontiguousarray(values))
