"""Low-passed forces and accelerations of the vehicle, and the readings of its inertial sensors, in every row.

The low-pass commutes with factors that all rows share: mass, inertia, axes. So the forces of each effect, and the powers of
rotor speeds before a map's coefficients, are filtered separately and cached; only changed ones are filtered again. Letters:
E rows, T rows kept, R rotors, K coefficients of a map.
"""

from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from weakref import ref

import torch
from torch import Tensor

from aerial_gym.config.sim import STANDARD_GRAVITY
from aerial_gym.math.quaternion import quat_rotate, quat_rotate_inverse, quat_to_matrix
from aerial_gym.math.rows import cross_product_matrix, times
from aerial_gym.physics import Accelerations
from aerial_gym.physics.effects import ImuEffect, WrenchEffect
from aerial_gym.physics.effects.sensor_errors import imu_errors
from aerial_gym.physics.model import Model
from aerial_gym.physics.rigid_body import ForceBreakdown
from aerial_gym.physics.rotors import map_terms, rotor_matrix
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.predict.rows.dataset import Dataset
from aerial_gym.sim2real.predict.tolerances import SensorErrors

FORCE, TORQUE = slice(0, 3), slice(3, 6)  # Parts of a wrench
KEPT = 2  # Number of cached results per effect and sensor, as in ``physics.answers``


@dataclass(frozen=True, kw_only=True)
class SensorDelays:
    """Delays of the sensors on the clock of the rows, by flight [s], and the scale of the gyro."""

    force: tuple[float, ...]  # Delay of the accelerometer, or of the derived force
    gyro: tuple[float, ...]
    gyro_scale: Tensor | None = None  # Relative, (3,); None: exact

    def of_true_motion(self, factors: Tensor) -> Tensor:
        """Return factors (..., 12) of the true motion (``_motion_selectors``) as those of the measured one."""
        if self.gyro_scale is None:
            return factors
        share = 1.0 / (1.0 + self.gyro_scale)
        return factors * torch.cat((share, torch.outer(share, share).flatten()))


