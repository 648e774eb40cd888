"""Sentences of notes on logs; the subject of a note names its flights."""

from collections.abc import Sequence

from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.wording.words import join_words, number, percent, round_value


def _places(items: Sequence[object], count: int, word: str = "line") -> str:
    more = count - len(items)
    return f"{word} {', '.join(str(item) for item in items)}" + (f" and {more} more" if more > 0 else "")


def _rows(finding: Finding, reason: str) -> str:
    values = finding.values
    where = _places(values["lines"], int(values["rows"]))
    return f"{values['rows']} of {values['total']} rows are left out: {reason} ({where})."


def _bad_numbers(finding: Finding) -> str:
    return _rows(
        finding, f"a field is no number of a flight, such as {finding.values['column']} = {finding.values['field']}"
    )


def _bad_quaternions(finding: Finding) -> str:
    values = finding.values
    times = [f"{time:.6g}" for time in values["times_s"]]
    where = _places(times, int(values["rows"]), "t [s] =")
    return f"{values['rows']} of {values['total']} rows are left out: their quaternion does not have norm 1 ({where})."


def _bad_samples(finding: Finding) -> str:
    values = finding.values
    where = _places(values["places"], int(values["samples"]), "sample")
    return (
        f"{values['samples']} of {values['total']} samples of topic {values['topic']} are left out: their time stamps do not "
        f"fit the others ({where})."
    )


def _clock(start: str, finding: Finding) -> str:
    values = finding.values
    place = f"line {values['line']}" if "line" in values else f"sample {values['sample']} of {values['topic']}"
    jump = f"from {values['before_s']:.6g} to {values['after_s']:.6g} s"
    doubt = " The clock may have restarted, and the time between both rows is then unknown."
    shift = f"Later stamps are shifted by {values['shift_s']:+.6g} s."
    return f"{start} at {place}, {jump}. {shift}{doubt * values.get('may_be_restart', False)}"


def _late_blocks(finding: Finding) -> str:
    values = finding.values
    start = f"Topic {values['topic']}: " if values["topic"] else ""
    where = _places(values["places"], values["blocks"], "sample" if values["topic"] else "line")
    return f"{start}{values['blocks']} blocks of rows were written late and are put in order of time, from {where}."


def _vector(values: Sequence[float], half_widths: Sequence[float | None]) -> str:
    """Return the values with their half widths; ``not shown`` for an axis without half width."""
    pairs = zip(values, half_widths, strict=True)
    parts = (
        "not shown" if half is None else f"{round_value(value, half)} ± {round_value(half, half)}"
        for value, half in pairs
    )
    return ", ".join(parts)


def _bias(finding: Finding) -> str:
    values = finding.values
    key, unit = ("rad_s", "rad/s") if "bias_rad_s" in values else ("m_s2", "m/s²")
    size = _vector(values[f"bias_{key}"], values[f"half_width_{key}"])
    return f"The {values['sensor']} has a bias of ({size}) {unit} by kinematics, which is left as logged."


def _misalignment(finding: Finding) -> str:
    values = finding.values
    size = _vector(values["angle_deg"], values["half_width_deg"])
    return f"The {values['sensor']} is turned against the body by ({size})° by kinematics, which is left as logged."


def _late(finding: Finding) -> str:
    values = finding.values
    late = float(values["late_ms"])
    other = "attitude" if values["sensor"] == "gyro" else "velocity"
    amount = f"{abs(late):.1f} ± {values['half_width_ms']:.1f} ms"
    return (
        f"The {values['sensor']} is {amount} {'late' if late > 0.0 else 'early'} against {other}; it is left as logged."
    )


def _factor(finding: Finding) -> str:
    values = finding.values
    rows = zip(values["axes"], values["factor"], values["low"], values["high"], strict=True)
    parts = [f"{axis} {factor:.3f} ({low:.3f} to {high:.3f})" for axis, factor, low, high in rows]
    return f"Velocity over the derivative of position is {join_words(parts)}; it is left as logged."


def _jump(finding: Finding) -> str:
    values = finding.values
    pairs = zip(values["size_m"], values["half_width_m"], strict=True)
    size = ", ".join(f"{value:+.3g} ± {half:.1g}" for value, half in pairs)
    start, end = values["start_s"], values["end_s"]
    when = f"at {start:.3f} s" if start == end else f"from {start:.3f} to {end:.3f} s"
    back = " Later positions are moved back." if values["moved_back"] else ""
    return f"The position jumps by ({size}) m {when}, against the velocity.{back}"


def _lead(finding: Finding) -> str:
    values = finding.values
    stay = "" if values["with_commands"] else "; commands stay"
    lead = f"{values['lead_ms']:.3g} ± {values['half_width_ms']:.2g} ms"
    return f"The rotor log leads the other sensors by {lead} and is moved back{stay}."


