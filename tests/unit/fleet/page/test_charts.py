"""Figures of histories: the places of flights, the fleet, the fit of a change, and limits that show the change."""

from typing import Any

import numpy as np
import pytest

from aerial_gym.fleet.page.charts import CHANGE, FIRMWARE, FLIGHT, _draw_history, effect_figures
from aerial_gym.sim2real.report.canvas import Panel
from tests.unit.fleet.page.fleet_tables import cause


def vehicle(kind: str, *, std: float = 0.01) -> dict[str, Any]:
    """Return a vehicle with eight flights whose motor loses 5 % with the sixth flight."""
    values = [1.0] * 5 + [0.95] * 3
    history = [
        {"number": n, "parameters": [{"name": "scale", "value": value, "std": std * (100.0 if n == 2 else 1.0)}]}
        for n, value in enumerate(values, 1)
    ]
    band = {"scale": {"low": 0.99, "median": 1.0, "high": 1.01, "vehicles": 40}}
    effect = {"effect": "weak_motor", "rotor": 3, "name": "weak motor, rotor 3", "history": history, "fleet": band}
    flights = [{"number": n, "start_time": 86400.0 * n * n} for n in range(1, 9)]
    causes = [cause("weak_motor", kind, 20.0, 5, {"scale": -0.05}, 0.004)]
    return {"all_flights": flights, "effects": [effect], "causes": causes, "updates": [{"number": 4}], "timed": True}


def draw(content: dict[str, Any]) -> Panel:
    panel = Panel(size=(900.0, 100.0))
    _draw_history(panel, content, content["effects"][0], "scale", np.arange(1.0, 9.0))
    return panel


def marks(panel: Panel, colour: str, *, filled: bool = False) -> list[Any]:
    return [mark for mark in panel.marks if colour in mark.colour and mark.filled == filled]


def test_a_step_is_drawn_between_the_flights_around_its_onset() -> None:
    panel = draw(vehicle("step"))
    (fit,) = marks(panel, CHANGE)
    assert fit.x.tolist() == [1.0, 2.0, 3.0, 4.0, 5.0, 5.5, 5.5, 6.0, 7.0, 8.0]
    assert fit.y.tolist() == pytest.approx([1.0] * 6 + [0.95] * 4)
    (onset,) = marks(panel, CHANGE, filled=True)
    assert set(onset.x) == {5.0, 7.0}  # flights 5 to 7
    (firmware,) = marks(panel, FIRMWARE)
    assert set(firmware.x) == {4.0}


def test_a_drift_grows_in_time_from_the_flight_before_its_onset() -> None:
    """Flight n is at n² days: of the 39 days from flight 5 to flight 8, 11 and 24 have passed at flights 6 and 7."""
    content = vehicle("drift")
    (fit,) = marks(draw(content), CHANGE)
    assert fit.x.tolist() == list(range(1, 9))
    assert fit.y.tolist() == pytest.approx([1.0] * 5 + [1.0 - 0.05 * share for share in (11 / 39, 24 / 39, 1.0)])
    content["timed"] = False
    (fit,) = marks(draw(content), CHANGE)
    assert fit.y.tolist() == pytest.approx([1.0] * 5 + [1.0 - 0.05 * share for share in (1 / 3, 2 / 3, 1.0)])


def test_a_cause_that_is_told_apart_has_no_fit() -> None:
    content = vehicle("step")
    content["causes"][0]["candidate"] = False
    assert marks(draw(content), CHANGE) == []


def test_a_flight_that_shows_little_does_not_widen_the_axis() -> None:
    """The second flight's interval is a hundred times wider: its bar ends at the limits of the others."""
    bars, dots = marks(draw(vehicle("step")), FLIGHT)
    low, high = 0.95 - 1.96 * 0.01, 1.0 + 1.96 * 0.01
    assert bars.y.reshape(-1, 2)[0].tolist() == pytest.approx([1.0 - 0.0196, high])
    assert bars.y.reshape(-1, 2)[1].tolist() == pytest.approx([low, high])
    assert dots.x.size == 8


def test_unknown_values_are_left_out() -> None:
    content = vehicle("step")
    for flight in content["effects"][0]["history"]:
        flight["parameters"][0]["std"] = np.inf
    assert all(mark.x.size == 0 for mark in marks(draw(content), FLIGHT))
    content["effects"][0]["fleet"] = {}
    assert effect_figures(content, {})


def test_the_axis_is_time_only_if_every_log_states_it() -> None:
    content = vehicle("step")
    assert "days since the first flight" in effect_figures(content, {"axis": "time"})[0]
    content["timed"] = False
    assert "days since" not in effect_figures(content, {"axis": "time"})[0]


def test_an_option_chooses_one_effect() -> None:
    content = vehicle("step")
    content["effects"] += [content["effects"][0] | {"name": f"number {n}"} for n in range(6)]
    assert len(effect_figures(content, {})) == 4
    (figure,) = effect_figures(content, {"effect": "number 5"})
    assert "Number 5" in figure
    assert len(effect_figures(content, {"effect": "weak motor, rotor 3"})) == 1
    assert len(effect_figures(content, {"effect": "<script>"})) == 4
