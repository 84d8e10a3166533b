/* The plugin interface of caphy: materials and nets in libraries of their own.
 *
 * Written by caphy itself from its Rust structs; do not edit. A complete example stands in examples/plugin-material-c.
 *
 * Contract
 *   - caphy_plugin_abi_version() is called first; a library of another version is not touched further.
 *   - Tables and names live as long as the library, which is never unloaded.
 *   - Handles are used from several threads at once; calls on a handle do not change it. destroy is called once.
 *   - Texts are UTF-8, not ended by a zero, and borrowed for the call alone. Sinks copy what is written to them.
 *   - The host has checked every block: lengths fit, inputs are finite, outputs declared as not offered are absent.
 *   - Equal blocks give equal bits, on any thread. Zero strain gives zero energy and stress. Every wanted output is finite
 *     for finite input.
 *   - A status other than CAPHY_OK leaves outputs undefined; its text, written to `error`, says why. For CAPHY_CONFIG the
 *     text has three lines: the key, the problem, the remedy; for CAPHY_LENGTH: the array's name, the length expected, the
 *     length given; for CAPHY_NON_FINITE: the array's name, the flat index, the value. For CAPHY_PARAMETER it has five: the
 *     parameter's name, the value, the lower and the upper bound, the unit.
 */
#ifndef CAPHY_PLUGIN_H
#define CAPHY_PLUGIN_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define CAPHY_ABI_VERSION 2
#define CAPHY_OK 0
#define CAPHY_UNSUPPORTED 1
#define CAPHY_CONFIG 2
#define CAPHY_FAILED 3
#define CAPHY_LENGTH 5
#define CAPHY_NON_FINITE 6
#define CAPHY_PARAMETER 7
#define CAPHY_KIND_MATERIAL 0
#define CAPHY_KIND_NET 1

/* An input array; `data` is NULL when it is absent. */
typedef struct {
    const float *data;
    size_t len;
} caphy_in_f32;

/* An output array; `data` is NULL when it is not wanted: do not compute it. */
typedef struct {
    float *data;
    size_t len;
} caphy_out_f32;

/* Triangle-frames, structure of arrays: shape [component][count], flat. N/m and J per m2 of rest area. */
typedef struct {
    size_t count; /* Number of triangle-frames. */
    caphy_in_f32 green; /* Green strain G = (F'F - I)/2, [Guu, Gvv, Guv][count]. */
    caphy_out_f32 energy; /* Energy density [J/m2], [count]. */
    caphy_out_f32 stress; /* Second Piola-Kirchhoff stress [N/m], [Suu, Svv, Suv][count]; Suv is half of d(energy)/dGuv. */
    caphy_out_f32 tangent_held; /* d(Suu, Svv, Suv)/d(Guu, Gvv, Guv) with the stiffness held, row-major [9][count]. */
    caphy_out_f32 tangent_total; /* The same with the stiffness's dependence on G. */
    caphy_out_f32 stress_by_parameter; /* d(Suu, Svv, Suv)/d(parameter), [parameter][3][count]. */
    caphy_out_f32 stiffness; /* Orthotropic constants [N/m], [k0, k1, k2, k3][count]. */
} caphy_membrane_f32;

/* Hinge-frames, structure of arrays. The energy k l^2 / (8 A) (angle - angle_rest)^2 is the host's. */
typedef struct {
    size_t count; /* Number of hinge-frames. */
    caphy_in_f32 angle; /* Dihedral angle [rad], 0 when flat, [count]. */
    caphy_in_f32 angle_rest; /* Rest dihedral angle [rad], [count]. */
    caphy_in_f32 length; /* Edge length by the material's rule [m], [count]. */
    caphy_in_f32 area; /* Sum of both rest areas [m2], [count]. */
    caphy_in_f32 direction0; /* Material direction (du, dv) of the edge on side 0, any length, [2][count]. */
    caphy_in_f32 direction1; /* The same on side 1; differs on a seam. */
    caphy_out_f32 stiffness; /* Bending stiffness k [N m], [count]. */
    caphy_out_f32 stiffness_by_angle; /* dk/d(angle) [N m/rad], [count]. */
    caphy_out_f32 stiffness_by_length; /* dk/d(length) [N], [count]. */
    caphy_out_f32 stiffness_by_parameter; /* dk/d(parameter), [parameter][count]. */
} caphy_hinge_f32;

