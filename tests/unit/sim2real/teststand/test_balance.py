"""The balance at hover: levers worked by hand, MuJoCo's statics, and how often verdicts and intervals are right."""

import json
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pandas as pd
import pytest
from scipy import integrate, stats

from aerial_gym.cli.main import main
from aerial_gym.errors import ConfigError, DataError
from aerial_gym.robots.catalog import ROBOTS
from aerial_gym.sim2real import find_mapping, read_flight_log
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.teststand.balance import Balance, HoverEffort, hover_effort, judge_balance
from aerial_gym.sim2real.teststand.causes import candidate_causes, experiments_for_causes, prior_probabilities_of_causes
from aerial_gym.sim2real.teststand.scatter import fit_scatter, log_evidence_of_cause, pool_scatter

ROBOT = ROBOTS.get("crazyflie_21")
"""Hubs at 0.0325 m along x and y: 1 front right, 2 back right, 3 back left, 4 front left; 1 and 3 turn alike."""

ARM, MASS = 0.0325, 0.027
UNEVEN = np.array([6.0, 5.8, 6.8, 5.1])  # Effort of an even hover: the motors differ

SPREAD = np.array([[1.0, 0.2, 0.3, 0.1], [0.2, 9.0, 0.5, 0.0], [0.3, 0.5, 1.0, -0.4], [0.1, 0.0, -0.4, 2.0]]) * 1e-4
"""Covariance between logs, relative."""


def hovers(rng: np.random.Generator, name: str, count: int, ratio: np.ndarray, size: float = 1.0) -> list[HoverEffort]:
    scatter = rng.multivariate_normal(np.zeros(4), size**2 * SPREAD, count)
    return [
        HoverEffort(name=f"{name}{n}", effort=UNEVEN * ratio * np.exp(s), windows=14, voltage=3.4)
        for n, s in enumerate(scatter)
    ]


def judge_pairs(
    seed: int, ratio: np.ndarray, *, size: float = 1.0, conditions: int = 9, baselines: int = 2,
    added_mass: float | None = None,
) -> Balance:  # fmt: skip
    """Baselines, one flight and one test, and pairs under other conditions, as the measured set has them."""
    rng = np.random.default_rng(seed)
    repeats = [h for n in range(conditions) for h in hovers(rng, f"other_{n}_log", 2, rng.uniform(0.9, 1.1, 4), size)]
    return judge_balance(
        hovers(rng, "normal", baselines, np.ones(4), size), hovers(rng, "flight", 1, ratio, size), robot=ROBOT,
        test=hovers(rng, "test", 1, ratio, size), repeats=repeats, added_mass=added_mass,
    )  # fmt: skip


def fit_values(result: Balance, name: str) -> dict[str, float]:
    return {k: v.value for fit in result.fits if fit.cause.name == name for k, v in fit.params.items()}


def test_a_weight_is_carried_by_the_rotors_that_balance_it() -> None:
    """Half way between rotors 3 and 4 each takes half of it. On the hub of rotor 3, that rotor alone would upset the yaw: it
    takes three quarters of four, the rotors beside it one each, and the one across loses one."""
    part = 0.003 / MASS
    half = 1.0 + 2.0 * part
    between = judge_pairs(0, np.array([1.0, 1.0, half, half]), size=1e-6)
    weighed = "payload_mass + com_offset"
    assert fit_values(between, weighed) == pytest.approx({"dm": 0.003, "x": 0.0, "y": 0.1 * ARM}, rel=1e-4, abs=1e-7)
    assert [axis.value for axis in between.fits[3].place] == pytest.approx([0.0, ARM], rel=1e-4, abs=1e-6)
    assert (between.verdict, between.candidates) == ("explained", (weighed,))
    at_hub = judge_pairs(0, 1.0 + part * np.array([-1.0, 1.0, 3.0, 1.0]), size=1e-6)
    place = {"dm": 0.003, "x": -0.1 * ARM, "y": 0.1 * ARM}  # 3 g of 30 g
    assert fit_values(at_hub, weighed) == pytest.approx(place, rel=1e-4)


