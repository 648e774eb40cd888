#include "hover.h"

#include <math.h>
#include <stdint.h>

static const float shift[13] = {
    0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f,
};
static const float factor[13] = {
    1.0f, 1.0f, 1.0f, 1.0f, 1.0f, 1.0f, 1.0f, 1.0f, 1.0f, 1.0f, 1.0f, 1.0f, 1.0f,
};
static const float weight_0[104] = {
    0.160642728f, -0.109240122f, -0.0669225827f, 0.146589756f, -0.223391965f, 0.210971206f, -0.0400289223f,
    0.137927428f, 0.103904873f, -0.0635716394f, 0.103021741f, 0.086084716f, 0.11574731f, -0.108083613f,
    -0.020221252f, -0.0249690898f, 0.0402002186f, -0.00110796443f, 0.242450222f, 0.0863086134f, -0.103286907f,
    -0.167508736f, -0.046488218f, -0.119632386f, -0.0888764262f, 0.013279967f, 0.173223495f, 0.207243115f,
    -0.314016938f, 0.19046472f, 0.0282940194f, 0.281294912f, 0.192526489f, -0.252031773f, -0.268457651f,
    -0.105724081f, 0.281902522f, -0.0818395615f, 0.133191749f, -0.164696589f, 0.237662181f, -0.107658468f,
    0.23982884f, -0.00920699444f, -0.180105418f, 0.107839957f, -0.162573025f, 0.0318563879f, -0.0397354662f,
    0.0106830522f, -0.242762566f, -0.119568057f, 0.1575277f, -0.0119715016f, 0.225631297f, 0.25207597f,
    -0.071419619f, -0.180502534f, 0.176779523f, 0.0935310498f, -0.172445416f, 0.219989523f, 0.219844118f,
    0.203551486f, -0.142778426f, -0.0273640994f, -0.0193437263f, -0.018868139f, -0.197810784f, -0.180393189f,
    0.104483865f, -0.0515421368f, 0.162671089f, 0.0689790323f, 0.108879179f, 0.0845000669f, 0.100536302f,
    0.1582129f, -0.295279503f, 0.102498017f, -0.18710278f, -0.218118817f, 0.0100668464f, -0.0530929975f,
    0.12329381f, -0.189803421f, -0.22397019f, 0.181338787f, -0.0454057232f, 0.155074f, 0.0781698227f,
    -0.182688609f, 0.114357188f, 0.0244638231f, -0.198174879f, -0.158744454f, 0.105845936f, 0.0739939287f,
    -0.0539172143f, -0.0282146279f, 0.326308191f, -0.0183464289f, 0.132629976f, 0.0909129307f,
};
static const float bias_0[8] = {
    -0.162246674f, -0.235866711f, 0.275620341f, -0.0198834576f, 0.197973683f, 0.0706950575f, 0.0496949553f,
    0.231114835f,
};
static const float weight_1[64] = {
    0.385877848f, -0.234611318f, 0.0641249567f, 0.296705306f, 0.252113312f, 0.237362728f, -0.270491272f,
    -0.274973065f, -0.167486727f, 0.0444163308f, 0.387150228f, -0.194799051f, 0.201399133f, -0.16565232f,
    -0.296713054f, -0.0549399294f, 0.190374464f, 0.328230083f, -0.193297863f, 0.100434765f, 0.322427064f,
    0.248090744f, 0.25104019f, 0.272775352f, 0.214903519f, 0.0913215578f, -0.184710175f, -0.210179105f,
    -0.116804026f, 0.00903328601f, -0.167759061f, 0.207886428f, 0.167158276f, -0.0800569654f, 0.173617661f,
    0.155836433f, 0.235693753f, 0.28040728f, -0.102103084f, 0.370761126f, -0.0408735089f, -0.0121466797f,
    -0.333712012f, -0.227552682f, -0.206547111f, -0.151222885f, 0.251365691f, -0.115534544f, -0.264203787f,
    0.136029631f, 0.113197036f, 0.228993222f, -0.182954028f, 0.0766556785f, -0.128711328f, -0.0794344991f,
    -0.301017344f, -0.161135823f, -0.152034342f, 0.158626795f, 0.0192485619f, 0.0546319522f, 0.31593439f,
    0.305638283f,
};
static const float bias_1[8] = {
    0.232151896f, 0.0298537314f, -0.22391884f, 0.330774933f, -0.0708674043f, -0.0285831485f, -0.304585874f,
    -0.111029766f,
};
static const float head[32] = {
    0.0507632233f, 0.156199947f, -0.0256108828f, -0.017218858f, 0.127172083f, -0.0216002297f, -0.013551346f,
    -0.0437667035f, -0.0181770343f, -0.0271367598f, 0.0669020191f, 0.0980443656f, 0.00195539929f,
    0.0170862153f, 0.0474413671f, -0.0398951545f, 0.0167843942f, -0.0812519863f, 0.0912466124f,
    0.00136582647f, 0.0295392387f, 0.0469231866f, 0.073285386f, -0.0473611876f, 0.0118067851f,
    -0.00913427398f, -0.0270759948f, -0.0288003404f, 0.0063600298f, -0.0290533956f, -0.028615443f,
    0.0208050702f,
};
static const float head_bias[4] = {
    0.02654914f, 0.00830832869f, 0.0097085163f, -0.0207723714f,
};
/* Reads the bits: with -ffast-math, comparisons and isnan() do not see NaN. */
static int is_finite(const float *numbers, int count) {
    union { float number; uint32_t bits; } each;
    for (int i = 0; i < count; ++i) {
        each.number = numbers[i];
        if ((each.bits & 0x7f800000u) == 0x7f800000u) return 0;
    }
    return 1;
}
static void set_nan(float *numbers, int count) {
    const union { uint32_t bits; float number; } made = { 0x7fc00000u };
    for (int i = 0; i < count; ++i) numbers[i] = made.number;
}
static float clamped(float x, float limit) { return x < -limit ? -limit : (x > limit ? limit : x); }
static float activated(float x) { return x < 0.0f ? 0.0f : x; } /* NaN stays NaN */