/* A forward pass over `steps` consecutive frames of `batch` windows. */
typedef struct {
    size_t steps; /* Consecutive frames per window. */
    size_t batch; /* Windows. */
    caphy_in_f32 parameters; /* Flat parameters. */
    caphy_in_f32 features; /* Pose features, [step][window][input]. */
    caphy_in_f32 state_before; /* Carried state, [window][state]; absent means zeros. */
    caphy_out_f32 output; /* Canonical displacements [m], [step][window][output]; absent where only the state is wanted. */
    caphy_out_f32 state_after; /* Carried state after the last step, [window][state]. */
    caphy_out_f32 tape; /* What the backward pass needs, of tape_len values; absent in inference. */
} caphy_forward_f32;

/* A backward pass over the tape of a forward pass. */
typedef struct {
    size_t steps; /* As in the forward pass. */
    size_t batch; /* As in the forward pass. */
    caphy_in_f32 parameters; /* As in the forward pass. */
    caphy_in_f32 features; /* As in the forward pass. */
    caphy_in_f32 state_before; /* As in the forward pass. */
    caphy_in_f32 tape; /* The tape that the forward pass wrote. */
    caphy_in_f32 output_gradient; /* Gradient of the loss by the output, [step][window][output]. */
    caphy_out_f32 parameter_gradient; /* Gradient by the parameters: add to it. */
    caphy_out_f32 feature_gradient; /* Gradient by the features, [step][window][input]: overwrite it. */
} caphy_backward_f32;

/* An input array; `data` is NULL when it is absent. */
typedef struct {
    const double *data;
    size_t len;
} caphy_in_f64;

/* An output array; `data` is NULL when it is not wanted: do not compute it. */
typedef struct {
    double *data;
    size_t len;
} caphy_out_f64;

/* Triangle-frames, structure of arrays: shape [component][count], flat. N/m and J per m2 of rest area. */
typedef struct {
    size_t count; /* Number of triangle-frames. */
    caphy_in_f64 green; /* Green strain G = (F'F - I)/2, [Guu, Gvv, Guv][count]. */
    caphy_out_f64 energy; /* Energy density [J/m2], [count]. */
    caphy_out_f64 stress; /* Second Piola-Kirchhoff stress [N/m], [Suu, Svv, Suv][count]; Suv is half of d(energy)/dGuv. */
    caphy_out_f64 tangent_held; /* d(Suu, Svv, Suv)/d(Guu, Gvv, Guv) with the stiffness held, row-major [9][count]. */
    caphy_out_f64 tangent_total; /* The same with the stiffness's dependence on G. */
    caphy_out_f64 stress_by_parameter; /* d(Suu, Svv, Suv)/d(parameter), [parameter][3][count]. */
    caphy_out_f64 stiffness; /* Orthotropic constants [N/m], [k0, k1, k2, k3][count]. */
} caphy_membrane_f64;

/* Hinge-frames, structure of arrays. The energy k l^2 / (8 A) (angle - angle_rest)^2 is the host's. */
typedef struct {
    size_t count; /* Number of hinge-frames. */
    caphy_in_f64 angle; /* Dihedral angle [rad], 0 when flat, [count]. */
    caphy_in_f64 angle_rest; /* Rest dihedral angle [rad], [count]. */
    caphy_in_f64 length; /* Edge length by the material's rule [m], [count]. */
    caphy_in_f64 area; /* Sum of both rest areas [m2], [count]. */
    caphy_in_f64 direction0; /* Material direction (du, dv) of the edge on side 0, any length, [2][count]. */
    caphy_in_f64 direction1; /* The same on side 1; differs on a seam. */
    caphy_out_f64 stiffness; /* Bending stiffness k [N m], [count]. */
    caphy_out_f64 stiffness_by_angle; /* dk/d(angle) [N m/rad], [count]. */
    caphy_out_f64 stiffness_by_length; /* dk/d(length) [N], [count]. */
    caphy_out_f64 stiffness_by_parameter; /* dk/d(parameter), [parameter][count]. */
} caphy_hinge_f64;

