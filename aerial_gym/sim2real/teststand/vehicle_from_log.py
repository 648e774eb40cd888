"""A robot file from flight logs: what the log states, what its flights show, and what only a person knows.

Only ratios follow from a flight: thrust needs the mass, inertia the length of the arms, drag torque the inertia about yaw. A
number that stands on an assumed one is assumed itself. Letters: T rows, R rotors.
"""

from collections.abc import Sequence
from dataclasses import replace
from math import inf, sqrt
from pathlib import Path

import numpy as np

from aerial_gym.config.sim import STANDARD_GRAVITY
from aerial_gym.errors import ConfigError, DataError
from aerial_gym.robots.drafts.draft import ValueWithOrigin, arm_by_mass, inertia_by_reach
from aerial_gym.robots.drafts.frames import FRAMES
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.logs.checks.rotors import interval_of_thrust_slope
from aerial_gym.sim2real.logs.flights import complete_flight
from aerial_gym.sim2real.logs.readers.flight_log import read_flights
from aerial_gym.sim2real.logs.readers.mapping import LogMapping
from aerial_gym.sim2real.logs.recording import FlightLog
from aerial_gym.sim2real.statistics import Estimate
from aerial_gym.sim2real.teststand.command_curve import CommandCurve, fit_command_curve, fit_thrust_power
from aerial_gym.sim2real.teststand.effectiveness import (
    Effectiveness,
    FlightRows,
    ForcePerInput,
    fit_effectiveness,
    mean_force_per_input,
    rows_of_flight,
    rows_under_power,
)
from aerial_gym.sim2real.teststand.log_geometry import RotorLayout, ThrustLaw, layout_in_log
from aerial_gym.sim2real.teststand.vehicle_draft import LogDraft, command_mapping_yaml, mean_command

FEWEST_S = 3.0  # Least time in the air [s]
LARGEST_FORCE = 100.0  # Larger commands of a CSV file are speeds [rad/s]; smaller ones are thrusts [N] or shares
WIDEST = 0.15  # Largest half width of the interval of a measured number, relative to it; a wider one is an assumption
UNEVEN = (
    0.2  # Difference of both spins' shares of the thrust that no usual asymmetry gives; motors differ by some per cent
)
VARIED = 1.3  # Ratio of thrusts per command in parts of the flights that no single vehicle shows
FASTEST_FALL = 10.0  # Change of the vertical velocity over a flight [m/s] that its mean specific force may contain


def draft_vehicle(
    paths: Sequence[str | Path], *, mass: float | None = None, arm: float | None = None, frame: str | None = None,
    mapping: LogMapping | None = None,
) -> LogDraft:  # fmt: skip
    """Return the numbers of a robot file from logs of one vehicle; ``frame``: name or robot file of its rotors."""
    for name, value in (("mass", mass), ("arm", arm)):
        if value is not None and not 0.0 < value < inf:
            raise ConfigError(f"{name} = {value!r}: must be > 0 and finite")
    logs = [_complete_log(log) for log in read_flights(paths, mapping=mapping)]
    layout = _common_layout(logs, frame)
    has_speeds, fast = all(log.rotor_speed is not None for log in logs), all(log.torques for log in logs)
    power = None if has_speeds or not fast else fit_thrust_power(logs)
    if power is not None and _has_narrow_interval_above_zero(power[0]):
        low, high = power[0].low, power[0].high
        origin = f"measured here [{low:.3g}, {high:.3g}]"
        layout = replace(layout, law=ThrustLaw(power=power[0].value, origin=origin))
    if not has_speeds and not fast:
        layout = replace(layout, law=_law_of_slow_commands(logs, layout.law))

    def thrust_input(log: FlightLog) -> Array:
        if has_speeds and log.rotor_speed is not None:
            return log.rotor_speed**2
        if log.rotor_command is None:
            raise DataError(f"{log.path}: holds neither rotor speeds nor commands; log one of them")
        return layout.law.share(log.rotor_command)

    flights = [rows_of_flight(log, thrust_input) for log in logs]
    for log, rows in zip(logs, flights, strict=True):
        _check_mean_force_in_flight(log, rows)
    flights = flights_in_air(logs[0].path, flights)
    effect = _fit_to_layout(flights, layout) if fast else None
    curve = fit_command_curve(logs) if has_speeds and fast else None
    lag = curve.lag if curve is not None else power[1] if power is not None else None
    draft = _assemble_draft(layout, effect, curve, lag, mean_force_per_input(flights), has_speeds, mass, arm, logs)
    notes = (*draft.notes, *_notes_on_yaw_balance(flights, draft.spins))
    return replace(draft, notes=notes, mapping=command_mapping_yaml(draft, logs, mapping))


