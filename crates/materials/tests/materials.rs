//! One entry for all tests of the fabric models.

#[path = "cases/asking.rs"]
mod asking; // whole answers in double precision
#[path = "cases/bad_input.rs"]
mod bad_input; // typed errors for blocks, keys, names, values
#[path = "cases/bend_reference.rs"]
mod bend_reference; // 220 hinges of ARCSim
#[path = "cases/closed_form.rs"]
mod closed_form; // StVK by hand, pitfalls of the tables
#[path = "cases/derivatives.rs"]
mod derivatives; // tangents and parameter derivatives against differences
#[path = "cases/extremes.rs"]
mod extremes; // rest, huge strains, collapsed hinges, single against double
#[path = "cases/independent.rs"]
mod independent; // the reference note once more, on random strains and folds
#[path = "cases/neo_hookean.rs"]
mod neo_hookean; // closed form, small strains, collapse
#[path = "cases/pitfalls.rs"]
mod pitfalls; // what the reference note warns of
#[path = "cases/stretch_reference.rs"]
mod stretch_reference; // 320 strains of ARCSim
#[path = "cases/switches.rs"]
mod switches; // presets, custom tables
