//! The C header, written from the Rust structs: sizes and offsets in it are the compiler's own.

use super::abi::*;
use crate::array::{In, Out};
use crate::material::{HingeBlock, MembraneBlock};
use crate::net::{BackwardBlock, ForwardBlock};
use std::fmt::Write;
use std::mem::offset_of;

/// A struct as the header shows it.
struct Layout {
    name: &'static str,
    doc: &'static str,
    size: usize,
    /// Declaration, comment, offset.
    fields: Vec<(&'static str, &'static str, usize)>,
}

/// Fields are named once; their offsets come from the compiler, so that a renamed or moved field does not go unnoticed.
macro_rules! layout {
    ($rust:ty as $name:literal, $doc:literal, { $($field:ident: $decl:literal, $comment:literal;)* }) => {
        Layout {
            name: $name,
            doc: $doc,
            size: size_of::<$rust>(),
            fields: vec![$(($decl, $comment, offset_of!($rust, $field))),*],
        }
    };
}

macro_rules! blocks {
    ($real:ty, $in:literal, $out:literal, $membrane:literal, $hinge:literal, $forward:literal, $backward:literal) => {
        vec![
            Layout {
                name: $in,
                doc: "An input array; `data` is NULL when it is absent.",
                size: size_of::<In<'_, $real>>(),
                fields: vec![],
            },
            Layout {
                name: $out,
                doc: "An output array; `data` is NULL when it is not wanted: do not compute it.",
                size: size_of::<Out<'_, $real>>(),
                fields: vec![],
            },
            layout!(MembraneBlock<'_, $real> as $membrane,
                "Triangle-frames, structure of arrays: shape [component][count], flat. N/m and J per m2 of rest area.", {
                count: "size_t count", "Number of triangle-frames.";
                green: "IN green", "Green strain G = (F'F - I)/2, [Guu, Gvv, Guv][count].";
                energy: "OUT energy", "Energy density [J/m2], [count].";
                stress: "OUT stress", "Second Piola-Kirchhoff stress [N/m], [Suu, Svv, Suv][count]; Suv is half of d(energy)/dGuv.";
                tangent_held: "OUT tangent_held", "d(Suu, Svv, Suv)/d(Guu, Gvv, Guv) with the stiffness held, row-major [9][count].";
                tangent_total: "OUT tangent_total", "The same with the stiffness's dependence on G.";
                stress_by_parameter: "OUT stress_by_parameter", "d(Suu, Svv, Suv)/d(parameter), [parameter][3][count].";
                stiffness: "OUT stiffness", "Orthotropic constants [N/m], [k0, k1, k2, k3][count].";
            }),
            layout!(HingeBlock<'_, $real> as $hinge,
                "Hinge-frames, structure of arrays. The energy k l^2 / (8 A) (angle - angle_rest)^2 is the host's.", {
                count: "size_t count", "Number of hinge-frames.";
                angle: "IN angle", "Dihedral angle [rad], 0 when flat, [count].";
                angle_rest: "IN angle_rest", "Rest dihedral angle [rad], [count].";
                length: "IN length", "Edge length by the material's rule [m], [count].";
                area: "IN area", "Sum of both rest areas [m2], [count].";
                direction0: "IN direction0", "Material direction (du, dv) of the edge on side 0, any length, [2][count].";
                direction1: "IN direction1", "The same on side 1; differs on a seam.";
                stiffness: "OUT stiffness", "Bending stiffness k [N m], [count].";
                stiffness_by_angle: "OUT stiffness_by_angle", "dk/d(angle) [N m/rad], [count].";
                stiffness_by_length: "OUT stiffness_by_length", "dk/d(length) [N], [count].";
                stiffness_by_parameter: "OUT stiffness_by_parameter", "dk/d(parameter), [parameter][count].";
            }),
            layout!(ForwardBlock<'_, $real> as $forward,
                "A forward pass over `steps` consecutive frames of `batch` windows.", {
                steps: "size_t steps", "Consecutive frames per window.";
                batch: "size_t batch", "Windows.";
                parameters: "IN parameters", "Flat parameters.";
                features: "IN features", "Pose features, [step][window][input].";
                state_before: "IN state_before", "Carried state, [window][state]; absent means zeros.";
                output: "OUT output", "Canonical displacements [m], [step][window][output]; absent where only the state is wanted.";
                state_after: "OUT state_after", "Carried state after the last step, [window][state].";
                tape: "OUT tape", "What the backward pass needs, of tape_len values; absent in inference.";
            }),
            layout!(BackwardBlock<'_, $real> as $backward,
                "A backward pass over the tape of a forward pass.", {
                steps: "size_t steps", "As in the forward pass.";
                batch: "size_t batch", "As in the forward pass.";
                parameters: "IN parameters", "As in the forward pass.";
                features: "IN features", "As in the forward pass.";
                state_before: "IN state_before", "As in the forward pass.";
                tape: "IN tape", "The tape that the forward pass wrote.";
                output_gradient: "IN output_gradient", "Gradient of the loss by the output, [step][window][output].";
                parameter_gradient: "OUT parameter_gradient", "Gradient by the parameters: add to it.";
                feature_gradient: "OUT feature_gradient", "Gradient by the features, [step][window][input]: overwrite it.";
            }),
        ]
    };
}