def test_a_shifted_centre_of_mass_keeps_the_sum() -> None:
    """2 mm forward: front rotors carry 1 + 0.002 / ARM, rear ones as much less."""
    ratio = 1.0 + 0.002 / ARM * np.array([1.0, -1.0, -1.0, 1.0])
    results = judge_pairs(1, ratio, size=1e-6)
    assert (results.verdict, results.candidates) == ("explained", ("com_offset",))
    assert fit_values(results, "com_offset") == pytest.approx({"x": 0.002, "y": 0.0}, rel=1e-4, abs=1e-7)
    weighed = ratio * (1.0 + 0.004 / MASS)
    assert judge_pairs(1, weighed, size=1e-6, added_mass=0.004).candidates == ("com_offset",)


def test_a_cut_propeller_is_balanced_in_yaw_by_the_others() -> None:
    """Rotor 3 at 90 % of its thrust and r = 0.8 of its drag per thrust: T1 = T3 and T2 = T4 by symmetry, and yaw balance
    T1 + r T3 = T2 + T4 gives T1 = 2 / (3 + r) of a half; with r = 1 only rotor 3 turns faster."""
    results = judge_pairs(2, np.array([1.0, 1.0, 1.0 / 0.9, 1.0]), size=1e-6)
    assert fit_values(results, "weak_motor 3") == pytest.approx({"scale": 0.9}, rel=1e-4)
    same = 4.0 / (3.0 + 0.8)
    results = judge_pairs(2, np.array([same, 2.0 - same, same / 0.9, 2.0 - same]), size=1e-6)
    assert (results.verdict, results.candidates) == ("explained", ("weak_motor 3 + torque_ratio",))
    assert fit_values(results, results.candidates[0]) == pytest.approx({"scale": 0.9, "torque_ratio": 0.8}, rel=1e-4)


def test_statics_agree_with_mujoco() -> None:
    places = ((0.05, -0.03, 0.0), (-0.04, -0.035, 0.0), (-0.04, 0.035, 0.0), (0.05, 0.03, 0.0))
    mounts = tuple(replace(mount, position=at) for mount, at in zip(ROBOT.mounts.layout, places, strict=True))
    body = replace(ROBOT.body, com=(0.003, -0.002, 0.0))
    robot = replace(ROBOT, mounts=replace(ROBOT.mounts, layout=mounts), body=body)

    def thrust(dm: float, place: tuple[float, float, float]) -> np.ndarray:
        sites = "".join(f"<site name='s{n}' pos='{' '.join(map(str, m.position))}'/>" for n, m in enumerate(mounts))
        motors = "".join(f"<motor site='s{n}' gear='0 0 1 0 0 {-0.006 * m.spin}'/>" for n, m in enumerate(mounts))
        load = "" if dm == 0.0 else f"<geom type='sphere' size='0.001' mass='{dm}' pos='{' '.join(map(str, place))}'/>"
        model = mujoco.MjModel.from_xml_string(
            f"<mujoco><worldbody><body><freejoint/><geom type='sphere' size='0.01' mass='{MASS}' pos='0.003 -0.002 0'/>{load}"
            f"{sites}</body></worldbody><actuator>{motors}</actuator></mujoco>"
        )
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        matrix = np.zeros((model.nu, model.nv))
        sparse = data.actuator_moment, data.moment_rownnz, data.moment_rowadr, data.moment_colind
        mujoco.mju_sparse2dense(matrix, *sparse)
        return np.linalg.lstsq(matrix.T, data.qfrc_bias, rcond=None)[0]

    place = np.array([0.02, 0.01])
    ratio = thrust(0.004, (0.02, 0.01, 0.0)) / thrust(0.0, (0.0, 0.0, 0.0))
    (cause,) = (cause for cause in candidate_causes(robot) if cause.name == "payload_mass + com_offset")
    params = np.linalg.lstsq(cause.columns, ratio - 1.0, rcond=None)[0]
    assert cause.columns @ params == pytest.approx(ratio - 1.0, abs=1e-9)
    shift = 0.004 / (MASS + 0.004) * (place - robot.body.com[:2])
    assert cause.physical(params) == pytest.approx({"dm": 0.004, "x": shift[0], "y": shift[1]}, rel=1e-6)


