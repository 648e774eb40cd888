"""Sentences of the answer (result, gain on unseen flights, worse or open results, next step) and of the trust."""

from collections.abc import Mapping, Sequence

from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.wording.effects import effect_sentence
from aerial_gym.sim2real.wording.words import (
    Template,
    Values,
    error_list,
    error_name,
    join_words,
    name_list,
    number_text,
    percent_text,
    quantity_unit,
    rise_interval_text,
    value_with_unit_suffix,
)


def failure_sentence(finding: Finding) -> str:
    """Return the sentence of a failure in one flight."""
    values, failure = finding.values, str(finding.values["failure"])
    place = f" ({values['place']})" if values.get("place") else ""
    rotor = f"rotor {values['rotor']}{place}" if "rotor" in values else "all rotors"
    verb = {"weak_motor": "gives", "brown_out": "follow", "stuck_rotor": "keeps"}.get(failure, "follows")
    if "share" in values:
        share, low, high = (float(f"{100.0 * values[name]:.3g}") for name in ("share", "share_low", "share_high"))
        of = {"weak_motor": "its thrust", "brown_out": "their commands"}.get(failure, "its commands")
        size = f"{share:g} % ({low:g} to {high:g} %) of {of}"
    else:
        unit = "rad/s" if "state_rad_s" in values else "N"
        size = f"{value_with_unit_suffix(values, 'state', unit):.4g} {unit}"
    span = f"for {values['duration_s']:.3f} s" if "duration_s" in values else "on"
    when = f"{values['time_s']:.3f} s ({values['time_low_s']:.3f} to {values['time_high_s']:.3f} s)"
    return f"{finding.subject}: {rotor} {verb} {size} from {when} {span}."


def _joint_sentence(finding: Finding) -> str:
    rows: Sequence[Values] = finding.values["numbers"]
    parts = [f"{row['name']} {number_text(row['value'])} instead of {number_text(row['declared'])}" for row in rows]
    if not parts:
        return f"Joint {finding.subject} differs from the declared one in {join_words(finding.values['changed'])}."
    return f"Joint {finding.subject} has {join_words(parts)}."


def _sentence_on_sufficient_declaration(finding: Finding) -> str:
    start = "Up to the failure, the" if finding.values.get("until_failure") else "The"
    rigid = ", taken as rigid," if finding.values.get("rigid") else ""
    return f"{start} declared model{rigid} explains the flights within noise and tolerances."


def _before_and_after_text(row: Values) -> str:
    unit = quantity_unit(str(row["quantity"]))
    before, after = value_with_unit_suffix(row, "before", unit), value_with_unit_suffix(row, "after", unit)
    return f"from {number_text(before)} to {number_text(after, 2 if after < 0.5 * before else 3)} {unit}"


def _error_decrease_sentence(finding: Finding) -> str:
    first, *further = finding.values["errors"]
    parts = [f"{error_name(first['quantity'])} falls {_before_and_after_text(first)}"]
    parts += [f"{error_name(row['quantity'])} {_before_and_after_text(row)}" for row in further]
    return f"On unseen flights, {join_words(parts)}."


def _error_rise_sentence(finding: Finding) -> str:
    more = int(finding.values["more"])
    further = f"; {more} more error{'s rise' if more > 1 else ' rises'}" if more else ""
    interval = rise_interval_text(finding.values)
    return f"The {error_name(finding.subject)} rises {_before_and_after_text(finding.values)} ({interval}){further}."


def _possible_rise_sentence(finding: Finding) -> str:
    more = int(finding.values["more"])
    further = f"; {more} more may rise" if more else ""
    change = f"{100.0 * float(finding.values['rise']):+.0f} %"
    return f"The {error_name(finding.subject)} may rise: {change} ({rise_interval_text(finding.values)}){further}."


def _sentence_on_unexplained_errors(finding: Finding) -> str:
    rows: Sequence[Mapping[str, float]] = finding.values.get("errors", ())
    if not rows:
        return f"Errors exceed noise and tolerances: {error_list(finding.values['channels'])}."

    def floor_multiple(row: Mapping[str, float]) -> float:
        unit = quantity_unit(str(row["channel"]))
        floor = value_with_unit_suffix(row, "floor", unit)
        return value_with_unit_suffix(row, "rms", unit) / floor if floor else 0.0

    most = max(rows, key=floor_multiple)
    unit, more = quantity_unit(str(most["channel"])), len(rows) - 1
    further = f"; {more} more error{'s exceed' if more > 1 else ' exceeds'} noise and tolerances" if more else ""
    times = f", {multiple:.2g} times the noise floor" if (multiple := floor_multiple(most)) else ""
    size = number_text(value_with_unit_suffix(most, "rms", unit))
    return f"The model is missing something: the {error_name(str(most['channel']))} is {size} {unit}{times}{further}."


