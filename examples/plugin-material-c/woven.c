/* `type = "woven_c"`: the sheet of ../plugin-material, in C. Keys and numbers are the same; derivatives by the parameters
 * are declared as not offered.
 *
 *   cc -O2 -shared -fPIC -I../../crates/core/include woven.c -o libwoven_c.so -lm
 */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "caphy_plugin.h"

enum { K0, K1, K2, K3, BEND_U, BEND_V, PARAMETERS };

static const char *const NAMES[] = {"k0", "k1", "k2", "k3", "bend_u", "bend_v", "density"};
static const char *const UNITS[] = {"N/m", "N/m", "N/m", "N/m", "N\xc2\xb7m", "N\xc2\xb7m"};
static const double DEFAULTS[] = {500.0, 40.0, 400.0, 20.0, 4e-5, 3e-5, 0.15};
enum { KEYS = 7, DENSITY = 6 };
static const double UPPER = 1e6;

/* Values of all keys, in their order. */
typedef struct {
    double values[KEYS];
} woven;

static void put(caphy_sink sink, const char *text) { sink.write(sink.context, (const uint8_t *)text, strlen(text)); }

/* An error about a key: three lines. */
static int32_t wrong(caphy_sink error, const char *key, const char *problem, const char *remedy) {
    put(error, key);
    put(error, "\n");
    put(error, problem);
    put(error, "\n");
    put(error, remedy);
    return CAPHY_CONFIG;
}

static int32_t check(const woven *w, caphy_sink error) {
    for (int i = 0; i < PARAMETERS; i++) {
        if (!(w->values[i] >= 0.0 && w->values[i] <= UPPER)) {
            return wrong(error, NAMES[i], "is outside [0, 1e6]", "give a value within");
        }
    }
    if (!(w->values[DENSITY] > 0.0 && w->values[DENSITY] <= UPPER)) {
        return wrong(error, NAMES[DENSITY], "is not an area density", "give a positive value");
    }
    if (w->values[K1] * w->values[K1] > w->values[K0] * w->values[K2]) {
        return wrong(error, "k1", "k1^2 exceeds k0 k2", "give a smaller k1");
    }
    return CAPHY_OK;
}

/* Reads lines `key = number`; `type` is the host's. That is all the TOML that seven numbers need. */
static int32_t read_table(caphy_text toml, woven *out, caphy_sink error) {
    memcpy(out->values, DEFAULTS, sizeof(out->values));
    size_t at = 0;
    while (at < toml.len) {
        char line[256];
        size_t n = 0;
        for (; at < toml.len && toml.data[at] != '\n'; at++) {
            if (n + 1 == sizeof(line) || toml.data[at] == 0) {
                return wrong(error, "(table)", "a line is too long or holds a zero byte", "write key = number");
            }
            line[n++] = (char)toml.data[at];
        }
        at++;
        line[n] = 0;
        char *comment = strchr(line, '#');
        if (comment) *comment = 0;
        if (line[strspn(line, " \t\r")] == 0) continue;
        char key[64], value[128];
        int end_of_line = -1;
        int read = sscanf(line, " %63[A-Za-z0-9_-] = %127s %n", key, value, &end_of_line);
        if (read <= 0) return wrong(error, "(table)", "a line has no key", "write key = number");
        if (read == 1) return wrong(error, key, "has no value", "write key = number");
        if (strcmp(key, "type") == 0) continue;
        if (line[end_of_line] != 0) return wrong(error, key, "has more than one value", "write key = number");
        int found = -1;
        for (int i = 0; i < KEYS; i++) {
            if (strcmp(key, NAMES[i]) == 0) found = i;
        }
        if (found < 0) {
            char problem[128];
            snprintf(problem, sizeof(problem), "unknown field `%s`", key);
            return wrong(error, key, problem, "there are k0, k1, k2, k3, bend_u, bend_v, density");
        }
        char *end = NULL;
        out->values[found] = strtod(value, &end);
        if (end == value || *end != 0) return wrong(error, key, "is not a number", "write key = number");
    }
    return check(out, error);
}