LOGS = {
    "flight_left_out": lambda f: f"Left out: {f.values['error']}.",
    "topic_left_out": lambda f: f"Topic left out: {f.values['error']}.",
    "battery_left_out": lambda f: f"The battery voltage is left out: {f.values['error']}.",
    "file_damaged": "The file is damaged; pyulog left out the parts that it could not read.",
    "position_jumps_left": lambda f: (
        f"The position jumps more than {f.values['most']} times against the velocity (position_jump); it is left as logged."
    ),
    "sensor_bias": _bias,
    "sensor_turned": _misalignment,
    "sensor_late": _late,
    "velocity_factor": _factor,
    "sensor_dropout": lambda f: f"{f.values['sensor']} repeats one value from {f.values['time_s']:.3f} s on.",
    "row_without_state": "It has no attitude or no angular velocity.",
    "row_with_bad_stamp": lambda f: f"t = {f.values['stamp_s']:g} s does not fit the rows around it.",
    "rows_with_bad_stamps": lambda f: _rows(f, "their time stamps do not fit the rows around them"),
    "rows_not_of_header": lambda f: _rows(f, f"they do not have the {f.values['fields']} fields of the header"),
    "rows_without_numbers": _bad_numbers,
    "rows_without_quaternion": _bad_quaternions,
    "rows_without_topic": lambda f: (
        f"{f.values['rows']} of {f.values['total']} rows are left out: topic {f.values['topic']} has no samples near them."
    ),
    "samples_with_bad_stamps": _bad_samples,
    "blocks_ordered": _late_blocks,
    "clock_set_back": lambda f: _clock("The clock was set back", f),
    "clock_wrapped": lambda f: _clock(f"The counter of the clock ({f.values['counter']}) wrapped", f),
    "rows_copied": lambda f: f"{f.values['rows']} rows are left out: they copy an earlier one, time included.",
    "fields_filled": lambda f: (
        f"{f.values['fields']} empty fields of {f.values['first']} to {f.values['last']} are filled "
        f"{'by the value before' if f.values['held'] else 'by straight lines'}."
    ),
    "battery_without_voltage": "The battery voltage is left out: it is not above 0 V in any row.",
    "battery_filled": lambda f: (
        f"The battery voltage is not above 0 V in {f.values['rows']} of {f.values['total']} rows; straight lines fill them."
    ),
    "mapping_note": lambda f: str(f.values["text"]),
    "attitude_level": "The attitude is not logged and is taken as level.",
    "attitude_integrated": "The attitude is not logged: it is integrated from the gyro, and only body axes are compared.",
    "other_vehicle": lambda f: f"The position of the other vehicle is from {f.values['file']}.",
    "wind_not_declared": "The mapping declares no wind for a file of this name; still air is assumed.",
    "wind_declared": lambda f: (
        f"The declared wind is ({', '.join(f'{v:g}' for v in f.values['wind_m_s'])}) m/s, world axes."
    ),
    "rows_cut": lambda f: (
        f"{f.values['rows']} rows at an end, beyond a gap of {number(f.values['gap_s'])} s, are cut off."
    ),
    "steps_resampled": lambda f: (
        f"Unequal time steps ({number(f.values['shortest_s'])} to {number(f.values['longest_s'])} s) are resampled to "
        f"{number(f.values['step_s'])} s."
    ),
    "velocity_derived": "Velocity is derived from position.",
    "velocity_unknown": "Neither velocity nor position is logged: drag is predicted as if the vehicle stood still.",
    "force_derived": "Specific force is derived from velocity.",
    "rates_derived": "Angular velocity is derived from attitude; angular acceleration is not compared.",
    "one_command": "All rotors have one command; angular acceleration is not compared.",
    "torques_not_logged": "By the mapping, these logs show no torques; angular acceleration is not compared.",
    "on_ground": lambda f: (
        f"In {percent(f.values['share'])} of the rows it stands on the ground; they are not compared."
    ),
    "commands_copied": "The commands are left out: they equal the measured rotor speeds, so that they show no lag.",
    "commands_scaled": lambda f: (
        f"Commands are scaled by {f.values['factor']:.4f} to the thrust measured above {f.values['height_m']:g} m."
    ),
    "rotor_log_moved": _lead,
    "position_jump": _jump,
    "samples_slow": lambda f: (
        f"{f.values['sensor']} comes only {number(f.values['rate_hz'])} times per second (the log has "
        f"{number(f.values['log_rate_hz'], 4)} rows); straight lines connect its values."
    ),
    "samples_repeated": lambda f: (
        f"{f.values['sensor']} repeats its value in {percent(f.values['share'])} of the rows, at most "
        f"{f.values['longest_rows']} in a row; straight lines connect measured values."
    ),
}
"""Template of each code: a text, or a function of the finding."""