class BandResponse:
    """Low-passed forces on the vehicle along some flights."""

    def __init__(self, data: Dataset) -> None:
        self._data = data
        self._known: dict[str, list[tuple[ref[Tensor], tuple[float, ...], Tensor]]] = {}
        on_time = (0.0,) * len(data.times)
        self._on_time = SensorDelays(force=on_time, gyro=on_time)
        rates = data.state["ang_vel"]
        products = (rates.unsqueeze(2) * rates.unsqueeze(1)).flatten(1)
        self._motion_rows = torch.cat((data.ang_acc, products), dim=1)
        self._motion = self._lowpass_rows(self._motion_rows, on_time)
        """Measured angular acceleration and products of angular velocities, (3 + 9, T)."""

        self._lead, self._late_motion = on_time, self._motion

    def clear_cache(self) -> None:
        """Free the cached rows in the band."""
        self._known.clear()

    def accelerations_in_band(
        self, model: Model, rotor_speed: Tensor, acting: ForceBreakdown, *, about: Tensor | None = None,
        late: SensorDelays | None = None,
    ) -> Accelerations:  # fmt: skip
        """Return specific force [m/s²] and angular acceleration [rad/s²] of the body origin in the band, (T, 3) each.

        The rotation is measured, so errors of the torque model do not enter the forces. ``rotor_speed``: true speeds
        [rad/s], (E, R). ``about``: point of the torques of effects at hubs [m], body, (3,); None: the centre of mass.
        ``late``: sensor delays; None: zero.
        """
        late, vehicle = late or self._on_time, model.vehicle
        parts = [(slice(6), late.force)] if late.gyro == late.force else [(FORCE, late.force), (TORQUE, late.gyro)]
        wrench = torch.cat([self._wrench_in_band(model, rotor_speed, acting, about, *one) for one in parts])
        _, products = _motion_selectors()
        spin = products @ vehicle.inertia[0]  # w (J w)^T, J is symmetric
        gyroscopic = torch.stack([spin[:, i, j] - spin[:, j, i] for i, j in ((1, 2), (2, 0), (0, 1))])
        force = wrench[:3] / vehicle.mass[0] - self.lever_arm_acceleration(vehicle.com[0], late)
        torque = self._by_flight(
            model.inertia_inverse[0], wrench[3:] - self._by_flight(late.of_true_motion(gyroscopic), self._motion)
        )
        return Accelerations(specific_force=force.T, ang_acc=torque.T)

    def _wrench_in_band(
        self, model: Model, rotor_speed: Tensor, acting: ForceBreakdown, about: Tensor | None, part: slice,
        late: tuple[float, ...],
    ) -> Tensor:  # fmt: skip
        """Return a ``part`` of the total force and torque (6, T) in the band, with a delay [s] per flight."""
        vehicle, hubs = model.vehicle, {effect.name for effect, _ in model.effects[WrenchEffect] if effect.at_hubs}
        offset = vehicle.com[0].new_zeros(3) if about is None else about - vehicle.com[0]

        def band_rows(name: str, rows: Tensor, needed: slice = part) -> Tensor:
            return self._rows_in_band(f"{name} {needed}", late, rows, lambda rows: rows[:, needed])

        maps = (vehicle.thrust_map, vehicle.reverse_thrust_map), (vehicle.torque_map, vehicle.reverse_torque_map)
        thrust, drag = (torch.cat([rows[0] for rows in pair], dim=1).T for pair in maps)  # (6, R) each
        used = [k for k in range(6 if "reversible" in vehicle.traits else 3) if thrust[k].any() or drag[k].any()]
        along, against = rotor_matrix(vehicle).T[part].split(vehicle.num_rotors, dim=1)
        factors = along * thrust[used].unsqueeze(1) + against * drag[used].unsqueeze(1)  # (K, part, R)
        terms = self._rows_in_band(
            f"rotors {used}", late, rotor_speed, lambda speed: map_terms(vehicle, speed)[used].permute(1, 0, 2)
        )
        wrench = self._by_flight(factors.transpose(0, 1).flatten(1), terms.flatten(0, 1))
        for name, more in acting.thrusts:
            wrench = wrench + self._by_flight(along, band_rows(f"thrust of {name}", more, slice(None)))
        linear = ((name, rows, params[0]) for name, rows, params in acting.linear)
        for name, rows, params in (*((name, rows, None) for name, rows in acting.wrenches), *linear):
            turned = part.stop == 6 and name in hubs and bool(offset.any())
            own = band_rows(name, rows, slice(6) if turned else part)
            own = own if params is None else self._by_flight(params, own)
            wrench = wrench + own[-len(wrench) :]
            if turned:
                wrench[-3:] += self._by_flight(cross_product_matrix(offset), own[:3])
        return wrench

    def lever_arm_acceleration(self, place: Tensor, late: SensorDelays) -> Tensor:
        """Return ``alpha x r + w (w r) - w² r`` [m/s²], (3, T), of a point r [m], body, with the delay of the force."""
        lever = late.of_true_motion((_lever_matrix() @ place).T)
        lead = tuple(force - gyro for force, gyro in zip(late.force, late.gyro, strict=True))
        if not any(lead):
            return self._by_flight(lever, self._motion)
        if lead != self._lead:
            self._lead, self._late_motion = lead, self._lowpass_rows(self._motion_rows, lead)
        return self._by_flight(lever, self._late_motion)

    def _by_flight(self, factors: Tensor, columns: Tensor) -> Tensor:
        """Return ``factors @ columns`` (..., T), one product per flight: the order of its sums depends on the shape."""
        spans = self._data.kept_spans
        if len(spans) == 1:
            return factors @ columns
        return torch.cat([factors @ columns[..., span].contiguous() for span in spans], dim=-1)

    def _rows_in_band(
        self, name: str, late: tuple[float, ...], rows: Tensor, law: Callable[[Tensor], Tensor]
    ) -> Tensor:
        """Return a function of rows (E, ...) in the band, (..., T), cached by tensor, while that lives, and delay."""
        kept = self._known[name] = [one for one in self._known.get(name, ()) if one[0]() is not None]
        for number, (before, delays, filtered) in enumerate(kept):
            if rows is before() and late == delays:
                kept.insert(0, kept.pop(number))
                return filtered
        values = law(rows)
        filtered = self._lowpass_rows(values.flatten(1), late).unflatten(0, values.shape[1:])
        kept.insert(1, (ref(rows), late, filtered))
        del kept[2 * KEPT :]
        return filtered

    def _lowpass_rows(self, rows: Tensor, late: tuple[float, ...]) -> Tensor:
        """Return low-passed rows (E, K) as columns (K, T)."""
        return torch.from_numpy(self._data.columns_in_band(rows.T.numpy(), late))