def test_scatter_alone_is_refused_as_often_as_it_says_and_intervals_cover() -> None:
    """Rao's statistics are exact: of 1500 draws 5 and 95 %, within 3.3 standard deviations of the binomial."""
    rng, draws = np.random.default_rng(3), 1500
    columns = candidate_causes(ROBOT)[2].columns
    truth = np.array([2.0, -1.0])
    misfits, covered = 0, 0
    root = np.linalg.cholesky(SPREAD)
    for _ in range(draws):
        scatter = pool_scatter([rng.standard_normal((2, 4)) @ root.T for _ in range(5)])
        noise = np.sqrt(1.5) * root @ rng.standard_normal(4)
        fit = fit_scatter(columns @ truth + noise, columns, scatter, 1.5)
        misfits += fit.misfit < 0.05
        # Student's t, 97.5 %, of 5 repeats less two rows that no parameter explains.
        covered += abs(fit.params[1] - truth[1]) < 3.182446305284263 * np.sqrt(fit.covariance[1, 1])
    allowed = 3.3 * np.sqrt(draws * 0.05 * 0.95)
    assert abs(misfits - 0.05 * draws) < allowed
    assert abs(covered - 0.95 * draws) < allowed


def test_evidence_is_that_of_students_distribution_and_of_effects_of_any_size() -> None:
    scatter = pool_scatter([np.random.default_rng(4).standard_normal((9, 2)) * (0.1, 0.2)])
    degrees, share = scatter.freedom - 1, 1.5
    student = stats.multivariate_t(shape=share * scatter.squares / degrees, df=degrees)
    column, target = np.array([[0.6], [0.8]]), np.array([0.5, 0.3])
    plain = log_evidence_of_cause(target, np.empty((2, 0)), scatter, share)
    constant = student.logpdf(target) - plain
    assert constant == pytest.approx(-np.log(2.0 * np.pi), abs=1e-3)
    least = np.sqrt(scatter.std @ scatter.std * share / 2.0)

    def density(effect: float, log_size: float) -> float:
        return float(student.pdf(target - column[:, 0] * effect) * stats.norm.pdf(effect, scale=np.exp(log_size)))

    whole, _ = integrate.dblquad(density, np.log(least), 0.0, -4.0, 4.0, epsabs=1e-9, epsrel=1e-4)
    results = log_evidence_of_cause(target, column, scatter, share) + constant
    assert results == pytest.approx(np.log(whole / -np.log(least)), abs=2e-3)


def test_what_many_candidates_share_is_one_half() -> None:
    causes = candidate_causes(ROBOT)
    results = dict(zip([cause.name for cause in causes], prior_probabilities_of_causes(causes), strict=True))
    assert results["none"] == 0.5
    assert results["something else"] == pytest.approx(1.0 / 6.0)
    assert results["com_offset"] == pytest.approx(1.0 / 18.0)
    assert results["weak_motor 2"] == pytest.approx(1.0 / 48.0)
    assert sum(results.values()) == pytest.approx(1.0)


@pytest.mark.slow
@pytest.mark.parametrize("baselines", [1, 2])
def test_wrong_names_are_as_rare_as_it_says(baselines: int) -> None:
    """Small and moderate weights and a weak propeller: in 1 % of draws what is named may lack the cause, and parts that do not
    show (a little mass beside a shift) are no reason to name another."""
    weight, known = "payload_mass + com_offset", {}
    known[weight] = [1.0 + 0.04 * np.array([-1.0, 1.0, 3.0, 1.0]), np.array([1.0, 1.0, 1.08, 1.08])]
    known["weak_motor 3"] = [np.array([1.0, 1.0, 1.15, 1.0])]
    named, wrong, draws = 0, 0, 34
    for cause, ratios in known.items():
        for ratio in ratios:
            for seed in range(draws):
                results = judge_pairs(seed, ratio, baselines=baselines)
                named += bool(results.candidates)
                wrong += bool(results.candidates) and not any(name.startswith(cause) for name in results.candidates)
    assert wrong <= stats.binom.ppf(0.999, 3 * draws, 0.01)
    assert named >= draws


