"""Candidates about a model that holds some of them, and their derivatives."""

from typing import Any, cast

import numpy as np

from aerial_gym.physics import EFFECTS
from aerial_gym.robots import ROBOTS
from aerial_gym.sim2real.identify.candidates.library import Library, build_library, exact_along
from aerial_gym.sim2real.predict.model_params import ModelParams

INERTIA = "inertia_error"


def test_derivatives_are_made_exact_along_a_step_and_kept_across_it() -> None:
    rng = np.random.default_rng(0)
    columns, change, step = rng.standard_normal((20, 2, 3)), rng.standard_normal((20, 2)), np.array([0.3, 0.0, -1.2])
    (exact,) = exact_along([columns], step, [change])
    np.testing.assert_allclose(exact @ step, change, atol=1e-12)
    for across in ([1.2, 0.0, 0.3], [0.0, 1.0, 0.0]):
        np.testing.assert_allclose(exact @ across, columns @ across, atol=1e-12)
    (kept,) = exact_along([columns], np.zeros(3), [change])
    np.testing.assert_array_equal(kept, columns)


class OfInertia:
    """A prediction that is linear in the factors of the inertia; no tolerances."""

    def __init__(self) -> None:
        rng = np.random.default_rng(3)
        self.columns = rng.standard_normal((40, 2, 3))
        self.robot, self.num_tolerances, self.times = ROBOTS.get("base_quadrotor"), 0, [np.arange(40) / 20.0]
        self.measured = [rng.standard_normal((40, 2))]

    def predict(self, point: ModelParams) -> list[np.ndarray]:
        return [self.columns @ (point.effects[INERTIA] - 1.0)]


def library_about(off: tuple[float, float, float], *frozen: int) -> Library:
    """Return the candidates about a model with such an inertia error, fitted but for what is frozen."""
    return build_library(
        cast("Any", OfInertia()),
        ModelParams(effects={}),
        ModelParams(effects={INERTIA: np.array(off)}),
        (INERTIA,),
        np.ones(2),
        frozen=frozenset((INERTIA, place) for place in frozen),
        skipped=[name for name in EFFECTS if name != INERTIA],
    )


def test_the_cases_of_an_effect_share_its_columns() -> None:
    """All three factors, those about x and y, and that about z; the case that was fitted is the named one, and comes first."""
    whole = library_about((1.1, 0.9, 1.2)).candidates
    assert [(one.named, one.columns.tolist()) for one in whole] == [
        (True, [0, 1, 2]), (False, [0, 1]), (False, [2]),
    ]  # fmt: skip
    about_z = library_about((1.0, 1.0, 1.2), 0, 1).candidates
    assert [(one.named, one.columns.tolist()) for one in about_z] == [
        (True, [2]), (False, [0, 1, 2]), (False, [0, 1]),
    ]  # fmt: skip
    assert [one.start.tolist() for one in about_z] == [[1.0, 1.0, 1.2], [1.0] * 3, [1.0] * 3]
    assert about_z[0].frozen == {(INERTIA, 0), (INERTIA, 1)}
