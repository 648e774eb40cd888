"""Sentences of the answer (result, gain on unseen flights, worse or open results, next step) and of the trust."""

from collections.abc import Mapping, Sequence

from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.wording.effects import effect_sentence
from aerial_gym.sim2real.wording.words import (
    Values,
    error_words,
    errors,
    join_words,
    names,
    number,
    percent,
    quantity_unit,
    quantity_value,
    rise_interval,
)


def failure_sentence(finding: Finding) -> str:
    """Return the sentence of a failure in one flight."""
    values = finding.values
    place = f" ({values['place']})" if values.get("place") else ""
    rotor = f"rotor {values['rotor']}{place}" if "rotor" in values else "all rotors"
    verb = {"weak_motor": "gives", "brown_out": "follow", "stuck_rotor": "keeps"}.get(str(values["failure"]), "follows")
    if "share" in values:
        low, high = (float(f"{100.0 * float(values[end]):.3g}") for end in ("share_low", "share_high"))
        of = {"weak_motor": "of its thrust", "brown_out": "of their commands"}.get(
            str(values["failure"]), "of its commands"
        )
        size = f"{100.0 * float(values['share']):.3g} % ({low:g} to {high:g} %) {of}"
    else:
        unit = "rad/s" if "state_rad_s" in values else "N"
        size = f"{quantity_value(values, 'state', unit):.4g} {unit}"
    span = f"for {values['duration_s']:.3f} s" if "duration_s" in values else "on"
    when = f"{values['time_s']:.3f} s ({values['time_low_s']:.3f} to {values['time_high_s']:.3f} s)"
    return f"{finding.subject}: {rotor} {verb} {size} from {when} {span}."


def _joint_sentence(finding: Finding) -> str:
    rows: Sequence[Values] = finding.values["numbers"]
    parts = [f"{row['name']} {number(row['value'])} instead of {number(row['declared'])}" for row in rows]
    if not parts:
        return f"Joint {finding.subject} differs from the declared one in {join_words(finding.values['changed'])}."
    return f"Joint {finding.subject} has {join_words(parts)}."


def _declaration_sentence(finding: Finding) -> str:
    start = "Up to the failure, the" if finding.values.get("until_failure") else "The"
    rigid = ", taken as rigid," if finding.values.get("rigid") else ""
    return f"{start} declared model{rigid} explains the flights within noise and tolerances."


def _change_words(row: Values) -> str:
    quantity = str(row["quantity"])
    unit = quantity_unit(quantity)
    before, after = quantity_value(row, "before", unit), quantity_value(row, "after", unit)
    digits = 2 if after < 0.5 * before else 3
    return f"from {number(before)} to {number(after, digits)} {unit}"


def _errors_fall(finding: Finding) -> str:
    first, *further = finding.values["errors"]
    parts = [f"{error_words(first['quantity'])} falls {_change_words(first)}"]
    parts += [f"{error_words(row['quantity'])} {_change_words(row)}" for row in further]
    return f"On unseen flights, {join_words(parts)}."


def _error_rises(finding: Finding) -> str:
    more = int(finding.values["more"])
    further = f"; {more} more error{'s rise' if more > 1 else ' rises'}" if more else ""
    interval = rise_interval(finding.values)
    return f"The {error_words(finding.subject)} rises {_change_words(finding.values)} ({interval}){further}."


def _error_may_rise(finding: Finding) -> str:
    more = int(finding.values["more"])
    further = f"; {more} more may rise" if more else ""
    change = f"{100.0 * float(finding.values['rise']):+.0f} %"
    return f"The {error_words(finding.subject)} may rise: {change} ({rise_interval(finding.values)}){further}."


def _remains(finding: Finding) -> str:
    rows: Sequence[Mapping[str, float]] = finding.values.get("errors", ())
    if not rows:
        return f"Errors exceed noise and tolerances: {errors(finding.values['channels'])}."

    def _excess(row: Mapping[str, float]) -> float:
        floor = quantity_value(row, "floor", quantity_unit(str(row["channel"])))
        rms = quantity_value(row, "rms", quantity_unit(str(row["channel"])))
        return rms / floor if floor else 0.0

    most = max(rows, key=_excess)
    unit, more = quantity_unit(str(most["channel"])), len(rows) - 1
    further = f"; {more} more error{'s exceed' if more > 1 else ' exceeds'} noise and tolerances" if more else ""
    times = f", {_excess(most):.2g} times the noise floor" if _excess(most) else ""
    error = f"the {error_words(str(most['channel']))} is {number(quantity_value(most, 'rms', unit))} {unit}{times}"
    return f"The model is missing something: {error}{further}."


