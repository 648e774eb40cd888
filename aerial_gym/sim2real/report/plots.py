"""Figures of a report as HTML with inline SVG."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from aerial_gym.sim2real.arrays import Array, Flags
from aerial_gym.sim2real.judge.evaluation import ModelEvaluation
from aerial_gym.sim2real.logs.flights import values_in_all_mappings
from aerial_gym.sim2real.logs.signals import welch
from aerial_gym.sim2real.predict.channels import Channel
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.predict.predictor import Predictor
from aerial_gym.sim2real.predict.rollout import QUANTITIES
from aerial_gym.sim2real.report.canvas import Panel, panels
from aerial_gym.sim2real.report.profiles import FEWEST_ROWS, ResidualProfile, bin_edges, bin_index
from aerial_gym.sim2real.statistics import Rms

DECLARED, CORRECTED, MEASURED, FLOOR = "var(--red)", "var(--blue)", "var(--ink)", "var(--amber)"
COLOURS = {"declared": DECLARED, "corrected": CORRECTED}
SHOWN_KINDS = ("specific_force", "angular_acceleration", "rotor_speed")

FLIGHTS = tuple(f"var(--c{number})" for number in range(10))
"""Colours of flights, repeated in order."""

SEGMENT_S = 8.0  # Segment length of a spectrum [s]
TRACE_S = 5.0  # Duration of the detailed trace [s]


@dataclass(frozen=True)
class FlightResidual:
    """Residual of one channel in one flight under the corrected model."""

    time: Array  # [s], (T,)
    values: Array  # Residual in body axes, (T,)
    world: Array  # Residual in world axes for a force, else the same, (T,)
    quantities: dict[str, Array]  # Quantities on the horizontal axes, (T,) each


def trace_figure(predictor: Predictor, models: Mapping[str, ModelParams], kind: str) -> str:
    """Return the time course of one flight: its most informative seconds, and the residual of the whole flight.

    The flight and seconds are those with the largest difference between the models, or from the measurement.
    """
    places = [place for place, channel in enumerate(predictor.channels) if channel.kind == kind]
    predicted = {name: predictor.predict(params) for name, params in models.items()}
    first, *rest = predicted.values()
    changes = ([np.square(a - b)[:, places] for a, b in zip(first, other, strict=True)] for other in rest)
    to_measured = [np.square(a - b)[:, places] for a, b in zip(first, predictor.measured, strict=True)]
    change = next((change for change in changes if any(map(np.any, change))), to_measured)
    size = np.maximum(np.concatenate(change).mean(axis=0), 1e-300)
    telling = [(part / size).sum(axis=1) for part in change]
    index = int(np.argmax([part.mean() for part in telling]))
    time, measured = predictor.times[index], predictor.measured[index]
    window = _most_informative_rows(time, telling[index])
    title = f"{kind.replace('_', ' ').capitalize()}, {predictor.flights[index].name}: measured and predicted"
    figure, axes = panels(len(places), 2, width=(4.6, 5.2), height=1.25, title=title, sharex=True, zooms=True)
    for (left, right), place in zip(axes, places, strict=True):
        left.line(time[window], measured[window, place], MEASURED, width=1.2, label="measured")
        for model, flights in predicted.items():
            values, colour = flights[index][:, place], COLOURS[model]
            left.line(time[window], values[window], colour, label=model)
            right.line(time, measured[:, place] - values, colour, width=0.6)
        left.y_label = right.y_label = _axis_label(predictor.channels[place])
        right.levels.append(0.0)
    axes[0][1].title = "measured minus predicted"
    figure.legend = axes[0][0].marks
    for panel in axes[-1]:
        panel.x_label = "t [s]"
    return figure.html()


def _axis_label(channel: Channel) -> str:
    return f"{channel.axis} [{channel.unit}]"


def _most_informative_rows(time: Array, size: Array) -> Flags:
    """Return the rows of the ``TRACE_S`` window with the largest sum of ``size`` (T,)."""
    ends = np.searchsorted(time, time + TRACE_S)
    total = np.concatenate(([0.0], np.cumsum(size)))
    whole = time <= max(time[-1] - TRACE_S, time[0])
    start = int(np.argmax(np.where(whole, total[ends] - total[:-1], -np.inf)))
    return (time >= time[start]) & (time <= time[start] + TRACE_S)


def profile_figure(profiles: Sequence[ResidualProfile], channels: Sequence[Channel], kind: str) -> str:
    """Return the mean residual of one kind of channel against each quantity, per model with standard errors."""
    places = [place for place, channel in enumerate(channels) if channel.kind == kind]
    title = f"Mean residual of the {kind.replace('_', ' ')}"
    figure, axes = panels(len(places), len(profiles), width=2.35, height=1.25, title=title, sharex=True)
    for row, place in zip(axes, places, strict=True):
        for panel, profile in zip(row, profiles, strict=True):
            for model, means in profile.residual.items():
                known = np.isfinite(means.half_width[:, place])
                at, mean, half = profile.middle[known], means.mean[known, place], means.half_width[known, place]
                panel.line(at, mean, COLOURS[model], label=model)
                panel.dots(at, mean, COLOURS[model], width=2.2)
                panel.error_bars(at, mean - half, mean + half, COLOURS[model])
            panel.levels.append(0.0)
            panel.y_label = _axis_label(channels[place])
    for panel, profile in zip(axes[-1], profiles, strict=True):
        panel.x_label = profile.against
    figure.legend = [mark for mark in axes[0][0].marks if mark.label]
    return figure.html()


def residual_figure(parts: Sequence[FlightResidual], channel: Channel) -> str:
    """Return the residual's spectrum and its means against place, speed, time and voltage, per flight.

    Features common to all flights are structure; differences between flights are noise.
    """
    against = values_in_all_mappings([part.quantities for part in parts])
    columns = min(4, 1 + len(against))
    rows = -(-(1 + len(against)) // columns)
    figure, grid = panels(
        rows, columns, width=2.35, height=1.5, title=f"Residual of the {channel.name.replace('_', ' ')}"
    )
    first, *rest = (panel for row in grid for panel in row)
    for place, part in enumerate(parts):
        rate = 1.0 / float(np.median(np.diff(part.time)))
        length = min(part.values.size, round(SEGMENT_S * rate))
        frequency, density = welch(part.values[:, None], rate, length)
        first.line(frequency[1:], np.sqrt(density[1:, 0]), FLIGHTS[place % len(FLIGHTS)], width=0.7, alpha=0.7)
    first.log, first.x_label, first.y_label = True, "frequency [Hz]", f"{channel.unit} / √Hz"
    for panel, (title, places) in zip(rest, against.items(), strict=False):
        turned = title in PLACES and channel.kind == "specific_force"
        _draw_means_by_flight(panel, places, [part.world if turned else part.values for part in parts])
        panel.x_label, panel.y_label = title, f"{'world ' if turned else ''}[{channel.unit}]"
    return figure.html()


PLACES = ("x [m]", "y [m]", "height [m]")  # Quantities against which forces are plotted in world axes


def _draw_means_by_flight(panel: Panel, places: Sequence[Array], values: Sequence[Array]) -> None:
    """Draw means over bins of equal count: a thin line per flight, and a thick one for all."""
    edges = bin_edges(np.concatenate(places))
    if edges.size < 3:
        return
    together = np.concatenate(places), np.concatenate(values)
    for number, (place, value) in enumerate((*zip(places, values, strict=True), together)):
        thick = place is together[0]
        index = bin_index(edges, place)
        count = np.maximum(np.bincount(index, minlength=edges.size - 1), 1)
        means = [np.bincount(index, weights=v, minlength=edges.size - 1) / count for v in (place, value)]
        enough = count >= FEWEST_ROWS
        colour = CORRECTED if thick else FLIGHTS[number % len(FLIGHTS)]
        panel.line(means[0][enough], means[1][enough], colour, width=2.0 if thick else 0.7, alpha=1.0 if thick else 0.6)
    panel.levels.append(0.0)


def residual_bars(before: ModelEvaluation, after: ModelEvaluation | None) -> str:
    """Return the RMS residual of each channel before and after, with intervals and noise floor, one panel per unit."""
    kinds = [kind for kind in SHOWN_KINDS if any(channel.kind == kind for channel in before.channels)]
    figure, axes = panels(1, len(kinds), width=2.9, height=2.1, title="Residuals (rms)")
    for panel, kind in zip(axes[0], kinds, strict=True):
        places = [place for place, channel in enumerate(before.channels) if channel.kind == kind]
        channels = [before.channels[place] for place in places]
        _draw_bars(panel, [c.axis for c in channels], [[e.residual[p] for p in places] for e in (before, after) if e])
        if before.floor is not None:
            for at, place in enumerate(places):
                ends = np.array([at - 0.4, at + 0.4])
                label = "" if at else "noise floor"
                panel.line(ends, np.full(2, before.floor[place]), FLOOR, width=1.6, dashed=True, label=label)
        panel.x_label = f"{kind.replace('_', ' ')} [{channels[0].unit}]"
    figure.legend = [mark for mark in axes[0][0].marks if mark.label]
    return figure.html()


def rollout_bars(before: ModelEvaluation, after: ModelEvaluation | None, variant: str, title: str) -> str:
    """Return rollout errors by horizon, before and after."""
    quantities = list(before.rollout[variant])
    figure, axes = panels(1, len(quantities), width=2.9, height=2.1, title=f"Open-loop errors (rms). {title}")
    for panel, quantity in zip(axes[0], quantities, strict=True):
        horizons = list(before.rollout[variant][quantity])
        rows = [list(e.rollout[variant][quantity].values()) for e in (before, after) if e]
        _draw_bars(panel, [f"{h:g} s" for h in horizons], rows)
        panel.log, panel.x_label = True, f"{quantity} [{QUANTITIES[quantity]}]"
    figure.legend = [mark for mark in axes[0][0].marks if mark.label]
    return figure.html()


def _draw_bars(panel: Panel, names: Sequence[str], rows: Sequence[Sequence[Rms]]) -> None:
    """Draw one bar with interval per name and model."""
    width, panel.names = 0.8 / len(rows), names
    for index, (values, (model, colour)) in enumerate(zip(rows, COLOURS.items(), strict=False)):
        at = np.arange(len(names)) + (index - 0.5 * (len(rows) - 1)) * width
        value, low, high = np.array([(v.value, v.low, v.high) for v in values]).T
        panel.bars(at, value, width, colour, label=model)
        panel.error_bars(at, np.minimum(low, value), np.maximum(high, value), MEASURED)
