"""The verdict on two vehicles in the same flights, if one set of parameters does not serve both."""

from collections.abc import Sequence
from dataclasses import replace
from math import hypot

from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.judge.outcome import NOT_SHOWN, NOTHING_NAMED
from aerial_gym.sim2real.judge.random_wind.gusts import LEAST_P_VALUE
from aerial_gym.sim2real.judge.verdict import NamedEffect, Verdict
from aerial_gym.sim2real.logs.flights import Flight
from aerial_gym.sim2real.statistics import chi_square_tail


def flights_by_vehicle(flights: Sequence[Flight]) -> tuple[list[Flight], list[Flight]]:
    """Return the flights of the first and of the second vehicle of all pairs."""
    first, second = ([f for f in flights if f.pair is not None and f.pair.vehicle == v] for v in (0, 1))
    return first, second


def verdict_with_each_vehicle(verdict: Verdict, alone: Sequence[Verdict], *, is_complete: bool = True) -> Verdict:
    """Return the verdict on both vehicles with the verdict on each one's own flights.

    If the same effects with the same values explain each of them, and both together have just these, they explain both: what
    remained is a difference within tolerances. If the declared vehicle explains each one within tolerances of its own, it
    explains both. If one of them has effects of its own, both together are ambiguous between these. Nothing becomes certain
    where clocks are in doubt, or if the vehicles' own flights are not all (``is_complete``).
    """
    points = [
        Finding("vehicle_alone", vehicle, {"verdict": one.verdict, "effects": {e.name: e.params for e in one.effects}})
        for vehicle, one in zip(("first", "second"), alone, strict=True)
    ]
    settled = all(one.verdict in ("explained", *NOTHING_NAMED) for one in alone)
    named = dict.fromkeys(effect.name for one in alone if one.verdict == "explained" for effect in one.effects)
    doubted = any(point.code in ("clock_contradicted", "clock_undecided") for point in verdict.open_points)
    certain = settled and is_complete and not doubted
    if certain and named and _are_shared([verdict, *alone]):
        verdict = replace(verdict, verdict="explained", unexplained=(), open_points=())
    elif settled and named:
        candidates = tuple(dict.fromkeys((*verdict.candidates, *named)))
        verdict = replace(verdict, verdict="ambiguous", candidates=candidates)
    elif certain and not verdict.corrects:
        kind = NOT_SHOWN if any(one.verdict == NOT_SHOWN for one in alone) else "none"
        verdict = replace(verdict, verdict=kind, unexplained=(), open_points=())
    return replace(verdict, open_points=(*points, *verdict.open_points))


def _are_shared(verdicts: Sequence[Verdict]) -> bool:
    """Return whether both vehicles together and each alone have the same effects with the same values, and no others."""
    both, first, second = ({effect.name: effect for effect in one.effects} for one in verdicts)
    if not both.keys() == first.keys() == second.keys() or any(one.verdict != "explained" for one in verdicts[1:]):
        return False
    return all(_agree(first[n], second[n]) and _agree(both[n], first[n]) and _agree(both[n], second[n]) for n in first)


def _agree(one: NamedEffect, other: NamedEffect) -> bool:
    """Return whether two fits of an effect have the same values within their errors; values without an error exactly."""
    std = {key: hypot(one.std.get(key, 0.0), other.std.get(key, 0.0)) for key in one.params}
    if any(one.params[key] != other.params[key] for key, size in std.items() if not size > 0.0):
        return False
    shifts = [(one.params[key] - other.params[key]) / size for key, size in std.items() if size > 0.0]
    return not shifts or chi_square_tail(sum(shift**2 for shift in shifts), len(shifts)) >= LEAST_P_VALUE
