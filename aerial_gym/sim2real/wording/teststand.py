"""Sentences of notes on the test stand, and of experiments that distinguish candidates."""

from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.wording.words import Template, number_text, value_with_unit_suffix


def _curvature_sentence(finding: Finding) -> str:
    values, unit = finding.values, "N" if "cubic_n" in finding.values else "N m"
    cubic, chosen = (number_text(value_with_unit_suffix(values, name, unit)) for name in ("cubic", "chosen"))
    return (
        f"The {values['quantity']} residual keeps a curvature that a cubic removes (held-out error {cubic} instead of {chosen} "
        f"{unit}). A robot file holds no cubic."
    )


def _sentence_on_published_law(finding: Finding) -> str:
    values = ", ".join(f"{name} {number_text(value, 6)}" for name, value in finding.values.items())
    return f"The published law has {values}, released at 0 s."


TESTSTAND: dict[str, Template] = {
    "test_left_out": "Left out: {error}.",
    "rows_without_speed": "{rows} rows with thrust at speed 0 are left out: the speed sensor failed.",
    "few_steps": (
        "{rising} rising and {falling} falling steps: two of each are needed to tell the time constants apart."
    ),
    "rows_far_apart": (
        "Rows are {step_s:number} s apart: time constants near that are less certain than their intervals."
    ),
    "mass_exact": "The mass is taken as exact: its relative error is that of c_t. Give --mass-std-kg.",
    "thrust_from_gravity": "Without accelerometer, thrust is taken as m g over the cosine of the tilt.",
    "scatter_unknown": (
        "The scatter between logs is known from {repeats} repeats, but {needed} are needed. "
        "Nothing is excluded: give more logs in --baseline or --repeats."
    ),
    "no_unseen_log": "One flight and no --test: no log is left to judge the fit on.",
    "flights_differ": "The flights differ from the logs that they are judged on by more than scatter.",
    "balance_assumptions": (
        "Thrust is taken as proportional to squared speed or voltage, and the baseline as balanced about the declared centre "
        "of mass. Its uneven shares count as uneven motors."
    ),
    "mass_added": "All candidates carry {added_kg:g} kg more than the baseline.",
    "battery_range": (
        "Battery: baseline {baseline_v[0]:.2f} to {baseline_v[1]:.2f} V, flights {flights_v[0]:.2f} to {flights_v[1]:.2f} V. "
        "The sum depends on it."
    ),
    "other_cause": "Any other cause has a probability of {probability:number2}.",
    "curvature_kept": _curvature_sentence,
    "weigh_vehicle": "To tell them apart, weigh the vehicle and give --added-mass-kg: only a payload adds mass.",
    "measure_thrust": (
        "To tell them apart, measure the total thrust at a known voltage: a weak propeller loses some, a payload none."
    ),
    "turn_with_gyro": (
        "To tell them apart, turn with a gyro: a weight adds inertia, a weak propeller turns its arm more slowly."
    ),
    "swap_propeller": "To tell them apart, exchange the propeller of that motor: a weak propeller goes with it.",
    "joint_driven": "Joint {subject} is left out: it has a drive, whose effort is not logged.",
    "joint_creeps": "Joint {subject} is left out: it creeps, which identify joint fits from a bench record.",
    "links_as_declared": (
        "Masses of links and thrusts are taken as declared: 1 % more inertia of a link is 1 % more of its numbers."
    ),
    "thrust_scale_fitted": (
        "Masses of links are taken as declared. A scale of all thrusts and constant sensor errors are fitted too."
    ),
    "intervals_of_flights": "Intervals hold the scatter within these flights, but no error of the declaration.",
    "published_law": _sentence_on_published_law,
    "axes_open": (
        "The throws do not tell principal moments {first} and {second} apart: their axes may lie anywhere in their plane."
    ),
    "one_record": "This is one record of one joint: its intervals hold for this record only.",
}
"""Templates of findings of the test stand, by code."""
