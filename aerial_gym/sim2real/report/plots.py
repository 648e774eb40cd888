"""Figures of a report as PNG text that stands inside the page."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray
from scipy import signal

from aerial_gym.sim2real.judge.evaluation import Evaluation
from aerial_gym.sim2real.logs.flights import Flight
from aerial_gym.sim2real.predict.channels import Channel
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.predict.predictor import Predictor
from aerial_gym.sim2real.predict.rollout import QUANTITIES
from aerial_gym.sim2real.report.canvas import legend, panels, png, zero_line
from aerial_gym.sim2real.report.profiles import FEWEST_ROWS, Profile, bin_edges, place_in

Array = NDArray[np.float64]

DECLARED, CORRECTED, MEASURED, FLOOR = "#b0413e", "#2a6f97", "#222222", "#888888"
COLOURS = {"declared": DECLARED, "corrected": CORRECTED}
SHOWN_KINDS = ("specific_force", "angular_acceleration", "rotor_speed")

SEGMENT_S = 8.0
"""Of a spectrum [s]."""

TRACE_S = 5.0
"""Of what is measured and predicted, drawn as it is [s]."""


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

    quantities: dict[str, Array]
    """Against which it is drawn, each (T,)."""


def traces(predictor: Predictor, models: Mapping[str, ModelParams], kind: str) -> str:
    """Return one flight over time: measured and predicted in its most telling seconds, and what is left of all of it.

    Most telling is where the models differ most; of one model alone, where it misses most.

    Args:
        predictor: The flights.
        models: By name, the declared one first.
        kind: Of the channels.
    """
    places = [place for place, channel in enumerate(predictor.channels) if channel.kind == kind]
    predicted = {name: predictor.predict(params) for name, params in models.items()}
    first, *others = predicted.values()
    against = others[0] if others and _differ(first, others[0], places) else predictor.measured
    change = [np.square(a[:, places] - b[:, places]) for a, b in zip(first, against, strict=True)]
    size = np.maximum(np.concatenate(change).mean(axis=0), 1e-300)
    telling = [(part / size).sum(axis=1) for part in change]
    index = int(np.argmax([part.mean() for part in telling]))
    time, measured = predictor.times[index], predictor.measured[index]
    window = _span(time, telling[index])
    title = f"{kind.replace('_', ' ')}, {predictor.flights[index].name}: measured and predicted"
    figure, axes = panels(len(places), 2, width=(4.6, 5.2), height=1.25, title=title, gap=(0.62, 0.12), sharex=True)
    for (left, right), place in zip(axes, places, strict=True):
        left.plot(time[window], measured[window, place], color=MEASURED, linewidth=1.2, label="measured")
        for model, flights in predicted.items():
            values, colour = flights[index][:, place], COLOURS[model]
            left.plot(time[window], values[window], color=colour, linewidth=0.8, label=model)
            right.plot(time, measured[:, place] - values, color=colour, linewidth=0.6, label=model)
        left.set_ylabel(f"{predictor.channels[place].axis} [{predictor.channels[place].unit}]", fontsize=8, labelpad=2)
        zero_line(right)
    axes[0, 1].set_title("measured minus predicted", fontsize=9, pad=3, loc="left")
    legend(figure, axes[0, 0])
    for axis in axes[-1]:
        axis.set_xlabel("t [s]", fontsize=8, labelpad=1)
    return png(figure)


def _differ(one: Sequence[Array], other: Sequence[Array], places: Sequence[int]) -> bool:
    return any(np.any(a[:, places] != b[:, places]) for a, b in zip(one, other, strict=True))


def _span(time: Array, size: Array) -> NDArray[np.bool_]:
    """Return the rows of the ``TRACE_S`` in which a size (T,) adds up to most."""
    ends = np.searchsorted(time, time + TRACE_S)
    total = np.concatenate(([0.0], np.cumsum(size)))
    whole = time <= max(time[-1] - TRACE_S, time[0])
    start = int(np.argmax(np.where(whole, total[ends] - total[:-1], -np.inf)))
    return (time >= time[start]) & (time <= time[start] + TRACE_S)


def residual_profiles(found: Sequence[Profile], channels: Sequence[Channel], kind: str) -> str:
    """Return the mean residual of the channels of one kind against each quantity, a line per model, with standard errors."""
    places = [place for place, channel in enumerate(channels) if channel.kind == kind]
    title = kind.replace("_", " ")
    figure, axes = panels(len(places), len(found), width=2.35, height=1.25, title=title, gap=(0.5, 0.12), sharex=True)
    for row, place in zip(axes, places, strict=True):
        for axis, profile in zip(row, found, strict=True):
            for model, means in profile.residual.items():
                _means(axis, profile.middle, means.mean[:, place], means.half_width[:, place], COLOURS[model], model)
            zero_line(axis)
        row[0].set_ylabel(f"{channels[place].axis} [{channels[place].unit}]", fontsize=8, labelpad=2)
    for axis, profile in zip(axes[-1], found, strict=True):
        axis.set_xlabel(profile.against, fontsize=8, labelpad=1)
    legend(figure, axes[0, 0])
    return png(figure)


def _means(axis: Axes, at: Array, mean: Array, half_width: Array, colour: str, label: str) -> None:
    known = np.isfinite(half_width)
    axis.errorbar(
        at[known],
        mean[known],
        yerr=half_width[known],
        color=colour,
        linewidth=0.8,
        elinewidth=0.8,
        capsize=1.5,
        marker="o",
        markersize=2.2,
        label=label,
    )


def what_remains(parts: Sequence[Rest], channel: Channel) -> str:
    """Return the spectrum of a rest, and its means against place, speed, time and voltage, flight by flight.

    What all flights have alike is structure; what differs from flight to flight is noise.
    """
    titles = [title for title in parts[0].quantities if all(title in part.quantities for part in parts)]
    columns = min(4, 1 + len(titles))
    rows = -(-(1 + len(titles)) // columns)
    title = channel.name
    figure, grid = panels(rows, columns, width=2.35, height=1.5, title=title, gap=(0.6, 0.5))
    axes = grid.ravel()
    for part in parts:
        rate = 1.0 / float(np.median(np.diff(part.time)))
        length = min(part.values.size, round(SEGMENT_S * rate))
        frequency, density = signal.welch(part.values, rate, nperseg=length, detrend="linear")
        axes[0].semilogy(frequency[1:], np.sqrt(density[1:]), linewidth=0.7, alpha=0.7)
    axes[0].set_xlabel("frequency [Hz]", fontsize=8, labelpad=1)
    axes[0].set_ylabel(f"{channel.unit} / √Hz", fontsize=8, labelpad=2)
    for axis, title in zip(axes[1:], titles, strict=False):
        turned = title in PLACES and channel.kind == "specific_force"
        _per_flight(axis, [p.quantities[title] for p in parts], [p.world if turned else p.values for p in parts])
        axis.set_xlabel(title, fontsize=8, labelpad=1)
        axis.set_ylabel(f"{'world ' if turned else ''}[{channel.unit}]", fontsize=8, labelpad=2)
    for axis in axes[1 + len(titles) :]:
        axis.remove()
    return png(figure)


PLACES = ("x [m]", "y [m]", "height [m]")
"""Against these a force is drawn in world axes."""


def _per_flight(axis: Axes, places: Sequence[Array], values: Sequence[Array]) -> None:
    """Draw means over bins of equal count, a line per flight and a thick one of all."""
    edges = bin_edges(np.concatenate(places))
    if edges.size < 3:
        return
    together = np.concatenate(places), np.concatenate(values)
    for place, value in (*zip(places, values, strict=True), together):
        thick = place is together[0]
        index = place_in(edges, place)
        count = np.maximum(np.bincount(index, minlength=edges.size - 1), 1)
        means = [np.bincount(index, weights=v, minlength=edges.size - 1) / count for v in (place, value)]
        enough = count >= FEWEST_ROWS
        axis.plot(
            means[0][enough],
            means[1][enough],
            linewidth=2.0 if thick else 0.7,
            alpha=1.0 if thick else 0.6,
            color=CORRECTED if thick else None,
        )
    zero_line(axis)


def residual_bars(before: Evaluation, after: Evaluation | None) -> str:
    """Return the residual of each channel before and after, with intervals and noise floor, one panel per unit."""
    kinds = [kind for kind in SHOWN_KINDS if any(channel.kind == kind for channel in before.channels)]
    title = "residual (rms)"
    figure, axes = panels(1, len(kinds), width=2.9, height=2.1, title=title, gap=(0.55, 0.0))
    for axis, kind in zip(axes[0], kinds, strict=True):
        places = [place for place, channel in enumerate(before.channels) if channel.kind == kind]
        channels = [before.channels[place] for place in places]
        _bars(axis, [c.axis for c in channels], [[e.residual[p] for p in places] for e in (before, after) if e])
        if before.floor is not None:
            for at, place in enumerate(places):
                axis.plot([at - 0.4, at + 0.4], [before.floor[place]] * 2, color=FLOOR, linestyle="--", linewidth=1.2)
        axis.set_xlabel(f"{kind.replace('_', ' ')} [{channels[0].unit}]", fontsize=8, labelpad=1)
    legend(figure, axes[0, 0])
    return png(figure)


def rollout_bars(before: Evaluation, after: Evaluation | None, variant: str) -> str:
    """Return open-loop errors by horizon, before and after."""
    quantities = list(before.rollout[variant])
    title = "open-loop error (rms)"
    figure, axes = panels(1, len(quantities), width=2.9, height=2.1, title=title, gap=(0.55, 0.0))
    for axis, quantity in zip(axes[0], quantities, strict=True):
        horizons = list(before.rollout[variant][quantity])
        rows = [list(e.rollout[variant][quantity].values()) for e in (before, after) if e]
        _bars(axis, [f"{h:g} s" for h in horizons], rows)
        axis.set_yscale("log")
        axis.set_xlabel(f"{quantity} [{QUANTITIES[quantity]}]", fontsize=8, labelpad=1)
    legend(figure, axes[0, 0])
    return png(figure)


def _bars(axis: Axes, labels: Sequence[str], rows: Sequence[Sequence]) -> None:
    width = 0.8 / len(rows)
    for index, (values, color) in enumerate(zip(rows, (DECLARED, CORRECTED), strict=False)):
        at = np.arange(len(labels)) + (index - 0.5 * (len(rows) - 1)) * width
        height = np.array([value.value for value in values])
        spread = np.array([[v.value - v.low for v in values], [v.high - v.value for v in values]])
        name = ("declared", "corrected")[index]
        axis.bar(
            at, height, width, yerr=np.maximum(spread, 0.0), color=color, capsize=2, label=name, error_kw={"lw": 0.8}
        )
    axis.set_xticks(np.arange(len(labels)), labels, fontsize=8)
