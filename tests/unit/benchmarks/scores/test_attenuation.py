"""Rotor speeds of the independent plant: what is expected follows the truth where what is logged does not."""

import pytest

from benchmarks.scores.attenuation import Row, rows_of

TORQUES = ("roll", "pitch", "yaw")


@pytest.mark.slow
def test_expected_speeds_follow_the_true_ones_and_logged_ones_do_not() -> None:
    """Four hovers: logged torques are mostly noise; the true ones are what is expected, one to one. Flights that move stay."""
    rows = {(row.flights, row.source): row for row in rows_of([7])}

    def slopes(row: Row) -> list[float]:
        return [row.slope[mode] for mode in TORQUES]

    assert max(slopes(rows["hover", "logged"])) < 0.6
    assert all(0.8 < slope < 1.1 for slope in slopes(rows["hover", "expected"]))
    assert all(0.98 < slope < 1.02 for kind in ("logged", "expected") for slope in slopes(rows["moving", kind]))
    for mode in TORQUES:
        assert rows["hover", "expected"].left[mode] < 0.5 * rows["hover", "logged"].left[mode]
