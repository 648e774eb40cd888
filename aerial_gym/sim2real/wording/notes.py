"""Sentences of notes on effects, rivals, tolerances, gusts and the learned residual, and of reasons against effects."""

from collections.abc import Mapping, Sequence

from aerial_gym.physics import EFFECTS
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.predict.scene import NEEDED
from aerial_gym.sim2real.wording.answer import failure_sentence
from aerial_gym.sim2real.wording.words import (
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


def _excitation(finding: Finding) -> str:
    return f"Needed: {EFFECTS.get(finding.subject).excitation}."


def _immaterial(finding: Finding) -> str:
    values = finding.values
    return (
        f"{finding.subject} is immaterial: without it no error of the test flights rises by {percent(values['least'])}. "
        f"The {error_words(str(values['channel']))} rises most ({rise_interval(values)}). The robot file may leave it out."
    )


def _materiality_open(finding: Finding) -> str:
    values = finding.values
    return (
        f"The test flights do not show whether {finding.subject} is material: without it, the "
        f"{error_words(str(values['channel']))} changes by {rise_interval(values)}."
    )


def _params(params: Mapping[str, float]) -> str:
    return ", ".join(f"{name}: {number(value, 4)}" for name, value in params.items())


WAYS_OUT = {
    "acc_bias": "Calibrate it",
    "gyro_bias": "Calibrate it",
    "acc_scale": "Calibrate it",
    "sensor_delay": "Log on one clock",
    "imu_place": "Log its reading at the body origin",
    "attitude": "Align the logged attitude with the body",
    "command_hold": "",
    "joint_rest": "",
}
"""Remedy for an implausible deviation, by the start of the tolerance's name; for others: declare the value anew."""


def _strain(finding: Finding) -> str:
    name, size = finding.subject, float(finding.values["deviation_std"])
    start = f"The flights ask for {name} to be off by {size:+.1f} standard deviations of its tolerance."
    if name.startswith("rotor_motion"):
        return f"{start} Noise of the logged rotor speeds hides their motion: log commands, or fly more."
    if name.startswith("answered_noise"):
        return f"{start} Torque and gyro noise go together, or an effect is missing: fly more than hover."
    way = next((way for key, way in WAYS_OUT.items() if name.startswith(key)), "Declare it anew")
    return f"{start} {f'{way}, or give' if way else 'Give'} its real tolerance (--tolerances)."


def _strain_changes(finding: Finding) -> str:
    rows: Sequence[Mapping[str, float]] = finding.values["errors"]
    parts = []
    for row in rows:
        unit = quantity_unit(str(row["channel"]))
        new, old = (number(quantity_value(row, when, unit), 2) for when in ("with", "without"))
        parts.append(f"the {error_words(str(row['channel']))} is {new} instead of {old} {unit}")
    return f"With these deviations, {join_words(parts[:3])}."


def _offsets(finding: Finding) -> str:
    rows: Sequence[Mapping[str, float]] = finding.values["offsets"]
    parts = []
    for row in rows:
        unit = quantity_unit(str(row["channel"]))
        parts.append(f"{row['channel']} {number(quantity_value(row, 'rms', unit), 2)} {unit}")
    return (
        f"Each flight has its own offset: {join_words(parts)} (rms). "
        "A warming sensor or a new battery does that; it is no property of the vehicle."
    )


def _residual_share(finding: Finding) -> str:
    shares: Mapping[str, float] = finding.values["shares"]
    if not shares:
        return "The named effects leave no gap above the noise floor."
    parts = [f"{percent(share) if share >= 0.0 else '-' + percent(share)} of {name}" for name, share in shares.items()]
    return f"Of the gap above the noise floor on unseen flights it closes {join_words(parts)}."


PROCESSES = {
    "memory": "Its memory has more than one correlation time",
    "line": "It has a line at one frequency",
    "shape": "It is not distributed as a random wind",
    "axes": "It differs between the axes",
    "flights": "It differs between the flights",
}
"""Properties that gusts do not have; any other name is a quantity that the residual follows."""


def _process(finding: Finding) -> str:
    name = str(finding.values["process"])
    p_value = number(finding.values["p_value"], 1)
    return f"{PROCESSES.get(name, f'It follows the {name}')} (p = {p_value})."


def _objections(finding: Finding) -> str:
    """Return the sentences of the objections in a refusal."""
    objections = [Finding(row["code"], row["subject"], row["values"]) for row in finding.values["objections"]]
    return " ".join(template if isinstance(template := NOTES[one.code], str) else template(one) for one in objections)


def _joints_felt(finding: Finding) -> str:
    pairs = finding.values["errors_before_and_after"].items()
    parts = [f"{name} {number(old)} to {number(new)}" for name, (old, new) in pairs]
    return f"Errors felt by the body on parts left out [m/s², rad/s²]: {'; '.join(parts)}."


NOTES = {
    "effect_immaterial": _immaterial,
    "materiality_open": _materiality_open,
    "doubt_by_test": lambda f: (
        f"The training flights alone show {f.subject}, not {f.values['other']} (log odds {f.values['log_odds']:.1f}). "
        f"The test flights speak for {f.values['other']}."
    ),
    "left_open_note": lambda f: (
        f"Errors of the test flights stay above noise: {errors(f.values['channels'])}. The training flights leave them open. "
        "Train on flights that move as the test flights do."
    ),
    "parameter_tied": lambda f: (
        f"{f.values['parameter']} of {f.subject} may also be {f.values['other']} ({_params(f.values['params'])}; "
        f"log odds {f.values['log_odds']:.1f})."
    ),
    "stands_in": lambda f: (
        f"{f.subject} is not named: it only replaces a residual that follows the {f.values['structure']}."
    ),
    "offsets_sizes": _offsets,
    "tolerance_strained": _strain,
    "tolerances_cut_off": lambda f: (
        f"{names(f.values['tolerances'])}: cut off at {f.values['deviation_std']:g} standard deviations, so not measured. "
        "An effect is missing, or input noise looks like it."
    ),
    "strained_changes": _strain_changes,
    "strained_changes_little": "These deviations hardly change the errors of the test flights.",
    "band_limited": lambda f: (
        f"Compared below {number(f.values['band_hz'])} Hz: the slowest log has {number(f.values['slowest_hz'], 4)} "
        "rows per second."
    ),
    "few_flights": lambda f: (
        f"Only {f.values['flights']} training flights: intervals rest on blocks of time, not on the spread of flights."
    ),
    "joints_held": lambda f: (
        f"The vehicle is taken as rigid, with its joints ({names(f.values['joints'])}) in the reference pose. "
        "Bending shows as a residual (docs/guides/articulated_vehicles.md)."
    ),
    "failure_suspected": lambda f: (
        f"A failure is suspected (log odds {f.values['log_odds']:.1f}), but the verdict does not use it. {failure_sentence(f)} "
        f"--failures compares {f.subject} up to its onset; a wrongly declared vehicle can look the same."
    ),
    "train_with_failure": lambda f: (
        f"{f.subject} is compared up to its failure, which robot.yaml does not hold: not every flight has it. "
        f"To train with it, add to effects: {f.values['effect']}: {{{_params(f.values['params'])}}}."
    ),
    "gusts_are_random": "Gusts predict no row and lower no residual; the noise floor after the correction includes them.",
    "gusts_refused": lambda f: f"The remaining residual is not attributed to gusts. {_objections(f)}",
    "may_be_noise": lambda f: f"It may be noise (p = {number(f.values['p_value'], 2)}).",
    "adds_too_little": "It adds too little to the noise of any channel, or less than the tolerances may cause.",
    "wrong_corr_time": lambda f: (
        f"These flights cannot show a correlation time of {number(f.values['corr_time_s'], 2)} s."
    ),
    "rival_process": _process,
    "rival_less_probable": lambda f: f"less probable (log odds {f.values['log_odds']:.1f})",
    "rival_wider": lambda f: f"as probable, but a wider case of {f.values['effect']}",
    "rival_not_rejected": "not rejected: these flights cannot tell them apart",
    "learned_added": lambda f: (
        f"learned_residual was added on request; it explains nothing. {f.values['rows_outside']} of {f.values['rows']} "
        "test rows lie outside its training data, where it fades."
    ),
    "learned_share": _residual_share,
    "learned_refused": lambda f: f"learned_residual was requested, but not added. {_objections(f)}",
    "gain_by_chance": lambda f: f"Its gain on flights left out may be chance (p = {number(f.values['p_value'], 2)}).",
    "few_flights_better": lambda f: f"It predicts only {percent(f.values['share'])} of the flights left out better.",
    "gain_small": lambda f: (
        f"It lowers no error by more than {percent(f.values['share'])}, or by less than the tolerances may cause."
    ),
    "channel_worse": lambda f: f"It raises the {error_words(f.subject)} by {percent(f.values['share'])}.",
    "channel_worse_in_flights": lambda f: (
        f"It raises the {error_words(f.subject)} in {percent(f.values['share'])} of the flights left out."
    ),
    "no_velocity": "The flights have no velocity.",
    "no_force": "The flights show neither force nor angular acceleration.",
    "share_small": lambda f: f"It takes at most {percent(f.values['share'])} of any mean square of flights left out.",
    "rollouts_lack_velocity": lambda f: f"No rollouts: {f.subject} without velocity or position.",
    "rollouts_lack_attitude": lambda f: (
        f"No rollouts: {f.subject} without attitude, which the gyro alone does not give."
    ),
    "rollouts_too_short": lambda f: f"No rollouts: no flight is airborne for {f.values['shortest_s']:g} s at a time.",
    "joint_effort": lambda f: (
        f"Joint {f.subject}: the effort error changes from {number(f.values['before_n_m'])} to "
        f"{number(f.values['after_n_m'])} N m."
    ),
    "joints_felt": _joints_felt,
}
"""Templates of the notes of a verdict, by code."""

REASONS = {
    "not_excited": lambda f: f"These flights do not show it. {_excitation(f)}",
    "no_soft_arms": "Its file gives the vehicle no soft arms, and these flights show none.",
    "acts_on_links": "It acts on moving links, and the vehicle is taken as rigid here.",
    "no_such_effect": lambda f: f"It looks like {f.values['alike']}, but no effect of this name is registered.",
    "logs_lack": lambda f: f"{f.values['flights']} without {NEEDED[f.values['need']]}.",
    "voltage_too_steady": lambda f: (
        f"The battery voltage varies by only {percent(f.values['share'])}. {_excitation(f)}"
    ),
    "commands_too_coarse": lambda f: (
        f"Commands are logged every {number(f.values['row_ms'])} ms, but the rotors follow within {number(f.values['lag_ms'])} "
        "ms. Log commands faster."
    ),
    "no_inertial_sensor": "The logs hold no inertial sensor: forces are derived from the velocity.",
    "torques_not_compared": "Torques are not compared here, and forces alone do not tell it from a drag or a turned sensor.",
    "effect_refused": lambda f: f"{f.values['error']}.",
    "parameters_unknown": "These flights leave every parameter unknown by more than its scale.",
    "flights_disagree": lambda f: (
        f"Probable only if noise were the only error (log odds {f.values['log_odds']:.0f}): the flights disagree on it, or it "
        "needs a structure beside it."
    ),
    "at_bound": lambda f: f"It ends at its physical bound: {names(f.values['parameters'])}.",
    "not_told_from_nothing": lambda f: (
        f"Probable, but not certain enough (log odds {f.values['log_odds']:.1f}; {f.values['least_log_odds']:g} needed)."
    ),
    "told_beside_another": "It is certain enough only together with an effect that is not.",
    "only_linear": "Its linear model predicts a gain that the full fit does not reach.",
    "less_probable": "Less probable than not.",
    "trifle": lambda f: f"Immaterial: without it no training error rises by more than {percent(f.values['rise'])}.",
    "follows_structure": lambda f: f"It only replaces a residual that follows the {f.values['structure']}.",
    "gusts_no_floor": "The logs are too slow to show a noise floor, above which gusts would stand.",
    "gusts_no_forces": "It needs specific force and velocity in the logs.",
    "gusts_no_drag": lambda f: f"This model has no drag along some axis. {_excitation(f)}",
}
"""Templates of the reasons why an effect could not be tested or is not named, by code."""