def _structure_sentence(finding: Finding) -> str:
    values, periodic = finding.values, finding.subject == "periodic"
    clause = f"has a line at {number_text(values['freq_hz'])} Hz" if periodic else f"follows the {finding.subject}"
    share = percent_text(float(values["share"]))
    return f"The {error_name(str(values['channel']))} {clause}, which explains {share} of its variance on flights left out."


def _manoeuvre_sentence(finding: Finding) -> str:
    tells = finding.values["tells"]
    clause = f"show {name_list(tells)}" if len(tells) == 1 else f"tell {join_words(tells, 'from')}"
    return f"To {clause}, fly: {finding.subject}."


def _bench_sentence(finding: Finding) -> str:
    tells = finding.values.get("tells", ())
    clause = f" about {name_list(tells)}" if tells else ""
    return f"Measure on a bench or log more{clause}; no manoeuvre of the catalogue decides it."


STRUCTURE_FLIGHTS = {
    "position": "hover at several places and heights",
    "heading": "hover and turn the heading in steps of 90 degrees",
    "velocity": "sweep forwards and sideways at several speeds",
    "voltage": "hover until the battery is empty",
    "time": "hover from a cold start for as long as the battery lasts",
    "periodic": "hover once with each propeller exchanged",
}
"""For each kind of structure, a flight that varies its quantity alone."""


ANSWER: dict[str, Template] = {
    "effect_found": effect_sentence,
    "failure_found": failure_sentence,
    "joint_found": _joint_sentence,
    "effects_none": "No known effect explains the flights better than the declared model.",
    "declared_explains": _sentence_on_sufficient_declaration,
    "errors_fall": _error_decrease_sentence,
    "no_error_falls": "No error on unseen flights falls for certain.",
    "gusts_lower_no_error": "Gusts are random, so no prediction error falls.",
    "error_rises": _error_rise_sentence,
    "error_may_rise": _possible_rise_sentence,
    "remains_unexplained": _sentence_on_unexplained_errors,
    "structure_found": _structure_sentence,
    "effect_tied": lambda f: f"These flights do not decide between {join_words([f.subject, *f.values['others']])}.",
    "effects_open": "The training flights leave {effects:or} open, which would explain it.",
    "left_open": "Errors stay above noise, and the training flights leave their cause open: {channels:errors}.",
    "offsets_of_flights": "Each flight has its own offset: {channels:errors}.",
    "remains_near_floor": lambda f: (
        f"{'Other errors are' if f.values.get('offsets') else 'The remaining error is'} near the noise floor."
    ),
    "gusts_reach_floor": "With the gusts, the remaining error is near the noise floor.",
    "floor_unknown": "The logs are too slow or too short to show a noise floor, so remaining errors cannot be judged.",
    "forces_not_judged": "Without velocity, air drag is unknown, so remaining force errors are not judged.",
    "fly": _manoeuvre_sentence,
    "weigh_or_log": _bench_sentence,
    "fly_structure": lambda f: (
        f"To confirm that, {STRUCTURE_FLIGHTS.get(f.subject, 'repeat a test flight')}, and train on it."
    ),
    "inspect_rest": (
        "Fly one test flight twice more. An error that repeats belongs to the model, any other to a disturbance."
    ),
    "log_velocity": "Log velocity (v_x, v_y, v_z) or position (p_x, p_y, p_z).",
    "log_faster": "Log longer flights at a higher rate.",
    "train_like_test": "Train on flights that move as the test flights do.",
    "test_like_train": "Fly test flights that move as the training flights do.",
    "load_robot_file": "Load robot.yaml in the simulator.",
    "keep_declared": "Keep the declared robot; nothing needs a correction.",
    "keep_declared_where": "Load robot.yaml, but keep the declared robot where this matters: {errors:errors}.",
    "keep_declared_for_harm": "Keep the declared robot; no error on unseen flights falls for certain.",
}
"""Templates of the answer, by code."""

TRUST: dict[str, Template] = {
    "trust_corrected": "The corrected vehicle explains the flights within noise and tolerances.",
    "trust_declared": "The declared vehicle explains the flights within noise and tolerances.",
    "trust_as_shown": "The declared vehicle explains the training flights; the test flights hold more, which they leave open.",
    "trust_as_trained": "The training flights speak for the corrected vehicle; the test flights do not confirm it.",
    "trust_nothing": "Do not trust the simulator in the channels that remain unexplained.",
    "trust_ambiguous": "These flights leave open which model is right.",
    "ties_named": "{subject} may also be {others:or}.",
    "certain_beside_ties": "This doubt does not concern {effects:names}.",
    "correction_harms": (
        "The correction raises these errors: {errors:errors}. Keep the declared vehicle where they matter."
    ),
    "correction_helps": "The correction lowers these errors: {errors:errors}.",
    "open_in_channels": "The training flights leave these open: {channels:errors}.",
    "rigid_vehicle_only": "This holds for the vehicle as a rigid body; its joints were fitted separately.",
    "until_failure_only": "This holds for {flights:names} up to the failure.",
}
"""Templates of the findings on trust in the model, by code."""