def _notes_on_yaw_balance(flights: Sequence[FlightRows], spins: Sequence[int]) -> list[str]:
    """Return a note if the mean inputs of equal rotors would turn the vehicle, which does not turn in the mean."""
    mean = np.concatenate([flight.inputs[flight.flies] for flight in flights]).mean(axis=0)
    left, right = (float(mean[np.array(spins) == spin].sum()) for spin in (1, -1))
    if abs(left - right) <= UNEVEN * (left + right):
        return []
    return [
        f"In the mean, rotors of spin 1 give {left / (left + right):.0%} of the thrust and those of spin -1 the rest, by their "
        "inputs. Equal upright rotors would turn the vehicle: check the spins, a tilt of the motors, and the command curve."
    ]


def _law_of_slow_commands(logs: Sequence[FlightLog], law: ThrustLaw) -> ThrustLaw:
    """Return the law of the log, or a power law if all flights show other slopes of the force, which it then has."""
    slopes = [(0.0, inf)]
    for log in logs:
        if log.rotor_command is not None and log.specific_force is not None:
            thrust = law.share(log.rotor_command)
            slopes.append(interval_of_thrust_slope(log, thrust.sum(axis=1), ~rows_under_power(thrust)))
    low, high = max(one for one, _ in slopes), min(one for _, one in slopes)
    if low <= 1.0 <= high or low > high:
        return law
    stated = law.slope(mean_command(logs))
    slope = Estimate(value=stated * sqrt(low * high), low=stated * low, high=stated * high)
    return ThrustLaw(power=slope.value, origin=_value_of_estimate(slope).origin)


def _fit_to_layout(flights: Sequence[FlightRows], layout: RotorLayout) -> Effectiveness:
    """Return the effectiveness by the stated rotors; of assumed ones only if the flights do not show all by themselves."""
    own = fit_effectiveness(flights, None) if layout.origin == "assumed" else None
    return own if own is not None and own.known.all() else fit_effectiveness(flights, layout.weights)


def _complete_log(log: FlightLog) -> FlightLog:
    """Return the log with the force by its velocity, and with commands above ``LARGEST_FORCE`` as speeds, if not measured."""
    if log.specific_force is None and log.lin_vel is not None:
        log = replace(log, specific_force=complete_flight(log).specific_force)
    command = log.rotor_command
    if command is None or log.rotor_speed is not None or command.max() <= LARGEST_FORCE:
        return log
    return replace(log, rotor_speed=command, rotor_command=None)


def flights_in_air(path: str, flights: Sequence[FlightRows]) -> list[FlightRows]:
    """Return the flights with time in the air; raise ``DataError`` if all together have less than ``FEWEST_S``."""
    seconds = sum(rows.seconds for rows in flights)
    if seconds < FEWEST_S:
        raise DataError(
            f"{path}: {seconds:.1f} s with all rotors turning; {FEWEST_S:g} s are needed. "
            "If the body was thrown by hand, take aerial-gym identify inertia"
        )
    return [rows for rows in flights if rows.seconds > 0.0]


def _check_mean_force_in_flight(log: FlightLog, rows: FlightRows) -> None:
    """Raise ``DataError`` if the accelerometer shows less than a vehicle in the air for this time can have."""
    least = 0.9 * STANDARD_GRAVITY - FASTEST_FALL / max(rows.seconds, 1e-3)
    if rows.force < least:
        raise DataError(
            f"{log.path}: its accelerometer shows {rows.force:.1f} m/s² in the mean of {rows.seconds:.0f} s in the air, and a "
            "vehicle that flies shows 9.8; give a log of a real flight"
        )


