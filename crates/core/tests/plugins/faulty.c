/* Plugins with one fault each, chosen by -DFAULT_…; without one, a material that answers zeros. */
#include "caphy_plugin.h"

#include <math.h>
#include <string.h>

static void put(caphy_sink sink, const char *text) { sink.write(sink.context, (const uint8_t *)text, strlen(text)); }

static int handle;
#ifdef FAULT_MISSING_FUNCTION
int32_t a_loom_that_nobody_built(void);
#endif

static int32_t create(caphy_text toml, void **out, caphy_sink error) {
    (void)toml;
    (void)error;
#ifdef FAULT_NULL_HANDLE
    *out = NULL;
#else
    *out = &handle;
#endif
#ifdef FAULT_FAILS
    put(error, "the loom is broken");
    return CAPHY_FAILED;
#elif defined FAULT_FAILS_SILENTLY
    return 77;
#elif defined FAULT_ERROR_IS_NOT_UTF8
    put(error, "\xff\xfe");
    return CAPHY_FAILED;
#elif defined FAULT_LENGTH_ERROR
    put(error, "weft counts\n12\n7");
    return CAPHY_LENGTH;
#elif defined FAULT_NON_FINITE_ERROR
    put(error, "warp tension\n3\nnan");
    return CAPHY_NON_FINITE;
#elif defined FAULT_PARAMETER_ERROR
    put(error, "k\n-1.5\n0\n1e6\nN/m");
    return CAPHY_PARAMETER;
#elif defined FAULT_GARBLED_ERROR
    put(error, "k\nmany\nfew");
    return CAPHY_LENGTH;
#elif defined FAULT_MISSING_FUNCTION
    return a_loom_that_nobody_built();
#else
    return CAPHY_OK;
#endif
}

static void destroy(void *material) { (void)material; }

static int32_t describe(const void *material, caphy_material_facts *out, caphy_sink error) {
    (void)material;
    (void)error;
    memset(out, 0, sizeof(*out));
    out->density = NAN;
    out->parameter_count = 1;
#ifdef FAULT_MANY_PARAMETERS
    out->parameter_count = (size_t)-1;
#endif
#ifdef FAULT_DENSITY
    out->density = -1.0;
#endif
#ifdef FAULT_FLAG
    out->stiffness_frozen = 2;
#endif
#ifdef FAULT_LENGTH_RULE
    out->hinge_length = 3;
#endif
    return CAPHY_OK;
}

static int32_t parameter(const void *material, size_t index, caphy_parameter_facts *out, caphy_sink name, caphy_sink unit,
                         caphy_sink error) {
    (void)material;
    (void)index;
    (void)error;
    out->value = 1.0;
    out->lower = 0.0;
    out->upper = 2.0;
#ifdef FAULT_PARAMETER_OUTSIDE
    out->value = 3.0;
#endif
#ifdef FAULT_NAME_IS_NOT_UTF8
    put(name, "\xff");
#else
    put(name, "k");
#endif
    put(unit, "N/m");
    return CAPHY_OK;
}

static int32_t with_parameters(const void *material, const double *values, size_t count, void **out, caphy_sink error) {
    (void)material;
    (void)values;
    (void)count;
    (void)error;
#ifdef FAULT_CHANGED_IS_NULL
    *out = NULL;
#else
    *out = &handle;
#endif
    return CAPHY_OK;
}

#define BLOCKS(REAL, S)                                                                                       \
    static int32_t membrane_##S(const void *material, caphy_membrane_##S *block, caphy_sink error) {          \
        (void)material;                                                                                       \
        (void)error;                                                                                          \
        for (size_t i = 0; block->energy.data && i < block->energy.len; i++) block->energy.data[i] = 0;       \
        for (size_t i = 0; block->stress.data && i < block->stress.len; i++) block->stress.data[i] = 0;       \
        return CAPHY_OK;                                                                                      \
    }                                                                                                         \
    static int32_t hinge_##S(const void *material, caphy_hinge_##S *block, caphy_sink error) {                \
        (void)material;                                                                                       \
        (void)error;                                                                                          \
        for (size_t i = 0; block->stiffness.data && i < block->stiffness.len; i++) block->stiffness.data[i] = 0; \
        return CAPHY_OK;                                                                                      \
    }
BLOCKS(float, f32)
BLOCKS(double, f64)

static const caphy_material_table MATERIAL = {
#ifdef FAULT_TABLE_SIZE
    .struct_size = 8,
#else
    .struct_size = sizeof(caphy_material_table),
#endif
    .create = create,
    .destroy = destroy,
    .describe = describe,
    .parameter = parameter,
    .with_parameters = with_parameters,
    .membrane_f32 = membrane_f32,
    .membrane_f64 = membrane_f64,
    .hinge_f32 = hinge_f32,
#ifndef FAULT_NULL_FUNCTION
    .hinge_f64 = hinge_f64,
#endif
};

static const caphy_plugin_entry TYPES[] = {
    {
#ifdef FAULT_KIND
        .kind = 9,
#else
        .kind = CAPHY_KIND_MATERIAL,
#endif
#ifdef FAULT_TYPE_IS_NOT_UTF8
        .name = {.data = (const uint8_t *)"\xff", .len = 1},
#elif defined FAULT_TYPE_IS_NULL
        .name = {.data = NULL, .len = 4},
#else
        .name = {.data = (const uint8_t *)"zero", .len = 4},
#endif
#ifndef FAULT_NO_MATERIAL_TABLE
        .material = &MATERIAL,
#endif
    },
#ifdef FAULT_DUPLICATE
    {.kind = CAPHY_KIND_MATERIAL, .name = {.data = (const uint8_t *)"zero", .len = 4}, .material = &MATERIAL},
#endif
};

static const caphy_plugin_table TABLE = {
#ifdef FAULT_PLUGIN_SIZE
    .struct_size = 1,
#else
    .struct_size = sizeof(caphy_plugin_table),
#endif
#ifdef FAULT_NO_TYPES
    .type_count = 0,
#else
    .type_count = sizeof(TYPES) / sizeof(TYPES[0]),
#endif
#ifndef FAULT_TYPES_ARE_NULL
    .types = TYPES,
#endif
};

#ifndef FAULT_NO_VERSION
uint32_t caphy_plugin_abi_version(void) {
#ifdef FAULT_VERSION
    return CAPHY_ABI_VERSION + 41;
#else
    return CAPHY_ABI_VERSION;
#endif
}
#endif

#ifndef FAULT_NO_TABLE
const caphy_plugin_table *caphy_plugin(void) {
#ifdef FAULT_TABLE_IS_NULL
    return NULL;
#else
    return &TABLE;
#endif
}
#else
/* Keeps the table from being unused. */
const void *not_the_symbol(void) { return &TABLE; }
#endif