fn tables() -> Vec<Layout> {
    vec![
        layout!(Text as "caphy_text", "Borrowed UTF-8 text, not ended by a zero.", {
            data: "const uint8_t *data", "First byte.";
            len: "size_t len", "Number of bytes.";
        }),
        layout!(Sink as "caphy_sink", "Where text is handed back: call write(context, data, len) any number of times.", {
            context: "void *context", "Handed back to write.";
            write: "void (*write)(void *context, const uint8_t *data, size_t len)", "Appends a piece of text.";
        }),
        layout!(MaterialFacts as "caphy_material_facts", "Facts about a material.", {
            density: "double density", "Area density [kg/m2]; NaN when the material does not know it.";
            parameter_count: "size_t parameter_count", "Number of native parameters.";
            stiffness_frozen: "uint8_t stiffness_frozen", "1 when the stress holds the stiffness instead of differentiating it.";
            hinge_length: "uint8_t hinge_length", "Edge length in bending: 0 rest, 1 current but held, 2 current.";
            linear_in_parameters: "uint8_t linear_in_parameters", "1 when energy and stress are linear in the parameters.";
            offers_tangent_held: "uint8_t offers_tangent_held", "1 when tangent_held is answered; 0: the host never asks.";
            offers_tangent_total: "uint8_t offers_tangent_total", "1 when tangent_total is answered.";
            offers_by_parameter: "uint8_t offers_by_parameter", "1 when derivatives by parameters are answered.";
            offers_stiffness: "uint8_t offers_stiffness", "1 when the four orthotropic constants are answered.";
            offers_hinge_slopes: "uint8_t offers_hinge_slopes", "1 when stiffness_by_angle and _by_length are answered.";
        }),
        layout!(ParameterFacts as "caphy_parameter_facts", "Value and bounds of a native parameter.", {
            value: "double value", "Present value, in the parameter's unit.";
            lower: "double lower", "Smallest allowed value.";
            upper: "double upper", "Largest allowed value.";
        }),
        layout!(MaterialTable as "caphy_material_table",
            "Functions of a material type; none may be NULL except normalise. All return a status.", {
            struct_size: "size_t struct_size", "sizeof(caphy_material_table).";
            create: "int32_t (*create)(caphy_text toml, void **out, caphy_sink error)", "Makes a material from its TOML table (`type` and its keys).";
            destroy: "void (*destroy)(void *material)", "Ends a material.";
            describe: "int32_t (*describe)(const void *material, caphy_material_facts *out, caphy_sink error)", "Facts.";
            parameter: "int32_t (*parameter)(const void *material, size_t index, caphy_parameter_facts *out, caphy_sink name, caphy_sink unit, caphy_sink error)", "One parameter, its name and unit.";
            with_parameters: "int32_t (*with_parameters)(const void *material, const double *values, size_t count, void **out, caphy_sink error)", "A new material with all parameter values given; they are within bounds.";
            membrane_f32: "int32_t (*membrane_f32)(const void *material, caphy_membrane_f32 *block, caphy_sink error)", "Membrane block.";
            membrane_f64: "int32_t (*membrane_f64)(const void *material, caphy_membrane_f64 *block, caphy_sink error)", "Membrane block.";
            hinge_f32: "int32_t (*hinge_f32)(const void *material, caphy_hinge_f32 *block, caphy_sink error)", "Hinge block.";
            hinge_f64: "int32_t (*hinge_f64)(const void *material, caphy_hinge_f64 *block, caphy_sink error)", "Hinge block.";
            normalise: "int32_t (*normalise)(caphy_text toml, caphy_sink out, caphy_sink error)", "Writes the table back with every default filled in; may be NULL.";
        }),
        layout!(NetFacts as "caphy_net_facts", "Sizes of a net.", {
            inputs: "size_t inputs", "Features per frame, as asked for.";
            outputs: "size_t outputs", "Outputs per frame, as asked for.";
            state: "size_t state", "Values of carried state per window.";
            tensor_count: "size_t tensor_count", "Number of tensors.";
            offers_double: "uint8_t offers_double", "1 when double precision is answered.";
            offers_feature_gradient: "uint8_t offers_feature_gradient", "1 when feature_gradient is answered.";
        }),
        layout!(TensorFacts as "caphy_tensor_facts", "Shape and place of a tensor; tensors follow each other without gaps.", {
            offset: "size_t offset", "First element in the flat parameters.";
            rank: "size_t rank", "Number of dimensions, at most 8.";
            shape: "size_t shape[8]", "Row-major shape; the first `rank` count.";
        }),
        layout!(NetTable as "caphy_net_table",
            "Functions of a net type; none may be NULL except normalise. All return a status.", {
            struct_size: "size_t struct_size", "sizeof(caphy_net_table).";
            create: "int32_t (*create)(caphy_text toml, size_t inputs, size_t outputs, void **out, caphy_sink error)", "Makes a net of these sizes.";
            destroy: "void (*destroy)(void *net)", "Ends a net.";
            describe: "int32_t (*describe)(const void *net, caphy_net_facts *out, caphy_sink error)", "Sizes.";
            tensor: "int32_t (*tensor)(const void *net, size_t index, caphy_tensor_facts *out, caphy_sink name, caphy_sink error)", "One tensor and its name.";
            initialise: "int32_t (*initialise)(const void *net, uint64_t seed, double *out, size_t count, caphy_sink error)", "First parameters from a seed; the last layer zero.";
            tape_len: "int32_t (*tape_len)(const void *net, size_t steps, size_t batch, size_t *out, caphy_sink error)", "Values on the tape of a pass.";
            forward_f32: "int32_t (*forward_f32)(const void *net, caphy_forward_f32 *block, caphy_sink error)", "Forward pass.";
            forward_f64: "int32_t (*forward_f64)(const void *net, caphy_forward_f64 *block, caphy_sink error)", "Forward pass.";
            backward_f32: "int32_t (*backward_f32)(const void *net, caphy_backward_f32 *block, caphy_sink error)", "Backward pass.";
            backward_f64: "int32_t (*backward_f64)(const void *net, caphy_backward_f64 *block, caphy_sink error)", "Backward pass.";
            normalise: "int32_t (*normalise)(caphy_text toml, caphy_sink out, caphy_sink error)", "Writes the table back with every default filled in; may be NULL.";
        }),
        layout!(PluginEntry as "caphy_plugin_entry", "One type of a library.", {
            kind: "uint32_t kind", "CAPHY_KIND_MATERIAL or CAPHY_KIND_NET.";
            name: "caphy_text name", "The `type` name in TOML.";
            material: "const caphy_material_table *material", "Functions of a material, else NULL.";
            net: "const caphy_net_table *net", "Functions of a net, else NULL.";
        }),
        layout!(PluginTable as "caphy_plugin_table", "What caphy_plugin() returns; lives as long as the library.", {
            struct_size: "size_t struct_size", "sizeof(caphy_plugin_table).";
            type_count: "size_t type_count", "Number of types.";
            types: "const caphy_plugin_entry *types", "The types.";
        }),
    ]
}