@cache
def _motion_selectors() -> tuple[Tensor, Tensor]:
    """Return selectors of the motion's columns: angular acceleration (12, 3), products of rates (12, 3, 3)."""
    unit = torch.eye(12, dtype=torch.float64)
    return unit[:, :3], unit[:, 3:].view(-1, 3, 3)


@cache
def _lever_matrix() -> Tensor:
    """Return the factors (12, 3, 3) of the motion's columns in ``alpha x r + w (w r) - w² r``, before r (3,)."""
    (turning, products), unit = _motion_selectors(), torch.eye(3, dtype=torch.float64)
    square = products.diagonal(dim1=1, dim2=2).sum(dim=1)
    return torch.linalg.cross(turning[:, :, None], unit[None], dim=1) + products - square[:, None, None] * unit


def columns_of_rows(rows: Tensor) -> list[Array]:
    """Return the columns (T,) of rows (T, K)."""
    return list(rows.T.contiguous().numpy())


Columns = list[Array]  # Channel columns, each (rows kept,); different predictions may share some
READINGS = 3  # Number of stored kinematic readings


def add_to_columns(channels: dict[str, Columns], kind: str, rows: Tensor) -> dict[str, Columns]:
    """Return the channels with rows (T, 3) added to one kind."""
    pairs = zip(channels[kind], columns_of_rows(rows), strict=True)
    return {**channels, kind: [one + other for one, other in pairs]}


@dataclass(frozen=True, kw_only=True)
class SensorReading:
    """Reading of a sensor for true vectors: ``turn^T v + offset``."""

    offset: Tensor
    turn: Tensor

    def apply(self, rows: Tensor) -> Tensor:
        """Return the readings for true rows (E, 3)."""
        return times(rows, self.turn) + self.offset


def imu_readings_of_model(model: Model) -> tuple[SensorReading, SensorReading]:
    """Return the readings of accelerometer and gyro under a model's sensor errors, constant in all rows."""
    numbers = imu_errors([(effect, params[:1]) for effect, params in model.effects[ImuEffect]]).view(2, 4, 3)
    accelerometer, gyro = (SensorReading(offset=part[0], turn=part[1:]) for part in numbers)
    return accelerometer, gyro


