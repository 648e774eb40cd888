"""Findings: each statement of the loop as data, with a code, a subject and values. ``wording`` has the sentences."""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any


class Severity(StrEnum):
    """Importance of a finding to its reader."""

    RESULT = "result"  # A result about the vehicle
    WARNING = "warning"  # A larger error, a missing input, or an action for the reader
    OPEN = "open"  # A question that the flights do not decide
    INFO = "info"  # A processing step that changes no conclusion


_BY_SEVERITY = {
    Severity.RESULT: (
        # the answer
        "effect_found effects_none declared_explains failure_found joint_found joint_effort joints_felt "
        "gusts_shared gusts_separate "
        "effect_immaterial errors_fall no_error_falls gusts_lower_no_error law_preferred load_robot_file keep_declared "
        # meaning of the verdict
        "trust_corrected trust_declared correction_helps "
        # identification and learned residual
        "remains_near_floor gusts_reach_floor learned_added learned_share "
        # preflight
        "constant_measured gyro_sign_measured rotor_layout_measured"
    ),
    Severity.WARNING: (
        # the answer
        "error_rises keep_declared_where keep_declared_for_harm remains_unexplained correction_harms trust_nothing "
        "structure_found fly_structure train_with_failure failure_suspected at_bound "
        "joints_held values_redeclared vehicle_misfit tolerance_strained tolerances_cut_off strained_changes "
        "strained_changes_little "
        # two vehicles
        "clock_contradicted clock_undecided "
        # logs
        "log_simulated sensor_at_rest vertical_force_off spins_reversed "
        "flight_left_out topic_left_out topic_covers_part stream_too_late rotors_too_slow flight_state_unknown "
        "rotor_unit_assumed rotor_speeds_not_shared "
        "battery_left_out file_damaged frames_damaged bytes_left_out checksum_wrong position_jumps_left "
        "sensor_bias sensor_turned sensor_late sensor_gain velocity_factor sensor_dropout row_without_state row_with_bad_stamp "
        # test stand
        "test_left_out axes_open few_steps rows_far_apart mass_exact scatter_unknown no_unseen_log flights_differ "
        "curvature_kept "
        "weigh_vehicle measure_thrust turn_with_gyro swap_propeller "
        # preflight
        "constant_contradicted gyro_sign_contradicted rotor_order_contradicted spins_contradicted outside_training"
    ),
    Severity.OPEN: (
        # the answer
        "error_may_rise effect_tied effects_open left_open offsets_of_flights floor_unknown forces_not_judged "
        "materiality_open fly weigh_or_log train_like_test log_velocity log_faster inspect_rest trust_ambiguous trust_as_shown "
        "trust_as_trained test_like_train "
        "ties_named certain_beside_ties open_in_channels rigid_vehicle_only until_failure_only doubt_by_test "
        "left_open_note offsets_sizes parameter_tied parameters_tied values_tied laws_tied stands_in "
        # not testable, not named
        "not_excited no_soft_arms acts_on_links no_such_effect logs_lack voltage_too_steady commands_too_coarse "
        "thrust_slope_open "
        "no_inertial_sensor kinematics_disagree torques_not_compared effect_refused parameters_unknown flights_disagree "
        "not_told_from_nothing interval_holds_neutral told_beside_another remainder_larger only_linear less_probable trifle "
        "follows_structure "
        # rivals, gusts, learned residual
        "rival_less_probable rival_wider rival_not_rejected gusts_no_floor gusts_no_forces gusts_no_drag gusts_refused "
        "may_be_noise adds_too_little wrong_corr_time rival_process learned_refused gain_by_chance few_flights_better "
        "gain_small channel_worse channel_worse_in_flights no_velocity no_force share_small "
        # two vehicles
        "vehicle_alone clock_unchecked gusts_undecided relative_position_unknown "
        # rollouts
        "rollouts_lack_velocity rollouts_lack_attitude rollouts_too_short errors_at_floor errors_above_floor "
        # round trip
        "controller_stands_in setpoints_missing "
        # preflight
        "constant_assumed gyro_sign_assumed rotor_layout_assumed"
    ),
    Severity.INFO: (
        # verdict
        "controller_flown clock_confirmed gusts_are_random band_limited few_flights "
        # logs
        "rows_with_bad_stamps rows_not_of_header rows_without_numbers rows_without_quaternion "
        "samples_with_bad_stamps clock_set_back clock_wrapped rows_copied blocks_ordered fields_filled battery_without_voltage "
        "battery_filled mapping_note attitude_level attitude_integrated other_vehicle flown_with wind_declared "
        "wind_not_declared "
        "rows_cut rows_lost steps_resampled velocity_derived velocity_unknown force_derived rates_derived one_command "
        "torques_not_logged on_ground commands_copied commands_scaled relative_commands_scaled "
        "commands_mixed rotor_order_of_firmware reset_undone stream_moved rotor_log_moved position_jump samples_slow "
        "samples_repeated quantities_absent "
        # test stand
        "rows_without_speed joint_driven joint_creeps links_as_declared thrust_scale_fitted intervals_of_flights "
        "published_law one_record thrust_from_gravity balance_assumptions mass_added battery_range other_cause"
    ),
}

CODES: dict[str, Severity] = {code: severity for severity, codes in _BY_SEVERITY.items() for code in codes.split()}
"""Severity of each code."""


@dataclass(frozen=True)
class Finding:
    """One statement about the flights or the vehicle: its code, its subject and its numbers."""

    code: str  # A key of ``CODES``
    subject: str = ""  # Name of an effect, channel, flight, joint or tolerance; empty for the whole run
    values: Mapping[str, Any] = field(default_factory=dict)  # Numbers and names; the key of a number ends in its unit

    def __post_init__(self) -> None:
        if self.code not in CODES:
            raise KeyError(f"no finding has the code {self.code!r}; add it to CODES and to the wording")

    def __hash__(self) -> int:
        return hash((self.code, self.subject))

    @property
    def severity(self) -> Severity:
        """Importance of the finding to its reader."""
        return CODES[self.code]


def finding_on_refusal(code: str, subject: str, objections: Iterable[Finding]) -> Finding:
    """Return a finding whose values list the objections to an effect."""
    rows = [{"code": one.code, "subject": one.subject, "values": one.values} for one in objections]
    return Finding(code, subject, {"objections": rows})


def unit_suffix(unit: str) -> str:
    """Return the suffix of a key for a unit: ``m_s2`` for m/s², ``ratio`` for none."""
    plain = unit.translate(str.maketrans("²³⁴", "234")).lower()
    return "_".join(part for part in re.split(r"[^a-z0-9]+", plain) if part) or "ratio"
