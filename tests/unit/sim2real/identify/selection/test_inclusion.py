"""How often an effect is chosen when flights are drawn again: against the selection's own statistics where nothing is drawn,
and against effects whose strength is known."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from aerial_gym.sim2real.identify.selection.inclusion import RESAMPLES, draw_blocks
from aerial_gym.sim2real.identify.selection.linear import LinearSelector

from aerial_gym.sim2real.identify.candidates.library import Candidate, Library, exact_along
from aerial_gym.sim2real.identify.least_squares.covariance import uncertainty, wald_probability
from aerial_gym.sim2real.identify.least_squares.gauss_newton import WEAK_PRIOR, Fit
from aerial_gym.sim2real.identify.least_squares.moments import Weighting, block_moments
from aerial_gym.sim2real.identify.selection.scoring import Criteria, LeftOut, Scored
from aerial_gym.sim2real.predict.channels import Channel
from aerial_gym.sim2real.predict.model_params import ModelParams

ROWS, RATE, CHANNELS = 360, 30.0, 2
EFFECT = "rotor_drag"


def made(
    rng: np.random.Generator,
    truth: np.ndarray,
    *,
    flights: int = 5,
    low: float = -np.inf,
    tolerated: float = 0.0,
    alike: float = 0.0,
) -> tuple[Library, LeftOut]:
    """Return candidates with one column each and one tolerance; residual ``J truth + white noise``, unit weights.

    A deviation of 1 in the tolerance does what ``alike`` of the first effect does, and nothing else if that is not 0.
    """
    columns = truth.size + 1
    jacobians = [rng.standard_normal((ROWS, CHANNELS, columns)) for _ in range(flights)]
    if alike:
        jacobians = [np.concatenate((j[:, :, :-1], alike * j[:, :, :1]), axis=2) for j in jacobians]
    residuals = [j[:, :, :-1] @ truth + rng.standard_normal((ROWS, CHANNELS)) for j in jacobians]
    times = [np.arange(ROWS) / RATE] * flights
    candidates = tuple(
        Candidate(name=f"effect_{k}", named=k == 0, columns=np.array([k]), low=np.array([low]), high=np.array([np.inf]))
        for k in range(truth.size)
    )
    moments = block_moments(times, residuals, jacobians)
    left_out = LeftOut(
        moments=moments,
        weights=Weighting(variance=np.ones(CHANNELS), effective=np.ones(CHANNELS)),
        criteria=Criteria(),
        channels=tuple(Channel(kind="specific_force", axis=axis) for axis in "xy"),
        tolerated=np.full(CHANNELS, tolerated),
    )
    return Library(candidates=candidates, moments=moments, tolerances=np.array([columns - 1])), left_out


def selector(library: Library, left_out: LeftOut, draws: np.ndarray) -> LinearSelector:
    selection = SimpleNamespace(criteria=left_out.criteria, weights=left_out.weights, left_out=left_out)
    return LinearSelector(library, selection, draws)  # type: ignore[arg-type]


def chosen(library: Library, left_out: LeftOut, seed: int = 0) -> list[tuple[int, ...]]:
    return selector(library, left_out, draw_blocks(left_out.fold, np.random.default_rng(seed))).select()


def scored(left_out: LeftOut, *, effect: bool) -> Scored:
    """Return the model with or without the first effect beside the tolerance, one column each."""
    moments, kept = left_out.moments, np.array([0, 1] if effect else [1])
    fit = Fit(
        effects=(EFFECT,) if effect else (),
        point=ModelParams(effects={EFFECT: np.zeros(3)} if effect else {}),
        moments=replace(
            moments, gradient=moments.gradient[..., kept], product=moments.product[..., kept[:, None], kept]
        ),
        low=np.full(kept.size, -np.inf),
        high=np.full(kept.size, np.inf),
        num_effect_params=int(effect),
        frozen=frozenset({(EFFECT, 1), (EFFECT, 2)}) if effect else frozenset(),
    )
    return Scored(fit=fit, spread=uncertainty(fit, left_out.weights.weight), left_out=left_out.squares(fit))


@pytest.mark.parametrize("flights", [1, 5])
@pytest.mark.parametrize(
    ("size", "alike"),
    [(0.0, 0.0), (0.2, 0.0), (0.33, 0.0), (0.6, 0.0), (0.6, 0.1), (0.6, 0.3), (0.6, 1.0), (0.1, 0.02)],
)
def test_undrawn_flights_are_judged_as_the_selection_judges_them(size: float, alike: float, flights: int) -> None:
    """With every block once, squares and verdict are those of ``LeftOut`` and of the Wald test, to rounding."""
    for seed in range(6):
        library, left_out = made(np.random.default_rng(seed), np.array([size]), flights=flights, alike=alike)
        less, more = scored(left_out, effect=False), scored(left_out, effect=True)
        gain = left_out.gain_beyond_tolerances(less, more)
        stands_out = wald_probability(more.spread.step[:1], more.spread) <= left_out.criteria.significance
        linear, only = selector(library, left_out, np.ones((1, left_out.fold.size))), np.zeros(1, dtype=int)
        found = linear.fit((0,), only)
        np.testing.assert_allclose(linear.squares(found, only)[0], more.left_out, rtol=1e-9)
        passes = linear.passes(linear.fit((), only), found, 0)
        assert bool(passes[0]) == (stands_out and not left_out.objections(gain))


@pytest.mark.parametrize(("alike", "expected"), [(0.1, True), (0.3, False), (0.0, True)])
def test_what_tolerances_would_have_to_strain_for_is_an_effect(alike: float, expected: bool) -> None:
    """A cause of 0.6 is six deviations of 0.1, or two of 0.3: the former are unlikely by 18 nats, the latter by 2.

    Flights left out are predicted alike with and without the effect wherever the tolerance does the same.
    """
    for seed in range(6):
        library, left_out = made(np.random.default_rng(seed), np.array([0.6]), alike=alike)
        less, more = scored(left_out, effect=False), scored(left_out, effect=True)
        own = left_out.gain(less.left_out, more.left_out)
        gain = left_out.gain_beyond_tolerances(less, more)
        assert gain.score == pytest.approx(own.score + less.penalty - more.penalty)
        if alike:
            assert max(own.falls) < 0.01
            assert less.penalty == pytest.approx(0.5 * (0.6 / alike) ** 2, rel=0.2)
        assert (not left_out.objections(gain)) == expected
        if expected:
            assert max(gain.falls) == pytest.approx(1.0 - 1.0 / np.sqrt(1.0 + 0.6**2), abs=0.05)
        assert set(chosen(library, left_out)) == {(0,) if expected else ()}


def test_what_is_visible_is_told_with_equal_deviations() -> None:
    """A cause that is one deviation: the tolerance takes all of it, so that nothing falls; beside that deviation 0.3² do.

    The effect does not relieve the tolerance beyond chance, so that all else is told with the deviations of each model.
    """
    library, left_out = made(np.random.default_rng(0), np.array([0.3]), alike=0.3, tolerated=0.3)
    assert library.tolerances.size == 1
    less, more = scored(left_out, effect=False), scored(left_out, effect=True)
    own, gain = left_out.gain(less.left_out, more.left_out), left_out.gain_beyond_tolerances(less, more)
    assert own.visible == (False, False)
    assert gain.visible == (True, True)
    assert (gain.falls, gain.p_value) == (own.falls, own.p_value)


@pytest.mark.parametrize("flights", [4, 7])
def test_drawn_flights_are_predicted_by_the_rows_of_the_others_as_often_as_drawn(flights: int) -> None:
    """Against ridge regression on the rows themselves; few flights are drawn with their blocks, many are drawn whole."""
    rng = np.random.default_rng(11)
    r, j = rng.standard_normal((flights, ROWS, CHANNELS)), rng.standard_normal((flights, ROWS, CHANNELS, 3))
    library, left_out = made(rng, np.zeros(2), flights=flights)
    library = replace(library, moments=block_moments([np.arange(ROWS) / RATE] * flights, list(r), list(j)))
    draws, j = draw_blocks(left_out.fold, rng)[:5], j[..., [1, 0, 2]]
    found = selector(library, left_out, draws).fit((1, 0), np.arange(5))
    for n, drawn in enumerate(draws.reshape(5, flights, -1)):
        often = np.repeat(drawn, ROWS // drawn.shape[1], axis=1)  # each row, (flights, rows)
        for out in range(flights):
            others = often * (np.arange(flights) != out)[:, None]
            normal = np.einsum("ft,ftck,ftcl->kl", others, j, j) + np.diag([WEAK_PRIOR**-2, WEAK_PRIOR**-2, 1.0])
            step = np.linalg.solve(normal, np.einsum("ft,ftck,ftc->k", others, j, r))
            np.testing.assert_allclose(found.step[out, n], step, rtol=1e-9, atol=1e-12)
            totals = often[out] @ (r[out] - j[out] @ step) ** 2
            np.testing.assert_allclose(found.totals[out, n], totals, rtol=1e-9)


def test_a_clear_effect_is_always_chosen_an_absent_one_never_and_one_at_the_limit_sometimes() -> None:
    """A column of unit variance takes ``1 - 1 / sqrt(1 + size²)`` off the residual: 5 % at size 0.33, the limit."""
    share = {}
    for size in (0.0, 0.33, 1.0):
        models = chosen(*made(np.random.default_rng(3), np.array([size, 0.0]), flights=8))
        assert len(models) == RESAMPLES
        assert not any(1 in model for model in models)
        share[size] = np.mean([0 in model for model in models])
    assert share[0.0] == 0.0
    assert 0.05 < share[0.33] < 0.95
    assert share[1.0] == 1.0


def test_of_two_effects_both_are_chosen_and_the_same_seed_chooses_the_same() -> None:
    library, left_out = made(np.random.default_rng(4), np.array([1.0, 0.8, 0.0]))
    models = chosen(library, left_out)
    assert {tuple(sorted(model)) for model in models} == {(0, 1)}
    limit = made(np.random.default_rng(3), np.array([0.33]), flights=8)
    assert chosen(*limit, seed=5) == chosen(*limit, seed=5) != chosen(*limit, seed=6)


def test_a_step_against_a_bound_and_one_that_tolerances_hide_are_not_chosen() -> None:
    """The step of -1 may go to -0.6 at most; and what falls by 1 m/s² counts only if tolerances cause less than 2."""
    truth = np.array([-1.0])
    assert not any(chosen(*made(np.random.default_rng(6), truth, low=-0.6)))
    assert not any(chosen(*made(np.random.default_rng(6), truth, tolerated=2.5)))
    assert all(chosen(*made(np.random.default_rng(6), truth, tolerated=0.5)))


def test_the_simplest_of_equals_is_chosen() -> None:
    """A candidate that has the cause and a useless column beside it loses to the cause alone, but for chance at one in 100."""
    library, left_out = made(np.random.default_rng(8), np.array([1.0, 0.0]))
    both = Candidate(name="family", named=False, columns=np.array([0, 1]), low=np.full(2, -9.0), high=np.full(2, 9.0))
    wide = Library(candidates=(both, library.candidates[0]), moments=library.moments, tolerances=library.tolerances)
    models = chosen(wide, left_out)
    assert set(models) <= {(0,), (1,)}
    assert np.mean([model == (1,) for model in models]) > 0.95


def test_few_flights_are_drawn_with_their_blocks_and_many_are_drawn_whole() -> None:
    rng = np.random.default_rng(0)
    few, many = np.repeat(np.arange(3), 8), np.repeat(np.arange(6), 8)
    draws = draw_blocks(few, rng)
    assert draws.shape == (RESAMPLES, 24)
    assert (draws.sum(axis=1) == 24).all()
    by_flight = draws.reshape(-1, 3, 8).sum(axis=2)
    assert set(np.unique(by_flight)) == {0.0, 8.0, 16.0}
    assert ((by_flight > 0).sum(axis=1) >= 2).all()
    assert (draws.reshape(-1, 3, 8).std(axis=2) > 0).any()
    whole = draw_blocks(many, rng).reshape(-1, 6, 8)
    assert (whole == whole[:, :, :1]).all()
    assert set(np.unique(whole)) <= set(range(6))


def test_derivatives_are_made_exact_along_a_step_and_kept_across_it() -> None:
    rng = np.random.default_rng(0)
    columns, change, step = rng.standard_normal((20, 2, 3)), rng.standard_normal((20, 2)), np.array([0.3, 0.0, -1.2])
    (exact,) = exact_along([columns], step, [change])
    np.testing.assert_allclose(exact @ step, change, atol=1e-12)
    for across in ([1.2, 0.0, 0.3], [0.0, 1.0, 0.0]):
        np.testing.assert_allclose(exact @ across, columns @ across, atol=1e-12)
    (kept,) = exact_along([columns], np.zeros(3), [change])
    np.testing.assert_array_equal(kept, columns)