class ImuReading:
    """Readings of the inertial sensors in the band."""

    def __init__(self, data: Dataset, in_band: BandResponse) -> None:
        self.data, self._in_band = data, in_band
        columns = data.columns_in_band(data.state["ang_vel"].T.contiguous().numpy())
        self._rates = torch.from_numpy(columns).T  # Measured angular velocity, (T, 3)
        rows = [torch.from_numpy(f.attitude[kept]) for f, kept in zip(data.flights, data.kept, strict=True)]
        self._attitude = torch.cat(rows)
        self._of_kinematics: OrderedDict[tuple[object, ...], dict[str, Columns]] = OrderedDict()

    def delays_on_prediction_clock(self, logged: SensorErrors) -> list[float]:
        """Return delays of rotor speeds, accelerometer, gyro, attitude and velocity against rotor speeds or commands [s]."""
        late = logged.delays.tolist()
        clock = 0.0 if self.data.simulated else late[0]
        return [one - clock for one in late]

    def delays_by_flight(self, logged: SensorErrors) -> SensorDelays:
        """Return the delays of force and rotation on that clock; a derived force has the delay of the attitude."""
        _, acc, gyro, attitude, _ = self.delays_on_prediction_clock(logged)
        force = tuple(acc if flight.accelerometer else attitude for flight in self.data.flights)
        scale = logged.gyro_scale if logged.gyro_scale.any() else None
        return SensorDelays(force=force, gyro=(gyro,) * len(force), gyro_scale=scale)

    def read_channels(
        self, model: Model, accelerations: Accelerations, logged: SensorErrors, seeming: Tensor | None
    ) -> dict[str, Columns]:
        """Return the sensor readings by kind of channel, three columns (T,) each.

        ``accelerations`` have the delays of the log; ``seeming``: apparent angular acceleration by noise [rad/s²], (T, 3),
        or None.
        """
        felt, force, torque = self.data.felt_force_kept, accelerations.specific_force, accelerations.ang_acc
        late = self.delays_by_flight(logged)

        def lever(place: Tensor) -> Tensor:
            return self._in_band.lever_arm_acceleration(place, late).T

        for place, rows in ((logged.imu_place, felt), (logged.velocity_place, ~felt)):
            if place.any() and rows.any():
                force = force + rows * lever(place)
        if model.effects[ImuEffect]:
            of_force, of_rate = imu_readings_of_model(model)
            force, torque = torch.where(felt, of_force.apply(force), force), times(torque, of_rate.turn)
        torque = torque * (1.0 + logged.gyro_scale)
        if seeming is not None:
            torque = torque + seeming
        turn = quat_to_matrix(logged.attitude_turn) if logged.attitude.any() else None
        if turn is not None:  # a derived force has the axes of the logged attitude
            force = torch.where(felt, force, times(force, turn))
        *_, attitude, velocity = logged.delays.tolist()
        if velocity != attitude and not felt.all():  # a derived force has the velocity's delay in those axes
            on_time, moved = (self.data.kinematic_force(0.0, ahead=ahead) for ahead in (0.0, attitude - velocity))
            force = torch.where(felt, force, force + moved - on_time)
        place = logged.imu_place - logged.velocity_place
        implied = self._read_kinematic_channels(model, logged, turn, lever(place) if place.any() else None)
        # Scales act on the predicted force and the measured rate; on the implied ones, noise would bias them.
        if logged.velocity_scale.any():
            more = self._change_by_velocity_scale(force, logged.velocity_scale)
            force = torch.where(felt, force, force + more)
            implied = add_to_columns(implied, "kinematic_force", -more * felt)
        if logged.acc_scale.any():
            more = force * logged.acc_scale * felt
            force, implied = force + more, add_to_columns(implied, "kinematic_force", more)
        if (scale := logged.gyro_scale - logged.attitude_scale).any():
            implied = add_to_columns(implied, "kinematic_rate", self._rates * (scale / (1.0 + logged.gyro_scale)))
        return {
            "specific_force": columns_of_rows(force + logged.acc_bias * felt),
            "angular_acceleration": columns_of_rows(torque),  # a constant error has no derivative
            **implied,
        }

    def _change_by_velocity_scale(self, force: Tensor, scale: Tensor) -> Tensor:
        """Return the change of a force derived from the velocity by its relative scale, (3,) [m/s²], body, (T, 3)."""
        weight = force.new_tensor((0.0, 0.0, STANDARD_GRAVITY))
        return quat_rotate_inverse(self._attitude, scale * (quat_rotate(self._attitude, force) - weight))

    def _read_kinematic_channels(
        self, model: Model, logged: SensorErrors, turn: Tensor | None, lever: Tensor | None
    ) -> dict[str, Columns]:
        """Return the kinematic channels with sensor errors, cached for all models with equal errors.

        ``turn``: rotation of the logged attitude, (3, 3); ``lever``: acceleration of the accelerometer against the point of
        the logged velocity [m/s²], (T, 3). None: without.
        """
        errs, turns = model.effects[ImuEffect], () if turn is None else (turn.flatten(),)
        names = ("acc_bias", "gyro_bias", "imu_place", "velocity_place", "gyro_scale", "delays")
        own = [getattr(logged, name) for name in names]
        numbers = torch.cat((*own, *turns, *(params[0] for _, params in errs))).numpy().tobytes()
        key = (numbers, *(effect.name for effect, _ in errs))
        if key not in self._of_kinematics:
            _, acc, gyro, attitude, velocity = logged.delays.tolist()
            force = self.data.kinematic_force(acc - attitude, ahead=velocity - attitude)
            rate = self.data.kinematic_rate(gyro - attitude)
            if turn is not None:
                force, rate = times(force, turn.T), times(rate, turn.T)
            force = force if lever is None else force + lever
            if errs:
                of_force, of_rate = imu_readings_of_model(model)
                force, rate = of_force.apply(force), of_rate.apply(rate)
            bias = logged.acc_bias * self.data.felt_force_kept
            self._of_kinematics[key] = {
                "kinematic_force": columns_of_rows(force + bias),
                "kinematic_rate": columns_of_rows(rate + logged.gyro_bias),
            }
            while len(self._of_kinematics) > READINGS:
                self._of_kinematics.popitem(last=False)
        self._of_kinematics.move_to_end(key)
        return self._of_kinematics[key]
