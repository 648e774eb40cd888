"""History of an effect as a figure: each flight with its interval, the fleet, and the change. Letters: N flights."""

from collections.abc import Mapping, Sequence
from math import isfinite
from typing import Any

import numpy as np

from aerial_gym.fleet.page.texts import HALF_95, unit_text
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.report.canvas import Mark, Panel, panels

Content = dict[str, Any]

FLIGHT, FLEET, CHANGE, FIRMWARE = "var(--blue)", "var(--green)", "var(--red)", "var(--amber)"
DAY_S = 86400.0
SHOWN_EFFECTS = 4  # Figures on a page; its table of effects links to the others
COARSE = 3.0  # Standard deviations above this multiple of the median do not set the limits of the axis


def effect_figures(vehicle: Content, options: Mapping[str, str]) -> list[str]:
    """Return the history of the first effects, or of the one that ``effect`` names, as HTML.

    ``axis`` = ``time`` draws over days in place of numbers of flights, if every log states its time.
    """
    effects = [one for one in vehicle["effects"] if one["name"] == options.get("effect")] or vehicle["effects"]
    times = _times(vehicle)
    places, label = np.arange(1.0, times.size + 1.0), "flight"
    if options.get("axis") == "time" and vehicle["timed"]:
        places, label = (times - times.min()) / DAY_S, "days since the first flight"
    shown = effects[:1] if options.get("effect") == effects[0]["name"] else effects[:SHOWN_EFFECTS]
    return [_effect_figure(vehicle, effect, places, label) for effect in shown]


def _times(vehicle: Content) -> Array:
    """Return the start times of all flights [s], (N,), or their numbers if a log states none: a drift is linear in them."""
    name = "start_time" if vehicle["timed"] else "number"
    return np.array([flight[name] for flight in vehicle["all_flights"]], dtype=float)


def _effect_figure(vehicle: Content, effect: Content, places: Array, label: str) -> str:
    names = [one["name"] for one in effect["history"][0]["parameters"]]
    title = effect["name"].capitalize()
    figure, grid = panels(len(names), 1, width=9.0, height=1.9, title=title, sharex=True)
    for name, (panel,) in zip(names, grid, strict=True):
        unit = unit_text(effect["effect"], name)
        panel.y_label = f"{name} [{unit}]" if unit else name
        _draw_history(panel, vehicle, effect, name, places)
    grid[-1][0].x_label = label
    figure.legend = list({mark.label: mark for (panel,) in grid for mark in panel.marks if mark.label}.values())
    return figure.html()


def _draw_history(panel: Panel, vehicle: Content, effect: Content, name: str, places: Array) -> None:
    """Draw one parameter. Bars end at the frame where flights that show little would widen the axis."""
    values = [(flight["number"], one) for flight in effect["history"] for one in flight["parameters"]]
    values = [(k, one) for k, one in values if one["name"] == name and isfinite(one["value"] + one["std"])]
    shown = [(k, one["value"], HALF_95 * one["std"]) for k, one in values]
    number, value, half = np.array(shown).reshape(-1, 3).T
    fine, band = half <= COARSE * np.median(half) if half.size else [], effect["fleet"].get(name)
    ends = [*(value - half)[fine], *(value + half)[fine], *((band["low"], band["high"]) if band else ())]
    low, high = min(ends, default=0.0), max(ends, default=1.0)
    if band and band["vehicles"] > 1:
        label = f"fleet: middle 90 % of {band['vehicles']} vehicles"
        _add_area(panel, places[[0, -1]], (band["low"], band["high"]), FLEET, label)
        panel.line(places[[0, -1]], np.full(2, band["median"]), FLEET, label="fleet: median")
    for update in vehicle["updates"]:
        line = np.full(2, places[update["number"] - 1])
        panel.line(line, np.array([low, high]), FIRMWARE, dashed=True, label="new firmware")
    at, inside = places[number.astype(int) - 1], (value >= low) & (value <= high)
    panel.error_bars(at, np.clip(value - half, low, high), np.clip(value + half, low, high), FLIGHT, alpha=0.55)
    panel.dots(at[inside], value[inside], FLIGHT, width=3.4, label="flight, 95 % interval")
    for cause in vehicle["causes"]:
        own = (cause["effect"], cause["rotor"]) == (effect["effect"], effect["rotor"]) and name in cause["parameters"]
        if own and cause["candidate"] and cause["onset_high"] < places.size:
            _draw_change(panel, cause, cause["parameters"].index(name), places, _times(vehicle), (low, high))


def _draw_change(
    panel: Panel, cause: Content, k: int, places: Array, times: Array, limits: tuple[float, float]
) -> None:
    """Draw the fit of a change of parameter ``k``, and the interval of its onset."""
    ends, onset = places[[cause["onset_low"], cause["onset_high"]]], cause["onset"]
    if ends[0] < ends[1]:
        _add_area(panel, ends, limits, CHANGE, "onset, 90 % interval")
    if cause["kind"] != "drift":  # Drawn between the flights around it
        x = np.insert(places, onset, np.full(2, places[max(onset - 1, 0) : onset + 1].mean()))
        share = (np.arange(x.size) > onset).astype(float)
    else:  # Grows from the flight before its onset
        start = times[max(onset - 1, 0)]
        x, share = places, np.maximum(times - start, 0.0) / max(times[-1] - start, 1e-300)
    y = cause["level"][k] + cause["change"][k] * (share - 1.0)
    panel.line(x, y, CHANGE, width=1.6, label=f"fit of the {cause['kind'] or 'change'}")


def _add_area(panel: Panel, x: Array, y: Sequence[float], colour: str, label: str) -> None:
    """Draw a pale rectangle between two places and two values."""
    pale = f"color-mix(in srgb, {colour} 22%, transparent)"
    corners = {"x": np.repeat(x, 2), "y": np.array([y[0], y[1], y[1], y[0]])}
    panel.marks.append(Mark(**corners, together=4, colour=pale, filled=True, label=label))
