"""Sentences of notes on the test stand, and of experiments that distinguish candidates."""

from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.wording.words import number, quantity_value


def _curvature(finding: Finding) -> str:
    values = finding.values
    unit = "N" if "cubic_n" in values else "N m"
    cubic, chosen = (number(quantity_value(values, name, unit)) for name in ("cubic", "chosen"))
    return (
        f"The {values['quantity']} residual keeps a curvature that a cubic removes (held-out error {cubic} instead of {chosen} "
        f"{unit}). A robot file holds no cubic."
    )


def _publication(finding: Finding) -> str:
    values = ", ".join(f"{name} {number(value, 6)}" for name, value in finding.values.items())
    return f"The published law has {values}, released at 0 s."


TESTSTAND = {
    "test_left_out": lambda f: f"Left out: {f.values['error']}.",
    "rows_without_speed": lambda f: (
        f"{f.values['rows']} rows with thrust at speed 0 are left out: the speed sensor failed."
    ),
    "few_steps": lambda f: (
        f"{f.values['rising']} rising and {f.values['falling']} falling steps: two of each are needed to tell the time "
        "constants apart."
    ),
    "rows_far_apart": lambda f: (
        f"Rows are {number(f.values['step_s'])} s apart: time constants near that are less certain than their intervals."
    ),
    "mass_exact": "The mass is taken as exact: its relative error is that of c_t. Give --mass-std-kg.",
    "thrust_from_gravity": "Without accelerometer, thrust is taken as m g over the cosine of the tilt.",
    "scatter_unknown": lambda f: (
        f"The scatter between logs is known from {f.values['repeats']} repeats, but {f.values['needed']} are needed. "
        "Nothing is excluded: give more logs in --baseline or --repeats."
    ),
    "no_unseen_log": "One flight and no --test: no log is left to judge the fit on.",
    "flights_differ": "The flights differ from the logs that they are judged on by more than scatter.",
    "balance_assumptions": (
        "Thrust is taken as proportional to squared speed or voltage, and the baseline as balanced about the declared centre "
        "of mass. Its uneven shares count as uneven motors."
    ),
    "mass_added": lambda f: f"All candidates carry {f.values['added_kg']:g} kg more than the baseline.",
    "battery_range": lambda f: (
        f"Battery: baseline {f.values['baseline_v'][0]:.2f} to {f.values['baseline_v'][1]:.2f} V, flights "
        f"{f.values['flights_v'][0]:.2f} to {f.values['flights_v'][1]:.2f} V. The sum depends on it."
    ),
    "other_cause": lambda f: f"Any other cause has a probability of {number(f.values['probability'], 2)}.",
    "curvature_kept": _curvature,
    "weigh_vehicle": "To tell them apart, weigh the vehicle and give --added-mass-kg: only a payload adds mass.",
    "measure_thrust": (
        "To tell them apart, measure the total thrust at a known voltage: a weak propeller loses some, a payload none."
    ),
    "turn_with_gyro": (
        "To tell them apart, turn with a gyro: a weight adds inertia, a weak propeller turns its arm more slowly."
    ),
    "swap_propeller": "To tell them apart, exchange the propeller of that motor: a weak propeller goes with it.",
    "joint_driven": lambda f: f"Joint {f.subject} is left out: it has a drive, whose effort is not logged.",
    "joint_creeps": lambda f: (
        f"Joint {f.subject} is left out: it creeps, which identify joint fits from a bench record."
    ),
    "links_as_declared": (
        "Masses of links and thrusts are taken as declared: 1 % more inertia of a link is 1 % more of its numbers."
    ),
    "thrust_scale_fitted": (
        "Masses of links are taken as declared. A scale of all thrusts and constant sensor errors are fitted too."
    ),
    "intervals_of_flights": "Intervals hold the scatter within these flights, but no error of the declaration.",
    "published_law": _publication,
    "one_record": "This is one record of one joint: its intervals hold for this record only.",
}
"""Template of each code: a text, or a function of the finding."""
