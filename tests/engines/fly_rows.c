/* Flies rows of states.bin with an exported controller and writes forces.bin, from reset at each STEPS-th row. A row is position,
 * velocity, quaternion xyzw, gyro [deg/s], position and velocity of the setpoint, and the mode of the setpoint: 20 numbers. On
 * the Cortex-M4 it also prints the instructions of a step, counted by SysTick against a block of NOPS instructions. */
#include <stdio.h>

#include "controller.h"

#define STEPS 10
#define NOPS 1000

#ifdef __arm__
#define SYST ((volatile uint32_t *)0xE000E010u)
static uint32_t elapsed(uint32_t since) { return (since - SYST[2]) & 0x00FFFFFFu; } /* counts down, 24 bits */
static void print_instructions(const setpoint_t *setpoint, const sensorData_t *sensors, const state_t *state) {
    enum { COUNT = 50 };
    control_t control;
    SYST[1] = 0x00FFFFFFu;
    SYST[2] = 0u;
    SYST[0] = 5u;
    while (SYST[2] == 0u) {}
    uint32_t begin = SYST[2];
    __asm volatile(".rept 1000\n nop\n .endr");
    const uint32_t block = elapsed(begin);
    begin = SYST[2];
    for (uint32_t i = 0; i < COUNT; ++i) controllerOutOfTree(&control, setpoint, sensors, state, 0u);
    const uint32_t flight = elapsed(begin);
    printf("instructions_per_step %u\n", (unsigned)((uint64_t)flight * NOPS / block / COUNT));
}
#endif

int main(void) {
    FILE *rows = fopen("states.bin", "rb"), *out = fopen("forces.bin", "wb");
    float row[20];
    control_t control;
    setpoint_t setpoint;
    sensorData_t sensors;
    state_t state;
    if (rows == NULL || out == NULL || !controllerOutOfTreeTest()) return 1;
    for (uint32_t i = 0; fread(row, sizeof row, 1, rows) == 1; ++i) {
        state.position = (point_t){0, row[0], row[1], row[2]};
        state.velocity = (velocity_t){0, row[3], row[4], row[5]};
        state.attitudeQuaternion = (quaternion_t){0, row[6], row[7], row[8], row[9]};
        sensors.gyro = (Axis3f){row[10], row[11], row[12]};
        setpoint.position = (point_t){0, row[13], row[14], row[15]};
        setpoint.velocity = (velocity_t){0, row[16], row[17], row[18]};
        setpoint.mode.x = setpoint.mode.y = setpoint.mode.z = (stab_mode_t)row[19];
        if (i % STEPS == 0) controllerOutOfTreeInit();
        controllerOutOfTree(&control, &setpoint, &sensors, &state, 0);
        if (control.controlMode != controlModeForce) return 2;
        fwrite(control.normalizedForces, sizeof control.normalizedForces, 1, out);
    }
    fclose(out);
    fclose(rows);
#ifdef __arm__
    print_instructions(&setpoint, &sensors, &state);
#endif
    return 0;
}
