//! What every plugin must do, as checks that any code can run.
//!
//! One list per trait ([`material::CHECKS`], [`net::CHECKS`], [`body::CHECKS`], [`segmenter::CHECKS`]); a check is one
//! function and one line in [`conformance_list!`](crate::conformance_list). The same lists become named tests by
//! [`conformance_tests!`](crate::conformance_tests) and the table of `caphy check`, so that nobody can leave one out:
//!
//! ```
//! # use caphy_core::material::*;
//! # #[derive(Debug, serde::Serialize, serde::Deserialize)]
//! # struct Spec;
//! # #[typetag::serde(name = "mine")]
//! # impl MaterialSpec for Spec {
//! #     fn build(&self) -> caphy_core::Result<Box<dyn MaterialModel>> { Err(caphy_core::Error::unsupported("x", "y")) }
//! # }
//! mod mine {
//!     use caphy_core::conformance::material::MaterialSubject;
//!     caphy_core::conformance_tests!(material, MaterialSubject::linked("type = \"mine\""));
//! }
//! ```
//!
//! Optional behaviour is declared by the plugin; what is not offered must be refused with
//! [`Error::Unsupported`](crate::Error::Unsupported), and is then reported as not offered, not as passed.

pub mod body;
pub mod differences;
pub mod material;
pub mod net;
pub mod segmenter;

use std::panic::{AssertUnwindSafe, catch_unwind};

/// What a check found, short of a failure.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    /// The promise holds.
    Passed,
    /// The plugin declares that it does not offer this, and refuses it cleanly.
    NotOffered,
}

/// A verdict, or what is wrong with the values found.
pub type Outcome = Result<Verdict, String>;

/// One promise.
pub struct Check<S> {
    /// Name, as in tests and tables.
    pub name: &'static str,
    /// The promise in one line.
    pub about: &'static str,
    /// Tries it.
    pub run: fn(&S) -> Outcome,
}

/// A check and its outcome.
#[derive(Debug, Clone, PartialEq)]
pub struct Row {
    /// As in [`Check`].
    pub name: &'static str,
    /// As in [`Check`].
    pub about: &'static str,
    /// What came out; a panic is a failure.
    pub outcome: Outcome,
}

/// Runs one check; a panic of the plugin is a failure that carries its message.
pub fn run<S>(check: &Check<S>, subject: &S) -> Row {
    let outcome = catch_unwind(AssertUnwindSafe(|| (check.run)(subject))).unwrap_or_else(|payload| {
        let text = payload.downcast_ref::<&str>().map(|t| (*t).to_string());
        let text = text.or_else(|| payload.downcast_ref::<String>().cloned()).unwrap_or_default();
        Err(format!("panicked: {text}"))
    });
    Row { name: check.name, about: check.about, outcome }
}

/// Runs a whole list in order.
pub fn run_all<S>(checks: &[Check<S>], subject: &S) -> Vec<Row> {
    checks.iter().map(|check| run(check, subject)).collect()
}

/// Runs the check of this name and panics when it fails: what [`conformance_tests!`](crate::conformance_tests) expands to.
pub fn assert_passes<S>(checks: &[Check<S>], name: &str, subject: &S) {
    let check = checks.iter().find(|c| c.name == name).unwrap_or_else(|| panic!("there is no check `{name}`"));
    if let Err(problem) = run(check, subject).outcome {
        panic!("{}: {problem}", check.about);
    }
}

/// `Ok` when the condition holds, else the text.
pub(crate) fn ensure(condition: bool, problem: impl FnOnce() -> String) -> Result<(), String> {
    if condition { Ok(()) } else { Err(problem()) }
}

/// An error of the plugin where none belongs.
pub(crate) fn unexpected(what: &str) -> impl FnOnce(crate::Error) -> String + '_ {
    move |error| format!("{what}: {error}")
}

