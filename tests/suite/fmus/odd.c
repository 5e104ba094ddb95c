/* Follower of examples/controllers/fmu in FMI 3.0. WHAT selects a fault that begins at 0.03 s. */
#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>

enum {
    TIME, GAP_M, RELATIVE_MPS, SPEED_MPS, ACCELERATION_MPS2, TIME_GAP_S, SET_SPEED_MPS, IS_AHEAD, LANES, SPARE,
    VARIABLES
};
enum { OK, WARNING, DISCARD, ERROR, FATAL };
enum { NOTHING, CRASH, NO_NUMBER, TO_DISCARD, TO_FAIL, TO_END, PRINT, WARN, HANG, NO_INSTANCE, ONCE, LATER };
#ifndef WHAT
#define WHAT NOTHING
#endif

typedef void (*Logger)(void *, int, const char *, const char *);
typedef struct {
    double values[VARIABLES], filtered_mps2;
    bool is_ahead;
    int lanes;
    Logger log;
} Follower;

int fmi3Reset(void *instance) {
    Follower *own = instance;
    Logger log = own->log;
    *own = (Follower){.values = {[TIME_GAP_S] = 1.4, [SET_SPEED_MPS] = 30.0}, .is_ahead = true, .lanes = 1, .log = log};
    return OK;
}

void *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *resources, bool visible,
                                  bool logging, bool events, bool early, const unsigned *intermediate, size_t count,
                                  void *environment, Logger log, void *update) {
    static int instances;
    Follower *own = calloc(1, sizeof *own);
    (void)name, (void)token, (void)resources, (void)visible, (void)logging, (void)events, (void)early;
    (void)intermediate, (void)count, (void)environment, (void)update;
    if (WHAT == NO_INSTANCE || (WHAT == ONCE && instances++)) return NULL;
    own->log = log;
    fmi3Reset(own);
    return own;
}
void fmi3FreeInstance(void *instance) { free(instance); }
int fmi3EnterInitializationMode(void *instance, bool has_tolerance, double tolerance, double start_s, bool has_stop,
                                double stop_s) {
    (void)has_tolerance, (void)tolerance, (void)start_s, (void)has_stop, (void)stop_s;
    return instance ? OK : ERROR;
}
int fmi3ExitInitializationMode(void *instance) {
    Follower *own = instance;
    /* The first observation is set by now. */
    return own->values[SPEED_MPS] > 0.0 ? OK : ERROR;
}
int fmi3Terminate(void *instance) { return instance ? OK : ERROR; }

int fmi3SetFloat64(void *instance, const unsigned references[], size_t count, const double values[], size_t many) {
    for (size_t one = 0; one < count && one < many; one++) {
        if (references[one] >= VARIABLES) return ERROR;
        ((Follower *)instance)->values[references[one]] = values[one];
    }
    return OK;
}
int fmi3GetFloat64(void *instance, const unsigned references[], size_t count, double values[], size_t many) {
    for (size_t one = 0; one < count && one < many; one++) {
        if (references[one] >= VARIABLES) return ERROR;
        values[one] = ((Follower *)instance)->values[references[one]];
    }
    return OK;
}
int fmi3SetInt32(void *instance, const unsigned references[], size_t count, const int32_t values[], size_t many) {
    if (count != 1 || many != 1 || references[0] != LANES) return ERROR;
    ((Follower *)instance)->lanes = values[0];
    return OK;
}
int fmi3SetBoolean(void *instance, const unsigned references[], size_t count, const bool values[], size_t many) {
    if (count != 1 || many != 1 || references[0] != IS_AHEAD) return ERROR;
    ((Follower *)instance)->is_ahead = values[0];
    return OK;
}

int fmi3DoStep(void *instance, double time_s, double step_s, bool no_set_state, bool *event, bool *end, bool *early,
               double *last_s) {
    Follower *own = instance;
    double *value = own->values, command_mps2;
    (void)no_set_state, (void)event, (void)early;
    *last_s = time_s + step_s;
    command_mps2 = 0.3 * (value[GAP_M] - 4.0 - value[TIME_GAP_S] * value[SPEED_MPS]) + 0.9 * value[RELATIVE_MPS];
    command_mps2 = fmax(-7.5, fmin(command_mps2, fmin(2.0, value[SET_SPEED_MPS] - value[SPEED_MPS])));
    if (!own->is_ahead || own->lanes != 1) return ERROR;
    if (WHAT == PRINT) printf("an answer that is none, at %g\n", time_s), fflush(stdout);
    if (WHAT == LATER) { /* A lag of 0.3 s with internal state. */
        own->filtered_mps2 += (command_mps2 - own->filtered_mps2) * (1.0 - exp(-step_s / 0.3));
        command_mps2 = own->filtered_mps2;
    }
    value[ACCELERATION_MPS2] = command_mps2;
    if (time_s < 0.025) return OK;
    switch (WHAT) {
    case CRASH: abort();
    case NO_NUMBER: value[ACCELERATION_MPS2] = NAN; return OK;
    case TO_DISCARD: own->log(NULL, DISCARD, "logStatus", "too long a step"); return DISCARD;
    case TO_FAIL: return ERROR;
    case TO_END: *end = true; return OK;
    case WARN: own->log(NULL, WARNING, "logStatus", "well"); return WARNING;
    case HANG: for (;;) own->lanes = 1;
    default: return OK;
    }
}