def _common_layout(logs: Sequence[FlightLog], frame: str | None) -> RotorLayout:
    """Return the rotors that all logs state; raise ``DataError`` if they state different ones."""
    layouts = [layout_in_log(log.path, log.num_rotors, frame) for log in logs]
    for log, layout in zip(logs, layouts, strict=True):
        if not layout.may_be_of_same_vehicle(layouts[0]):
            raise DataError(
                f"{logs[0].path} and {log.path} state different rotors ({layouts[0].count} by {layouts[0].source}, "
                f"{layout.count} by {layout.source}); give logs of one vehicle"
            )
    return layouts[0]


def _has_narrow_interval_above_zero(estimate: Estimate) -> bool:
    """Return whether an interval excludes 0 and is not wider than ``WIDEST``."""
    return estimate.low > 0.0 and estimate.high - estimate.low <= 2.0 * WIDEST * abs(estimate.value)


def _value_of_estimate(estimate: Estimate, basis: str = "") -> ValueWithOrigin:
    if not 0.0 < estimate.low <= estimate.high < inf:
        return ValueWithOrigin(value=estimate.value, origin="assumed: the flight does not show it")
    how = "measured here" if _has_narrow_interval_above_zero(estimate) else "assumed: the flight shows only"
    return ValueWithOrigin(value=estimate.value, origin=f"{how} [{estimate.low:.3g}, {estimate.high:.3g}]{basis}")


def scale_estimate(estimate: Estimate, factor: float) -> Estimate:
    """Return an estimate times a factor > 0."""
    return Estimate(value=factor * estimate.value, low=factor * estimate.low, high=factor * estimate.high)


def quotient_by_estimate(estimate: Estimate, numerator: float) -> Estimate:
    """Return a numerator over an estimate, whose interval may reach 0."""
    low, high = (numerator / max(end, 1e-300) for end in (estimate.high, estimate.low))
    return Estimate(
        value=numerator / max(abs(estimate.value), 1e-300), low=low if estimate.low > 0.0 else 0.0, high=high
    )


