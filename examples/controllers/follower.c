/* Controller as a process: keeps 4 m and 1.4 s to the leader, and otherwise 30 m/s. Needs the standard library only.
 *
 * Compiled with `-lm` to `my-controller`, `crumple simulate paper-1 --controller exec:./my-controller` runs it.
 *
 * Expects lines as crumple writes them: no spaces, and the fields in the order of the protocol. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { GAP_M, RELATIVE_MPS, SPEED_MPS, INPUTS };
static const char *const names[INPUTS] = {"\"gap_ahead_m\"", "\"relative_speed_ahead_mps\"", "\"speed_mps\""};
static int places[INPUTS];

/* Index of an input in the hello; -1 if it is missing. */
static int place_of(const char *inputs, const char *name) {
    const char *end = strchr(inputs, ']'), *found = strstr(inputs, name);
    int place = 0;
    if (!end || !found || found > end) return -1;
    for (; inputs < found; inputs++) place += *inputs == ',';
    return place;
}

static double decide(const char *see) {
    double inputs[INPUTS] = {0.0}, command_mps2;
    for (int place = 0; *see && *see != ']'; place++) {
        char *end;
        double value = strtod(see + 1, &end);
        for (int one = 0; one < INPUTS; one++)
            if (places[one] == place) inputs[one] = value;
        see = end;
    }
    command_mps2 = 0.3 * (inputs[GAP_M] - 4.0 - 1.4 * inputs[SPEED_MPS]) + 0.9 * inputs[RELATIVE_MPS];
    return fmax(-7.5, fmin(command_mps2, fmin(2.0, 30.0 - inputs[SPEED_MPS])));
}

int main(void) {
    static char line[1 << 16];
    const char *found;
    unsigned long long id;
    while (fgets(line, sizeof line, stdin)) {
        id = strncmp(line, "{\"id\":", 6) ? 0 : strtoull(line + 6, NULL, 10);
        if ((found = strstr(line, "\"see\":["))) {
            printf("{\"id\":%llu,\"acceleration_mps2\":%.17g}\n", id, decide(found + strlen("\"see\":")));
        } else if (strstr(line, "\"reset\":")) { /* A new run: a controller with memory would reset here. */
            printf("{\"id\":%llu,\"ready\":true}\n", id);
        } else if ((found = strstr(line, "\"inputs\":["))) {
            for (int one = 0; one < INPUTS; one++)
                if ((places[one] = place_of(found, names[one])) < 0) {
                    fprintf(stderr, "the observation has no %s\n", names[one]);
                    return 1;
                }
            printf("{\"crumple\":1,\"name\":\"my-controller\",\"deterministic\":true}\n");
        } else {
            fprintf(stderr, "unknown message: %s", line);
            return 1;
        }
        fflush(stdout);
    }
    return 0;
}
