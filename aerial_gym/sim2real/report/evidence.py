"""Evidence for an effect: the residual without it against its predicted contribution.

All channels share one plot, in units of their weight in the fit, so the fitted value is the least-squares line through all
points. The legend gives the value from each single channel. Letters: S rows of all flights.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from aerial_gym.physics import EFFECTS
from aerial_gym.sim2real.arrays import Array, Indices
from aerial_gym.sim2real.identify.least_squares.derivatives import effect_jacobian, parameter_scales
from aerial_gym.sim2real.identify.least_squares.moments import time_block_of_rows
from aerial_gym.sim2real.predict.channels import Channel
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.predict.predictor import Predictor
from aerial_gym.sim2real.report.canvas import Panel, panels

MOST_CHANNELS = 4  # Number of plotted channels per parameter, the most informative ones
LEAST_TOLD = 0.02  # Least share of a parameter's information in a channel of the table
MOST_POINTS = 1200  # Most points per channel

COLOURS = ("var(--c3)", "var(--c0)", "var(--c2)", "var(--c4)")
LINE = "var(--ink)"


@dataclass(frozen=True)
class ChannelEvidence:
    """Information of one channel about a parameter."""

    channel: Channel
    adds: Array  # Weighted contribution of one scale of the parameter, (S,)
    beyond: Array  # Weighted residual without the parameter, (S,)
    alone: float  # Parameter value from this channel alone
    std: float  # Standard deviation of that value, from the scatter of time blocks


@dataclass(frozen=True)
class ParameterEvidence:
    """Information of all channels about a parameter."""

    parameter: str
    unit: str
    scale: float
    neutral: float
    fitted: float
    clouds: tuple[ChannelEvidence, ...]  # All channels, the most informative first

    @property
    def informative_channels(self) -> list[tuple[ChannelEvidence, float]]:
        """Return the channels with a noticeable share of the parameter's information, and these shares."""
        information = [float(cloud.adds @ cloud.adds) for cloud in self.clouds]
        shares = [own / max(sum(information), 1e-300) for own in information]
        return [pair for pair in zip(self.clouds, shares, strict=True) if pair[1] >= LEAST_TOLD]

    @property
    def channels_to_plot(self) -> list[ChannelEvidence]:
        """Return the channels to plot."""
        return [cloud for cloud, _ in self.informative_channels[:MOST_CHANNELS]]


def parameter_evidence(
    predictor: Predictor, params: ModelParams, effect: str, neutral: Array, weight: Array, untold: Collection[str] = ()
) -> list[ParameterEvidence]:
    """Return the information of the flights about each parameter of an effect.

    Args:
        params: Model with the effect and the jointly fitted deviations within the tolerances.
        weight: Weight of a row of each channel in the fit, (C,).
        untold: Parameters that these flights do not determine.
    """
    predicted = predictor.predict(params)
    jacobian = np.concatenate(effect_jacobian(predictor, params, (effect,), predicted)) * np.sqrt(weight)[:, None]
    left = np.concatenate([m - p for m, p in zip(predictor.measured, predicted, strict=True)]) * np.sqrt(weight)
    group, scale = time_block_of_rows(predictor.times), parameter_scales((effect,))
    results = []
    for k, parameter in enumerate(EFFECTS.get(effect).parameters):
        if parameter.kind != "number" or parameter.name in untold:
            continue
        adds = jacobian[:, :, k]
        beyond = left + adds * (params.effects[effect][k] - neutral[k]) / scale[k]
        clouds = []
        for place in np.argsort(-(adds**2).sum(axis=0)).tolist():
            slope, std = _slope_through_zero(adds[:, place], beyond[:, place], group)
            alone = float(neutral[k] + slope * scale[k])
            columns = (adds[:, place], beyond[:, place])
            clouds.append(ChannelEvidence(predictor.channels[place], *columns, alone, float(std * scale[k])))
        numbers = (float(scale[k]), float(neutral[k]), float(params.effects[effect][k]))
        results.append(ParameterEvidence(parameter.name, parameter.unit, *numbers, tuple(clouds)))
    return results


def _slope_through_zero(x: Array, y: Array, group: Indices) -> tuple[float, float]:
    """Return the slope of a least-squares line through the origin, and its standard deviation from the scatter of groups."""
    square = float(x @ x)
    if square == 0.0:
        return 0.0, np.inf
    slope = float(x @ y) / square
    scores = np.bincount(group, weights=x * (y - slope * x))
    return slope, float(np.sqrt(scores @ scores) / square)


def evidence_figure(clues: list[ParameterEvidence], title: str) -> str:
    """Return a figure with one panel per parameter, as HTML."""
    shown = [clue for clue in clues if clue.channels_to_plot]
    figure, axes = panels(1, max(len(shown), 1), width=3.3, height=2.6, title=title)
    for panel, clue in zip(axes[0], shown, strict=False):
        _draw_evidence_of_parameter(panel, clue)
    return figure.html()


def write_evidence(path: Path, clues: Mapping[str, Sequence[ParameterEvidence]]) -> None:
    """Write each parameter's fitted value, and the value from each informative channel alone."""
    columns = ["effect", "parameter", "fitted", "channel", "alone", "std", "share_told"]
    rows = [
        (effect, clue.parameter, clue.fitted, cloud.channel.name, cloud.alone, cloud.std, share)
        for effect, own in clues.items()
        for clue in own
        for cloud, share in clue.informative_channels
    ]
    pd.DataFrame(rows, columns=columns).to_csv(path, index=False, float_format="%.6g", errors="surrogateescape")


def _draw_evidence_of_parameter(panel: Panel, clue: ParameterEvidence) -> None:
    for cloud, colour in zip(clue.channels_to_plot, COLOURS, strict=False):
        step = max(1, cloud.adds.size // MOST_POINTS)
        name = f"{cloud.channel.kind.replace('_', ' ')} {cloud.channel.axis}"
        label = f"{name} alone: {cloud.alone:.4g} ± {1.96 * cloud.std:.2g}"
        panel.dots(cloud.adds[::step], cloud.beyond[::step], colour, width=1.8, alpha=0.45, label=label)
    adds = np.concatenate([cloud.adds for cloud in clue.channels_to_plot])
    ends = np.array([adds.min(), adds.max()])
    line = (clue.fitted - clue.neutral) / clue.scale * ends
    panel.line(ends, line, LINE, width=1.6, label=f"{clue.parameter} = {clue.fitted:.4g}")
    unit = "" if clue.unit == "-" else f" {clue.unit}"
    panel.x_label = f"contribution of {clue.scale:g}{unit} of {clue.parameter}"
    panel.y_label, panel.boxed = "residual without it (units of the fit)", True
