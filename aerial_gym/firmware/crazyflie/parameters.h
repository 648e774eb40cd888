/* Included before every source of the firmware: all groups of parameters stand in one section, which host.c searches. */
#include "param.h"
#undef PARAM_GROUP_START
#define PARAM_GROUP_START(NAME)                                                                                \
    static struct param_s params_##NAME[] __attribute__((section("parameters"), aligned(8), used)) = {         \
        PARAM_ADD_GROUP(PARAM_GROUP | PARAM_START, NAME, 0x0)