def test_a_ratio_is_open_where_its_divisor_may_be_zero() -> None:
    """Fieller with a known divisor is the plain interval, 3 ± t; with independent errors of 1 about 10 and 10 and t² = q,
    the ends solve (10 - 10 r)² = q (1 + r²)."""
    noise = np.random.default_rng(10).standard_normal((13, 4))
    fit = fit_scatter(np.zeros(4), np.eye(4)[:, :2], pool_scatter([noise]), 1.0)
    t, q = 2.2281388519649385, 2.2281388519649385**2  # 12 - 2 = 10 degrees of freedom
    plain = replace(fit, params=np.array([6.0, 2.0]), covariance=np.diag([4.0, 0.0])).ratio_of_parameters(0, 1)
    assert (plain.value, plain.low, plain.high) == pytest.approx((3.0, 3.0 - t, 3.0 + t))
    even = replace(fit, params=np.array([10.0, 10.0]), covariance=np.eye(2)).ratio_of_parameters(0, 1)
    for end in (even.low, even.high):
        assert (10.0 - 10.0 * end) ** 2 == pytest.approx(q * (1.0 + end**2))
    tied = replace(
        fit, params=np.array([30.0, 10.0]), covariance=np.array([[9.0, 3.0], [3.0, 1.0]])
    ).ratio_of_parameters(0, 1)
    assert (tied.low, tied.high) == pytest.approx((3.0, 3.0), abs=1e-6)
    assert replace(fit, params=np.array([6.0, 2.0]), covariance=np.eye(2)).ratio_of_parameters(0, 1) is None


@pytest.mark.slow
def test_nothing_is_found_in_scatter() -> None:
    """The logs differ from each other, or from the baseline, in 1 % of cases each: of 150 at most 9 with probability 99.8 %."""
    assert sum(judge_pairs(seed, np.ones(4)).verdict != "none" for seed in range(150)) <= 9


def test_a_payload_between_two_rotors_is_named_and_its_mass_covered() -> None:
    """2 g between rotors 3 and 4: seven standard deviations. Other names are refused; in the other draws something else, of one
    parameter more, is as probable."""
    half = 1.0 + 2.0 * 0.002 / MASS
    results = [judge_pairs(seed, np.array([1.0, 1.0, half, half])) for seed in range(60)]
    named = [f for f in results if "payload_mass + com_offset" in f.candidates]
    assert len(named) >= 36
    assert all(not f.candidates for f in results if "payload_mass + com_offset" not in f.candidates)
    assert sum(f.verdict == "explained" for f in named) >= 0.8 * len(named)
    place = [f.fits[3].place for f in results]
    assert sum(p is not None and p[1].low < ARM < p[1].high for p in place) >= 52
    dm = [fit.params["dm"] for f in results for fit in f.fits if fit.cause.name == "payload_mass + com_offset"]
    assert sum(value.low < 0.002 < value.high for value in dm) >= 52  # of 60 with probability 99 %


def test_a_weight_at_a_hub_and_a_propeller_of_more_drag_tie_until_the_vehicle_is_weighed() -> None:
    """Rotor 3 carries more, and the yaw balance moves the others, in both."""
    ratio = 1.0 + 0.1 * np.array([-1.0, 1.0, 3.0, 1.0])
    results = judge_pairs(5, ratio)
    both = ("payload_mass + com_offset", "weak_motor 3 + torque_ratio")
    assert (results.verdict, results.candidates) == ("ambiguous", both)
    assert results.tell_apart[0] == Finding("weigh_vehicle")
    weighed = judge_pairs(5, ratio, added_mass=0.0)
    assert (weighed.verdict, weighed.candidates) == ("explained", ("weak_motor 3 + torque_ratio",))
    heavy = judge_pairs(5, ratio, added_mass=0.1 * MASS)
    assert (heavy.verdict, heavy.candidates) == ("explained", ("com_offset",))
    assert Finding("mass_added", "", {"added_kg": 0.0027}) in heavy.notes


def test_weak_propellers_are_named_and_their_share_covered() -> None:
    results = [judge_pairs(seed, np.array([1.0, 1.0, 1.0, 1.0 / 0.8])) for seed in range(40)]
    assert sum("weak_motor 4" in f.candidates for f in results) >= 36
    scale = [fit.params["scale"] for f in results for fit in f.fits if fit.cause.name == "weak_motor 4"]
    assert sum(value.low < 0.8 < value.high for value in scale) >= 34  # of 40 with probability 99 %


def test_what_no_candidate_does_is_unexplained() -> None:
    """Rotors 1 and 3 lose 20 % each, with their drag: no weight and no single propeller does that."""
    results = judge_pairs(7, np.array([1.25, 1.0, 1.25, 1.0]), size=0.3)
    assert (results.verdict, results.candidates) == ("unexplained", ())