/* Sums of 32 products each: rounding grows with the root of their number, not of num_in. */
static void dense(const float *weight, const float *bias, int num_in, int num_out, const float *in, float *out) {
    for (int o = 0; o < num_out; ++o) {
        float sum = bias[o];
        for (int first = 0; first < num_in; first += 32) {
            const int end = first + 32 < num_in ? first + 32 : num_in;
            float part = 0.0f;
            for (int i = first; i < end; ++i) part += weight[o * num_in + i] * in[i];
            sum += part;
        }
        out[o] = sum;
    }
}

void hover_reset(hover_state *state) {
    for (int i = 0; i < 4; ++i) state->action[i] = 0.0f;
}

int hover_step(hover_state *state, const float observation[13], float command[4]) {
    int finite = is_finite(observation, 13);
    float seen[13];
    for (int i = 0; i < 13; ++i) {
        seen[i] = (observation[i] - shift[i]) * factor[i];
    }
    float layer_0[8];
    dense(weight_0, bias_0, 13, 8, seen, layer_0);
    for (int i = 0; i < 8; ++i) layer_0[i] = activated(layer_0[i]);
    float layer_1[8];
    dense(weight_1, bias_1, 8, 8, layer_0, layer_1);
    for (int i = 0; i < 8; ++i) layer_1[i] = activated(layer_1[i]);
    dense(head, head_bias, 8, 4, layer_1, state->action);
    finite = finite && is_finite(state->action, 4);
    for (int i = 0; i < 4; ++i) state->action[i] = clamped(state->action[i], 1.0f);
    const float *action = state->action;
    for (int i = 0; i < 4; ++i) command[i] = action[i];
    if (!finite) { set_nan(command, 4); set_nan(state->action, 4); }
    return !finite;
}
