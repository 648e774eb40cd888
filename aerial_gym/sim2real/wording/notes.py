"""Sentences of notes on effects, rivals, tolerances, gusts and the learned residual, and of reasons against effects."""

from collections.abc import Mapping, Sequence

from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.wording.answer import failure_sentence
from aerial_gym.sim2real.wording.words import (
    Template,
    error_name,
    join_words,
    number_text,
    percent_text,
    quantity_unit,
    rise_interval_text,
    template_sentence,
    value_with_unit_suffix,
)

REMEDIES_OF_DEVIATIONS = {
    "acc_bias": "Calibrate it",
    "gyro_bias": "Calibrate it",
    **dict.fromkeys(("acc_scale", "gyro_scale", "attitude_scale", "velocity_scale"), "Calibrate it"),
    "sensor_delay": "Log on one clock",
    "command_clock": "Log on one clock",
    "command_gain": "Log rotor speeds",
    "imu_place": "Log its reading at the body origin",
    "load_place": "Hang the load at the body origin",
    "attitude": "Align the logged attitude with the body",
    "command_hold": "",
    "joint_rest": "",
}
"""Remedy for an implausible deviation, by the start of the tolerance's name; for others: declare the value anew."""


def _implausible_deviation_sentence(finding: Finding) -> str:
    name, size = finding.subject, float(finding.values["deviation_std"])
    start = f"The flights ask for {name} to be off by {size:+.1f} standard deviations of its tolerance."
    if name.startswith("rotor_motion"):
        return f"{start} Noise of the logged rotor speeds hides their motion: log commands, or fly more."
    if name.startswith("answered_noise"):
        return f"{start} Torque and gyro noise go together, or an effect is missing: fly more than hover."
    way = next((way for key, way in REMEDIES_OF_DEVIATIONS.items() if name.startswith(key)), "Declare it anew")
    return f"{start} {f'{way}, or give' if way else 'Give'} its real tolerance (--tolerances)."


def _sentence_on_structure(finding: Finding) -> str:
    kind = finding.values["structure"]
    if int(finding.values["flights"]) > 1:
        return f"It only replaces a residual that follows the {kind}."
    return f"Its size varies with the {kind} in the only training flight, and one flight cannot show the cause. Add another."


def _sentence_on_redeclared_values(finding: Finding) -> str:
    rows: Sequence[Mapping[str, float]] = finding.values["values"]
    parts = [f"{row['value']} ({float(row['deviation_std']):+.1f} standard deviations)" for row in rows]
    return f"The flights contradict {join_words(parts)}. robot.yaml has the values that fit best."


def _sentence_on_errors_with_deviations(finding: Finding) -> str:
    rows: Sequence[Mapping[str, float]] = finding.values["errors"]
    parts = []
    for row in rows:
        unit = quantity_unit(str(row["channel"]))
        new, old = (number_text(value_with_unit_suffix(row, when, unit), 2) for when in ("with", "without"))
        parts.append(f"the {error_name(str(row['channel']))} is {new} instead of {old} {unit}")
    return f"With these deviations, {join_words(parts[:3])}."


def _sentence_on_offsets_of_flights(finding: Finding) -> str:
    rows: Sequence[Mapping[str, float]] = finding.values["offsets"]
    parts = []
    for row in rows:
        unit = quantity_unit(str(row["channel"]))
        parts.append(f"{row['channel']} {number_text(value_with_unit_suffix(row, 'rms', unit), 2)} {unit}")
    return (
        f"Each flight has its own offset: {join_words(parts)} (rms). "
        "A warming sensor or a new battery does that; it is no property of the vehicle."
    )


def _sentence_on_gap_closed(finding: Finding) -> str:
    shares: Mapping[str, float] = finding.values["shares"]
    named: Mapping[str, float] = finding.values.get("named_shares", {})
    if not shares:
        return "The named effects leave no gap above the noise floor."

    def share_list(shares: Mapping[str, float]) -> str:
        parts = [f"{'-' * (share < 0.0)}{percent_text(share)} of {name}" for name, share in shares.items()]
        return join_words(parts)

    beside = f"; named effects close {share_list(named)}" if any(named.values()) else ""
    return f"Of the gap above the noise floor on unseen flights it closes {share_list(shares)}{beside}."


PROCESSES = {
    "memory": "Its memory has more than one correlation time",
    "line": "It has a line at one frequency",
    "shape": "It is not distributed as a random wind",
    "axes": "It differs between the axes",
    "flights": "It differs between the flights",
}
"""Properties that gusts do not have; any other name is a quantity that the residual follows."""


def _sentence_on_other_process(finding: Finding) -> str:
    name = str(finding.values["process"])
    p_value = number_text(finding.values["p_value"], 1)
    return f"{PROCESSES.get(name, f'It follows the {name}')} (p = {p_value})."


def _objection_sentences(finding: Finding) -> str:
    """Return the sentences of the objections in a refusal."""
    objections = [Finding(row["code"], row["subject"], row["values"]) for row in finding.values["objections"]]
    return " ".join(template_sentence(NOTES[one.code], one) for one in objections)