/* A forward pass over `steps` consecutive frames of `batch` windows. */
typedef struct {
    size_t steps; /* Consecutive frames per window. */
    size_t batch; /* Windows. */
    caphy_in_f64 parameters; /* Flat parameters. */
    caphy_in_f64 features; /* Pose features, [step][window][input]. */
    caphy_in_f64 state_before; /* Carried state, [window][state]; absent means zeros. */
    caphy_out_f64 output; /* Canonical displacements [m], [step][window][output]; absent where only the state is wanted. */
    caphy_out_f64 state_after; /* Carried state after the last step, [window][state]. */
    caphy_out_f64 tape; /* What the backward pass needs, of tape_len values; absent in inference. */
} caphy_forward_f64;

/* A backward pass over the tape of a forward pass. */
typedef struct {
    size_t steps; /* As in the forward pass. */
    size_t batch; /* As in the forward pass. */
    caphy_in_f64 parameters; /* As in the forward pass. */
    caphy_in_f64 features; /* As in the forward pass. */
    caphy_in_f64 state_before; /* As in the forward pass. */
    caphy_in_f64 tape; /* The tape that the forward pass wrote. */
    caphy_in_f64 output_gradient; /* Gradient of the loss by the output, [step][window][output]. */
    caphy_out_f64 parameter_gradient; /* Gradient by the parameters: add to it. */
    caphy_out_f64 feature_gradient; /* Gradient by the features, [step][window][input]: overwrite it. */
} caphy_backward_f64;

/* Borrowed UTF-8 text, not ended by a zero. */
typedef struct {
    const uint8_t *data; /* First byte. */
    size_t len; /* Number of bytes. */
} caphy_text;

/* Where text is handed back: call write(context, data, len) any number of times. */
typedef struct {
    void *context; /* Handed back to write. */
    void (*write)(void *context, const uint8_t *data, size_t len); /* Appends a piece of text. */
} caphy_sink;

/* Facts about a material. */
typedef struct {
    double density; /* Area density [kg/m2]; NaN when the material does not know it. */
    size_t parameter_count; /* Number of native parameters. */
    uint8_t stiffness_frozen; /* 1 when the stress holds the stiffness instead of differentiating it. */
    uint8_t hinge_length; /* Edge length in bending: 0 rest, 1 current but held, 2 current. */
    uint8_t linear_in_parameters; /* 1 when energy and stress are linear in the parameters. */
    uint8_t offers_tangent_held; /* 1 when tangent_held is answered; 0: the host never asks. */
    uint8_t offers_tangent_total; /* 1 when tangent_total is answered. */
    uint8_t offers_by_parameter; /* 1 when derivatives by parameters are answered. */
    uint8_t offers_stiffness; /* 1 when the four orthotropic constants are answered. */
    uint8_t offers_hinge_slopes; /* 1 when stiffness_by_angle and _by_length are answered. */
} caphy_material_facts;

/* Value and bounds of a native parameter. */
typedef struct {
    double value; /* Present value, in the parameter's unit. */
    double lower; /* Smallest allowed value. */
    double upper; /* Largest allowed value. */
} caphy_parameter_facts;

/* Functions of a material type; none may be NULL except normalise. All return a status. */
typedef struct {
    size_t struct_size; /* sizeof(caphy_material_table). */
    int32_t (*create)(caphy_text toml, void **out, caphy_sink error); /* Makes a material from its TOML table (`type` and its keys). */
    void (*destroy)(void *material); /* Ends a material. */
    int32_t (*describe)(const void *material, caphy_material_facts *out, caphy_sink error); /* Facts. */
    int32_t (*parameter)(const void *material, size_t index, caphy_parameter_facts *out, caphy_sink name, caphy_sink unit, caphy_sink error); /* One parameter, its name and unit. */
    int32_t (*with_parameters)(const void *material, const double *values, size_t count, void **out, caphy_sink error); /* A new material with all parameter values given; they are within bounds. */
    int32_t (*membrane_f32)(const void *material, caphy_membrane_f32 *block, caphy_sink error); /* Membrane block. */
    int32_t (*membrane_f64)(const void *material, caphy_membrane_f64 *block, caphy_sink error); /* Membrane block. */
    int32_t (*hinge_f32)(const void *material, caphy_hinge_f32 *block, caphy_sink error); /* Hinge block. */
    int32_t (*hinge_f64)(const void *material, caphy_hinge_f64 *block, caphy_sink error); /* Hinge block. */
    int32_t (*normalise)(caphy_text toml, caphy_sink out, caphy_sink error); /* Writes the table back with every default filled in; may be NULL. */
} caphy_material_table;