def _assemble_draft(
    layout: RotorLayout, effect: Effectiveness | None, curve: CommandCurve | None, lag: Estimate | None, lift: ForcePerInput,
    has_speeds: bool, mass: float | None, arm: float | None, logs: Sequence[FlightLog],
) -> LogDraft:  # fmt: skip
    """Return the draft; ``lift``: specific force of one rotor per unit of input in the mean of the flights."""
    questions, values = list[str](), dict[str, ValueWithOrigin]()
    if mass is None:
        questions.append("How heavy is the vehicle, battery included? Weigh it and give --mass-kg")
    kilograms = 1.0 if mass is None else mass
    how = "assumed: not in the log" if mass is None else "given: --mass-kg"
    values["mass"] = ValueWithOrigin(value=kilograms, origin=how)
    places, spins, layout_origin, notes = _places_and_spins_of_rotors(layout, effect)
    notes = [*layout.notes, *notes]
    if layout_origin.startswith("assumed"):
        frames = ", ".join(name for name, rotors in FRAMES.items() if len(rotors.split()) == layout.count)
        questions.append(f"Which rotor is where, and how does it turn? Give --frame: {frames}, or a robot file")
    if not layout.has_lengths:
        if arm is None:
            questions.append("How far is a rotor's axis from the centre? Measure it and give --arm-m")
        given = arm_by_mass(kilograms) if arm is None else ValueWithOrigin(value=arm, origin="given: --arm-m")
        places = places * given.value / np.linalg.norm(places[:, :2], axis=1).max()
        values["arm"] = given
    elif arm is not None:
        notes.append(f"--arm-m {arm:g} is not used: the places of the rotors are known ({layout.source}).")
    law, mean = layout.law, 1.0 if has_speeds else mean_command(logs)
    unit = kilograms * (1.0 if has_speeds else float(law.share(np.array(mean))))
    thrust = _value_of_estimate(scale_estimate(lift.mean, unit), ": by the mass").weaken(values, "mass")
    if lift.highest > VARIED * lift.lowest:
        a, b = unit * lift.lowest, unit * lift.highest
        thrust = replace(thrust, origin=f"assumed: it varies from {a:.3g} to {b:.3g} in the flights")
        questions.append(
            "What changed the thrust per command in flight: a load, a propeller, the battery? Give flights without it"
        )
    values["thrust" if has_speeds else "hover_thrust"] = thrust
    if not has_speeds:
        exponent = f"{law.origin}; at the mean command {mean:.2f}"
        values["thrust_exponent"] = ValueWithOrigin(value=law.slope(mean), origin=exponent)
        thrust = replace(thrust, value=kilograms * lift.mean.value)  # of a full share
    axes = np.tile((0.0, 0.0, 1.0), (layout.count, 1)) if layout.axes is None else layout.axes
    arms = np.abs(np.cross(places, axes)).max(axis=0)
    for axis, (name, reach) in enumerate(zip(("inertia_x", "inertia_y"), arms[:2], strict=True)):
        if effect is not None and effect.known[axis]:
            moment = quotient_by_estimate(effect.sizes[axis], float(reach) * thrust.value)
            value = _value_of_estimate(moment, ": by arm, mass and effectiveness")
            value = value.weaken(values, "mass", "arm", "thrust", "hover_thrust")
            if not layout.has_lengths and not value.is_assumed:
                value = replace(
                    value, origin=f"assumed: if the frame is as wide as long, [{moment.low:.3g}, {moment.high:.3g}]"
                )
            values[name] = value
        else:
            guess = inertia_by_reach(kilograms, float(reach))
            why = "the log is too slow for torques" if effect is None else "the flight does not show it"
            values[name] = replace(guess, origin=f"{guess.origin}; {why}")
    for name in ("inertia_x", "inertia_y"):  # short numbers, whose sum stays exact in the file
        values[name] = replace(values[name], value=float(f"{values[name].value:.5g}"))
    values["torque_ratio"], values["inertia_z"] = _torque_ratio_and_yaw_inertia(
        layout, effect, thrust.value, values, notes
    )
    slow = ValueWithOrigin(value=0.05, origin="assumed: speeds or commands are not logged fast enough")
    values["lag"] = slow if lag is None else _value_of_estimate(lag)
    values["largest_thrust"] = _largest_thrust(thrust, curve, layout.law, has_speeds, logs)
    for name, size in zip(("roll", "pitch", "yaw"), () if effect is None else effect.sizes[:3], strict=False):
        if size.low > 0.0:
            values[name] = _value_of_estimate(size)
    if curve is not None:
        for name in ("offset", "gain", "power"):
            values[f"speed_{name}"] = _value_of_estimate(getattr(curve, name), f", up to {curve.reached:.0f} rad/s")
        if not _reaches_full_thrust(curve.reached**2, curve.full_speed**2):
            origin = f"assumed: the flights reach {curve.reached:.0f} of {curve.full_speed:.0f} rad/s"
            values["speed_gain"] = ValueWithOrigin(value=curve.gain.value, origin=origin)
    return LogDraft(
        values=values, places=places, axes=layout.axes, spins=spins, layout_origin=layout_origin, curve=curve,
        effectiveness=effect, questions=tuple(questions), notes=tuple(notes), force_mode=not has_speeds,
    )  # fmt: skip


def _torque_ratio_and_yaw_inertia(
    layout: RotorLayout, effect: Effectiveness | None, thrust: float, values: dict[str, ValueWithOrigin],
    notes: list[str],
) -> tuple[ValueWithOrigin, ValueWithOrigin]:  # fmt: skip
    """Return drag torque per thrust [m] and inertia about z; one of them fixes the other by the effectiveness about yaw."""
    x, y = values["inertia_x"].value, values["inertia_y"].value
    flat = ValueWithOrigin(value=x + y, origin="assumed: flat body, x + y")
    logged = ValueWithOrigin(value=layout.torque_ratio or 0.015, origin="logged: CA_ROTOR0_KM")
    if effect is None or not effect.known[2]:
        return logged if layout.torque_ratio else replace(logged, origin="assumed: typical"), flat
    size = effect.sizes[2]
    if layout.torque_ratio is not None:
        inertia = _value_of_estimate(
            quotient_by_estimate(size, layout.torque_ratio * thrust), ": by the logged torque ratio"
        )
        if abs(x - y) < inertia.value < x + y:
            return logged, inertia.weaken(values, "mass")
        notes.append(
            f"By CA_ROTOR0_KM = {layout.torque_ratio:g} the inertia about z would be {inertia.value:.3g} kg m², which no body "
            f"with {x:.3g} and {y:.3g} has; it is not used."
        )
    origin = "assumed: as the inertia about z is; by yaw acceleration"
    return ValueWithOrigin(value=size.value * flat.value / thrust, origin=origin), flat


