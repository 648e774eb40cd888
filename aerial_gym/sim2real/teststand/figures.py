"""Figures of test stand identifications: data with fit, and the residuals below."""

from typing import TYPE_CHECKING

import numpy as np

from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.teststand.hover import HoverFit
from aerial_gym.sim2real.teststand.joints.record import JointStudy
from aerial_gym.sim2real.teststand.static import StaticFit
from aerial_gym.sim2real.teststand.step import StepFit

if TYPE_CHECKING:
    from matplotlib.figure import Figure


BEFORE, AFTER, DATA = "#b0413e", "#2a6f97", "#333333"


def _comparison_figure(
    x: Array, measured: Array, before: Array, after: Array, names: tuple[str, str], labels: tuple[str, str]
) -> "Figure":
    """Return a figure of measurements with two predictions (upper) and their residuals (lower)."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.0, 6.0))
    upper, lower = figure.subplots(2, 1, sharex=True)
    order = np.argsort(x, kind="stable")
    upper.plot(x, measured, ".", color=DATA, markersize=4, label="measured")
    for prediction, color, name in ((before, BEFORE, names[0]), (after, AFTER, names[1])):
        upper.plot(x[order], prediction[order], color=color, linewidth=1.0, label=name)
        lower.plot(x[order], (measured - prediction)[order], ".-", color=color, linewidth=0.7, markersize=3)
    lower.axhline(0.0, color="black", linewidth=0.4)
    upper.set_ylabel(labels[1])
    lower.set_ylabel("measured minus predicted")
    lower.set_xlabel(labels[0])
    upper.legend(fontsize=8)
    return figure


def static_figures(fit: StaticFit) -> "dict[str, Figure]":
    """Return the figures of thrust and torque against speed."""
    panels = {}
    for name, values, choice in (("thrust", fit.thrust, fit.thrust_map), ("torque", fit.torque, fit.torque_map)):
        if values is None or choice is None:
            continue
        before, after = choice.candidates["w²"].polynomial_values(fit.speed), choice.best.polynomial_values(fit.speed)
        if choice.chosen == "torque ratio":
            after = choice.best.params["ratio"].value * fit.thrust_map.best.polynomial_values(fit.speed)
        labels = ("speed [rad/s]", f"{name} [{choice.unit}]")
        panels[name] = _comparison_figure(fit.speed, values, before, after, ("w²", choice.chosen), labels)
    return panels


def step_figures(lag: StepFit) -> "dict[str, Figure]":
    """Return the figures of measured and predicted speed of every record against time."""
    names = ("one time constant", lag.chosen)
    panels, offset = {}, 0
    for number, record in enumerate(lag.records, start=1):
        rows = slice(record.starts[0], None)
        measured = record.measured[rows]
        part = slice(offset, offset + measured.size)
        before, after = (measured - lag.laws[name].residual[part] for name in names)
        labels = ("t [s]", "speed [rad/s]")
        panels[f"steps_{number}"] = _comparison_figure(record.time[rows], measured, before, after, names, labels)
        offset += measured.size
    return panels


def joint_figures(study: JointStudy) -> "dict[str, Figure]":
    """Return the figures of the angle against time, complete and in the first second."""
    record, names = study.record, ("published", study.chosen)
    measured = np.degrees(record.angle)
    before = measured - np.degrees(study.published)
    after = measured - np.degrees(study.laws[study.chosen].residual)
    early = record.time < 1.0
    labels = ("t [s]", "angle [deg]")
    return {
        "joint": _comparison_figure(record.time, measured, before, after, names, labels),
        "joint_first_second": _comparison_figure(
            record.time[early], measured[early], before[early], after[early], names, labels
        ),
    }


def hover_figures(fit: HoverFit) -> "dict[str, Figure]":
    """Return the figure of thrust over mass against the sum of squared speeds."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.0, 4.0))
    axis = figure.subplots()
    axis.plot(fit.square_sum, fit.force, ".", color=DATA, label="windows")
    ends = np.array([fit.square_sum.min(), fit.square_sum.max()])
    axis.plot(ends, fit.thrust_coefficient.value * ends / fit.mass, color=AFTER, label="c_t w²")
    axis.set_xlabel("sum of squared speeds [rad²/s²]")
    axis.set_ylabel("thrust over mass [m/s²]")
    axis.legend(fontsize=8)
    return {"hover": figure}