/* Sizes of a net. */
typedef struct {
    size_t inputs; /* Features per frame, as asked for. */
    size_t outputs; /* Outputs per frame, as asked for. */
    size_t state; /* Values of carried state per window. */
    size_t tensor_count; /* Number of tensors. */
    uint8_t offers_double; /* 1 when double precision is answered. */
    uint8_t offers_feature_gradient; /* 1 when feature_gradient is answered. */
} caphy_net_facts;

/* Shape and place of a tensor; tensors follow each other without gaps. */
typedef struct {
    size_t offset; /* First element in the flat parameters. */
    size_t rank; /* Number of dimensions, at most 8. */
    size_t shape[8]; /* Row-major shape; the first `rank` count. */
} caphy_tensor_facts;

/* Functions of a net type; none may be NULL except normalise. All return a status. */
typedef struct {
    size_t struct_size; /* sizeof(caphy_net_table). */
    int32_t (*create)(caphy_text toml, size_t inputs, size_t outputs, void **out, caphy_sink error); /* Makes a net of these sizes. */
    void (*destroy)(void *net); /* Ends a net. */
    int32_t (*describe)(const void *net, caphy_net_facts *out, caphy_sink error); /* Sizes. */
    int32_t (*tensor)(const void *net, size_t index, caphy_tensor_facts *out, caphy_sink name, caphy_sink error); /* One tensor and its name. */
    int32_t (*initialise)(const void *net, uint64_t seed, double *out, size_t count, caphy_sink error); /* First parameters from a seed; the last layer zero. */
    int32_t (*tape_len)(const void *net, size_t steps, size_t batch, size_t *out, caphy_sink error); /* Values on the tape of a pass. */
    int32_t (*forward_f32)(const void *net, caphy_forward_f32 *block, caphy_sink error); /* Forward pass. */
    int32_t (*forward_f64)(const void *net, caphy_forward_f64 *block, caphy_sink error); /* Forward pass. */
    int32_t (*backward_f32)(const void *net, caphy_backward_f32 *block, caphy_sink error); /* Backward pass. */
    int32_t (*backward_f64)(const void *net, caphy_backward_f64 *block, caphy_sink error); /* Backward pass. */
    int32_t (*normalise)(caphy_text toml, caphy_sink out, caphy_sink error); /* Writes the table back with every default filled in; may be NULL. */
} caphy_net_table;

/* One type of a library. */
typedef struct {
    uint32_t kind; /* CAPHY_KIND_MATERIAL or CAPHY_KIND_NET. */
    caphy_text name; /* The `type` name in TOML. */
    const caphy_material_table *material; /* Functions of a material, else NULL. */
    const caphy_net_table *net; /* Functions of a net, else NULL. */
} caphy_plugin_entry;

/* What caphy_plugin() returns; lives as long as the library. */
typedef struct {
    size_t struct_size; /* sizeof(caphy_plugin_table). */
    size_t type_count; /* Number of types. */
    const caphy_plugin_entry *types; /* The types. */
} caphy_plugin_table;

/* Exported by every plugin. */
uint32_t caphy_plugin_abi_version(void);
const caphy_plugin_table *caphy_plugin(void);

#ifdef __cplusplus
}
#endif