static int32_t create(caphy_text toml, void **out, caphy_sink error) {
    woven *w = malloc(sizeof(*w));
    if (!w) {
        put(error, "out of memory");
        return CAPHY_FAILED;
    }
    int32_t status = read_table(toml, w, error);
    if (status != CAPHY_OK) {
        free(w);
        return status;
    }
    *out = w;
    return CAPHY_OK;
}

static void destroy(void *material) { free(material); }

static int32_t describe(const void *material, caphy_material_facts *out, caphy_sink error) {
    (void)error;
    memset(out, 0, sizeof(*out));
    out->density = ((const woven *)material)->values[DENSITY];
    out->parameter_count = PARAMETERS;
    out->linear_in_parameters = 1;
    out->offers_tangent_held = 1;
    out->offers_tangent_total = 1;
    out->offers_stiffness = 1;
    out->offers_hinge_slopes = 1;
    return CAPHY_OK;
}

static int32_t parameter(const void *material, size_t index, caphy_parameter_facts *out, caphy_sink name, caphy_sink unit,
                         caphy_sink error) {
    if (index >= PARAMETERS) {
        put(error, "no such parameter");
        return CAPHY_FAILED;
    }
    out->value = ((const woven *)material)->values[index];
    out->lower = 0.0;
    out->upper = UPPER;
    put(name, NAMES[index]);
    put(unit, UNITS[index]);
    return CAPHY_OK;
}

static int32_t with_parameters(const void *material, const double *values, size_t count, void **out, caphy_sink error) {
    woven changed = *(const woven *)material;
    if (count != PARAMETERS) {
        put(error, "wrong number of parameters");
        return CAPHY_FAILED;
    }
    memcpy(changed.values, values, count * sizeof(*values));
    int32_t status = check(&changed, error);
    if (status != CAPHY_OK) return status;
    woven *w = malloc(sizeof(*w));
    if (!w) {
        put(error, "out of memory");
        return CAPHY_FAILED;
    }
    *w = changed;
    *out = w;
    return CAPHY_OK;
}

static int32_t normalise(caphy_text toml, caphy_sink out, caphy_sink error) {
    woven w;
    int32_t status = read_table(toml, &w, error);
    if (status != CAPHY_OK) return status;
    put(out, "type = \"woven_c\"\n");
    for (int i = 0; i < KEYS; i++) {
        char line[96];
        /* 17 digits carry a double exactly; the exponent makes it a TOML float. */
        snprintf(line, sizeof(line), "%s = %.16e\n", NAMES[i], w.values[i]);
        put(out, line);
    }
    return CAPHY_OK;
}

/* Both precisions from one text. */
#define REAL float
#define NAME(x) x##_f32
#include "woven_blocks.h"
#undef REAL
#undef NAME
#define REAL double
#define NAME(x) x##_f64
#include "woven_blocks.h"

static const caphy_material_table MATERIAL = {
    .struct_size = sizeof(caphy_material_table),
    .create = create,
    .destroy = destroy,
    .describe = describe,
    .parameter = parameter,
    .with_parameters = with_parameters,
    .membrane_f32 = membrane_f32,
    .membrane_f64 = membrane_f64,
    .hinge_f32 = hinge_f32,
    .hinge_f64 = hinge_f64,
    .normalise = normalise,
};

static const caphy_plugin_entry TYPES[] = {
    {.kind = CAPHY_KIND_MATERIAL,
     .name = {.data = (const uint8_t *)"woven_c", .len = sizeof("woven_c") - 1},
     .material = &MATERIAL,
     .net = NULL},
};

static const caphy_plugin_table TABLE = {.struct_size = sizeof(caphy_plugin_table), .type_count = 1, .types = TYPES};

uint32_t caphy_plugin_abi_version(void) { return CAPHY_ABI_VERSION; }

const caphy_plugin_table *caphy_plugin(void) { return &TABLE; }
