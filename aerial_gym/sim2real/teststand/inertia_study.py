"""Study of ``aerial-gym identify inertia``: the inertia of a thrown body, by that of its flywheel or of a proof body."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import inf
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from aerial_gym.errors import ConfigError, DataError
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.logs.readers.flight_log import open_raw_log, read_flight_log
from aerial_gym.sim2real.logs.readers.log_readers import LOG_READERS, read_raw_log
from aerial_gym.sim2real.logs.recording import split_flight_number
from aerial_gym.sim2real.logs.signals import interpolate_columns
from aerial_gym.sim2real.statistics import Estimate
from aerial_gym.sim2real.teststand.report import ReportTable, Study, interval_text
from aerial_gym.sim2real.teststand.throws import (
    PAIRS,
    FreeFlight,
    MomentumFit,
    find_free_flight,
    fit_momentum,
    steiner_term,
)

NORMAL_95 = 1.96  # Half width of a 95 % interval in standard deviations
LARGEST_REST = 0.15  # Largest unexplained share of the change of momentum; throws of one rigid body show 0.03


@dataclass(frozen=True, kw_only=True)
class ThrowSeries:
    """Logs of throws of one body, the device with the IMU and the flywheel included."""

    paths: Sequence[Path]
    mass: float | None = None  # Of the body without the device; of the device, for throws of the device alone [kg]
    inertia: tuple[float, float, float] | None = None  # Known moments of a proof body about the IMU's axes [kg m²]

    def __post_init__(self) -> None:
        for name, value in (("mass", self.mass), *(("inertia", moment) for moment in self.inertia or ())):
            if value is not None and not 0.0 < value < inf:
                raise ConfigError(
                    f"{name} of the body in {', '.join(map(str, self.paths))} = {value!r}: must be > 0, finite"
                )


@dataclass(frozen=True, kw_only=True)
class BodyInertia:
    """Inertia of the body alone about its centre of mass."""

    matrix: Array  # [kg m²], axes of the IMU, (3, 3)
    moments: tuple[Estimate, ...]  # Principal moments [kg m²], smallest first
    axes: Array  # Principal axes as columns, right-handed, (3, 3)
    turns: Array  # Half widths of the 95 % intervals of the angle in the plane of two axes [rad], pi / 4: undetermined, (3, 3)
    centre: Array  # Centre of mass from the IMU [m], (3,)
    wheel: Estimate  # Inertia of the flywheel [kg m²]


def read_throw(path: Path) -> FreeFlight:
    """Return the free flight in a log with gyro, accelerometer and the speed of one flywheel."""
    series = {name: (time, values) for name, time, values in _best_channel_of_each_quantity(path)}
    if missing := [name for name in ("ang_vel", "specific_force", "rotor_speed") if name not in series]:
        raise DataError(
            f"{path}: has no {' and no '.join(missing)}; log the gyro, the accelerometer and the wheel's speed"
        )
    (time, rates), force, (wheel_time, wheel) = (series[name] for name in ("ang_vel", "specific_force", "rotor_speed"))
    speed = wheel[:, int(np.argmax(np.nanmax(np.abs(wheel), axis=0)))]
    return find_free_flight(FreeFlight(
        name=str(path), time=time, ang_vel=rates, wheel_speed=np.interp(time, wheel_time, speed),
        specific_force=interpolate_columns(time, *force),
    ))  # fmt: skip


def _best_channel_of_each_quantity(path: Path) -> Iterator[tuple[str, Array, Array]]:
    """Yield quantity, time [s] and values of the best channel of each quantity."""
    file, number = split_flight_number(path)
    raw, seen = read_raw_log(Path(file)), set[str]()
    if raw is None or number is not None:
        log = read_flight_log(path, hover=True)
        for name in ("ang_vel", "specific_force", "rotor_speed"):
            if (values := getattr(log, name)) is not None:
                yield name, log.time, values
        return
    try:
        opened = open_raw_log(raw, hover=True)
    except DataError:  # a throw may be shorter than a flight
        opened = None
    if opened is not None and len(opened.spans) > 1:
        opened.single_flight()  # which lists the flights
    for channel in LOG_READERS.get(raw.format).channels(raw):
        if channel.quantity not in seen:
            seen.add(channel.quantity)
            yield channel.quantity, channel.time, channel.values


def study_inertia(
    body: ThrowSeries, device: ThrowSeries | None, proof: ThrowSeries | None, wheel_inertia: float | None
) -> Study:
    """Return a study of the inertia of a body; without throws of the device alone, of all that was thrown."""
    if (wheel_inertia is None) == (proof is None):
        raise ConfigError(
            "identify inertia needs one scale: give --wheel-inertia-kg-m2, or --proof with its mass and inertia"
        )
    for series, role in ((proof, "proof"), (device, "device")):
        if series is not None and series.mass is None:
            raise ConfigError(f"identify inertia --{role} needs the mass of that body: give --{role}-mass-kg")
    if proof is not None and (device is None or proof.inertia is None):
        raise ConfigError(
            "a proof body needs throws of the device alone (--device), and its inertia (--proof-inertia-kg-m2)"
        )
    if device is not None and body.mass is None:
        raise ConfigError("identify inertia --device needs the mass of the body without the device: give --mass-kg")
    if wheel_inertia is not None and not 0.0 < wheel_inertia < inf:
        raise ConfigError(f"wheel inertia = {wheel_inertia!r}: must be > 0 and finite")
    series = [each for each in (body, device, proof) if each is not None]
    wheel, fits = fit_momentum([[read_throw(path) for path in each.paths] for each in series])
    for each, fit in zip(series, fits, strict=True):
        _check_momentum(each, fit)
    result = body_inertia(series, fits, wheel_inertia)
    return _report_inertia(body, result, fits[0], wheel.lateness)


def _check_momentum(series: ThrowSeries, fit: MomentumFit) -> None:
    """Raise ``DataError`` if the throws of a series do not conserve the momentum of one rigid body."""
    if fit.residual > LARGEST_REST:
        raise DataError(
            f"{', '.join(map(str, series.paths))}: {fit.residual:.0%} of the change of momentum stay unexplained, and throws "
            f"of one rigid body leave at most {LARGEST_REST:.0%}; give throws of the same body, touched by nobody in the air"
        )


def body_inertia(
    series: Sequence[ThrowSeries], fits: Sequence[MomentumFit], wheel_inertia: float | None
) -> BodyInertia:
    """Return the inertia of the first body; of the second, the device, that of all others is freed; the third is the proof."""
    total, device = fits[0], fits[1] if len(fits) > 1 else None
    scale = (
        wheel_inertia_by_proof_body(series, fits)
        if wheel_inertia is None
        else Estimate.from_half_width(wheel_inertia, 0.0)
    )
    matrix, elements = scale.value * total.inertia, total.covariance
    centre = -total.imu_position
    if device is not None:
        offset = inertia_of_distance(total, device, series[0].mass or 0.0, series[1].mass or 0.0)
        matrix, elements = scale.value * (total.inertia - device.inertia) - offset, elements + device.covariance
        centre = centre - (total.imu_position - device.imu_position) * (series[1].mass or 0.0) / (series[0].mass or 1.0)
    values, axes = np.linalg.eigh(matrix)
    axes[:, 2] *= np.sign(np.linalg.det(axes))
    gradients = np.stack([[axes[i, k] * axes[j, k] * (1.0 if i == j else 2.0) for i, j in PAIRS] for k in range(3)])
    spread = np.sqrt(np.einsum("ka,ab,kb->k", gradients, elements, gradients)) * scale.value
    turns = half_widths_of_axis_angles(values, axes, elements * scale.value**2)
    share = (scale.high - scale.value) / NORMAL_95 / scale.value
    half = NORMAL_95 * np.hypot(spread, values * share)
    return BodyInertia(
        matrix=matrix, moments=tuple(map(Estimate.from_half_width, values, half)), axes=axes, turns=turns, centre=centre,
        wheel=scale,
    )  # fmt: skip


def half_widths_of_axis_angles(moments: Array, axes: Array, covariance: Array) -> Array:
    """Return half widths of the 95 % intervals of the angles by which two principal axes may turn in their plane [rad], (3, 3).

    An error ``e`` of the product of inertia turns the axes of moments that differ by ``d`` by ``atan2(2 e, d) / 2``. The least
    difference inside its interval counts; ``pi / 4`` means that the data do not tell the two moments apart.

    Args:
        moments: Principal moments [kg m²], (3,).
        axes: Principal axes as columns, (3, 3).
        covariance: Of the elements of the matrix in the order of ``PAIRS`` [kg² m⁴], (6, 6).
    """
    first, second = (np.array(index) for index in zip(*PAIRS, strict=True))
    left, right = axes[first], axes[second]  # (6, 3)
    outer = left[:, :, None] * right[:, None, :]
    products = np.where((first == second)[:, None, None], outer, outer + np.swapaxes(outer, 1, 2))  # (6, 3, 3)
    own = np.stack([products[:, k, k] for k in range(3)], axis=1)  # gradients of the moments, (6, 3)
    apart = own[:, :, None] - own[:, None, :]

    def half_width(gradients: Array) -> Array:
        return NORMAL_95 * np.sqrt(np.einsum("akl,ab,bkl->kl", gradients, covariance, gradients))

    difference = np.maximum(np.abs(moments[:, None] - moments) - half_width(apart), 0.0)
    angles = 0.5 * np.arctan2(2.0 * half_width(products), difference)
    return np.where(np.eye(3, dtype=bool), 0.0, angles)


def inertia_of_distance(total: MomentumFit, device: MomentumFit, mass: float, device_mass: float) -> Array:
    """Return the inertia by the distance of body and device from their common centre of mass [kg m²], (3, 3)."""
    lever = total.imu_position - device.imu_position
    return steiner_term(device_mass, lever) + steiner_term(mass, lever * device_mass / mass)


def wheel_inertia_by_proof_body(series: Sequence[ThrowSeries], fits: Sequence[MomentumFit]) -> Estimate:
    """Return the wheel's inertia [kg m²] that gives the proof body its known inertia, by least squares."""
    (_, device, proof), (_, device_fit, proof_fit) = series, fits
    assert proof.mass is not None
    assert device.mass is not None
    assert proof.inertia is not None
    known = np.diag(proof.inertia) + inertia_of_distance(proof_fit, device_fit, proof.mass, device.mass)
    measured = proof_fit.inertia - device_fit.inertia
    value = float((measured * known).sum() / (measured * measured).sum())
    weights = np.array([measured[i, j] * (1.0 if i == j else 2.0) for i, j in PAIRS]) / (measured * measured).sum()
    covariance = proof_fit.covariance + device_fit.covariance
    return Estimate.from_half_width(value, NORMAL_95 * value * float(np.sqrt(weights @ covariance @ weights)))