const INTRODUCTION: &str = "\
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
extern \"C\" {
#endif

";

/// The whole header.
pub fn header() -> String {
    let mut out = String::from(INTRODUCTION);
    // Writing to a String cannot fail.
    for (name, value) in [
        ("ABI_VERSION", i64::from(ABI_VERSION)),
        ("OK", i64::from(OK)),
        ("UNSUPPORTED", i64::from(UNSUPPORTED)),
        ("CONFIG", i64::from(CONFIG)),
        ("FAILED", i64::from(FAILED)),
        ("LENGTH", i64::from(LENGTH)),
        ("NON_FINITE", i64::from(NON_FINITE)),
        ("PARAMETER", i64::from(PARAMETER)),
        ("KIND_MATERIAL", i64::from(KIND_MATERIAL)),
        ("KIND_NET", i64::from(KIND_NET)),
    ] {
        let _ = writeln!(out, "#define CAPHY_{name} {value}");
    }
    out.push('\n');
    let single = blocks!(
        f32,
        "caphy_in_f32",
        "caphy_out_f32",
        "caphy_membrane_f32",
        "caphy_hinge_f32",
        "caphy_forward_f32",
        "caphy_backward_f32"
    );
    let double = blocks!(
        f64,
        "caphy_in_f64",
        "caphy_out_f64",
        "caphy_membrane_f64",
        "caphy_hinge_f64",
        "caphy_forward_f64",
        "caphy_backward_f64"
    );
    let all: Vec<Layout> = single.into_iter().chain(double).chain(tables()).collect();
    for layout in &all {
        write_struct(&mut out, layout);
    }
    out.push_str("/* Exported by every plugin. */\nuint32_t caphy_plugin_abi_version(void);\n");
    out.push_str("const caphy_plugin_table *caphy_plugin(void);\n\n#ifdef __cplusplus\n}\n#endif\n\n");
    // Layouts of the 64-bit machines that caphy runs on; another one is noticed when the plugin is compiled.
    out.push_str(
        "#if UINTPTR_MAX == 0xffffffffffffffffu && defined(__STDC_VERSION__) && __STDC_VERSION__ >= 201112L\n",
    );
    for layout in &all {
        let _ = writeln!(out, "_Static_assert(sizeof({0}) == {1}, \"{0}\");", layout.name, layout.size);
        for (declaration, _, offset) in &layout.fields {
            let field = field_name(declaration);
            let _ = writeln!(out, "_Static_assert(offsetof({0}, {field}) == {offset}, \"{0}.{field}\");", layout.name);
        }
    }
    out.push_str("#endif\n\n#endif\n");
    out
}

