"""Figures of a report as PNG text that stands inside the page."""

import base64
import io
from collections.abc import Sequence
from dataclasses import dataclass

import matplotlib

matplotlib.use("Agg", force=False)

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy import signal

from aerial_gym.physics import EFFECTS
from aerial_gym.sim2real.identify.least_squares.gauss_newton import effect_jacobian, scales
from aerial_gym.sim2real.judge.evaluation import Evaluation
from aerial_gym.sim2real.logs.flights import Flight
from aerial_gym.sim2real.predict.channels import Channel
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.predict.predictor import Predictor
from aerial_gym.sim2real.predict.rollout import QUANTITIES

Array = NDArray[np.float64]

BEFORE, AFTER, FLOOR = "#b0413e", "#2a6f97", "#888888"
MOST_POINTS = 4000
SHOWN_KINDS = ("specific_force", "angular_acceleration", "rotor_speed")


BINS = 16
"""Of a quantity against which a residual is drawn."""

SEGMENT_S = 8.0
"""Of a spectrum [s]."""


@dataclass(frozen=True, kw_only=True)
class Rest:
    """What remains of one channel in one flight."""

    flight: Flight
    time: Array
    """[s], (T,)."""

    values: Array
    """In body axes, (T,)."""

    world: Array
    """In world axes if it is a force, else the same, (T,)."""


def png(figure: Figure) -> str:
    """Return a figure as the text of a PNG in base 64."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=90, bbox_inches="tight")
    return base64.b64encode(buffer.getvalue()).decode("ascii")


def residuals_over_time(predictor: Predictor, before: ModelParams, after: ModelParams | None, kind: str) -> str:
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


def evidence(predictor: Predictor, point: ModelParams, effect: str, neutral: Array) -> str:
    """Return, for each parameter, the residual without the effect against what the parameter would change.

    The slope of the line is the fitted value: a straight cloud is evidence, a round one is none.
    """
    known = {k: parameter for k, parameter in enumerate(EFFECTS.get(effect).parameters) if parameter.kind == "number"}
    predicted = predictor.predict(point)
    jacobian = np.concatenate(effect_jacobian(predictor, point, (effect,), predicted))
    left = np.concatenate([m - p for m, p in zip(predictor.measured, predicted, strict=True)])
    change = (point.effects[effect] - neutral) / scales((effect,))
    figure = Figure(figsize=(3.4 * len(known), 3.0))
    axes = figure.subplots(1, len(known), squeeze=False)[0]
    for axis, (k, parameter) in zip(axes, known.items(), strict=True):
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


def what_remains(parts: Sequence[Rest], channel: Channel) -> str:
    """Return the spectrum of a rest, and its means against place, speed, time and voltage, flight by flight.

    What all flights have alike is structure; what differs from flight to flight is noise.
    """
    known = [[against(part) for part in parts], [part.values for part in parts], [part.world for part in parts]]
    titles = [title for title in known[0][0] if all(title in found for found in known[0])]
    figure = Figure(figsize=(3.4 * 4, 2.6 * (1 + len(titles) // 4)))
    axes = figure.subplots(1 + len(titles) // 4, 4, squeeze=False).ravel()
    for part in parts:
        rate = 1.0 / float(np.median(np.diff(part.time)))
        length = min(part.values.size, round(SEGMENT_S * rate))
        frequency, density = signal.welch(part.values, rate, nperseg=length, detrend="linear")
        axes[0].semilogy(frequency[1:], np.sqrt(density[1:]), linewidth=0.7, alpha=0.7)
    axes[0].set_xlabel("frequency [Hz]", fontsize=8)
    axes[0].set_ylabel(f"{channel.unit} / √Hz", fontsize=8)
    for axis, title in zip(axes[1:], titles, strict=False):
        values = known[2] if title in PLACES else known[1]
        _binned(axis, [found[title] for found in known[0]], values)
        axis.set_xlabel(title, fontsize=8)
        axis.set_ylabel(
            f"{'world ' if title in PLACES and channel.kind == 'specific_force' else ''}[{channel.unit}]", fontsize=8
        )
    for axis in axes:
        axis.tick_params(labelsize=7)
    for axis in axes[1 + len(titles) :]:
        axis.remove()
    figure.suptitle(f"{channel.name}: a line per flight, thick: all together", fontsize=10)
    figure.tight_layout()
    return png(figure)


PLACES = ("x [m]", "y [m]", "height [m]")


def against(part: Rest) -> dict[str, Array]:
    """Return the quantities against which a rest is drawn, as far as the log has them, each (T,)."""
    rows, flight = np.round(part.time * part.flight.rate).astype(int), part.flight
    found = {"time [s]": part.time}
    if flight.position is not None:
        found |= dict(zip(PLACES, flight.position[rows].T, strict=True))
    if flight.lin_vel is not None:
        found["speed [m/s]"] = np.linalg.norm(flight.lin_vel[rows], axis=1)
    if flight.battery is not None and np.ptp(flight.battery[rows]) > 0.0:
        found["voltage [V]"] = flight.battery[rows]
    return found


def _binned(axis: Axes, places: Sequence[Array], values: Sequence[Array]) -> None:
    """Draw means over bins of equal count, a line per flight and a thick one of all."""
    edges = np.unique(np.quantile(np.concatenate(places), np.linspace(0.0, 1.0, BINS + 1)))
    if edges.size < 3:
        return
    middle = 0.5 * (edges[1:] + edges[:-1])
    together = np.concatenate(places), np.concatenate(values)
    for place, value in (*zip(places, values, strict=True), together):
        thick = place is together[0]
        index = np.clip(np.searchsorted(edges, place, side="right") - 1, 0, middle.size - 1)
        count = np.bincount(index, minlength=middle.size)
        mean = np.bincount(index, weights=value, minlength=middle.size) / np.maximum(count, 1)
        axis.plot(
            middle[count > 4],
            mean[count > 4],
            linewidth=2.0 if thick else 0.7,
            alpha=1.0 if thick else 0.6,
            color=AFTER if thick else None,
        )
    axis.axhline(0.0, color="black", linewidth=0.4)


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
