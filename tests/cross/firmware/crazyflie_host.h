// To be included before every source of the Crazyflie's firmware (gcc -include).
#include "math3d.h"
#include "param.h"

// A group's parameters, names and addresses, are seen from outside as parameters_GROUP.
#undef PARAM_GROUP_START
#define PARAM_GROUP_START(NAME) const struct param_s parameters_##NAME[] = {

// Products of quaternions in the order that their documentation states, as since the firmware's change 1665.
#define qqmul(a, b) (qqmul)(b, a)