/* FMI requires these symbols, even if unsupported. */
#define UNSUPPORTED(name) int name(void) { return ERROR; }
UNSUPPORTED(fmi3ActivateModelPartition) UNSUPPORTED(fmi3CompletedIntegratorStep) UNSUPPORTED(fmi3DeserializeFMUState)
UNSUPPORTED(fmi3EnterConfigurationMode) UNSUPPORTED(fmi3EnterContinuousTimeMode) UNSUPPORTED(fmi3EnterEventMode)
UNSUPPORTED(fmi3EnterStepMode) UNSUPPORTED(fmi3EvaluateDiscreteStates) UNSUPPORTED(fmi3ExitConfigurationMode)
UNSUPPORTED(fmi3FreeFMUState) UNSUPPORTED(fmi3GetAdjointDerivative) UNSUPPORTED(fmi3GetBinary)
UNSUPPORTED(fmi3GetBoolean)
UNSUPPORTED(fmi3GetClock) UNSUPPORTED(fmi3GetContinuousStateDerivatives) UNSUPPORTED(fmi3GetContinuousStates)
UNSUPPORTED(fmi3GetDirectionalDerivative) UNSUPPORTED(fmi3GetEventIndicators) UNSUPPORTED(fmi3GetFMUState)
UNSUPPORTED(fmi3GetFloat32) UNSUPPORTED(fmi3GetInt16) UNSUPPORTED(fmi3GetInt32) UNSUPPORTED(fmi3GetInt64)
UNSUPPORTED(fmi3GetInt8) UNSUPPORTED(fmi3GetIntervalDecimal) UNSUPPORTED(fmi3GetIntervalFraction)
UNSUPPORTED(fmi3GetNominalsOfContinuousStates) UNSUPPORTED(fmi3GetNumberOfContinuousStates)
UNSUPPORTED(fmi3GetNumberOfEventIndicators) UNSUPPORTED(fmi3GetNumberOfVariableDependencies)
UNSUPPORTED(fmi3GetOutputDerivatives) UNSUPPORTED(fmi3GetShiftDecimal) UNSUPPORTED(fmi3GetShiftFraction)
UNSUPPORTED(fmi3GetString) UNSUPPORTED(fmi3GetUInt16) UNSUPPORTED(fmi3GetUInt32) UNSUPPORTED(fmi3GetUInt64)
UNSUPPORTED(fmi3GetUInt8) UNSUPPORTED(fmi3GetVariableDependencies) UNSUPPORTED(fmi3GetVersion)
UNSUPPORTED(fmi3InstantiateModelExchange) UNSUPPORTED(fmi3InstantiateScheduledExecution)
UNSUPPORTED(fmi3SerializeFMUState)
UNSUPPORTED(fmi3SerializedFMUStateSize) UNSUPPORTED(fmi3SetBinary) UNSUPPORTED(fmi3SetClock)
UNSUPPORTED(fmi3SetContinuousStates) UNSUPPORTED(fmi3SetDebugLogging) UNSUPPORTED(fmi3SetFMUState)
UNSUPPORTED(fmi3SetFloat32) UNSUPPORTED(fmi3SetInt16) UNSUPPORTED(fmi3SetInt64) UNSUPPORTED(fmi3SetInt8)
UNSUPPORTED(fmi3SetIntervalDecimal) UNSUPPORTED(fmi3SetIntervalFraction) UNSUPPORTED(fmi3SetShiftDecimal)
UNSUPPORTED(fmi3SetShiftFraction) UNSUPPORTED(fmi3SetString) UNSUPPORTED(fmi3SetTime) UNSUPPORTED(fmi3SetUInt16)
UNSUPPORTED(fmi3SetUInt32) UNSUPPORTED(fmi3SetUInt64) UNSUPPORTED(fmi3SetUInt8) UNSUPPORTED(fmi3UpdateDiscreteStates)