/// The checks of all four traits: name, what it takes (`model`: the trait object, `subject`: the table too), promise.
#[doc(hidden)]
#[macro_export]
macro_rules! conformance_list {
    (material, $then:ident $($rest:tt)*) => {
        $crate::$then! { material $($rest)*;
            name_is_the_type(subject) "it calls itself by its `type`";
            table_survives_a_round_trip(subject) "its table, written back with every default, means the same";
            unknown_keys_are_refused(subject) "a key that it does not know is an error that names the key";
            rest_is_free_of_stress(model) "no strain, no energy and no stress";
            stress_is_the_gradient(model) "the stress is the energy's gradient, or, when declared frozen, K G";
            tangent_is_the_derivative(model) "the total tangent is the derivative of the stress";
            held_tangent_is_symmetric(model) "the held tangent is symmetric, and the total one unless the stiffness is frozen";
            parameter_derivatives_are_exact(model) "derivatives by parameters agree with changed parameters";
            hinge_slopes_are_exact(model) "dk/dθ and dk/dl agree with differences of k";
            rotations_change_nothing(model) "turning the cloth changes no energy";
            bending_is_not_negative(model) "k is finite and not negative for every fold";
            bending_ignores_the_edges_sense(model) "an edge has no sense and no first side";
            elements_are_independent(model) "an element's answer does not depend on its neighbours in the block";
            outputs_are_independent(model) "an output does not depend on which others are wanted";
            extremes_are_finite(model) "every finite input has a finite answer in both precisions";
            extremes_keep_the_gradient(model) "beyond what cloth does, the stress still belongs to the energy";
            bounds_are_survived(model) "with parameters at their bounds, answers are finite and bending is not negative";
            bad_blocks_are_refused(model) "wrong lengths and values that are not finite are typed errors";
            single_agrees_with_double(model) "single precision agrees with double";
            parameters_are_sound(model) "parameters have unique names, values within bounds, and are refused outside";
            linearity_is_as_declared(model) "what is declared linear in the parameters is";
            threads_change_nothing(model) "equal blocks give equal bits on any thread";
            offers_are_true(model) "what is declared is answered, and nothing else is";
        }
    };
    (net, $then:ident $($rest:tt)*) => {
        $crate::$then! { net $($rest)*;
            name_is_the_type(subject) "it calls itself by its `type`";
            table_survives_a_round_trip(subject) "its table, written back with every default, means the same";
            unknown_keys_are_refused(subject) "a key that it does not know is an error that names the key";
            sizes_are_those_asked_for(subject) "inputs and outputs are those asked for";
            tensors_are_dense(model) "tensors cover the flat parameters without gaps, with unique names";
            first_values_come_from_the_seed(model) "a seed gives the same first values, another seed others";
            training_starts_at_the_template(model) "with its first values, a net displaces nothing";
            a_window_equals_its_parts(model) "a whole window equals its parts with the state carried";
            no_state_means_zeros(model) "absent state is zeros";
            a_state_needs_no_output(model) "the state is the same where no output is asked for";
            batches_are_independent(model) "a window's answer does not depend on the others of its batch";
            backward_is_the_gradient(model) "gradients agree with differences";
            gradients_reach_every_parameter(model) "every parameter has a gradient";
            parameter_gradients_are_added(model) "the parameter gradient is added to, the feature gradient overwritten";
            single_agrees_with_double(model) "single precision agrees with double";
            wrong_lengths_are_refused(model) "wrong lengths are typed errors";
            large_features_stay_finite(model) "large features have finite answers, and what is no number is not hidden";
            threads_change_nothing(model) "equal passes give equal bits on any thread";
            offers_are_true(model) "what is declared is answered, and nothing else is";
        }
    };
    (body, $then:ident $($rest:tt)*) => {
        $crate::$then! { body $($rest)*;
            table_survives_a_round_trip(subject) "its table, written back with every default, means the same";
            unknown_keys_are_refused(subject) "a key that it does not know is an error that names the key";
            skeleton_is_a_tree(model) "parents come before children, names are unique";
            surface_is_sound(model) "faces are triangles of its vertices";
            weights_sum_to_one(model) "skinning weights are not negative and sum to 1";
            rest_is_the_identity(model) "the T-pose has identity transforms";
            translation_comes_last(model) "a translation moves everything by itself";
            the_root_turns_everything(model) "the root's rotation turns the whole body about its joint";
            displacements_add_in_the_rest_pose(model) "dT is added to the T-pose and moves no joint";
            missing_coefficients_are_zeros(model) "fewer coefficients mean zeros behind";
            wrong_counts_are_refused(model) "too many coefficients, wrong counts and values that are not finite are typed errors";
            gradients_agree_with_differences(model) "vector-Jacobian products agree with differences, at zero rotation too";
            the_jacobian_is_made_of_products(model) "rows of the Jacobian are vector-Jacobian products";
            frames_agree_with_poses(model) "batches in lanes agree with single poses";
            skeleton_agrees_with_poses(model) "joints and transforms without the surface are those of the pose";
            landmarks_ride_on_the_surface(model) "landmarks are named means of existing vertices, in every pose";
            extremes_are_finite(model) "every joint at π has a finite answer";
            threads_change_nothing(model) "equal poses give equal bits on any thread";
        }
    };
    (segmenter, $then:ident $($rest:tt)*) => {
        $crate::$then! { segmenter $($rest)*;
            table_survives_a_round_trip(subject) "its table, written back with every default, means the same";
            unknown_keys_are_refused(subject) "a key that it does not know is an error that names the key";
            empty_pixels_are_ignored(model) "pixels that show nothing are ignored";
            shown_pixels_are_labelled(model) "some pixel that shows something gets a label of a person";
            labels_overwrite(model) "every label is written, whatever stood there";
            wrong_lengths_are_refused(model) "a wrong number of labels is a typed error";
            bare_scans_are_answered_or_named(model) "a scan without colours and labels is labelled, or an error names it";
            threads_change_nothing(model) "equal views give equal labels on any thread";
        }
    };
}

