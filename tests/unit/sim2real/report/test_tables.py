"""The headline of a report: how sure each effect is, and what became of each channel."""

from types import SimpleNamespace

from aerial_gym.sim2real.judge.outcome import Outcome
from aerial_gym.sim2real.judge.verdict import NamedEffect
from aerial_gym.sim2real.report.tables import became_rows, named_rows, reason_rows
from aerial_gym.sim2real.statistics import Rise


def outcome(about: str, value: float, low: float, high: float, where: str = "") -> Outcome:
    return Outcome(name=about, about=about, where=where, rise=Rise(value=value, low=low, high=high), least=0.05)


def test_every_channel_is_told_once_with_what_became_of_it() -> None:
    found = (
        outcome("specific force x", -0.51, -0.6, -0.4),
        outcome("specific force y", 0.0, -0.01, 0.01),
        outcome("specific force z", 0.2, 0.1, 0.3),
        outcome("rotor speed 1", -0.87, -0.9, -0.8),
        outcome("rotor speed 2", -0.86, -0.9, -0.8),
        outcome("angular acceleration x", 0.1, -0.1, 0.4),
        outcome("velocity of the rollout", 0.5, 0.4, 0.6, " after 1 s"),  # no channel
    )
    assert became_rows(SimpleNamespace(outcomes=found)) == {  # type: ignore[arg-type]
        "worse": "specific force z (+20%)",
        "better": "specific force x (-51%); rotor speed 1 (-87%), 2 (-86%)",
        "same": "specific force y",
        "not shown": "angular acceleration x (+10%)",
    }
    assert next(iter(became_rows(SimpleNamespace(outcomes=found)))) == "worse"  # type: ignore[arg-type]


def test_every_effect_says_how_sure_it_is() -> None:
    offset = NamedEffect(
        name="com_offset",
        params={"x": 0.004, "y": -0.002, "z": 0.0},
        std={"x": 1e-4, "y": 2e-4},
        noise_std={},
        frozen=("z",),
        confidence=0.98,
        ties=("motor_tilt",),
    )
    gusts = NamedEffect(name="gusts", params={"std": 0.5}, std={}, noise_std={}, frozen=(), confidence=0.999)
    rows = named_rows(SimpleNamespace(effects=(offset, gusts)))  # type: ignore[arg-type]
    assert rows[0]["parameters"] == "x = 0.004 ± 0.0002 m, y = -0.002 ± 0.00039 m"
    assert rows[0]["sure"] == "confidence 0.98, may as well be motor_tilt"
    assert rows[1] == {"name": "gusts", "parameters": "std = 0.5 m/s", "sure": "confidence 0.999"}


def test_names_that_share_a_reason_share_a_line() -> None:
    assert reason_rows({"a": "no position", "b": "no voltage", "c": "no position"}) == {
        "no position": ["a", "c"],
        "no voltage": ["b"],
    }
