"""Figures of a report as PNG text that stands inside the page."""

import base64
import io
from collections.abc import Sequence

import matplotlib

matplotlib.use("Agg", force=False)

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from aerial_gym.physics import EFFECTS
from aerial_gym.sim2real.evaluation import Evaluation
from aerial_gym.sim2real.fit import effect_jacobian, scales
from aerial_gym.sim2real.prediction import Channel, Point, Predictor
from aerial_gym.sim2real.rollout import QUANTITIES

Array = NDArray[np.float64]

BEFORE, AFTER, FLOOR = "#b0413e", "#2a6f97", "#888888"
MOST_POINTS = 4000
SHOWN_KINDS = ("specific_force", "angular_acceleration", "rotor_speed")


def png(figure: Figure) -> str:
    """Return a figure as the text of a PNG in base 64."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=90, bbox_inches="tight")
    return base64.b64encode(buffer.getvalue()).decode("ascii")


def residuals_over_time(predictor: Predictor, before: Point, after: Point | None, kind: str) -> str:
    """Return the residual of one kind of channel in the first flight, before and after."""
    places = [place for place, channel in enumerate(predictor.channels) if channel.kind == kind]
    figure = Figure(figsize=(10.0, 1.6 * len(places)))
    axes = figure.subplots(len(places), 1, sharex=True, squeeze=False)[:, 0]
    first, time = predictor.residuals(before)[0], predictor.times[0]
    second = None if after is None else predictor.residuals(after)[0]
    for axis, place in zip(axes, places, strict=True):
        channel = predictor.channels[place]
        axis.plot(time, first[:, place], color=BEFORE, linewidth=0.8, label="declared")
        if second is not None:
            axis.plot(time, second[:, place], color=AFTER, linewidth=0.8, label="corrected")
        axis.set_ylabel(f"{channel.axis} [{channel.unit}]")
        axis.axhline(0.0, color="black", linewidth=0.4)
    axes[0].legend(loc="upper right", fontsize=8)
    axes[0].set_title(f"measured minus predicted {kind.replace('_', ' ')}, {predictor.flights[0].name}", fontsize=10)
    axes[-1].set_xlabel("t [s]")
    return png(figure)


def evidence(predictor: Predictor, point: Point, effect: str, neutral: Array) -> str:
    """Return, for each parameter, the residual without the effect against what the parameter would change.

    The slope of the line is the fitted value: a straight cloud is evidence, a round one is none.
    """
    known = EFFECTS.get(effect).parameters
    predicted = predictor.predict(point)
    jacobian = np.concatenate(effect_jacobian(predictor, point, (effect,), predicted))
    left = np.concatenate([m - p for m, p in zip(predictor.measured, predicted, strict=True)])
    change = (point.effects[effect] - neutral) / scales((effect,))
    figure = Figure(figsize=(3.4 * len(known), 3.0))
    axes = figure.subplots(1, len(known), squeeze=False)[0]
    for k, (axis, parameter) in enumerate(zip(axes, known, strict=True)):
        # The channel in which this parameter stands out most from what is left.
        place = int(np.argmax((jacobian[:, :, k] ** 2).mean(axis=0) / np.maximum((left**2).mean(axis=0), 1e-30)))
        _cloud(axis, predictor.channels[place], jacobian[:, place, k], left[:, place], change[k])
        axis.set_xlabel(f"change by {parameter.scale:g} {parameter.unit} of {parameter.name}", fontsize=8)
    figure.suptitle(f"{effect}: what remains without it, against what it would add", fontsize=10)
    figure.tight_layout()
    return png(figure)


def _cloud(axis: Axes, channel: Channel, regressor: Array, left: Array, change: float) -> None:
    step = max(1, regressor.size // MOST_POINTS)
    without = left + regressor * change
    axis.plot(regressor[::step], without[::step], ".", markersize=1.5, alpha=0.4, color=BEFORE)
    ends = np.array([regressor.min(), regressor.max()])
    axis.plot(ends, change * ends, color=AFTER, linewidth=1.5)
    axis.set_ylabel(f"{channel.kind.replace('_', ' ')} {channel.axis} [{channel.unit}]", fontsize=8)
    axis.tick_params(labelsize=7)


def residual_bars(before: Evaluation, after: Evaluation | None) -> str:
    """Return the residual of each channel before and after, with intervals and noise floor, one panel per unit."""
    kinds = [kind for kind in SHOWN_KINDS if any(channel.kind == kind for channel in before.channels)]
    figure = Figure(figsize=(3.6 * len(kinds), 3.0))
    axes = figure.subplots(1, len(kinds), squeeze=False)[0]
    for axis, kind in zip(axes, kinds, strict=True):
        places = [place for place, channel in enumerate(before.channels) if channel.kind == kind]
        channels = [before.channels[place] for place in places]
        _bars(axis, [c.axis for c in channels], [[e.residual[p] for p in places] for e in (before, after) if e])
        if before.floor is not None:
            for at, place in enumerate(places):
                axis.plot([at - 0.4, at + 0.4], [before.floor[place]] * 2, color=FLOOR, linestyle="--", linewidth=1.2)
        axis.set_title(f"{kind.replace('_', ' ')} [{channels[0].unit}]", fontsize=9)
    figure.suptitle("residual (rms) on the test flights; dashed: noise floor", fontsize=10)
    figure.tight_layout()
    return png(figure)


def rollout_bars(before: Evaluation, after: Evaluation | None, variant: str) -> str:
    """Return open-loop errors by horizon, before and after."""
    quantities = list(before.rollout[variant])
    figure = Figure(figsize=(3.6 * len(quantities), 3.0))
    axes = figure.subplots(1, len(quantities), squeeze=False)[0]
    for axis, quantity in zip(axes, quantities, strict=True):
        horizons = list(before.rollout[variant][quantity])
        rows = [list(e.rollout[variant][quantity].values()) for e in (before, after) if e]
        _bars(axis, [f"{h:g} s" for h in horizons], rows)
        axis.set_yscale("log")
        axis.set_title(f"{quantity} [{QUANTITIES[quantity]}]", fontsize=9)
    figure.suptitle("open-loop error (rms over windows)", fontsize=10)
    figure.tight_layout()
    return png(figure)


def _bars(axis: Axes, labels: Sequence[str], rows: Sequence[Sequence]) -> None:
    width = 0.8 / len(rows)
    for index, (values, color) in enumerate(zip(rows, (BEFORE, AFTER), strict=False)):
        at = np.arange(len(labels)) + (index - 0.5 * (len(rows) - 1)) * width
        height = np.array([value.value for value in values])
        spread = np.array([[v.value - v.low for v in values], [v.high - v.value for v in values]])
        name = ("declared", "corrected")[index]
        axis.bar(
            at, height, width, yerr=np.maximum(spread, 0.0), color=color, capsize=2, label=name, error_kw={"lw": 0.8}
        )
    axis.set_xticks(np.arange(len(labels)), labels, fontsize=8)
    axis.tick_params(labelsize=7)
    axis.legend(fontsize=7)
