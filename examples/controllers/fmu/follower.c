/* Controller as an FMU (FMI 2.0, co-simulation): keeps 4 m and a time gap to the leader, and otherwise its set speed.
 * Needs the standard library only; `modelDescription.xml` names the variables. On Linux:
 *
 *     mkdir -p binaries/linux64 && cc -O2 -shared -fPIC -o binaries/linux64/follower.so follower.c -lm
 *     python3 -m zipfile -c follower.fmu modelDescription.xml binaries
 *     crumple simulate paper-1 --controller follower.fmu */
#include <math.h>
#include <stddef.h>

enum { GAP_M, RELATIVE_MPS, SPEED_MPS, ACCELERATION_MPS2, TIME_GAP_S, SET_SPEED_MPS, VARIABLES };
enum { OK, ERROR = 3 };

typedef struct {
    void (*logger)(void *, const char *, int, const char *, const char *, ...);
    void *(*allocate)(size_t, size_t);
    void (*free)(void *);
    void (*step_finished)(void *, int);
    void *environment;
} Callbacks;

typedef struct {
    double values[VARIABLES];
    const Callbacks *callbacks;
} Follower;

const char *fmi2GetTypesPlatform(void) { return "default"; }
const char *fmi2GetVersion(void) { return "2.0"; }

int fmi2Reset(void *component) {
    Follower *own = component;
    for (int one = 0; one < VARIABLES; one++) own->values[one] = 0.0;
    own->values[TIME_GAP_S] = 1.4;
    own->values[SET_SPEED_MPS] = 30.0;
    return OK;
}

void *fmi2Instantiate(const char *name, int type, const char *guid, const char *resources, const Callbacks *callbacks,
                      int visible, int logging) {
    Follower *own = callbacks->allocate(1, sizeof *own);
    (void)name, (void)type, (void)guid, (void)resources, (void)visible, (void)logging;
    if (own) own->callbacks = callbacks, fmi2Reset(own);
    return own;
}

void fmi2FreeInstance(void *component) {
    if (component) ((Follower *)component)->callbacks->free(component);
}

int fmi2SetupExperiment(void *component, int has_tolerance, double tolerance, double start_s, int has_stop,
                        double stop_s) {
    (void)component, (void)has_tolerance, (void)tolerance, (void)start_s, (void)has_stop, (void)stop_s;
    return OK;
}
int fmi2EnterInitializationMode(void *component) { return component ? OK : ERROR; }
int fmi2ExitInitializationMode(void *component) { return component ? OK : ERROR; }
int fmi2Terminate(void *component) { return component ? OK : ERROR; }
int fmi2SetDebugLogging(void *component, int on, size_t count, const char *const categories[]) {
    (void)component, (void)on, (void)count, (void)categories;
    return OK;
}

int fmi2SetReal(void *component, const unsigned references[], size_t count, const double values[]) {
    for (size_t one = 0; one < count; one++) {
        if (references[one] >= VARIABLES) return ERROR;
        ((Follower *)component)->values[references[one]] = values[one];
    }
    return OK;
}

int fmi2GetReal(void *component, const unsigned references[], size_t count, double values[]) {
    for (size_t one = 0; one < count; one++) {
        if (references[one] >= VARIABLES) return ERROR;
        values[one] = ((Follower *)component)->values[references[one]];
    }
    return OK;
}

int fmi2SetInteger(void *component, const unsigned references[], size_t count, const int values[]) {
    (void)component, (void)references, (void)values;
    return count ? ERROR : OK;
}
int fmi2SetBoolean(void *component, const unsigned references[], size_t count, const int values[]) {
    return fmi2SetInteger(component, references, count, values);
}

int fmi2DoStep(void *component, double time_s, double step_s, int no_set_state) {
    double *value = ((Follower *)component)->values, command_mps2;
    (void)time_s, (void)step_s, (void)no_set_state;
    command_mps2 = 0.3 * (value[GAP_M] - 4.0 - value[TIME_GAP_S] * value[SPEED_MPS]) + 0.9 * value[RELATIVE_MPS];
    value[ACCELERATION_MPS2] = fmax(-7.5, fmin(command_mps2, fmin(2.0, value[SET_SPEED_MPS] - value[SPEED_MPS])));
    return OK;
}

/* FMI requires these symbols, even if unsupported. */
#define UNSUPPORTED(name) int name(void) { return ERROR; }
UNSUPPORTED(fmi2CancelStep) UNSUPPORTED(fmi2EnterContinuousTimeMode) UNSUPPORTED(fmi2FreeFMUstate)
UNSUPPORTED(fmi2GetBoolean) UNSUPPORTED(fmi2GetBooleanStatus) UNSUPPORTED(fmi2GetDerivatives)
UNSUPPORTED(fmi2GetDirectionalDerivative) UNSUPPORTED(fmi2GetFMUstate) UNSUPPORTED(fmi2GetInteger)
UNSUPPORTED(fmi2GetIntegerStatus) UNSUPPORTED(fmi2GetRealOutputDerivatives) UNSUPPORTED(fmi2GetRealStatus)
UNSUPPORTED(fmi2GetStatus) UNSUPPORTED(fmi2GetString) UNSUPPORTED(fmi2GetStringStatus)
UNSUPPORTED(fmi2SerializedFMUstateSize) UNSUPPORTED(fmi2SetFMUstate) UNSUPPORTED(fmi2SetRealInputDerivatives)
UNSUPPORTED(fmi2SetString) UNSUPPORTED(fmi2SerializeFMUstate) UNSUPPORTED(fmi2DeSerializeFMUstate)
