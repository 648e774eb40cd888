"""What manoeuvres are expected to tell, against closed forms; their flights, against the simulator's accelerations."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.identify.least_squares.moments import Weighting
from aerial_gym.sim2real.identify.selection.criteria import LEAST_SCORE
from aerial_gym.sim2real.identify.selection.select import SelectionResult
from aerial_gym.sim2real.judge.experiments.design import ManoeuvreCatalogue, effects_to_show, manoeuvre_for_ties
from aerial_gym.sim2real.judge.experiments.manoeuvres import MANOEUVRES, manoeuvre_flight
from aerial_gym.sim2real.predict.channels import find_channels
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.predict.tolerances import Tolerances
from tests.unit.sim2real.flat_flights import ROBOT, flight, load_tables, make_predictor
from tests.unit.sim2real.set_fits import make_choice, make_fit, make_selection

TOLERANCES = Tolerances()
STD = {
    "specific_force": 0.02, "angular_acceleration": 0.1, "rotor_speed": 2.0, "kinematic_force": 0.05, "kinematic_rate": 0.01
}  # fmt: skip
"""Of the residual of each kind of channel."""


def make_catalogue(folder: Path, *, only: str | None = None) -> ManoeuvreCatalogue:
    """Return the catalogue for a flight of the made-up quadrotor, with white residuals of known size."""
    flights = load_tables(folder, [flight(1, seconds=4.0, rate=100.0)])
    channels = [channel for channel in find_channels(flights) if only in (None, channel.kind)]
    weights = Weighting(
        variance=np.array([STD[channel.kind] ** 2 for channel in channels]), effective=np.ones(len(channels))
    )
    chosen = replace(make_choice(make_fit()), weights=weights)
    return ManoeuvreCatalogue(make_predictor(flights, channels=channels), make_selection(chosen))


@pytest.fixture(scope="module")
def catalogue(tmp_path_factory: pytest.TempPathFactory) -> ManoeuvreCatalogue:
    return make_catalogue(tmp_path_factory.mktemp("flight"))


def model(**effects: list[float]) -> tuple[ModelParams, tuple[str, ...]]:
    params = {name: np.array(values, dtype=float) for name, values in effects.items()}
    return ModelParams(effects=params), tuple(effects)


def by_name(catalogue: ManoeuvreCatalogue, scores: np.ndarray) -> dict[str, float]:
    return {flown.name: float(score) for flown, score in zip(catalogue.flights, scores, strict=True)}


def test_every_manoeuvre_is_one_that_the_simulator_flies_with_these_rotor_speeds(catalogue: ManoeuvreCatalogue) -> None:
    """Flatness against the equations of motion: forces to 1 % of g and turns to 2 % of the largest, away from the ends."""
    assert {flown.name for flown in catalogue.flights} == set(MANOEUVRES)
    kinds = [channel.kind for channel in catalogue.predictor.channels]
    for flown, residual, measured in zip(
        catalogue.flights, catalogue.predictor.residuals(ModelParams()), catalogue.predictor.measured, strict=True
    ):
        for kind, least in (("specific_force", 9.81), ("angular_acceleration", 1.0)):
            places = [place for place, name in enumerate(kinds) if name == kind]
            size = max(least, float(np.abs(measured[:, places]).max()))
            share = 0.01 if kind == "specific_force" else 0.02
            assert np.abs(residual[10:-10, places]).max() < share * size, (flown.name, kind)


def test_a_manoeuvre_beyond_the_rotors_is_left_out(catalogue: ManoeuvreCatalogue) -> None:
    weak = replace(ROBOT, rotor=replace(ROBOT.rotor, thrust_range=(0.05, 1.55)))  # hover takes 1.47 N
    like = catalogue.flights[0]
    assert manoeuvre_flight("hover", weak, like, rate=100.0) is not None
    assert manoeuvre_flight("sweep along both axes, slow and then fast, up to 5 m/s", weak, like, rate=100.0) is None
    heavy = replace(ROBOT, rotor=replace(ROBOT.rotor, thrust_range=(1.3, 5.0)))
    jump = "jump up and down by a few centimetres, thrust up and down by a third"
    assert manoeuvre_flight(jump, heavy, like, rate=100.0) is None
    stood = np.ones(like.num_rows, dtype=bool)
    without = replace(like, lin_vel=None, position=None, rotor_speed=None, on_ground=stood, lost=stood)
    blind = manoeuvre_flight("hover", ROBOT, without, rate=100.0)
    assert blind.lin_vel is blind.position is blind.rotor_speed is blind.on_ground is blind.lost is None


def test_the_expected_score_of_a_bias_in_hover_is_the_closed_form(catalogue: ManoeuvreCatalogue) -> None:
    """A bias b along x that nothing fits but the tolerance t: ``b² / 2 / (t² + 1 / n w)``, n w summed over both channels."""
    bias, predictor = 0.04, catalogue.predictor
    truth, empty = model(imu_bias=[bias, 0.0, 0.0, 0.0, 0.0, 0.0]), model()
    score = by_name(catalogue, catalogue.likelihood_losses(truth[0], *empty))["hover"]
    time = predictor.times[[flown.name for flown in catalogue.flights].index("hover")]
    information = time.size * (STD["specific_force"] ** -2 + STD["kinematic_force"] ** -2)
    expected = 0.5 * bias**2 / (TOLERANCES.acc_bias**2 + 1.0 / information) * 10.0 / (time[-1] - time[0])
    assert score == pytest.approx(expected, rel=1e-3)


def test_a_shifted_centre_of_mass_and_a_weak_motor_tie_in_hover_and_are_told_by_rotation(
    catalogue: ManoeuvreCatalogue,
) -> None:
    """In hover both are constant torques; a turn changes the thrusts, and with them what a weak motor lacks. The shift
    is the one with the torques of the weak motor: ``(1 - scale) / 4`` of the arm in x and y."""
    loss = 0.025
    shift = 0.1 * loss / 4.0
    one, other = model(com_offset=[-shift, shift, 0.0]), model(weak_motor=[1.0, 1.0 - loss])
    scores = catalogue.score_of_pair(one, other)
    advice = catalogue.best_advice(scores, ("com_offset", "weak_motor"))
    assert by_name(catalogue, scores)["hover"] < LEAST_SCORE
    assert advice.fly in (
        "rock quickly in roll and pitch (doublets of 15 to 20 degrees)",
        "hover and turn the heading in steps of 90 degrees, a second each",
    )
    assert advice.score > 1.5 * advice.hover


def test_wind_and_drag_are_told_by_motion(catalogue: ManoeuvreCatalogue) -> None:
    drag = {"rotor_drag": [0.2, 0.2, 0.2]}
    one, other = model(**drag, constant_wind=[1.0, 0.0, 0.0]), model(rotor_drag=[0.25, 0.2, 0.2])
    scores = by_name(catalogue, catalogue.score_of_pair(one, other))
    assert scores["hover"] < 1e-3  # drag says nothing there, wind is not needed
    # At one heading what a wind pushes may be what sensors are turned by.
    assert scores["sweep forwards and back, the same path at four headings"] > 20.0 * LEAST_SCORE


def test_mass_and_thrust_are_not_told_by_forces_at_all_and_by_turns_only_as_far_as_the_inertia_is_known(
    catalogue: ManoeuvreCatalogue, tmp_path: Path
) -> None:
    """Without drag ``c / m`` alone counts in the force. Turns show c / J: an error of J of each axis imitates it, at most
    ``3 (d / 0.02)² / 2`` for a share d: 2 % are never told, 5 % are, by rocking and turning."""
    for share, tells in ((0.02, False), (0.05, True)):
        mass, thrust = model(payload_mass=[share * ROBOT.body.mass]), model(thrust_coefficient=[1.0 / (1.0 + share)])
        forces = make_catalogue(tmp_path, only="specific_force")
        assert forces.score_of_pair(mass, thrust).max() < 1e-3
        advice = catalogue.best_advice(catalogue.score_of_pair(mass, thrust), ("payload_mass", "thrust_coefficient"))
        assert (advice.fly is not None) == tells
        assert advice.score < 1.2 * 1.5 * (share / TOLERANCES.inertia) ** 2
        assert (advice.finding.code == "weigh_or_log") != tells


def test_what_has_not_shown_is_shown_by_what_excites_it(catalogue: ManoeuvreCatalogue) -> None:
    robot = replace(ROBOT, rotor=replace(ROBOT.rotor, radius=0.0635))

    def selection(hidden: str, *named: str) -> SelectionResult:
        return make_selection(make_choice(make_fit(*named)), not_testable={hidden: Finding("not_excited", hidden)})

    assert effects_to_show(selection("ground_effect"), robot, []) == ["ground_effect"]
    assert effects_to_show(selection("ground_effect"), ROBOT, []) == []
    assert effects_to_show(selection("joint_creep"), ROBOT, []) == []
    assert effects_to_show(selection("joint_creep", "joint_spring"), ROBOT, []) == ["joint_creep"]
    empty_selection, names = make_selection(), ["quadratic_drag", "rotor_inertia", "translational_lift"]
    scores = {name: catalogue.score_of_effect(name, ModelParams(), (), ModelParams()) for name in names}
    advice = {name: catalogue.best_advice(score, (name,)) for name, score in scores.items()}
    assert advice["quadratic_drag"].fly == "sweep along both axes, slow and then fast, up to 5 m/s"
    assert all(result.hover < 1e-3 for result in advice.values())
    for name in names:
        assert advice[name].as_mapping()["tells"] == [name]
    assert manoeuvre_for_ties(catalogue, empty_selection, {}) is None
