"""A robot file from flight logs: what the log states, what its flights show, and what only a person knows.

Effectiveness is the share of angular acceleration and specific force that a rotor gives per unit of its input: the squared
speed, or without measured speeds the command on the firmware's thrust curve. Both sides are smoothed to ``BAND_HZ``, above
which frame and sensors vibrate, less their mean over ``MEAN_S``, in which air flow moves the vehicle too. Rotors of one flight
move together. So the sign of each rotor is taken from all inputs at once, but the size about an axis from the sum of the inputs
with these signs.

Only ratios follow from a flight: thrust needs the mass, inertia the length of the arms, drag torque the inertia about yaw.
Letters: T rows, R rotors.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.ndimage import binary_erosion, gaussian_filter1d
from scipy.optimize import least_squares
from scipy.signal import lfilter

from aerial_gym.errors import DataError
from aerial_gym.sim2real.arrays import Array, Flags
from aerial_gym.sim2real.logs.readers.binary_log import flight_paths
from aerial_gym.sim2real.logs.readers.flight_log import read_flight_log
from aerial_gym.sim2real.logs.recording import FlightLog, sample_rate, take_rows
from aerial_gym.sim2real.statistics import Estimate
from aerial_gym.sim2real.teststand.log_geometry import RotorLayout, layout_in_log

BAND_HZ = 20.0  # Highest frequency of the regression
MEAN_S = 0.3  # Standard deviation of the Gaussian window whose mean is taken from each row [s]
EDGE_S = 1.0  # Rows this near to the start or end of a flight's powered part are left out: the reach of the window [s]
SLOWEST = 0.1  # A rotor below this share of the largest speed or command does not carry the vehicle
PARTS = 8  # Parts of the flights that are left out in turn for the intervals
CLEAR = 2.0  # A sign is clear if the value is so many standard deviations from 0
FEWEST_S = 3.0  # Least time in the air [s]


@dataclass(frozen=True, kw_only=True)
class ValueWithOrigin:
    """A number of the robot file with its origin: ``logged``, ``measured here`` or ``assumed``."""

    value: float
    origin: str

    @property
    def is_assumed(self) -> bool:
        """Whether neither log nor flight shows it."""
        return self.origin.startswith("assumed")


@dataclass(frozen=True, kw_only=True)
class FlightRows:
    """Rows of one flight with all rotors turning, smoothed, less their moving mean."""

    inputs: Array  # Input of each rotor, (T, R)
    swings: Array  # Rate of change of the speeds [rad/s²], (T, R); 0 without measured speeds
    products: Array  # Products of body rates y z, z x, x y [rad²/s²], (T, 3)
    motion: Array  # Angular acceleration [rad/s²] and specific force along z [m/s²], (T, 4)
    level: float  # Mean specific force along z over the mean sum of inputs


@dataclass(frozen=True, kw_only=True)
class Effectiveness:
    """Motion per unit of input: roll, pitch and yaw acceleration, and specific force along z."""

    signs: Array  # Of each rotor about roll, pitch and yaw, 0 where not clear, (3, R)
    sizes: tuple[Estimate, ...]  # Size about each axis, and the specific force of one rotor


@dataclass(frozen=True, kw_only=True)
class CommandCurve:
    """Steady speed ``offset + gain u^power`` [rad/s] of a command u from 0 to 1, and the lag [s] of the speed behind it."""

    offset: Estimate
    gain: Estimate
    power: Estimate
    lag: Estimate


@dataclass(frozen=True, kw_only=True)
class VehicleDraft:
    """Numbers of a robot file with their origins, and the questions that are left."""

    values: dict[str, ValueWithOrigin]
    places: Array  # Of the rotors [m], (R, 3)
    spins: tuple[int, ...]
    layout_origin: str
    curve: CommandCurve | None
    effectiveness: Effectiveness | None
    questions: tuple[str, ...]
    notes: tuple[str, ...] = field(default=())
    force_mode: bool  # Whether commands are thrusts, since the log has no speeds
    mapping: str = ""  # Text of a mapping file that turns logged commands into those of the robot


def rows_of_flight(log: FlightLog, thrust_input: Callable[[FlightLog], Array]) -> FlightRows:
    """Return the filtered rows of a flight in which all rotors turn and the log has gyro and accelerometer."""
    if log.ang_vel is None or log.specific_force is None:
        raise DataError(f"{log.path}: needs gyro and accelerometer")
    rate, inputs = sample_rate(log), thrust_input(log)

    def in_band(values: Array) -> Array:
        smooth = gaussian_filter1d(values, rate * np.sqrt(np.log(2.0)) / (2.0 * np.pi * BAND_HZ), axis=0)
        return smooth - gaussian_filter1d(smooth, rate * MEAN_S, axis=0, truncate=3.0)

    rates = log.ang_vel
    products = np.stack([rates[:, j] * rates[:, k] for j, k in ((1, 2), (2, 0), (0, 1))], axis=1)
    speeds = np.zeros_like(inputs) if log.rotor_speed is None else log.rotor_speed
    motion = np.concatenate((np.gradient(rates, axis=0) * rate, log.specific_force[:, 2:]), axis=1)
    rows = _rows_in_flight(inputs, rate)
    parts = (inputs, np.gradient(speeds, axis=0) * rate, products, motion)
    level = float(log.specific_force[rows, 2].mean() / max(inputs[rows].mean(), 1e-12)) if rows.any() else 0.0
    filtered = [in_band(part)[rows] for part in parts]
    return FlightRows(inputs=filtered[0], swings=filtered[1], products=filtered[2], motion=filtered[3], level=level)


def _rows_in_flight(inputs: Array, rate: float) -> Flags:
    """Return the rows in which all rotors turn, without the edges of such spans, (T,)."""
    turning = (inputs > SLOWEST**2 * np.quantile(inputs, 0.99)).all(axis=1)
    return np.asarray(binary_erosion(turning, np.ones(2 * round(EDGE_S * rate) + 1)), dtype=np.bool_)


def fit_effectiveness(flights: Sequence[FlightRows], logged_signs: Array | None) -> Effectiveness:
    """Return signs and sizes of the effectiveness, with intervals by leaving out parts of the flights."""
    inputs, swings, products, motion = (
        np.concatenate([getattr(flight, name) for flight in flights])
        for name in ("inputs", "swings", "products", "motion")
    )
    part = np.arange(len(inputs)) * PARTS // len(inputs)
    kept = [part != k for k in range(PARTS)]

    def single_rotors(rows: Flags) -> Array:
        columns = np.concatenate((inputs, swings, products), axis=1)[rows]
        return _least_squares(columns, motion[rows, :3])[: inputs.shape[1]].T

    whole, deviation = _jackknife(single_rotors, kept)
    clear = (np.abs(whole) > CLEAR * deviation).all(axis=1, keepdims=True)
    patterns = np.where(clear | (logged_signs is None), np.sign(whole), 0.0 if logged_signs is None else logged_signs)

    def sizes(rows: Flags) -> Array:
        sums = inputs[rows] @ np.concatenate((patterns, np.ones((1, inputs.shape[1])))).T
        spin_up = (swings[rows] @ patterns[2])[:, None]
        fit = _least_squares(np.concatenate((sums, spin_up, products[rows]), axis=1), motion[rows])
        return np.diag(fit[:4])

    value, spread = _jackknife(sizes, kept)
    turned = np.append(np.sign(value[:3]), 1.0)  # logged signs that the flight contradicts
    known = np.abs(value[:3]) > CLEAR * spread[:3] if logged_signs is not None else clear[:, 0]
    signs = patterns * (turned[:3] * known)[:, None]
    return Effectiveness(
        signs=np.asarray(signs, dtype=np.float64),
        sizes=tuple(map(Estimate.from_half_width, turned * value, CLEAR * spread)),
    )


def _least_squares(columns: Array, targets: Array) -> Array:
    scale = np.maximum(np.sqrt((columns * columns).mean(axis=0)), 1e-300)
    return np.linalg.lstsq(columns / scale, targets, rcond=None)[0] / scale[:, None]


def _jackknife(fit: Callable[[Flags], Array], kept: Sequence[Flags]) -> tuple[Array, Array]:
    """Return the fit to all rows, and its standard deviation from fits that leave out one part each."""
    whole = fit(np.ones(kept[0].size, dtype=bool))
    parts = np.stack([fit(rows) for rows in kept])
    count = len(kept)
    return whole, np.sqrt((count - 1) / count * ((parts - parts.mean(axis=0)) ** 2).sum(axis=0))


def fit_command_curve(logs: Sequence[FlightLog]) -> CommandCurve | None:
    """Return the steady speed of a command and the lag behind it; None without measured speeds and fast commands."""
    if len(logs) == 1:
        logs = [take_rows(logs[0], slice(*ends)) for ends in pairwise(np.linspace(0, logs[0].time.size, 5).astype(int))]
    pairs = [(log.rotor_command, log.rotor_speed, sample_rate(log)) for log in logs]
    if any(command is None or speed is None for command, speed, _ in pairs):
        return None
    largest = max(float(speed.max()) for _, speed, _ in pairs if speed is not None)

    def residual(params: Array, chosen: Sequence[int]) -> Array:
        offset, gain, power, lag = params * (largest, largest, 1.0, 0.02)
        rows = []
        for k in chosen:
            command, speed, rate = pairs[k]
            assert command is not None
            assert speed is not None
            share = np.exp(-1.0 / (rate * max(lag, 1e-4)))
            steady = offset + gain * np.clip(command, 0.0, None) ** power
            state = lfilter([0.0, 1.0 - share], [1.0, -share], steady - steady[:1], axis=0) + steady[:1]
            rows.append(((state - speed) / largest)[_rows_in_flight(speed**2, rate)].reshape(-1))
        return np.concatenate(rows)

    def fit(chosen: Sequence[int]) -> Array:
        start, low, high = (0.1, 0.9, 0.7, 1.0), (0.0, 0.1, 0.3, 0.05), (0.6, 2.0, 1.5, 10.0)
        return least_squares(residual, start, bounds=(low, high), args=(chosen,)).x * (largest, largest, 1.0, 0.02)

    count = range(len(pairs))
    whole = fit(list(count))
    leave_one_out = np.array([fit([k for k in count if k != left]) for left in count])
    half = CLEAR * np.sqrt(
        (len(pairs) - 1) / len(pairs) * ((leave_one_out - leave_one_out.mean(axis=0)) ** 2).sum(axis=0)
    )
    offset, gain, power, lag = map(Estimate.from_half_width, whole, half)
    return CommandCurve(offset=offset, gain=gain, power=power, lag=lag)


def draft_vehicle(paths: Sequence[str | Path], *, mass: float | None = None, arm: float | None = None) -> VehicleDraft:
    """Return the numbers of a robot file from one log or several of one vehicle."""
    given = [flight for path in paths for flight in flight_paths(path)]
    logs = [read_flight_log(path) for path in given]
    layout = layout_in_log(str(given[0]), logs[0].num_rotors)
    has_speeds = all(log.rotor_speed is not None for log in logs)

    def thrust_input(log: FlightLog) -> Array:
        if has_speeds and log.rotor_speed is not None:
            return log.rotor_speed**2
        if log.rotor_command is None:
            raise DataError(f"{log.path}: holds neither rotor speeds nor commands; log one of them")
        u, curved = np.clip(log.rotor_command, 0.0, None), layout.thrust_curve
        return curved * u**2 + (1.0 - curved) * u

    flights = [rows for log in logs if len((rows := rows_of_flight(log, thrust_input)).motion)]
    seconds = sum(len(rows.motion) for rows in flights) / sample_rate(logs[0])
    if seconds < FEWEST_S:
        raise DataError(f"{given[0]}: {seconds:.1f} s with all rotors turning; {FEWEST_S:g} s are needed")
    fast = all(log.torques for log in logs)
    effect = fit_effectiveness(flights, layout.signs) if fast else None
    curve = fit_command_curve(logs) if has_speeds and fast else None
    level = float(np.average([rows.level for rows in flights], weights=[len(rows.motion) for rows in flights]))
    return _assemble_draft(layout, effect, curve, level / layout.count, has_speeds, mass, arm, logs)


def _value_of_estimate(estimate: Estimate, factor: float = 1.0, basis: str = "") -> ValueWithOrigin:
    low, high = factor * estimate.low, factor * estimate.high
    interval = f" [{low:.3g}, {high:.3g}]" if np.isfinite(high) else ""
    return ValueWithOrigin(value=factor * estimate.value, origin=f"measured here{interval}{basis}")


def _assemble_draft(
    layout: RotorLayout, effect: Effectiveness | None, curve: CommandCurve | None, lift: float, has_speeds: bool,
    mass: float | None, arm: float | None, logs: Sequence[FlightLog],
) -> VehicleDraft:  # fmt: skip
    """Return the draft; ``lift``: specific force of one rotor per unit of input in the mean of the flights."""
    questions, values = list[str](), dict[str, ValueWithOrigin]()
    if mass is None:
        questions.append("How heavy is the vehicle, battery included? Weigh it and give --mass-kg")
    kilograms = 1.0 if mass is None else mass
    values["mass"] = ValueWithOrigin(
        value=kilograms, origin="assumed: not in the log" if mass is None else "given: --mass-kg"
    )
    places, spins, layout_origin, notes = _layout_of_flight(layout, effect)
    if not layout.has_lengths:
        if arm is None:
            questions.append("How far is a rotor's axis from the centre? Measure it and give --arm-m")
        length = 0.12 * kilograms ** (1.0 / 3.0) + 0.05 if arm is None else arm
        places = places * length / np.linalg.norm(places[:, :2], axis=1).max()
        how = "assumed: from the mass, +- 40 %" if arm is None else "given: --arm-m"
        values["arm"] = ValueWithOrigin(value=length, origin=how)
    thrust = ValueWithOrigin(value=kilograms * lift, origin="measured here: hover, by the mass")
    values["thrust"] = thrust
    arms = np.abs(places[:, [1, 0]]).mean(axis=0)
    if effect is not None:
        for name, reach, size in zip(("inertia_x", "inertia_y"), arms, effect.sizes[:2], strict=True):
            values[name] = _positive_ratio(reach * thrust.value, size, "by arm, mass and effectiveness")
    else:
        for name, reach in zip(("inertia_x", "inertia_y"), arms, strict=True):
            guess = 0.4 * kilograms * float(reach) ** 2
            values[name] = ValueWithOrigin(
                value=guess, origin="assumed: 0.4 m arm², +- 50 %; the log is too slow for torques"
            )
    values["torque_ratio"], values["inertia_z"] = _yaw_numbers(layout, effect, thrust.value, values)
    if curve is None:
        values["lag"] = ValueWithOrigin(value=0.05, origin="assumed: speeds or commands are not logged fast enough")
    else:
        values["lag"] = _value_of_estimate(curve.lag)
    top = thrust.value * _largest_input(curve, has_speeds, logs)
    at = "full command" if curve is not None or not has_speeds else "the largest speed in flight"
    values["largest_thrust"] = ValueWithOrigin(value=top, origin=f"measured here: at {at}")
    return VehicleDraft(
        values=values, places=places, spins=spins, layout_origin=layout_origin, curve=curve, effectiveness=effect,
        questions=tuple(questions), notes=tuple(notes), force_mode=not has_speeds,
        mapping=_mapping_text(curve, layout, thrust.value, has_speeds),
    )  # fmt: skip


def _positive_ratio(numerator: float, size: Estimate, basis: str) -> ValueWithOrigin:
    low, high = numerator / max(size.high, 1e-300), numerator / max(size.low, 1e-300)
    origin = (
        f"measured here [{low:.3g}, {high:.3g}]: {basis}"
        if size.low > 0.0
        else f"assumed: not clear in the flight; {basis}"
    )
    return ValueWithOrigin(value=numerator / max(abs(size.value), 1e-300), origin=origin)


def _yaw_numbers(
    layout: RotorLayout, effect: Effectiveness | None, thrust: float, values: dict[str, ValueWithOrigin]
) -> tuple[ValueWithOrigin, ValueWithOrigin]:
    """Return drag torque per thrust [m] and inertia about z; one of them fixes the other by the effectiveness about yaw."""
    flat = values["inertia_x"].value + values["inertia_y"].value
    if effect is None or effect.sizes[2].low <= 0.0:
        ratio = layout.torque_ratio or 0.015
        how = "logged: CA_ROTOR0_KM" if layout.torque_ratio else "assumed: typical"
        return ValueWithOrigin(value=ratio, origin=how), ValueWithOrigin(value=flat, origin="assumed: flat body, x + y")
    size = effect.sizes[2]
    if layout.torque_ratio is not None:
        inertia = _positive_ratio(layout.torque_ratio * thrust, size, "by the logged torque ratio")
        return ValueWithOrigin(value=layout.torque_ratio, origin="logged: CA_ROTOR0_KM"), inertia
    return (
        _value_of_estimate(size, flat / thrust, " by yaw acceleration and the inertia about z"),
        ValueWithOrigin(value=flat, origin="assumed: flat body, x + y"),
    )


def _layout_of_flight(
    layout: RotorLayout, effect: Effectiveness | None
) -> tuple[Array, tuple[int, ...], str, list[str]]:
    """Return places and spins of the rotors: those of the flight where its signs are clear, else those of the log."""
    notes: list[str] = []
    signs = None if effect is None else effect.signs
    if signs is None or not signs.all():
        if layout.places is None or layout.spins is None:
            raise DataError(
                "neither log nor flight shows where the rotors are; fly with turns about all axes, or log ESC speeds"
            )
        return layout.places, layout.spins, f"logged: {layout.source}; the flight does not show all signs", notes
    roll, pitch, yaw = signs
    spins = tuple(int(-sign) for sign in yaw)
    places = np.stack((-pitch, roll, np.zeros_like(roll)), axis=1)
    if layout.places is None or layout.spins is None:
        return places, spins, "measured here: signs of roll, pitch and yaw", notes
    agree = np.array_equal(np.sign(layout.places[:, :2]), places[:, :2])
    if agree and layout.spins == spins:
        return layout.places, spins, f"logged: {layout.source}; the flight agrees", notes
    parts = [name for name, wrong in (("order of rotors", not agree), ("spins", layout.spins != spins)) if wrong]
    notes.append(
        f"The flight contradicts the {' and the '.join(parts)} of {layout.source}; the file has those of the flight."
    )
    size = np.abs(layout.places[:, :2]).mean(axis=0)
    return places * (*size, 1.0), spins, "measured here: signs of roll, pitch and yaw", notes


def _largest_input(curve: CommandCurve | None, has_speeds: bool, logs: Sequence[FlightLog]) -> float:
    if not has_speeds:
        return 1.0
    if curve is not None:
        return (curve.offset.value + curve.gain.value) ** 2
    return max(float((log.rotor_speed**2).max()) for log in logs if log.rotor_speed is not None)


def _mapping_text(curve: CommandCurve | None, layout: RotorLayout, thrust: float, has_speeds: bool) -> str:
    """Return a mapping that turns logged commands into speeds [rad/s], or into thrusts [N] without measured speeds."""
    if curve is not None:
        law = f"offset: {curve.offset.value:.6g}, gain: {curve.gain.value:.6g}, power: {curve.power.value:.4g}"
    elif not has_speeds and layout.thrust_curve in (0.0, 1.0):
        law = f"gain: {thrust:.6g}, power: {1.0 + layout.thrust_curve:g}"
    else:
        return ""
    return (
        "summary: commands of this vehicle, by aerial-gym robot from-log\ntime: {columns: [t]}\n"
        f"rotor_command: {{columns: [rotor_command], {law}}}\n"
    )


def robot_text(draft: VehicleDraft, *, name: str) -> str:
    """Return the robot file, with the origin of each number beside it."""
    v = draft.values

    def line(key: str, number: str, source: ValueWithOrigin) -> str:
        return f"  {key}: {number}  # {source.origin}"

    moments = [v[f"inertia_{axis}"] for axis in "xyz"]
    rows = np.diag([moment.value for moment in moments])
    inertia = [
        f"  - [{', '.join(f'{number:.5g}' for number in row)}]  # {moment.origin}"
        for row, moment in zip(rows, moments, strict=True)
    ]
    reach = float(np.linalg.norm(draft.places, axis=1).max())
    rotor = (
        ["  mode: force"]
        if draft.force_mode
        else [line("thrust_map", f"[0.0, 0.0, {v['thrust'].value:.6g}]", v["thrust"])]
    )
    mounts = [
        f"  - {{position: [{', '.join(f'{x:.5g}' for x in place)}], spin: {spin}}}"
        for place, spin in zip(draft.places, draft.spins, strict=True)
    ]
    arm = f"; arm {v['arm'].origin}" if "arm" in v else ""
    source = f"aerial-gym robot from-log {name}"
    return "\n".join((
        f"summary: vehicle of {name}", "body:", line("mass", f"{v['mass'].value:g}", v["mass"]), "  inertia:", *inertia,
        f"  source: {source!r}", "rotor:", *rotor, line("torque_ratio", f"{v['torque_ratio'].value:.4g}", v["torque_ratio"]),
        *(line(f"time_constant_{way}", f"{v['lag'].value:.4g}", v["lag"]) for way in ("up", "down")),
        line("thrust_range", f"[0.0, {v['largest_thrust'].value:.5g}]", v["largest_thrust"]), f"  source: {source!r}",
        f"mounts:  # {draft.layout_origin}{arm}", "  layout:", *mounts, f"  source: {source!r}",
        "collision:", f"  spheres: [{{center: [0.0, 0.0, 0.0], radius: {1.2 * reach:.4g}}}]  # assumed: 1.2 times the arm",
        f"  source: {source!r}", "",
    ))  # fmt: skip