def test_a_change_that_the_test_does_not_show_is_unexplained() -> None:
    rng = np.random.default_rng(8)
    baseline = hovers(rng, "normal", 6, np.ones(4), 0.3)
    payload = hovers(rng, "flight", 1, np.full(4, 1.1), 0.3)
    even = hovers(rng, "test", 1, np.ones(4), 0.3)
    assert judge_balance(baseline, payload, robot=ROBOT, test=payload).candidates == ("payload_mass",)
    assert judge_balance(baseline, payload, robot=ROBOT, test=even).verdict == "unexplained"
    late = judge_balance(baseline, even, robot=ROBOT, test=payload)
    assert (late.verdict, late.notes[-1].code) == ("unexplained", "flights_differ")
    twice = judge_balance(baseline, [*payload, *hovers(rng, "flight", 1, np.full(4, 1.1), 0.3)], robot=ROBOT)
    assert twice.candidates == ("payload_mass",)
    assert all(fit.judged is not None for fit in twice.fits)


def test_each_flight_is_predicted_from_the_others() -> None:
    """One flight 10 % heavier and one even: each is predicted as the other, the mean of both would miss by half as much."""
    rng = np.random.default_rng(11)
    normal = hovers(rng, "normal", 6, np.ones(4), 1e-6)
    flights = [hover for ratio in (1.1, 1.0) for hover in hovers(rng, "f", 1, np.full(4, ratio), 1e-6)]
    results = judge_balance(normal, flights, robot=ROBOT)
    (payload,) = (fit for fit in results.fits if fit.cause.name == "payload_mass")
    assert payload.held_out == pytest.approx(np.sqrt(((1.0 / 1.1 - 1.0) ** 2 + 0.1**2) / 2.0), rel=0.05)


def test_something_else_and_nothing_are_weighed_beside_the_candidates() -> None:
    results = judge_pairs(12, np.array([1.0, 1.0, 1.5, 1.0]))
    probability = {fit.cause.name: fit.probability for fit in results.fits}
    assert sum(probability.values()) == pytest.approx(1.0)
    assert probability["none"] < 1e-4
    assert results.candidates == ("weak_motor 3",)
    assert results.notes[-1] == Finding("other_cause", "", {"probability": probability["something else"]})


def test_few_repeats_exclude_nothing() -> None:
    results = judge_pairs(9, np.array([1.0, 1.0, 1.5, 1.0]), conditions=2)
    assert (results.verdict, len(results.candidates), results.fits) == ("ambiguous", 12, ())
    assert 3 in [note.values["repeats"] for note in results.notes if note.code == "scatter_unknown"]
    assert results.shares[2].change.value > 0.05
    rng = np.random.default_rng(9)
    one = hovers(rng, "normal", 1, np.ones(4))
    with pytest.raises(DataError, match=r"two logs of at least one condition.*--repeats"):
        judge_balance(one, one, robot=ROBOT)
    with pytest.raises(DataError, match=r"are some of them copies"):
        judge_balance(one * 2, one, robot=ROBOT)
    with pytest.raises(ConfigError, match=r"added_mass = nan kg"):
        judge_balance(one, one, robot=ROBOT, added_mass=float("nan"))


def test_shares_and_sum_have_the_interval_of_a_pooled_t_test() -> None:
    """Shares 0.25 ± d in two baselines, again in two flights: variance 2 d² per group over 2 degrees of freedom in all."""

    def pair(name: str, total: float) -> list[HoverEffort]:
        share = np.array([[0.26, 0.24, 0.25, 0.25], [0.24, 0.26, 0.25, 0.25]])
        return [HoverEffort(name=f"{name}{n}", effort=total * s, windows=9, voltage=None) for n, s in enumerate(share)]

    results = judge_balance(pair("normal", 20.0), pair("flight", 22.0), robot=ROBOT)
    # Student's t with 2 degrees; variance 2 d², mean of two and of two.
    half_width = 4.302652729911275 * np.sqrt(2.0 * 0.01**2)
    assert results.shares[0].change.high == pytest.approx(half_width, rel=1e-9)
    assert results.shares[0].baseline.high == pytest.approx(0.25 + half_width / np.sqrt(2.0), rel=1e-9)
    assert results.total.change.value == pytest.approx(0.1, rel=1e-9)