def _sentence_on_body_motion_errors(finding: Finding) -> str:
    pairs = finding.values["errors_before_and_after"].items()
    parts = [f"{name} {number_text(old)} to {number_text(new)}" for name, (old, new) in pairs]
    return f"Errors felt by the body on parts left out [m/s², rad/s²]: {'; '.join(parts)}."


def _sentence_on_lack(finding: Finding) -> str:
    from aerial_gym.sim2real.predict.scene import NEEDED  # here, as it needs torch

    return f"{finding.values['flights']} without {NEEDED[finding.values['need']]}."


def _sentence_on_value_tie(finding: Finding) -> str:
    values = finding.values
    parts = [
        f"{row['effect']} ({', '.join(f'{name} = {number_text(value)}' for name, value in row['params'].items())})"
        for row in values["others"]
    ]
    loss = f"{max(float(values['loss']), 0.0):.1f}"
    return (
        f"These logs cannot distinguish {join_words(values['replaced'])} from {join_words(parts)}, because both predict the "
        f"same motion: the log likelihood falls by {loss}."
    )


NOTES: dict[str, Template] = {
    "effect_immaterial": lambda f: (
        f"{f.subject} is immaterial: without it no error of the test flights rises by {percent_text(f.values['least'])}. "
        f"The {error_name(f.values['channel'])} rises most ({rise_interval_text(f.values)}). The robot file may leave it out."
    ),
    "materiality_open": lambda f: (
        f"The test flights do not show whether {f.subject} is material: without it, the {error_name(f.values['channel'])} "
        f"changes by {rise_interval_text(f.values)}."
    ),
    "doubt_by_test": (
        "The training flights alone show {subject}, not {other} (log odds {log_odds:.1f}). The test flights speak for {other}."
    ),
    "left_open_note": (
        "Errors of the test flights stay above noise: {channels:errors}. The training flights leave them open. "
        "Train on flights that move as the test flights do."
    ),
    "parameter_tied": "{parameter} of {subject} may also be {other} ({params:params}; log odds {log_odds:.1f}).",
    "parameters_tied": "{parameters:and} of {subject} may also be {others:or}.",
    "values_tied": _sentence_on_value_tie,
    "at_bound": (
        "{subject} ends at a physical bound of {parameters:names}: its law does not fit exactly, or another cause "
        "acts beside it."
    ),
    "stands_in": lambda f: f"{f.subject} is not named. {_sentence_on_structure(f)}",
    "offsets_sizes": _sentence_on_offsets_of_flights,
    "values_redeclared": _sentence_on_redeclared_values,
    "tolerance_strained": _implausible_deviation_sentence,
    "tolerances_cut_off": (
        "{tolerances:names}: cut off at {deviation_std:g} standard deviations, so not measured. "
        "An effect is missing, or input noise looks like it."
    ),
    "strained_changes": _sentence_on_errors_with_deviations,
    "strained_changes_little": "These deviations hardly change the errors of the test flights.",
    "band_limited": "Compared below {band_hz:number} Hz: the slowest log has {slowest_hz:number4} rows per second.",
    "few_flights": ("Only {flights} training flights: intervals rest on blocks of time, not on the spread of flights."),
    "joints_held": (
        "The vehicle is taken as rigid, with its joints ({joints:names}) in the reference pose. "
        "Bending shows as a residual (docs/guides/articulated_vehicles.md)."
    ),
    "failure_suspected": lambda f: (
        f"A failure is suspected (log odds {f.values['log_odds']:.1f}), but the verdict does not use it. {failure_sentence(f)} "
        f"--failures compares {f.subject} up to its onset; a wrongly declared vehicle can look the same."
    ),
    "vehicle_misfit": (
        "The declared vehicle does not fit: the mean {quantity} of rotor {rotor} differs by {difference_share:percent} "
        "± {half_width_share:percent} of hover (p = {p_value:.1g}). A failure must exceed that; correct the robot file by "
        "close-loop."
    ),
    "train_with_failure": (
        "{subject} is compared up to its failure, which robot.yaml does not hold: not every flight has it. "
        "To train with it, add to effects: {effect}: {{{params:params}}}."
    ),
    "gusts_are_random": "Gusts predict no row and lower no residual; the noise floor after the correction includes them.",
    "law_preferred": "{subject}: the flights prefer {law} to {other} (log odds {log_odds:.1f}).",
    "laws_tied": "{subject}: these flights do not distinguish {law} from {other} (log odds {log_odds:.1f}).",
    "gusts_refused": lambda f: f"The remaining residual is not attributed to gusts. {_objection_sentences(f)}",
    "may_be_noise": "It may be noise (p = {p_value:number2}).",
    "adds_too_little": "It adds too little to the noise of any channel, or less than the tolerances may cause.",
    "wrong_corr_time": "These flights cannot show a correlation time of {corr_time_s:number2} s.",
    "rival_process": _sentence_on_other_process,
    "rival_less_probable": "less probable (log odds {log_odds:.1f})",
    "rival_wider": "as probable, but a wider case of {effect}",
    "rival_not_rejected": "not rejected: these flights cannot tell them apart",
    "learned_added": (
        "learned_residual was added; it explains nothing. {rows_outside} of {rows} test rows lie outside its "
        "training data, where it fades."
    ),
    "learned_share": _sentence_on_gap_closed,
    "learned_refused": lambda f: f"learned_residual was fitted, but not added. {_objection_sentences(f)}",
    "gain_by_chance": "Its gain on flights left out may be chance (p = {p_value:number2}).",
    "few_flights_better": "It predicts only {share:percent} of the flights left out better.",
    "gain_small": "It lowers no error by more than {share:percent}, or by less than the tolerances may cause.",
    "channel_worse": "It raises the {subject:error} by {share:percent}.",
    "channel_worse_in_flights": "It raises the {subject:error} in {share:percent} of the flights left out.",
    "no_velocity": "The flights have no velocity.",
    "no_force": "The flights show neither force nor angular acceleration.",
    "share_small": "It takes at most {share:percent} of any mean square of flights left out.",
    "rollouts_lack_velocity": "No rollouts: {subject} without velocity or position.",
    "rollouts_lack_attitude": "No rollouts: {subject} without attitude, which the gyro alone does not give.",
    "errors_at_floor": "No error of {channels} exceeds its noise floor by more than 10 %: the robot file fits these flights.",
    "errors_above_floor": (
        "{above} of {channels} errors exceed their noise floors. The {channel:error} does most, {ratio:number2} times. "
        "Next: aerial-gym close-loop finds the cause, best from three or more flights."
    ),
    "rollouts_too_short": "No rollouts: no flight is airborne for {shortest_s:g} s at a time.",
    "controller_flown": (
        "Round trip by the law of {controller}: {logged} of its parameters come from the log, {assumed} are assumed."
    ),
    "controller_stands_in": (
        "Round trip: the law of {firmware} is not known here. That of {controller}, with derived gains, stands in."
    ),
    "setpoints_missing": "Round trip: {subject} without complete setpoints for long enough.",
    "joint_effort": ("Joint {subject}: the effort error changes from {before_n_m:number} to {after_n_m:number} N m."),
    "joints_felt": _sentence_on_body_motion_errors,
}
"""Templates of the notes of a verdict, by code."""

