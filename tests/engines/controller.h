/* Stands in for the Crazyflie's controller.h: the types and fields that an exported controller uses, under their public names
 * (github.com/bitcraze/crazyflie-firmware, stabilizer_types.h). */
#ifndef CONTROLLER_H
#define CONTROLLER_H

#include <stdbool.h>
#include <stdint.h>

typedef struct { uint32_t timestamp; float x, y, z; } point_t, velocity_t;
typedef struct { uint32_t timestamp; float x, y, z, w; } quaternion_t;
typedef struct { float x, y, z; } Axis3f;
typedef struct { Axis3f acc, gyro; } sensorData_t; /* G, deg/s */
typedef struct { quaternion_t attitudeQuaternion; point_t position; velocity_t velocity; } state_t;
typedef enum { modeDisable = 0, modeAbs, modeVelocity } stab_mode_t;
typedef struct { point_t position; velocity_t velocity; struct { stab_mode_t x, y, z; } mode; } setpoint_t;
typedef enum { controlModeLegacy = 0, controlModeForceTorque = 1, controlModeForce = 2 } control_mode_t;
typedef struct { float normalizedForces[4]; control_mode_t controlMode; } control_t;
typedef uint32_t stabilizerStep_t;

void controllerOutOfTreeInit(void);
bool controllerOutOfTreeTest(void);
void controllerOutOfTree(control_t *control, const setpoint_t *setpoint, const sensorData_t *sensors, const state_t *state,
                         const stabilizerStep_t step);

#endif
