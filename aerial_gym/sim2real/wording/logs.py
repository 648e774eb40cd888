"""Sentences of notes on logs; the subject of a note names its flights."""

from collections.abc import Sequence

from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.wording.words import Template, join_words, number_text, percent_text, value_text


def _place_list(items: Sequence[object], count: int, word: str = "line") -> str:
    """Return ``word`` with the first of ``count`` places, and the number of further ones."""
    more = count - len(items)
    return f"{word} {', '.join(map(str, items))}" + (f" and {more} more" if more > 0 else "")


def _rows_left_out_sentence(finding: Finding, reason: str, word: str = "line", places: Sequence[object] = ()) -> str:
    values = finding.values
    where = _place_list(places or values["lines"], int(values["rows"]), word)
    return f"{values['rows']} of {values['total']} rows are left out: {reason} ({where})."


def _samples_left_out_sentence(finding: Finding) -> str:
    values = finding.values
    where = _place_list(values["places"], int(values["samples"]), "sample")
    return (
        f"{values['samples']} of {values['total']} samples of topic {values['topic']} are left out: their time stamps do not "
        f"fit the others ({where})."
    )


def _clock_sentence(start: str, finding: Finding) -> str:
    values = finding.values
    place = f"line {values['line']}" if "line" in values else f"sample {values['sample']} of {values['topic']}"
    jump = f"from {values['before_s']:.6g} to {values['after_s']:.6g} s"
    doubt = " The clock may have restarted, and the time between both rows is then unknown."
    shift = f"Later stamps are shifted by {values['shift_s']:+.6g} s."
    return f"{start} at {place}, {jump}. {shift}{doubt * values.get('may_be_restart', False)}"


def _late_blocks_sentence(finding: Finding) -> str:
    values = finding.values
    start = f"Topic {values['topic']}: " if values["topic"] else ""
    where = _place_list(values["places"], values["blocks"], "sample" if values["topic"] else "line")
    return f"{start}{values['blocks']} blocks of rows were written late and are put in order of time, from {where}."


def _sentence_on_other_log(finding: Finding) -> str:
    values = finding.values
    clock = f", whose times are shifted by {values['clock_s']:+g} s" if values["clock_s"] else ""
    away = f", {values['nearest_m']:.2f} to {values['farthest_m']:.2f} m away" if "nearest_m" in values else ""
    share = percent_text(values["share"])
    return f"The other vehicle of this flight is in {values['file']}{clock}: in {share} of the rows{away}."


def _vector_text(values: Sequence[float], half_widths: Sequence[float | None]) -> str:
    """Return the values with their half widths; ``not shown`` for an axis without half width."""
    pairs = zip(values, half_widths, strict=True)
    return ", ".join(
        "not shown" if half is None else f"{value_text(value, half)} ± {value_text(half, half)}"
        for value, half in pairs
    )


def _sensor_bias_sentence(finding: Finding) -> str:
    values = finding.values
    key, unit = ("rad_s", "rad/s") if "bias_rad_s" in values else ("m_s2", "m/s²")
    size = _vector_text(values[f"bias_{key}"], values[f"half_width_{key}"])
    return f"The {values['sensor']} has a bias of ({size}) {unit} by kinematics, which is left as logged."


def _sensor_misalignment_sentence(finding: Finding) -> str:
    size = _vector_text(finding.values["angle_deg"], finding.values["half_width_deg"])
    sensor = finding.values["sensor"]
    return f"The {sensor} is turned against the body by ({size})° by kinematics, which is left as logged."


def _sensor_delay_sentence(finding: Finding) -> str:
    values, late = finding.values, float(finding.values["late_ms"])
    other = "attitude" if values["sensor"] == "gyro" else "velocity"
    amount = f"{abs(late):.1f} ± {values['half_width_ms']:.1f} ms {'late' if late > 0.0 else 'early'}"
    return f"The {values['sensor']} is {amount} against {other}; it is left as logged."


def _velocity_factor_sentence(finding: Finding) -> str:
    values = finding.values
    rows = zip(values["axes"], values["factor"], values["low"], values["high"], strict=True)
    parts = [f"{axis} {factor:.3f} ({low:.3f} to {high:.3f})" for axis, factor, low, high in rows]
    return f"Velocity over the derivative of position is {join_words(parts)}; it is left as logged."


def _position_jump_sentence(finding: Finding) -> str:
    values = finding.values
    pairs = zip(values["size_m"], values["half_width_m"], strict=True)
    size = ", ".join(f"{value:+.3g} ± {half:.1g}" for value, half in pairs)
    start, end = values["start_s"], values["end_s"]
    when = f"at {start:.3f} s" if start == end else f"from {start:.3f} to {end:.3f} s"
    back = " Later positions are moved back." if values["moved_back"] else ""
    return f"The position jumps by ({size}) m {when}, against the velocity.{back}"