#if UINTPTR_MAX == 0xffffffffffffffffu && defined(__STDC_VERSION__) && __STDC_VERSION__ >= 201112L
_Static_assert(sizeof(caphy_in_f32) == 16, "caphy_in_f32");
_Static_assert(sizeof(caphy_out_f32) == 16, "caphy_out_f32");
_Static_assert(sizeof(caphy_membrane_f32) == 120, "caphy_membrane_f32");
_Static_assert(offsetof(caphy_membrane_f32, count) == 0, "caphy_membrane_f32.count");
_Static_assert(offsetof(caphy_membrane_f32, green) == 8, "caphy_membrane_f32.green");
_Static_assert(offsetof(caphy_membrane_f32, energy) == 24, "caphy_membrane_f32.energy");
_Static_assert(offsetof(caphy_membrane_f32, stress) == 40, "caphy_membrane_f32.stress");
_Static_assert(offsetof(caphy_membrane_f32, tangent_held) == 56, "caphy_membrane_f32.tangent_held");
_Static_assert(offsetof(caphy_membrane_f32, tangent_total) == 72, "caphy_membrane_f32.tangent_total");
_Static_assert(offsetof(caphy_membrane_f32, stress_by_parameter) == 88, "caphy_membrane_f32.stress_by_parameter");
_Static_assert(offsetof(caphy_membrane_f32, stiffness) == 104, "caphy_membrane_f32.stiffness");
_Static_assert(sizeof(caphy_hinge_f32) == 168, "caphy_hinge_f32");
_Static_assert(offsetof(caphy_hinge_f32, count) == 0, "caphy_hinge_f32.count");
_Static_assert(offsetof(caphy_hinge_f32, angle) == 8, "caphy_hinge_f32.angle");
_Static_assert(offsetof(caphy_hinge_f32, angle_rest) == 24, "caphy_hinge_f32.angle_rest");
_Static_assert(offsetof(caphy_hinge_f32, length) == 40, "caphy_hinge_f32.length");
_Static_assert(offsetof(caphy_hinge_f32, area) == 56, "caphy_hinge_f32.area");
_Static_assert(offsetof(caphy_hinge_f32, direction0) == 72, "caphy_hinge_f32.direction0");
_Static_assert(offsetof(caphy_hinge_f32, direction1) == 88, "caphy_hinge_f32.direction1");
_Static_assert(offsetof(caphy_hinge_f32, stiffness) == 104, "caphy_hinge_f32.stiffness");
_Static_assert(offsetof(caphy_hinge_f32, stiffness_by_angle) == 120, "caphy_hinge_f32.stiffness_by_angle");
_Static_assert(offsetof(caphy_hinge_f32, stiffness_by_length) == 136, "caphy_hinge_f32.stiffness_by_length");
_Static_assert(offsetof(caphy_hinge_f32, stiffness_by_parameter) == 152, "caphy_hinge_f32.stiffness_by_parameter");
_Static_assert(sizeof(caphy_forward_f32) == 112, "caphy_forward_f32");
_Static_assert(offsetof(caphy_forward_f32, steps) == 0, "caphy_forward_f32.steps");
_Static_assert(offsetof(caphy_forward_f32, batch) == 8, "caphy_forward_f32.batch");
_Static_assert(offsetof(caphy_forward_f32, parameters) == 16, "caphy_forward_f32.parameters");
_Static_assert(offsetof(caphy_forward_f32, features) == 32, "caphy_forward_f32.features");
_Static_assert(offsetof(caphy_forward_f32, state_before) == 48, "caphy_forward_f32.state_before");
_Static_assert(offsetof(caphy_forward_f32, output) == 64, "caphy_forward_f32.output");
_Static_assert(offsetof(caphy_forward_f32, state_after) == 80, "caphy_forward_f32.state_after");
_Static_assert(offsetof(caphy_forward_f32, tape) == 96, "caphy_forward_f32.tape");
_Static_assert(sizeof(caphy_backward_f32) == 128, "caphy_backward_f32");
_Static_assert(offsetof(caphy_backward_f32, steps) == 0, "caphy_backward_f32.steps");
_Static_assert(offsetof(caphy_backward_f32, batch) == 8, "caphy_backward_f32.batch");
_Static_assert(offsetof(caphy_backward_f32, parameters) == 16, "caphy_backward_f32.parameters");
_Static_assert(offsetof(caphy_backward_f32, features) == 32, "caphy_backward_f32.features");
_Static_assert(offsetof(caphy_backward_f32, state_before) == 48, "caphy_backward_f32.state_before");
_Static_assert(offsetof(caphy_backward_f32, tape) == 64, "caphy_backward_f32.tape");
_Static_assert(offsetof(caphy_backward_f32, output_gradient) == 80, "caphy_backward_f32.output_gradient");
_Static_assert(offsetof(caphy_backward_f32, parameter_gradient) == 96, "caphy_backward_f32.parameter_gradient");
_Static_assert(offsetof(caphy_backward_f32, feature_gradient) == 112, "caphy_backward_f32.feature_gradient");
_Static_assert(sizeof(caphy_in_f64) == 16, "caphy_in_f64");
_Static_assert(sizeof(caphy_out_f64) == 16, "caphy_out_f64");
_Static_assert(sizeof(caphy_membrane_f64) == 120, "caphy_membrane_f64");
_Static_assert(offsetof(caphy_membrane_f64, count) == 0, "caphy_membrane_f64.count");
_Static_assert(offsetof(caphy_membrane_f64, green) == 8, "caphy_membrane_f64.green");
_Static_assert(offsetof(caphy_membrane_f64, energy) == 24, "caphy_membrane_f64.energy");
_Static_assert(offsetof(caphy_membrane_f64, stress) == 40, "caphy_membrane_f64.stress");
_Static_assert(offsetof(caphy_membrane_f64, tangent_held) == 56, "caphy_membrane_f64.tangent_held");
_Static_assert(offsetof(caphy_membrane_f64, tangent_total) == 72, "caphy_membrane_f64.tangent_total");
_Static_assert(offsetof(caphy_membrane_f64, stress_by_parameter) == 88, "caphy_membrane_f64.stress_by_parameter");
_Static_assert(offsetof(caphy_membrane_f64, stiffness) == 104, "caphy_membrane_f64.stiffness");
_Static_assert(sizeof(caphy_hinge_f64) == 168, "caphy_hinge_f64");
_Static_assert(offsetof(caphy_hinge_f64, count) == 0, "caphy_hinge_f64.count");
_Static_assert(offsetof(caphy_hinge_f64, angle) == 8, "caphy_hinge_f64.angle");
_Static_assert(offsetof(caphy_hinge_f64, angle_rest) == 24, "caphy_hinge_f64.angle_rest");
_Static_assert(offsetof(caphy_hinge_f64, length) == 40, "caphy_hinge_f64.length");
_Static_assert(offsetof(caphy_hinge_f64, area) == 56, "caphy_hinge_f64.area");
_Static_assert(offsetof(caphy_hinge_f64, direction0) == 72, "caphy_hinge_f64.direction0");
_Static_assert(offsetof(caphy_hinge_f64, direction1) == 88, "caphy_hinge_f64.direction1");
_Static_assert(offsetof(caphy_hinge_f64, stiffness) == 104, "caphy_hinge_f64.stiffness");
_Static_assert(offsetof(caphy_hinge_f64, stiffness_by_angle) == 120, "caphy_hinge_f64.stiffness_by_angle");
_Static_assert(offsetof(caphy_hinge_f64, stiffness_by_length) == 136, "caphy_hinge_f64.stiffness_by_length");
_Static_assert(offsetof(caphy_hinge_f64, stiffness_by_parameter) == 152, "caphy_hinge_f64.stiffness_by_parameter");
_Static_assert(sizeof(caphy_forward_f64) == 112, "caphy_forward_f64");
_Static_assert(offsetof(caphy_forward_f64, steps) == 0, "caphy_forward_f64.steps");
_Static_assert(offsetof(caphy_forward_f64, batch) == 8, "caphy_forward_f64.batch");
_Static_assert(offsetof(caphy_forward_f64, parameters) == 16, "caphy_forward_f64.parameters");
_Static_assert(offsetof(caphy_forward_f64, features) == 32, "caphy_forward_f64.features");
_Static_assert(offsetof(caphy_forward_f64, state_before) == 48, "caphy_forward_f64.state_before");
_Static_assert(offsetof(caphy_forward_f64, output) == 64, "caphy_forward_f64.output");
_Static_assert(offsetof(caphy_forward_f64, state_after) == 80, "caphy_forward_f64.state_after");
_Static_assert(offsetof(caphy_forward_f64, tape) == 96, "caphy_forward_f64.tape");
_Static_assert(sizeof(caphy_backward_f64) == 128, "caphy_backward_f64");
_Static_assert(offsetof(caphy_backward_f64, steps) == 0, "caphy_backward_f64.steps");
_Static_assert(offsetof(caphy_backward_f64, batch) == 8, "caphy_backward_f64.batch");
_Static_assert(offsetof(caphy_backward_f64, parameters) == 16, "caphy_backward_f64.parameters");
_Static_assert(offsetof(caphy_backward_f64, features) == 32, "caphy_backward_f64.features");
_Static_assert(offsetof(caphy_backward_f64, state_before) == 48, "caphy_backward_f64.state_before");
_Static_assert(offsetof(caphy_backward_f64, tape) == 64, "caphy_backward_f64.tape");
_Static_assert(offsetof(caphy_backward_f64, output_gradient) == 80, "caphy_backward_f64.output_gradient");
_Static_assert(offsetof(caphy_backward_f64, parameter_gradient) == 96, "caphy_backward_f64.parameter_gradient");
_Static_assert(offsetof(caphy_backward_f64, feature_gradient) == 112, "caphy_backward_f64.feature_gradient");
_Static_assert(sizeof(caphy_text) == 16, "caphy_text");
_Static_assert(offsetof(caphy_text, data) == 0, "caphy_text.data");
_Static_assert(offsetof(caphy_text, len) == 8, "caphy_text.len");
_Static_assert(sizeof(caphy_sink) == 16, "caphy_sink");
_Static_assert(offsetof(caphy_sink, context) == 0, "caphy_sink.context");
_Static_assert(offsetof(caphy_sink, write) == 8, "caphy_sink.write");
_Static_assert(sizeof(caphy_material_facts) == 24, "caphy_material_facts");
_Static_assert(offsetof(caphy_material_facts, density) == 0, "caphy_material_facts.density");
_Static_assert(offsetof(caphy_material_facts, parameter_count) == 8, "caphy_material_facts.parameter_count");
_Static_assert(offsetof(caphy_material_facts, stiffness_frozen) == 16, "caphy_material_facts.stiffness_frozen");
_Static_assert(offsetof(caphy_material_facts, hinge_length) == 17, "caphy_material_facts.hinge_length");
_Static_assert(offsetof(caphy_material_facts, linear_in_parameters) == 18, "caphy_material_facts.linear_in_parameters");
_Static_assert(offsetof(caphy_material_facts, offers_tangent_held) == 19, "caphy_material_facts.offers_tangent_held");
_Static_assert(offsetof(caphy_material_facts, offers_tangent_total) == 20, "caphy_material_facts.offers_tangent_total");
_Static_assert(offsetof(caphy_material_facts, offers_by_parameter) == 21, "caphy_material_facts.offers_by_parameter");
_Static_assert(offsetof(caphy_material_facts, offers_stiffness) == 22, "caphy_material_facts.offers_stiffness");
_Static_assert(offsetof(caphy_material_facts, offers_hinge_slopes) == 23, "caphy_material_facts.offers_hinge_slopes");
_Static_assert(sizeof(caphy_parameter_facts) == 24, "caphy_parameter_facts");
_Static_assert(offsetof(caphy_parameter_facts, value) == 0, "caphy_parameter_facts.value");
_Static_assert(offsetof(caphy_parameter_facts, lower) == 8, "caphy_parameter_facts.lower");
_Static_assert(offsetof(caphy_parameter_facts, upper) == 16, "caphy_parameter_facts.upper");
_Static_assert(sizeof(caphy_material_table) == 88, "caphy_material_table");
_Static_assert(offsetof(caphy_material_table, struct_size) == 0, "caphy_material_table.struct_size");
_Static_assert(offsetof(caphy_material_table, create) == 8, "caphy_material_table.create");
_Static_assert(offsetof(caphy_material_table, destroy) == 16, "caphy_material_table.destroy");
_Static_assert(offsetof(caphy_material_table, describe) == 24, "caphy_material_table.describe");
_Static_assert(offsetof(caphy_material_table, parameter) == 32, "caphy_material_table.parameter");
_Static_assert(offsetof(caphy_material_table, with_parameters) == 40, "caphy_material_table.with_parameters");
_Static_assert(offsetof(caphy_material_table, membrane_f32) == 48, "caphy_material_table.membrane_f32");
_Static_assert(offsetof(caphy_material_table, membrane_f64) == 56, "caphy_material_table.membrane_f64");
_Static_assert(offsetof(caphy_material_table, hinge_f32) == 64, "caphy_material_table.hinge_f32");
_Static_assert(offsetof(caphy_material_table, hinge_f64) == 72, "caphy_material_table.hinge_f64");
_Static_assert(offsetof(caphy_material_table, normalise) == 80, "caphy_material_table.normalise");
_Static_assert(sizeof(caphy_net_facts) == 40, "caphy_net_facts");
_Static_assert(offsetof(caphy_net_facts, inputs) == 0, "caphy_net_facts.inputs");
_Static_assert(offsetof(caphy_net_facts, outputs) == 8, "caphy_net_facts.outputs");
_Static_assert(offsetof(caphy_net_facts, state) == 16, "caphy_net_facts.state");
_Static_assert(offsetof(caphy_net_facts, tensor_count) == 24, "caphy_net_facts.tensor_count");
_Static_assert(offsetof(caphy_net_facts, offers_double) == 32, "caphy_net_facts.offers_double");
_Static_assert(offsetof(caphy_net_facts, offers_feature_gradient) == 33, "caphy_net_facts.offers_feature_gradient");
_Static_assert(sizeof(caphy_tensor_facts) == 80, "caphy_tensor_facts");
_Static_assert(offsetof(caphy_tensor_facts, offset) == 0, "caphy_tensor_facts.offset");
_Static_assert(offsetof(caphy_tensor_facts, rank) == 8, "caphy_tensor_facts.rank");
_Static_assert(offsetof(caphy_tensor_facts, shape) == 16, "caphy_tensor_facts.shape");
_Static_assert(sizeof(caphy_net_table) == 96, "caphy_net_table");
_Static_assert(offsetof(caphy_net_table, struct_size) == 0, "caphy_net_table.struct_size");
_Static_assert(offsetof(caphy_net_table, create) == 8, "caphy_net_table.create");
_Static_assert(offsetof(caphy_net_table, destroy) == 16, "caphy_net_table.destroy");
_Static_assert(offsetof(caphy_net_table, describe) == 24, "caphy_net_table.describe");
_Static_assert(offsetof(caphy_net_table, tensor) == 32, "caphy_net_table.tensor");
_Static_assert(offsetof(caphy_net_table, initialise) == 40, "caphy_net_table.initialise");
_Static_assert(offsetof(caphy_net_table, tape_len) == 48, "caphy_net_table.tape_len");
_Static_assert(offsetof(caphy_net_table, forward_f32) == 56, "caphy_net_table.forward_f32");
_Static_assert(offsetof(caphy_net_table, forward_f64) == 64, "caphy_net_table.forward_f64");
_Static_assert(offsetof(caphy_net_table, backward_f32) == 72, "caphy_net_table.backward_f32");
_Static_assert(offsetof(caphy_net_table, backward_f64) == 80, "caphy_net_table.backward_f64");
_Static_assert(offsetof(caphy_net_table, normalise) == 88, "caphy_net_table.normalise");
_Static_assert(sizeof(caphy_plugin_entry) == 40, "caphy_plugin_entry");
_Static_assert(offsetof(caphy_plugin_entry, kind) == 0, "caphy_plugin_entry.kind");
_Static_assert(offsetof(caphy_plugin_entry, name) == 8, "caphy_plugin_entry.name");
_Static_assert(offsetof(caphy_plugin_entry, material) == 24, "caphy_plugin_entry.material");
_Static_assert(offsetof(caphy_plugin_entry, net) == 32, "caphy_plugin_entry.net");
_Static_assert(sizeof(caphy_plugin_table) == 24, "caphy_plugin_table");
_Static_assert(offsetof(caphy_plugin_table, struct_size) == 0, "caphy_plugin_table.struct_size");
_Static_assert(offsetof(caphy_plugin_table, type_count) == 8, "caphy_plugin_table.type_count");
_Static_assert(offsetof(caphy_plugin_table, types) == 16, "caphy_plugin_table.types");
#endif

#endif