/// `CHECKS` of one trait.
#[doc(hidden)]
#[macro_export]
macro_rules! conformance_checks {
    ($kind:ident $subject:ty; $($name:ident($takes:ident) $about:literal;)*) => {
        /// All checks, in the order in which a failure says most.
        pub const CHECKS: &[$crate::conformance::Check<$subject>] = &[
            $($crate::conformance::Check {
                name: stringify!($name),
                about: $about,
                run: $crate::conformance_checks!(@ $takes $name),
            }),*
        ];
    };
    (@ subject $name:ident) => { $name };
    (@ model $name:ident) => { |subject| $name(&*subject.model()?) };
}

/// One `#[test]` per check.
#[doc(hidden)]
#[macro_export]
macro_rules! conformance_test_functions {
    ($kind:ident $subject:expr; $($name:ident($takes:ident) $about:literal;)*) => {
        $(
            #[test]
            fn $name() {
                $crate::conformance::assert_passes($crate::conformance::$kind::CHECKS, stringify!($name), &$subject);
            }
        )*
    };
}

/// Named tests of a plugin: all checks of its trait, none to be left out. Put it into a module of its own.
///
/// `conformance_tests!(material, SUBJECT)`, and the same for `net`, `body` and `segmenter`; `SUBJECT` is an expression of
/// the trait's subject, evaluated once per test.
#[macro_export]
macro_rules! conformance_tests {
    ($kind:ident, $subject:expr $(,)?) => {
        $crate::conformance_list! { $kind, conformance_test_functions $subject }
    };
}

/// Checks on the TOML table that all four subjects share.
macro_rules! table_checks {
    ($subject:ty, $same:ident) => {
        /// [`CHECKS`]: the table written back builds a plugin with the same answers; not offered by plugins that cannot write.
        pub fn table_survives_a_round_trip(subject: &$subject) -> Outcome {
            let Some(normalise) = &subject.normalise else { return Ok(Verdict::NotOffered) };
            let written = normalise(&subject.toml).map_err(unexpected("writing the table back"))?;
            let again = normalise(&written).map_err(unexpected("reading what was written"))?;
            ensure(written == again, || format!("written once:\n{written}\nand twice:\n{again}"))?;
            let (a, b) = (subject.model()?, subject.model_of(&written)?);
            $same(&*a, &*b)?;
            Ok(Verdict::Passed)
        }

        /// [`CHECKS`]: deny unknown keys.
        pub fn unknown_keys_are_refused(subject: &$subject) -> Outcome {
            let key = "no_such_key_exists";
            let table = format!("{key} = 1\n{}", subject.toml);
            match subject.model_of(&table) {
                Ok(_) => Err(format!("`{key}` was accepted")),
                Err(problem) if problem.contains(key) => Ok(Verdict::Passed),
                Err(problem) => Err(format!("the error does not name `{key}`: {problem}")),
            }
        }
    };
}
pub(crate) use table_checks;