fn write_struct(out: &mut String, layout: &Layout) {
    let real = if layout.name.ends_with("f32") { "float" } else { "double" };
    let suffix = &layout.name[layout.name.len() - 3..];
    let _ = writeln!(out, "/* {} */\ntypedef struct {{", layout.doc);
    if layout.name.starts_with("caphy_in_") {
        let _ = writeln!(out, "    const {real} *data;\n    size_t len;");
    } else if layout.name.starts_with("caphy_out_") {
        let _ = writeln!(out, "    {real} *data;\n    size_t len;");
    }
    for (declaration, comment, _) in &layout.fields {
        let declaration = declaration.replacen("IN ", &format!("caphy_in_{suffix} "), 1).replacen(
            "OUT ",
            &format!("caphy_out_{suffix} "),
            1,
        );
        let _ = writeln!(out, "    {declaration}; /* {comment} */");
    }
    let _ = writeln!(out, "}} {};\n", layout.name);
}

/// The name that a declaration declares.
fn field_name(declaration: &str) -> &str {
    let name = match declaration.split_once("(*") {
        Some((_, rest)) => rest.split(')').next().unwrap_or(rest),
        None => declaration.split([' ', '*']).next_back().unwrap_or(declaration),
    };
    name.split('[').next().unwrap_or(name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_field_is_in_the_header() {
        // Fields in order, without a gap that a forgotten one would leave: at most padding to 8 bytes.
        let single = blocks!(f32, "caphy_in_f32", "caphy_out_f32", "a_f32", "b_f32", "c_f32", "d_f32");
        for layout in single.iter().chain(&tables()).filter(|l| !l.fields.is_empty()) {
            let mut ends: Vec<usize> = layout.fields.iter().skip(1).map(|f| f.2).collect();
            ends.push(layout.size);
            for (field, end) in layout.fields.iter().zip(ends) {
                let width = end - field.2;
                let most = match field.0 {
                    d if d.starts_with("IN") || d.starts_with("OUT") || d.starts_with("caphy_text name") => 16,
                    "size_t shape[8]" => 64,
                    _ => 8,
                };
                assert!(width <= most, "{}.{}: {width} bytes", layout.name, field.0);
            }
        }
    }

    #[test]
    fn the_committed_header_is_current() {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/include/caphy_plugin.h");
        if std::env::var_os("CAPHY_WRITE_HEADER").is_some() {
            std::fs::write(path, header()).unwrap();
        }
        let committed = std::fs::read_to_string(path).unwrap_or_default();
        assert!(
            committed == header(),
            "include/caphy_plugin.h is out of date: CAPHY_WRITE_HEADER=1 cargo test -p caphy-core the_committed_header"
        );
    }
}
