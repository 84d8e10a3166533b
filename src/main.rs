//! The `caphy` program.

mod command;

use caphy::plugins::Plugins;
use caphy_core::{Error, Result};
use clap::{Parser, Subcommand};
use std::path::PathBuf;
use std::process::ExitCode;

/// From 3D scans of one clothed person to an avatar whose garments move by that person's own fabrics.
#[derive(Parser)]
#[command(version, after_help = "Example:\n  caphy run configs/quickstart.toml")]
struct Cli {
    /// Number of threads; results are the same bits for any number. Default: all cores.
    #[arg(long, global = true)]
    threads: Option<usize>,
    /// Library with types of your own, loaded before anything is read; may be given several times.
    #[arg(long, global = true, value_name = "LIBRARY")]
    plugin: Vec<PathBuf>,
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Run every stage of an experiment, from scans to report; finished stages are not run again.
    #[command(after_help = command::run::EXAMPLES)]
    Run(command::run::Arguments),
    /// Run an experiment with parts of the method left out, and compare.
    #[command(after_help = command::ablation::EXAMPLES)]
    Ablation(command::ablation::Arguments),
    /// Measure what every knob of an experiment costs and buys, against the reference solver.
    #[command(after_help = command::tradeoff::EXAMPLES)]
    Tradeoff(command::tradeoff::Arguments),
    /// Show what caphy has or reads, as tables and pictures.
    #[command(subcommand)]
    Show(command::show::What),
    /// Write the views of an experiment's scans as pictures, for a human parser to label.
    #[command(after_help = command::views::EXAMPLES)]
    Views(command::views::Arguments),
    /// Train garments of a dressed body by physics on motion, without scans.
    #[command(after_help = command::train::EXAMPLES)]
    Train(command::train::Arguments),
    /// Play a motion clip on a dressed body and write files that other programs open.
    #[command(after_help = command::animate::EXAMPLES)]
    Animate(command::animate::Arguments),
    /// Simulate garments along a motion clip by the reference solver, at rest in each frame or in motion.
    #[command(after_help = command::simulate::EXAMPLES)]
    Simulate(command::simulate::Arguments),
    /// Estimate the fabric of a cloth from scans of it at rest.
    #[command(after_help = command::estimate::EXAMPLES)]
    Estimate(command::estimate::Arguments),
    /// Make scans of a generated person of known shape, clothes and fabrics.
    #[command(after_help = command::synth::EXAMPLES)]
    Synth(command::synth::Arguments),
    /// Ask a material for its answers to deformation gradients or folds.
    #[command(after_help = command::probe::EXAMPLES)]
    Probe(command::probe::Arguments),
    /// Map where fabrics are finite, have the right gradient and a positive tangent, in both precisions.
    #[command(after_help = command::stress::EXAMPLES)]
    Stress(command::stress::Arguments),
    /// Check a plugin against the promise of its trait; fails when a check fails.
    #[command(after_help = command::check::EXAMPLES)]
    Check(command::check::Arguments),
}

fn main() -> ExitCode {
    match run(&Cli::parse()) {
        Ok(code) => code,
        Err(error) => {
            command::note!("error: {error}");
            ExitCode::FAILURE
        }
    }
}

fn run(cli: &Cli) -> Result<ExitCode> {
    if let Some(threads) = cli.threads {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build_global();
        pool.map_err(|e| {
            Error::config("--threads", e.to_string(), "give a number of threads that the machine can start")
        })?;
    }
    let mut plugins = Plugins::new()?;
    for library in &cli.plugin {
        plugins.load(library)?;
    }
    match &cli.command {
        Command::Run(arguments) => command::run::run(arguments, &mut plugins),
        Command::Ablation(arguments) => command::ablation::run(arguments, &plugins),
        Command::Tradeoff(arguments) => command::tradeoff::run(arguments, &plugins),
        Command::Show(what) => command::show::run(what, &plugins),
        Command::Views(arguments) => command::views::run(arguments, &mut plugins),
        Command::Train(arguments) => command::train::run(arguments, &mut plugins),
        Command::Animate(arguments) => command::animate::run(arguments, &plugins),
        Command::Simulate(arguments) => command::simulate::run(arguments, &plugins),
        Command::Estimate(arguments) => command::estimate::run(arguments, &mut plugins),
        Command::Synth(arguments) => command::synth::run(arguments, &mut plugins),
        Command::Probe(arguments) => command::probe::run(arguments, &plugins),
        Command::Stress(arguments) => command::stress::run(arguments, &plugins),
        Command::Check(arguments) => command::check::run(arguments, &mut plugins),
    }
}
