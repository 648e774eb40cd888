"""Sentences on changed vehicles."""

from dataclasses import replace

from aerial_gym.fleet.statistics import Change, ChangeResult
from aerial_gym.fleet.wording import text_of_change, text_of_no_change

THRUST = Change(
    effect="weak_motor", rotor=3, kind="step", log_evidence=50.0, onset=211, onset_low=211, onset_high=211,
    parameters=("scale",), change=(-0.021,), std=(0.0015,), level=(0.97,), level_std=(0.002,), slope=(0.0,),
    slope_std=(0.0,), level_slope_cov=(0.0,), last_time=300.0,
)  # fmt: skip
CENTRE = replace(
    THRUST, effect="com_offset", rotor=0, kind="drift", log_evidence=49.0, onset_low=205, onset_high=220,
    parameters=("x", "y", "z"), change=(0.0031, 0.0001, -0.002), std=(0.0002, 0.0002, 0.0005),
)  # fmt: skip


def test_step_of_one_rotor() -> None:
    result = ChangeResult(vehicle="17", flights=300, log_e=40.0, causes=(THRUST,))
    assert text_of_change(result, "17") == "vehicle 17, rotor 3: -2.1 % thrust (± 0.3 %) since flight 212"


def test_drift_of_certain_parameters() -> None:
    result = ChangeResult(vehicle="a", flights=300, log_e=40.0, causes=(CENTRE,))
    assert text_of_change(result, "a") == (
        "vehicle a: com offset x +0.0031 m (± 0.0004 m) and z -0.0020 m (± 0.0010 m) by a drift since flight 212 "
        "(90 % interval 206 to 221)"
    )


def test_alternatives_firmware_and_odd_flight() -> None:
    result = ChangeResult(
        vehicle="17", flights=300, log_e=40.0, causes=(THRUST, CENTRE), odd_flights=(6,), firmware_change=("1.0", "1.1")
    )
    assert text_of_change(result, "17") == (
        "vehicle 17, rotor 3: -2.1 % thrust (± 0.3 %) since flight 212, as firmware 1.1 replaced 1.0; "
        "or a change of com offset; flight 7 deviates alone"
    )


def test_repair_and_second_change() -> None:
    repaired = ChangeResult(vehicle="17", flights=300, causes=(THRUST,), end=220)
    assert (
        text_of_change(repaired, "17") == "vehicle 17, rotor 3: -2.1 % thrust (± 0.3 %) from flight 212 to flight 220"
    )
    second = ChangeResult(
        vehicle="17", flights=300, causes=(replace(THRUST, rotor=1, onset=99, onset_low=90, onset_high=99),)
    )
    both = ChangeResult(vehicle="17", flights=300, causes=(THRUST,), second=second)
    assert text_of_change(both, "17") == (
        "vehicle 17, rotor 3: -2.1 % thrust (± 0.3 %) since flight 212; "
        "second change, rotor 1: -2.1 % thrust (± 0.3 %) since flight 100 (90 % interval 91 to 100)"
    )


def test_odd_flights_without_a_change() -> None:
    result = ChangeResult(vehicle="b", flights=30, causes=(THRUST,), odd_flights=(3, 8))
    text = text_of_no_change(result, "b", "no_change")
    assert text == "vehicle b: no change shown; flights 4 and 9 deviate alone"


def test_vehicles_that_cannot_be_judged() -> None:
    result = ChangeResult(vehicle="b", flights=9)
    few, blind = (text_of_no_change(result, "b", verdict) for verdict in ("too_few_flights", "not_testable"))
    assert few == "vehicle b: too few flights to judge a change"
    assert blind == "vehicle b: its flights show no effect, so no change can be judged"