def _structure_sentence(finding: Finding) -> str:
    values = finding.values
    line = finding.subject == "periodic"
    clause = f"has a line at {number(values['freq_hz'])} Hz" if line else f"follows the {finding.subject}"
    share = percent(float(values["share"]))
    return f"The {error_words(str(values['channel']))} {clause}, which explains {share} of its variance on flights left out."


def _fly(finding: Finding) -> str:
    tells = finding.values["tells"]
    clause = f"show {names(tells)}" if len(tells) == 1 else f"tell {join_words(tells, 'from')}"
    return f"To {clause}, fly: {finding.subject}."


def _weigh_or_log(finding: Finding) -> str:
    tells = finding.values.get("tells", ())
    clause = f" about {names(tells)}" if tells else ""
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


def _fly_structure(finding: Finding) -> str:
    return f"To confirm that, {STRUCTURE_FLIGHTS.get(finding.subject, 'repeat a test flight')}, and train on it."


def _keep_where(finding: Finding) -> str:
    return f"Load robot.yaml, but keep the declared robot where this matters: {errors(finding.values['errors'])}."


def _effect_tied(finding: Finding) -> str:
    return f"These flights do not decide between {join_words([finding.subject, *finding.values['others']])}."


def _near_floor(finding: Finding) -> str:
    clause = "Other errors are" if finding.values.get("offsets") else "The remaining error is"
    return f"{clause} near the noise floor."


ANSWER = {
    "effect_found": effect_sentence,
    "failure_found": failure_sentence,
    "joint_found": _joint_sentence,
    "effects_none": "No known effect explains the flights better than the declared model.",
    "declared_explains": _declaration_sentence,
    "errors_fall": _errors_fall,
    "no_error_falls": "No error on unseen flights falls for certain.",
    "gusts_lower_no_error": "Gusts are random, so no prediction error falls.",
    "error_rises": _error_rises,
    "error_may_rise": _error_may_rise,
    "remains_unexplained": _remains,
    "structure_found": _structure_sentence,
    "effect_tied": _effect_tied,
    "effects_open": lambda f: (
        f"The training flights leave {join_words(f.values['effects'], 'or')} open, which would explain it."
    ),
    "left_open": lambda f: (
        f"Errors stay above noise, and the training flights leave their cause open: {errors(f.values['channels'])}."
    ),
    "offsets_of_flights": lambda f: f"Each flight has its own offset: {errors(f.values['channels'])}.",
    "remains_near_floor": _near_floor,
    "gusts_reach_floor": "With the gusts, the remaining error is near the noise floor.",
    "floor_unknown": "The logs are too slow or too short to show a noise floor, so remaining errors cannot be judged.",
    "forces_not_judged": "Without velocity, air drag is unknown, so remaining force errors are not judged.",
    "fly": _fly,
    "weigh_or_log": _weigh_or_log,
    "fly_structure": _fly_structure,
    "inspect_rest": (
        "Fly one test flight twice more. An error that repeats belongs to the model, any other to a disturbance."
    ),
    "log_velocity": "Log velocity (v_x, v_y, v_z) or position (p_x, p_y, p_z).",
    "log_faster": "Log longer flights at a higher rate.",
    "train_like_test": "Train on flights that move as the test flights do.",
    "load_robot_file": "Load robot.yaml in the simulator.",
    "keep_declared": "Keep the declared robot; nothing needs a correction.",
    "keep_declared_where": _keep_where,
    "keep_declared_for_harm": "Keep the declared robot; no error on unseen flights falls for certain.",
}
"""Template of each code: a text, or a function of the finding."""


def _until_failure(finding: Finding) -> str:
    return f"This holds for {names(finding.values['flights'])} up to the failure."


TRUST = {
    "trust_corrected": "The corrected vehicle explains the flights within noise and tolerances.",
    "trust_declared": "The declared vehicle explains the flights within noise and tolerances.",
    "trust_as_shown": "The declared vehicle explains the training flights; the test flights hold more, which they leave open.",
    "trust_nothing": "Do not trust the simulator in the channels that remain unexplained.",
    "trust_ambiguous": "The remaining error may be an effect that the training flights do not show.",
    "ties_named": lambda f: f"{f.subject} may also be {join_words(f.values['others'], 'or')}.",
    "certain_beside_ties": lambda f: f"This doubt does not concern {names(f.values['effects'])}.",
    "correction_harms": lambda f: (
        f"The correction raises these errors: {errors(f.values['errors'])}. Keep the declared vehicle where they matter."
    ),
    "correction_helps": lambda f: f"The correction lowers these errors: {errors(f.values['errors'])}.",
    "open_in_channels": lambda f: f"The training flights leave these open: {errors(f.values['channels'])}.",
    "rigid_vehicle_only": "This holds for the vehicle as a rigid body; its joints were fitted separately.",
    "until_failure_only": _until_failure,
}
"""Templates of the findings on trust in the model, by code."""
