/* One controller of the Crazyflie's firmware on the host, with its power distribution: sensors, states and setpoint in, motor
 * commands out. CONTROLLER is the name of its function in controller.c, CONTROLLER_INIT that of its start.
 *
 * SI units, world z up, body x forward, y left, z up, quaternions xyzw. The firmware has degrees and g; its pitch is positive
 * with the nose up. Its state is in static variables: one copy of the library flies one vehicle.
 */
#include <string.h>

#include "math3d.h"
#include "power_distribution.h"
#include "stabilizer_types.h"

void CONTROLLER_INIT(void);
void CONTROLLER(control_t *, const setpoint_t *, const sensorData_t *, const state_t *, const uint32_t);

struct input {
    float position[3], attitude[4], velocity[3], rates[3], force[3]; /* Rates and specific force are those of the IMU, body */
    float goal[3], yaw;
};

extern struct param_s __start_parameters[], __stop_parameters[];
static const float GRAVITY = 9.80665f;
static control_t control; /* Kept between runs: the firmware's controllers write it in some runs only */
static uint32_t tick;

/* Set a parameter; return 0 if there is none of that name. */
int host_set(const char *group, const char *name, float value) {
    int inside = 0;
    for (struct param_s *row = __start_parameters; row < __stop_parameters; row++) {
        if (row->type & PARAM_GROUP) {
            inside = (row->type & PARAM_START) && strcmp(row->name, group) == 0;
        } else if (inside && strcmp(row->name, name) == 0) {
            int kind = row->type & 0x0f;
            if (kind == PARAM_FLOAT) *(float *)row->address = value;
            else if (kind == PARAM_UINT16) *(uint16_t *)row->address = (uint16_t)(value + 0.5f);
            else if (kind == PARAM_UINT8) *(uint8_t *)row->address = (uint8_t)(value + 0.5f);
            else return 0;
            return 1;
        }
    }
    return 0;
}

void host_start(void) {
    powerDistributionInit();
    CONTROLLER_INIT();
}

/* Run the loop once, which is a millisecond of the firmware; write the motor commands of m1 to m4, 0 to 65535. */
void host_run(const struct input *in, uint16_t *motors_out) {
    const float *p = in->position, *q = in->attitude, *v = in->velocity, *w = in->rates, *f = in->force, *g = in->goal;
    struct vec turn = quat2rpy(mkquat(q[0], q[1], q[2], q[3]));
    sensorData_t sensors = {0};
    sensors.gyro.x = degrees(w[0]), sensors.gyro.y = degrees(w[1]), sensors.gyro.z = degrees(w[2]);
    sensors.acc.x = f[0] / GRAVITY, sensors.acc.y = f[1] / GRAVITY, sensors.acc.z = f[2] / GRAVITY;
    struct vec felt = qvrot(mkquat(q[0], q[1], q[2], q[3]), mkvec(sensors.acc.x, sensors.acc.y, sensors.acc.z));
    state_t state = {
        .attitude = {.roll = degrees(turn.x), .pitch = -degrees(turn.y), .yaw = degrees(turn.z)},
        .attitudeQuaternion = {.x = q[0], .y = q[1], .z = q[2], .w = q[3]},
        .position = {.x = p[0], .y = p[1], .z = p[2]},
        .velocity = {.x = v[0], .y = v[1], .z = v[2]},
        .acc = {.x = felt.x, .y = felt.y, .z = felt.z - 1.0f},
    };
    setpoint_t setpoint = {
        .position = {.x = g[0], .y = g[1], .z = g[2]},
        .attitude = {.yaw = degrees(in->yaw)},
        .mode = {.x = modeAbs, .y = modeAbs, .z = modeAbs, .yaw = modeAbs},
    };
    motors_thrust_uncapped_t uncapped;
    motors_thrust_pwm_t motors;
    CONTROLLER(&control, &setpoint, &sensors, &state, tick++);
    powerDistribution(&control, &uncapped);
    powerDistributionCap(&uncapped, &motors);
    memcpy(motors_out, motors.list, sizeof motors.list);
}