REASONS: dict[str, Template] = {
    "not_excited": "These flights do not show it. {subject:excitation}",
    "no_soft_arms": "Its file gives the vehicle no soft arms, and these flights show none.",
    "acts_on_links": "It acts on moving links, and the vehicle is taken as rigid here.",
    "no_such_effect": "It looks like {alike}, but no effect of this name is registered.",
    "logs_lack": _sentence_on_lack,
    "voltage_too_steady": "The battery voltage varies by only {share:percent}. {subject:excitation}",
    "thrust_slope_open": (
        "Slow commands miss what the rotors did between samples, and leave open how steeply the thrust grows. "
        "Log them at 40 Hz or more."
    ),
    "commands_too_coarse": (
        "Commands are logged every {row_ms:number} ms, but the rotors follow within {lag_ms:number} ms. Log commands faster."
    ),
    "no_inertial_sensor": "The logs hold no inertial sensor: forces are derived from the velocity.",
    "kinematics_disagree": "The sensors alone contradict it: with it, the error of {channel} rises by {rise:percent}.",
    "torques_not_compared": "Torques are not compared here, and forces alone do not tell it from a drag or a turned sensor.",
    "effect_refused": "{error}.",
    "interval_holds_neutral": "The interval of every parameter that can show it contains the value without effect.",
    "parameters_unknown": "These flights leave every parameter unknown by more than its scale.",
    "flights_disagree": (
        "Probable only if noise were the only error (log odds {log_odds:.0f}): the flights disagree on it, or it needs a "
        "structure beside it."
    ),
    "not_told_from_nothing": (
        "Probable, but not certain enough (log odds {log_odds:.1f}; {least_log_odds:.1f} needed)."
    ),
    "told_beside_another": "It is certain enough only together with an effect that is not.",
    "remainder_larger": (
        "{subject} is not named: it removes less of the {channels:errors} than remains unexplained. An unknown cause is larger."
    ),
    "only_linear": "Its linear model predicts a gain that the full fit does not reach.",
    "less_probable": "Less probable than not.",
    "trifle": "Immaterial: without it no training error rises by more than {rise:percent}.",
    "follows_structure": _sentence_on_structure,
    "gusts_no_floor": "The logs are too slow to show a noise floor, above which gusts would stand.",
    "gusts_no_forces": "It needs specific force and velocity in the logs.",
    "gusts_no_drag": "This model has no drag along some axis. {subject:excitation}",
}
"""Templates of the reasons why an effect could not be tested or is not named, by code."""
