"""The verdict on two vehicles in the same flights, if one set of parameters does not serve both."""

from collections.abc import Sequence
from dataclasses import replace

from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.judge.outcome import NOT_SHOWN, NOTHING_NAMED
from aerial_gym.sim2real.judge.random_wind.gusts import LEAST_P_VALUE
from aerial_gym.sim2real.judge.verdict import Verdict
from aerial_gym.sim2real.logs.flights import Flight
from aerial_gym.sim2real.statistics import chi_square_tail


def flights_by_vehicle(flights: Sequence[Flight]) -> tuple[list[Flight], list[Flight]]:
    """Return the flights of the first and of the second vehicle of all pairs."""
    first, second = ([f for f in flights if f.pair is not None and f.pair.vehicle == v] for v in (0, 1))
    return first, second


def verdict_with_each_vehicle(verdict: Verdict, alone: Sequence[Verdict]) -> Verdict:
    """Return the verdict on both vehicles with the verdict on each one's own flights.

    If the same effects with the same values explain each of them, and both together have them too, they explain both: what
    remained is a difference within tolerances. If one of them has effects of its own, both together are ambiguous between
    these. If the declared vehicle explains each one within tolerances of its own, it explains both.
    """
    points = [
        Finding("vehicle_alone", vehicle, {"verdict": one.verdict, "effects": {e.name: e.params for e in one.effects}})
        for vehicle, one in zip(("first", "second"), alone, strict=True)
    ]
    settled = all(one.verdict in ("explained", *NOTHING_NAMED) for one in alone)
    named = dict.fromkeys(effect.name for one in alone if one.verdict == "explained" for effect in one.effects)
    doubted = any(point.code == "clock_contradicted" for point in verdict.open_points)
    if settled and named and not doubted and _are_shared(verdict, alone):
        verdict = replace(verdict, verdict="explained", unexplained=(), open_points=())
    elif settled and named:
        candidates = tuple(dict.fromkeys((*verdict.candidates, *named)))
        verdict = replace(verdict, verdict="ambiguous", candidates=candidates)
    elif settled and not verdict.corrects:
        kind = NOT_SHOWN if any(one.verdict == NOT_SHOWN for one in alone) else "none"
        verdict = replace(verdict, verdict=kind, unexplained=(), open_points=())
    return replace(verdict, open_points=(*points, *verdict.open_points))


def _are_shared(verdict: Verdict, alone: Sequence[Verdict]) -> bool:
    """Return whether both vehicles alone have the same effects with the same values, and both together have them too."""
    first, second = ({effect.name: effect for effect in one.effects} for one in alone)
    if first.keys() != second.keys() or not first.keys() <= {effect.name for effect in verdict.effects}:
        return False
    squares = [
        (first[name].params[key] - second[name].params[key]) ** 2 / (std**2 + second[name].std[key] ** 2)
        for name in first
        for key, std in first[name].std.items()
        if std > 0.0 and second[name].std.get(key, 0.0) > 0.0
    ]
    return not squares or chi_square_tail(sum(squares), len(squares)) >= LEAST_P_VALUE
