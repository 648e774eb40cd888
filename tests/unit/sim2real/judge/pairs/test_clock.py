"""Clocks of two vehicles' logs, checked by the wake that one feels of the other."""

from dataclasses import replace

import numpy as np
import pytest

from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.judge.pairs.clock import (
    OFFSETS,
    _finding_on_clock,
    contradictions_of_several_pairs,
    equal_offsets,
    log_likelihood_gains,
)
from aerial_gym.sim2real.logs.recording import PairMember
from tests.unit.sim2real.predict.test_scene import hover

RATE = 100.0


def make_pass(offset: float, force: float, *, seed: int = 0, vehicle: int = 0, periodic: bool = False) -> tuple:
    """Return a hover below a vehicle that passes back and forth, and its residual with a wake 20 cm wide that is really so
    much off the clock; noise of 0.05 m/s² in every row."""
    base = hover("low", 1.0)
    count = 1600
    time = np.arange(count) / RATE
    sign = 1.0 if vehicle else -1.0

    def level_place(at: np.ndarray) -> np.ndarray:
        return 0.6 * np.sin(2.0 * at + 0.3 + (0.0 if periodic else 0.05 * at**2))

    zeros, place, attitude = np.zeros(count), base.position[:1].repeat(count, axis=0), base.attitude[:1]
    other = np.stack((level_place(time), zeros, zeros + 3.0), axis=1) + place * (1.0, 1.0, 0.0)
    flight = replace(
        base,
        time=time,
        rate=RATE,
        position=place,
        attitude=attitude.repeat(count, axis=0),
        other_position=other,
        pair=PairMember(pair=0, vehicle=vehicle, clock=0.0),
    )
    residual = 0.05 * np.random.default_rng(seed).standard_normal((count, 3))
    residual[:, 2] -= force * np.exp(-0.5 * (level_place(time + sign * offset) / 0.2) ** 2)
    return flight, time, residual


@pytest.mark.parametrize(
    ("vehicle", "offset", "code"),
    [
        (0, 0.0, "clock_confirmed"), (0, 0.23, "clock_contradicted"), (0, 1.7, "clock_contradicted"),
        (1, 0.0, "clock_confirmed"), (1, -0.4, "clock_contradicted"),
    ],
)  # fmt: skip
def test_the_wake_shows_the_offset_of_the_second_clock(vehicle: int, offset: float, code: str) -> None:
    seen = [make_pass(offset, 0.4, vehicle=vehicle)]
    gains = log_likelihood_gains(seen)
    finding = _finding_on_clock("a and b", gains, 0.001, equal_offsets(seen, OFFSETS[gains.argmax()]))
    assert finding.code == code
    assert finding.values["offset_s"] == pytest.approx(offset, abs=0.03)
    assert finding.values["half_width_s"] < 0.05


@pytest.mark.parametrize(
    ("offset", "code"), [(0.0, "clock_unchecked"), (0.23, "clock_undecided"), (4.0, "clock_undecided")]
)
def test_periodic_passes_and_offsets_out_of_range_state_no_offset(offset: float, code: str) -> None:
    """Passes every pi / 2 s fit at all offsets that differ by this; at the end of the range a larger one may fit better."""
    seen = [make_pass(offset, 0.4, periodic=offset < 4.0)]
    gains = log_likelihood_gains(seen)
    finding = _finding_on_clock("a and b", gains, 0.001, equal_offsets(seen, OFFSETS[gains.argmax()]))
    assert finding == Finding(code, "a and b")


def test_both_vehicles_below_each_other_have_one_offset() -> None:
    gains = log_likelihood_gains([make_pass(0.3, 0.4, vehicle=vehicle) for vehicle in (0, 1)])
    assert OFFSETS[gains.argmax()] == pytest.approx(0.3, abs=0.03)
    against = log_likelihood_gains(
        [make_pass(0.3, 0.4, vehicle=0), make_pass(-0.3, 0.4, vehicle=1)]
    )  # a late wake, not a clock
    assert against.max() < 0.8 * gains.max()


@pytest.mark.slow
def test_without_a_wake_nothing_checks_the_clocks() -> None:
    for seed in range(6):
        finding = _finding_on_clock("a and b", log_likelihood_gains([make_pass(0.2, 0.0, seed=seed)]), 0.001)
        assert finding.code == "clock_unchecked"
    upwards = _finding_on_clock("a and b", log_likelihood_gains([make_pass(0.0, -0.4)]), 0.001)
    assert upwards.code != "clock_confirmed"


def test_a_weak_wake_at_another_offset_confirms_nothing() -> None:
    """A gain of 13 at 0.4 s is significant, but not against 5 at the stated offset, which is no wake either."""
    gains = 13.0 * np.exp(-0.5 * ((OFFSETS - 0.4) / 0.05) ** 2)
    gains[np.abs(OFFSETS) < 0.02] = 5.0
    assert _finding_on_clock("a and b", gains, 0.001).code == "clock_unchecked"
    gains[np.abs(OFFSETS) < 0.02] = 40.0
    assert _finding_on_clock("a and b", gains, 0.001).code == "clock_confirmed"


def test_one_pair_without_a_named_wake_shows_no_clock() -> None:
    def contradiction(pair: str, offset: float) -> Finding:
        return Finding("clock_contradicted", pair, {"offset_s": offset, "half_width_s": 0.02})

    unchecked = Finding("clock_unchecked", "b")
    assert contradictions_of_several_pairs([contradiction("a", -0.54), unchecked]) == [
        Finding("clock_unchecked", "a"),
        unchecked,
    ]
    both = [contradiction("a", 0.24), contradiction("b", 0.27)]
    assert contradictions_of_several_pairs([*both, contradiction("c", -0.6)]) == [
        *both,
        Finding("clock_unchecked", "c"),
    ]
    assert contradictions_of_several_pairs([Finding("clock_confirmed", "b")]) == [unchecked]