def _report_inertia(body: ThrowSeries, result: BodyInertia, fit: MomentumFit, lateness: float) -> Study:
    values = np.array([moment.value for moment in result.moments])
    open_moments = [k + 1 for k, moment in enumerate(result.moments) if moment.value > 0.0 >= moment.low]
    if open_moments:
        raise DataError(
            f"the throws do not show principal moment {', '.join(map(str, open_moments))}: its interval reaches 0; throw with "
            "more spin about all axes"
        )
    if values[0] <= 0.0 or result.moments[0].high + result.moments[1].high < result.moments[2].low:
        raise DataError(
            f"the moments {', '.join(f'{value:.3g}' for value in values)} kg m² belong to no body: the largest may not "
            "exceed the sum of the others; throw with more spin about all axes, and check masses and the number of magnet poles"
        )
    near = [k for k in (0, 1) if result.turns[k, k + 1] > 0.25 * np.pi - 1e-6]
    notes = [Finding("axes_open", "", {"first": k + 1, "second": k + 2}) for k in near]
    turns = np.degrees(np.linalg.norm(result.turns, axis=1))
    directions = [
        f"{', '.join(f'{x:+.3f}' for x in axis)} ± {turn:.1f}°" for axis, turn in zip(result.axes.T, turns, strict=True)
    ]
    rows = [
        (f"principal moment {k + 1} [kg m²]", interval_text(moment), directions[k])
        for k, moment in enumerate(result.moments)
    ]
    rows += [
        ("centre of mass from the IMU [m]", ", ".join(f"{x:+.4f}" for x in result.centre), ""),
        ("inertia of the flywheel [kg m²]", interval_text(result.wheel), ""),
        ("wheel speed logged late by [ms]", f"{1e3 * lateness:.2f}", ""),
        ("unexplained change of momentum", f"{100.0 * fit.residual:.1f} %", ""),
    ]
    matrix = [[float(f"{x:.6g}") for x in row] for row in result.matrix]
    mass = {} if body.mass is None else {"mass": body.mass}
    source = f"aerial-gym identify inertia: {', '.join(Path(path).name for path in body.paths)}"
    lines = [f"  {name}: {value!r}" for name, value in (mass | {"inertia": matrix, "source": source}).items()]
    quaternion = Rotation.from_matrix(result.axes).as_quat().tolist()
    return Study(
        title="Inertia of a thrown body",
        intro=f"Number of throws: {len(body.paths)}. Intervals are 95 % intervals of the scatter within the flights.",
        mapping={
            "inertia_kg_m2": matrix,
            "moments_kg_m2": [moment.as_mapping() for moment in result.moments],
            "axes_xyzw": quaternion,
            "axes_half_width_deg": turns.tolist(),
            "centre_of_mass_m": result.centre.tolist(),
            "wheel_inertia_kg_m2": result.wheel.as_mapping(),
            "wheel_lateness_s": lateness,
            "unexplained_share": fit.residual,
        },
        tables=(ReportTable("Body", ("quantity", "value, 95 %", "axis in the frame of the IMU"), rows),),
        notes=tuple(notes),
        files={"body.yaml": "\n".join(["body:", *lines, ""])},
    )
