/* A policy of position_setpoint_task for base_quadrotor with lee_attitude_control; aerial_gym 0.1.0.
 * Ask it every 10 ms (100 Hz), as in training.
 *
 * observation
 *      0 to 2  position_error_world: target minus position [m], world
 *      3 to 6  attitude: the attitude, body to world, xyzw
 *      7 to 9  lin_vel_body: the velocity [m/s], body
 *    10 to 12  ang_vel_body: the angular velocity [rad/s], body
 * command
 *           0  thrust - 1 [weights]
 *           1  roll [rad]
 *           2  pitch [rad]
 *           3  yaw rate [rad/s]
 */
#ifndef HOVER_H
#define HOVER_H

#define HOVER_NUM_OBSERVATIONS 13
#define HOVER_NUM_COMMANDS 4
#define HOVER_NUM_ACTIONS 4

/* What stays from step to step: the last action, -1 to 1. */
typedef struct {
    float action[4];
} hover_state;

/* Before the first step, and where a new flight begins. */
void hover_reset(hover_state *state);

/* Returns 0. Returns 1, with NaN in command and action, if a number that goes in, or the
 * action before its limits, is NaN or infinite. The next step is not affected. */
int hover_step(hover_state *state, const float observation[13], float command[4]);

#endif