def _stream_delay_text(finding: Finding) -> str:
    values, late = finding.values, float(finding.values["late_ms"])
    delay = f"{value_text(abs(late), values['half_width_ms'])} ± {value_text(values['half_width_ms'], values['half_width_ms'])}"
    return f"Stream {values['topic']} is {delay} ms {'late' if late > 0.0 else 'early'} against the inertial sensors"


def _slow_rotors_sentence(finding: Finding) -> str:
    values = finding.values
    start = f"{values['quantity']} comes at {number_text(values['rate_hz'])} Hz"
    if values["torques"]:
        return f"{start}: the lag cannot be judged, and the measured rotor speeds alone drive the model."
    return f"{start}: lag, torques and order of the rotors cannot be judged, and rollouts take the logged attitude."


def _reset_sentence(finding: Finding) -> str:
    values = finding.values
    size = f"{values['angle_deg']:.3g} deg" if "angle_deg" in values else f"{values['distance_m']:.3g} m"
    effect = "earlier samples are turned" if "angle_deg" in values else "later samples are moved"
    return f"The estimator reset the {values['quantity']} by {size} at {values['time_s']:.3f} s; {effect} accordingly."


LOGS: dict[str, Template] = {
    "spins_reversed": (
        "The yaw reaction to {columns} has the opposite sign: {gain_ratio:number} ± {half_width_ratio:number} of the declared. "
        "All spins are reversed, or the sign of yaw: correct the mounts or the log."
    ),
    "flight_left_out": "Left out: {error}.",
    "log_simulated": lambda f: (
        f"The log is of a simulation, not of a vehicle in the air: {join_words(f.values['evidence'])}."
    ),
    "sensor_at_rest": (
        "The {sensor} does not follow the motion that {other} shows: its gain is {gain:number4} ± {half_width:number} "
        "instead of 1. It measures another body, or its topic repeats old values."
    ),
    "sensor_gain": (
        "{column} reads {gain_ratio:number4} ± {half_width_ratio:number} of the motion that {other} shows. Effects are known "
        "no better: calibrate the sensor, or check unit and clock of {other}."
    ),
    "vertical_force_off": (
        "The mean vertical specific force, less the change of velocity, is {mean_m_s2:number4} m/s². A sound accelerometer "
        "reads 9.81 ± {offset_m_s2:number} m/s²: its scale, its axes or the attitude are wrong."
    ),
    "topic_left_out": "Topic left out: {error}.",
    "quantities_absent": "Not in the log: {quantities:and}.",
    "topic_covers_part": "Topic {topic} is left out: it covers {covered_s:number} s of {log_s:number} s.",
    "stream_too_late": lambda f: f"{_stream_delay_text(f)}, more than is corrected, and is left out.",
    "stream_moved": lambda f: f"{_stream_delay_text(f)}; it is moved.",
    "reset_undone": _reset_sentence,
    "rotors_too_slow": _slow_rotors_sentence,
    "flight_state_unknown": "Arming and landing show no flight: the whole log counts as one.",
    "rotor_order_of_firmware": "Rotors are in the order of {firmware}; the robot file must list them in the same order.",
    "rotor_unit_assumed": (
        "Topic {topic} states no unit of its rotor speeds; they count as {unit}. If this is wrong, map its columns (--mapping)."
    ),
    "rotor_speeds_not_shared": (
        "Measured rotor speeds are left out, and commands drive the rotors of all flights, because some logs have no speeds: "
        "{without:names}. Leave out these logs to use the speeds."
    ),
    "commands_mixed": "Rotor commands are computed from torque and thrust commands by the mixer of an X frame.",
    "relative_commands_scaled": lambda f: (
        f"Commands are shares of the largest speed. A full command counts as {f.values['full']:.4g} {f.values['unit']}, by "
        f"{'measured rotor speeds' if f.values['by_speeds'] else 'the mean measured thrust'}."
    ),
    "battery_left_out": "The battery voltage is left out: {error}.",
    "file_damaged": "The file is damaged; pyulog left out the parts that it could not read.",
    "bytes_left_out": "{bytes} of {total} bytes of the log are damaged and left out.",
    "checksum_wrong": "The checksum of the log does not fit its content: some values may be damaged.",
    "frames_damaged": "{damaged} frames of the log are damaged; with them, {lost} of {total} rows are lost.",
    "position_jumps_left": (
        "The position jumps more than {most} times against the velocity (position_jump); it is left as logged."
    ),
    "sensor_bias": _sensor_bias_sentence,
    "sensor_turned": _sensor_misalignment_sentence,
    "sensor_late": _sensor_delay_sentence,
    "velocity_factor": _velocity_factor_sentence,
    "sensor_dropout": "{sensor} repeats one value from {time_s:.3f} s on.",
    "row_without_state": "It has no attitude or no angular velocity.",
    "row_with_bad_stamp": "t = {stamp_s:g} s does not fit the rows around it.",
    "rows_with_bad_stamps": lambda f: _rows_left_out_sentence(f, "their time stamps do not fit the rows around them"),
    "rows_not_of_header": lambda f: _rows_left_out_sentence(
        f, f"they do not have the {f.values['fields']} fields of the header"
    ),
    "rows_without_numbers": lambda f: _rows_left_out_sentence(
        f, f"a field is no number of a flight, such as {f.values['column']} = {f.values['field']}"
    ),
    "rows_without_quaternion": lambda f: _rows_left_out_sentence(
        f, "their quaternion does not have norm 1", "t [s] =", [f"{time:.6g}" for time in f.values["times_s"]]
    ),
    "samples_with_bad_stamps": _samples_left_out_sentence,
    "blocks_ordered": _late_blocks_sentence,
    "clock_set_back": lambda f: _clock_sentence("The clock was set back", f),
    "clock_wrapped": lambda f: _clock_sentence(f"The counter of the clock ({f.values['counter']}) wrapped", f),
    "rows_copied": "{rows} rows are left out: they copy an earlier one, time included.",
    "fields_filled": lambda f: (
        f"{f.values['fields']} empty fields of {f.values['first']} to {f.values['last']} are filled "
        f"{'by the value before' if f.values['held'] else 'by straight lines'}."
    ),
    "battery_without_voltage": "The battery voltage is left out: it is not above 0 V in any row.",
    "battery_filled": ("The battery voltage is not above 0 V in {rows} of {total} rows; straight lines fill them."),
    "mapping_note": "{text}",
    "attitude_level": "The attitude is not logged and is taken as level.",
    "attitude_integrated": "The attitude is not logged: it is integrated from the gyro, and only body axes are compared.",
    "flown_with": _sentence_on_other_log,
    "relative_position_unknown": (
        "The position relative to the vehicle in {file} is unknown: its frame is local, without a geodetic origin. No downwash "
        "is named. Give both logs as CSV files in one world frame."
    ),
    "other_vehicle": "The position of the other vehicle is from {file}.",
    "wind_not_declared": "The mapping declares no wind for a file of this name; still air is assumed.",
    "wind_declared": "The declared wind is ({wind_m_s[0]:g}, {wind_m_s[1]:g}, {wind_m_s[2]:g}) m/s, world axes.",
    "rows_cut": "{rows} rows at an end, beyond a gap of {gap_s:number} s, are cut off.",
    "rows_lost": "{share:percent} of the rows are lost, up to {longest_s:number} s at a time; rows in gaps are not compared.",
    "steps_resampled": (
        "Unequal time steps ({shortest_s:number} to {longest_s:number} s) are resampled to {step_s:number} s."
    ),
    "velocity_derived": "Velocity is derived from position.",
    "velocity_unknown": "Neither velocity nor position is logged: drag is predicted as if the vehicle stood still.",
    "force_derived": "Specific force is derived from velocity.",
    "rates_derived": "Angular velocity is derived from attitude; angular acceleration is not compared.",
    "one_command": "All rotors have one command: angular acceleration is not compared, rollouts take the logged attitude.",
    "torques_not_logged": (
        "These logs show no torques: angular acceleration is not compared, rollouts take the logged attitude."
    ),
    "on_ground": "In {share:percent} of the rows it stands, is carried or thrown; they are not compared.",
    "commands_copied": "The commands are left out: they equal the measured rotor speeds, so that they show no lag.",
    "commands_scaled": "Commands are scaled by {factor:.4f} to the thrust measured above {height_m:g} m.",
    "rotor_log_moved": lambda f: (
        f"The rotor log leads the other sensors by {f.values['lead_ms']:.3g} ± {f.values['half_width_ms']:.2g} ms and is moved "
        f"back{'' if f.values['with_commands'] else '; commands stay'}."
    ),
    "position_jump": _position_jump_sentence,
    "samples_slow": (
        "{sensor} comes only {rate_hz:number} times per second (the log has {log_rate_hz:number4} rows); "
        "straight lines connect its values."
    ),
    "samples_repeated": (
        "{sensor} repeats its value in {share:percent} of the rows, at most {longest_rows} in a row; straight lines connect "
        "measured values."
    ),
}
"""Templates of notes on logs, by code."""
