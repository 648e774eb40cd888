"""A robot file from flight logs: what the log states, what its flights show, and what only a person knows.

Only ratios follow from a flight: thrust needs the mass, inertia the length of the arms, drag torque the inertia about yaw. A
number that stands on an assumed one is assumed itself. Letters: T rows, R rotors.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import inf
from pathlib import Path

import numpy as np

from aerial_gym.config.loader import dump_yaml
from aerial_gym.config.sim import STANDARD_GRAVITY
from aerial_gym.errors import ConfigError, DataError
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.logs.flights import complete_flight
from aerial_gym.sim2real.logs.readers.flight_log import read_flights
from aerial_gym.sim2real.logs.readers.log_readers import find_reader
from aerial_gym.sim2real.logs.readers.mapping import ColumnsCfg, LogMapping, find_mapping
from aerial_gym.sim2real.logs.recording import FlightLog, split_flight_number
from aerial_gym.sim2real.statistics import Estimate
from aerial_gym.sim2real.teststand.effectiveness import (
    CommandCurve,
    Effectiveness,
    FlightRows,
    fit_command_curve,
    fit_effectiveness,
    mean_lift,
    rows_of_flight,
)
from aerial_gym.sim2real.teststand.log_geometry import RotorLayout, layout_in_log

FEWEST_S = 3.0  # Least time in the air [s]
LARGEST_FORCE = 100.0  # Larger commands of a CSV file are speeds [rad/s]; smaller ones are thrusts [N] or shares
FASTEST_FALL = 10.0  # Change of the vertical velocity over a flight [m/s] that its mean specific force may contain


@dataclass(frozen=True, kw_only=True)
class ValueWithOrigin:
    """A number of the robot file with its origin: ``logged``, ``measured here`` or ``assumed``."""

    value: float
    origin: str

    @property
    def is_assumed(self) -> bool:
        """Whether neither log nor flight shows it."""
        return self.origin.startswith("assumed")

    def weaken(self, values: Mapping[str, "ValueWithOrigin"], *names: str) -> "ValueWithOrigin":
        """Return the value as assumed if one of the named values is."""
        assumed = [name for name in names if name in values and values[name].is_assumed]
        if self.is_assumed or not assumed:
            return self
        return replace(self, origin=f"assumed: scales with the assumed {' and '.join(assumed)}")


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


def draft_vehicle(
    paths: Sequence[str | Path],
    *,
    mass: float | None = None,
    arm: float | None = None,
    mapping: LogMapping | None = None,
) -> VehicleDraft:
    """Return the numbers of a robot file from one log or several of one vehicle."""
    for name, value in (("mass", mass), ("arm", arm)):
        if value is not None and not 0.0 < value < inf:
            raise ConfigError(f"{name} = {value!r}: must be > 0 and finite")
    logs = [_complete_log(log) for log in read_flights(paths, mapping=mapping)]
    layout = _common_layout(logs)
    has_speeds = all(log.rotor_speed is not None for log in logs)

    def thrust_input(log: FlightLog) -> Array:
        if has_speeds and log.rotor_speed is not None:
            return log.rotor_speed**2
        if log.rotor_command is None:
            raise DataError(f"{log.path}: holds neither rotor speeds nor commands; log one of them")
        u, curved = np.clip(log.rotor_command, 0.0, None), layout.thrust_curve
        return curved * u**2 + (1.0 - curved) * u

    flights = [rows_of_flight(log, thrust_input) for log in logs]
    for log, rows in zip(logs, flights, strict=True):
        _check_force(log, rows)
    flights = [rows for rows in flights if rows.seconds > 0.0]
    seconds = sum(rows.seconds for rows in flights)
    if seconds < FEWEST_S:
        raise DataError(f"{logs[0].path}: {seconds:.1f} s with all rotors turning; {FEWEST_S:g} s are needed")
    fast = all(log.torques for log in logs)
    effect = fit_effectiveness(flights, layout.signs) if fast else None
    curve = fit_command_curve(logs) if has_speeds and fast else None
    draft = _assemble_draft(layout, effect, curve, mean_lift(flights), has_speeds, mass, arm, logs)
    return replace(draft, mapping=_mapping_text(draft, layout, logs, mapping))


def _complete_log(log: FlightLog) -> FlightLog:
    """Return the log with the force by its velocity, and with commands above ``LARGEST_FORCE`` as speeds, if not measured."""
    if log.specific_force is None and log.lin_vel is not None:
        log = replace(log, specific_force=complete_flight(log).specific_force)
    command = log.rotor_command
    if command is None or log.rotor_speed is not None or command.max() <= LARGEST_FORCE:
        return log
    return replace(log, rotor_speed=command, rotor_command=None)


def _check_force(log: FlightLog, rows: FlightRows) -> None:
    """Raise ``DataError`` if the accelerometer shows less than a vehicle in the air for this time can have."""
    least = 0.9 * STANDARD_GRAVITY - FASTEST_FALL / max(rows.seconds, 1e-3)
    if rows.force < least:
        raise DataError(
            f"{log.path}: its accelerometer shows {rows.force:.1f} m/s² in the mean of {rows.seconds:.0f} s in the air, and a "
            "vehicle that flies shows 9.8; give a log of a real flight"
        )


def _common_layout(logs: Sequence[FlightLog]) -> RotorLayout:
    """Return the rotors that all logs state; raise ``DataError`` if they state different ones."""
    layouts = [layout_in_log(log.path, log.num_rotors) for log in logs]
    for log, layout in zip(logs, layouts, strict=True):
        if not layout.may_equal(layouts[0]):
            raise DataError(
                f"{logs[0].path} and {log.path} state different rotors ({layouts[0].count} by {layouts[0].source}, "
                f"{layout.count} by {layout.source}); give logs of one vehicle"
            )
    return layouts[0]


def _value_of_estimate(estimate: Estimate, factor: float = 1.0, basis: str = "") -> ValueWithOrigin:
    low, high = factor * estimate.low, factor * estimate.high
    interval = f" [{low:.3g}, {high:.3g}]" if np.isfinite(high) else ""
    return ValueWithOrigin(value=factor * estimate.value, origin=f"measured here{interval}{basis}")


def _assemble_draft(
    layout: RotorLayout, effect: Effectiveness | None, curve: CommandCurve | None, lift: Estimate, has_speeds: bool,
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
    elif arm is not None:
        notes.append(f"--arm-m {arm:g} is not used: the log states the places of the rotors ({layout.source}).")
    thrust = _value_of_estimate(lift, kilograms, ": hover, by the mass").weaken(values, "mass")
    values["thrust"] = thrust
    arms = np.abs(places[:, [1, 0]]).mean(axis=0)
    for axis, (name, reach) in enumerate(zip(("inertia_x", "inertia_y"), arms, strict=True)):
        if effect is not None:
            moment = _positive_ratio(reach * thrust.value, effect.sizes[axis], "by arm, mass and effectiveness")
            values[name] = moment.weaken(values, "mass", "arm")
        else:
            guess = 0.4 * kilograms * float(reach) ** 2
            origin = "assumed: 0.4 m arm², +- 50 %; the log is too slow for torques"
            values[name] = ValueWithOrigin(value=guess, origin=origin)
    for name in ("inertia_x", "inertia_y"):  # short numbers, whose sum stays exact in the file
        values[name] = replace(values[name], value=float(f"{values[name].value:.5g}"))
    values["torque_ratio"], values["inertia_z"] = _yaw_numbers(layout, effect, thrust.value, values, notes)
    values["lag"] = _lag_value(curve)
    values["largest_thrust"] = _largest_thrust(thrust, curve, has_speeds, logs)
    return VehicleDraft(
        values=values, places=places, spins=spins, layout_origin=layout_origin, curve=curve, effectiveness=effect,
        questions=tuple(questions), notes=tuple(notes), force_mode=not has_speeds,
    )  # fmt: skip


def _positive_ratio(numerator: float, size: Estimate, basis: str) -> ValueWithOrigin:
    low, high = numerator / max(size.high, 1e-300), numerator / max(size.low, 1e-300)
    origin = (
        f"measured here [{low:.3g}, {high:.3g}]: {basis}"
        if size.low > 0.0
        else f"assumed: not clear in the flight; {basis}"
    )
    return ValueWithOrigin(value=numerator / max(abs(size.value), 1e-300), origin=origin)


def _lag_value(curve: CommandCurve | None) -> ValueWithOrigin:
    if curve is None:
        return ValueWithOrigin(value=0.05, origin="assumed: speeds or commands are not logged fast enough")
    if curve.lag.low <= 0.0:
        return ValueWithOrigin(value=curve.lag.value, origin="assumed: not clear in the flight")
    return _value_of_estimate(curve.lag)


def _yaw_numbers(
    layout: RotorLayout,
    effect: Effectiveness | None,
    thrust: float,
    values: dict[str, ValueWithOrigin],
    notes: list[str],
) -> tuple[ValueWithOrigin, ValueWithOrigin]:
    """Return drag torque per thrust [m] and inertia about z; one of them fixes the other by the effectiveness about yaw."""
    x, y = values["inertia_x"].value, values["inertia_y"].value
    flat = ValueWithOrigin(value=x + y, origin="assumed: flat body, x + y")
    logged = ValueWithOrigin(value=layout.torque_ratio or 0.015, origin="logged: CA_ROTOR0_KM")
    if effect is None or effect.sizes[2].low <= 0.0:
        return logged if layout.torque_ratio else replace(logged, origin="assumed: typical"), flat
    size = effect.sizes[2]
    if layout.torque_ratio is not None:
        inertia = _positive_ratio(layout.torque_ratio * thrust, size, "by the logged torque ratio").weaken(
            values, "mass"
        )
        if abs(x - y) < inertia.value < x + y:
            return logged, inertia
        notes.append(
            f"By CA_ROTOR0_KM = {layout.torque_ratio:g} the inertia about z would be {inertia.value:.3g} kg m², which no body "
            f"with {x:.3g} and {y:.3g} has; it is not used."
        )
    return ValueWithOrigin(
        value=size.value * flat.value / thrust, origin="assumed: as the inertia about z is; by yaw acceleration"
    ), flat


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


def _largest_thrust(
    thrust: ValueWithOrigin, curve: CommandCurve | None, has_speeds: bool, logs: Sequence[FlightLog]
) -> ValueWithOrigin:
    """Return the thrust at full command, or at the largest speed in flight if no command curve is known."""
    series = [log.rotor_speed if has_speeds else log.rotor_command for log in logs]
    largest = max(float(values.max()) for values in series if values is not None)
    origin = f"{thrust.origin};" if thrust.is_assumed else "measured here:"
    if curve is not None:
        full = (curve.offset.value + curve.gain.value) ** 2
        return ValueWithOrigin(value=thrust.value * full, origin=f"{origin} at full command, by the command curve")
    if has_speeds:
        return ValueWithOrigin(value=thrust.value * largest**2, origin=f"{origin} at the largest speed in flight")
    reached = f"at full command; the flights reach {largest:.2g}"
    return ValueWithOrigin(value=thrust.value * max(largest, 1.0), origin=f"assumed: {reached}")


def _mapping_text(
    draft: VehicleDraft, layout: RotorLayout, logs: Sequence[FlightLog], mapping: LogMapping | None
) -> str:
    """Return a mapping that turns logged commands into speeds [rad/s], or into thrusts [N] without measured speeds.

    A thrust curve ``f u² + (1 - f) u`` becomes the power law with the same thrust and slope at the mean command. Text files
    keep the rest of their mapping. Empty without commands, or if a mapping converts them already.
    """
    curve, commands = draft.curve, [log.rotor_command for log in logs if log.rotor_command is not None]
    is_text = find_reader(Path(split_flight_number(logs[0].path)[0])) is None
    base = (mapping or find_mapping("aerial_gym")) if is_text else mapping
    own = ColumnsCfg(columns=("rotor_command",)) if base is None else base.rotor_command
    if own is None or not commands or own != ColumnsCfg(columns=own.columns, fill_gap_s=own.fill_gap_s):
        return ""
    if curve is not None:
        power, offset = curve.power.value, curve.offset.value
        law = replace(own, gain=curve.gain.value / curve.full**power, power=power, offset=offset)
    elif draft.force_mode:
        f, u = layout.thrust_curve, float(np.mean([command.mean() for command in commands]))
        power = 1.0 + f * u / (f * u + 1.0 - f)
        law = replace(own, gain=draft.values["thrust"].value * (f * u**2 + (1.0 - f) * u) / u**power, power=power)
    else:
        return ""
    source = "aerial-gym robot from-log"
    if base is None:
        base = LogMapping(summary="commands of this vehicle", time=ColumnsCfg(columns=("t",)), source=source)
    return dump_yaml(replace(base, rotor_command=law, source=source))


def robot_text(draft: VehicleDraft, *, name: str) -> str:
    """Return the robot file, with the origin of each number beside it."""
    v = draft.values

    def line(key: str, number: str, source: ValueWithOrigin) -> str:
        return f"  {key}: {number}  # {source.origin}"

    moments = [v[f"inertia_{axis}"] for axis in "xyz"]
    rows = np.diag([moment.value for moment in moments])
    inertia = [
        f"  - [{', '.join(f'{number:.12g}' for number in row)}]  # {moment.origin}"
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
    source = json.dumps(f"aerial-gym robot from-log {name}")
    return "\n".join((
        f"summary: {json.dumps(f'vehicle of {name}')}", "body:",
        line("mass", f"{v['mass'].value:g}", v["mass"]), "  inertia:", *inertia,
        f"  source: {source}", "rotor:", *rotor, line("torque_ratio", f"{v['torque_ratio'].value:.4g}", v["torque_ratio"]),
        *(line(f"time_constant_{way}", f"{v['lag'].value:.4g}", v["lag"]) for way in ("up", "down")),
        line("thrust_range", f"[0.0, {v['largest_thrust'].value:.5g}]", v["largest_thrust"]), f"  source: {source}",
        f"mounts:  # {draft.layout_origin}{arm}", "  layout:", *mounts, f"  source: {source}",
        "collision:", f"  spheres: [{{center: [0.0, 0.0, 0.0], radius: {1.2 * reach:.4g}}}]  # assumed: 1.2 times the arm",
        f"  source: {source}", "",
    ))  # fmt: skip