def _places_and_spins_of_rotors(
    layout: RotorLayout, effect: Effectiveness | None
) -> tuple[Array, tuple[int, ...], str, list[str]]:
    """Return places and spins of the rotors: those of the flight where it shows them, else those of the log."""
    shown = effect if effect is not None and effect.known.all() else None
    if layout.places is not None and layout.spins is not None and (shown is None or not shown.measured.any()):
        result = "these flights cannot check it" if shown is None else "the flight agrees"
        return layout.places, layout.spins, f"{layout.origin}: {layout.source}; {result}", []
    if shown is None:
        raise DataError(
            f"neither log nor flight shows where the {layout.count} rotors are; give --frame with the name of a frame or a "
            f"robot file, or a flight that turns about all axes. Frames: {', '.join(FRAMES)}"
        )
    places, spins = _places_of_weights(shown.weights), tuple(int(-sign) for sign in np.sign(shown.weights[2]))
    origin, notes = "measured here: roll, pitch and yaw of each rotor", list[str]()
    if layout.places is None or layout.spins is None:
        return places, spins, origin, notes
    moved, size = bool(shown.measured[:2].any()), np.abs(layout.places[:, :2]).mean(axis=0)
    parts = [name for name, differs in (("order of rotors", moved), ("spins", layout.spins != spins)) if differs]
    if layout.origin != "assumed" and parts:
        notes.append(
            f"The flight contradicts the {' and the '.join(parts)} of {layout.source}; the file has those of the flight."
        )
    if not moved:
        return layout.places, spins, origin, notes
    return np.sign(places) * (*size, 1.0) if layout.has_lengths else places, spins, origin, notes


def _places_of_weights(weights: Array) -> Array:
    """Return places on a circle that give weights about roll and pitch, (R, 3); the circle gives the scale of each axis."""
    y, x = weights[0], -weights[1]
    scale = np.linalg.lstsq(np.stack((x * x, y * y), axis=1), np.ones(x.size), rcond=None)[0]
    scale = scale if (scale > 0.0).all() else np.ones(2)
    return np.stack((np.sqrt(scale[0]) * x, np.sqrt(scale[1]) * y, np.zeros_like(x)), axis=1)


def _largest_thrust(
    thrust: ValueWithOrigin, curve: CommandCurve | None, law: ThrustLaw, has_speeds: bool, logs: Sequence[FlightLog]
) -> ValueWithOrigin:
    """Return the thrust at full command, or at the largest speed in flight if no command curve is known.

    It is measured only if the flights reach it, and show its curve.
    """
    series = [log.rotor_speed if has_speeds else log.rotor_command for log in logs]
    largest = max(float(np.quantile(values, 0.999)) for values in series if values is not None)
    if has_speeds and curve is None:
        origin = "assumed: at the largest speed in flight; the motors may give more"
        return ValueWithOrigin(value=thrust.value * largest**2, origin=origin)
    if curve is not None:
        ends, reached, most = (
            f"{curve.reached:.0f} of {curve.full_speed:.0f} rad/s",
            curve.reached**2,
            curve.full_speed**2,
        )
    else:
        full = max(largest, 1.0)
        ends, reached, most = f"command {largest:.2g} of {full:.2g}", *law.share(np.array((largest, full))).tolist()
    shown = not thrust.is_assumed and (curve is not None or law.origin.startswith("measured"))
    how = "measured here" if shown and _reaches_full_thrust(reached, most) else "assumed"
    return ValueWithOrigin(value=thrust.value * most, origin=f"{how}: at full command; the flights reach {ends}")


def _reaches_full_thrust(reached: float, most: float) -> bool:
    """Return whether the largest input of the flights is the full one within ``WIDEST``."""
    return reached > (1.0 - WIDEST) * most