def test_what_tells_candidates_apart() -> None:
    assert experiments_for_causes(("weak_motor 3",)) == []
    assert experiments_for_causes(("weak_motor 1", "weak_motor 3"))[0].code == "swap_propeller"
    assert experiments_for_causes(("com_offset", "weak_motor 3"))[0].code == "turn_with_gyro"
    assert experiments_for_causes(("com_offset", "payload_mass"))[0].code == "weigh_vehicle"


def test_vehicles_that_the_balance_does_not_settle_are_refused() -> None:
    mounts = ROBOT.mounts.layout
    tilted = replace(mounts[0], axis=(0.1, 0.0, 1.0))
    same = tuple(replace(mount, spin=1) for mount in mounts)
    for layout, message in (
        (mounts[:3], "needs 4 rotors"), ((tilted, *mounts[1:]), "along body z"), (same, "cannot balance")
    ):  # fmt: skip
        with pytest.raises(ConfigError, match=message):
            candidate_causes(replace(ROBOT, mounts=replace(ROBOT.mounts, layout=layout)))
    with pytest.raises(ConfigError, match="not between the rotors"):
        candidate_causes(replace(ROBOT, body=replace(ROBOT.body, com=(0.1, 0.0, 0.0))))


def hover_file(path: Path, ratio: np.ndarray, *, seed: int) -> Path:
    """Twelve seconds as crazypad stores them, with four seconds near the ground that need half the effort."""
    rng, rows = np.random.default_rng(seed), 1200
    table = pd.DataFrame({"t": np.arange(rows) / 100.0})
    for name in ("px", "py", "vx", "vy", "vz"):
        table[name] = 0.0
    table["pz"] = np.where(table["t"] < 4.0, 0.1, 0.5)
    low = np.where(table["t"] < 4.0, 0.5, 1.0)
    table["vbat"] = 3.5
    level = UNEVEN * ratio * np.exp(rng.multivariate_normal(np.zeros(4), 1e-2 * SPREAD))
    for n in range(4):
        table[f"pwm{n + 1}"] = np.sqrt(low * level[n]) / 3.5
    table.to_csv(path, index=False)
    return path


def test_the_command_names_a_payload_in_logs_without_attitude(tmp_path, capsys) -> None:
    half = 1.0 + 2.0 * 0.003 / MASS
    normal = [hover_file(tmp_path / f"normal_{n}.csv", np.ones(4), seed=n) for n in range(6)]
    load = [hover_file(tmp_path / f"load_{n}.csv", np.array([1.0, 1.0, half, half]), seed=10 + n) for n in range(2)]
    effort = hover_effort(read_flight_log(normal[0], mapping=find_mapping("crazypad"), hover=True))
    assert effort.effort == pytest.approx(UNEVEN, rel=0.02)
    assert (effort.windows, effort.voltage) == (16, pytest.approx(3.5))
    common = ("--robot", "crazyflie_21", "--mapping", "crazypad")
    argv = ["identify", "hover", str(load[0]), "--baseline", *map(str, normal[:2]), *common]
    repeats = ["--repeats", *map(str, [*normal, *load])]
    assert main([*argv, "--test", str(load[1]), *repeats, "--out", str(tmp_path / "out"), "--json"]) == 0
    results = json.loads(capsys.readouterr().out)
    assert (results["verdict"], results["candidates"]) == ("explained", ["payload_mass + com_offset"])
    assert results["scatter"]["freedom"] == 1 + 3  # four of the six baselines are in --repeats alone
    assert "## Candidates" in (tmp_path / "out" / "report.md").read_text()
    assert main([*argv, *repeats, "--added-mass-kg", "0.003"]) == 0
    assert "Verdict: explained. Candidates: com_offset." in " ".join(capsys.readouterr().out.split())
    mass = "with --baseline the mass is the robot's"
    for more, message in ((["--test", str(load[0])], "named twice"), (["--mass-kg", "0.03"], mass)):
        assert main([*argv, *more]) == 2
        assert message in " ".join(capsys.readouterr().err.split())
    assert main(["identify", "hover", str(load[0]), "--baseline", str(normal[0])]) == 2
    assert "give --robot" in capsys.readouterr().err
    assert main(["identify", "hover", str(load[0]), "--test", str(load[1])]) == 2
    assert "give --baseline" in " ".join(capsys.readouterr().err.split())
