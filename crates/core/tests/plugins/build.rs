//! Builds libraries for the tests: Rust with cargo, C with the system's compiler.

use std::path::{Path, PathBuf};
use std::process::Command;

fn repository() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

/// The library of an example in Rust, in the target folder of these tests, so that it is built once.
pub(crate) fn rust(example: &str, crate_name: &str) -> PathBuf {
    let test = std::env::current_exe().expect("the test's own path");
    let profile = test.parent().and_then(Path::parent).expect("target/PROFILE/deps");
    let target = profile.parent().expect("the target folder");
    let manifest = repository().join("examples").join(example).join("Cargo.toml");
    let mut cargo = Command::new(env!("CARGO"));
    cargo.args(["build", "--quiet", "--locked", "--manifest-path"]).arg(&manifest).arg("--target-dir").arg(target);
    if profile.ends_with("release") {
        // As the program's own tests ask for them, or both would build the interface.
        cargo.args(["--release", "--config", "profile.release.package.caphy-core.opt-level=1"]);
    }
    let output = cargo.output().expect("cargo runs");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let (prefix, suffix) = (std::env::consts::DLL_PREFIX, std::env::consts::DLL_SUFFIX);
    profile.join(format!("{prefix}{}{suffix}", crate_name.replace('-', "_")))
}

/// A library from a C file, with definitions; `None`, loudly, where there is no C compiler.
pub(crate) fn c(source: &Path, folder: &Path, name: &str, defines: &[&str]) -> Option<PathBuf> {
    let compiler = std::env::var("CC").unwrap_or_else(|_| "cc".into());
    let library = folder.join(format!("{name}{}", std::env::consts::DLL_SUFFIX));
    let mut command = Command::new(&compiler);
    // A fixture's fault leaves some of its parts unused.
    command.args(["-std=c11", "-O2", "-Wall", "-Wextra", "-Werror", "-Wno-unused", "-shared", "-fPIC"]);
    command.arg("-I").arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("include"));
    command.args(defines.iter().map(|d| format!("-D{d}")));
    command.arg(source).arg("-o").arg(&library).arg("-lm");
    let output = match command.output() {
        Ok(output) => output,
        Err(error) => {
            eprintln!("SKIPPED: the C compiler `{compiler}` does not start ({error}); set CC");
            return None;
        }
    };
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    Some(library)
}

/// The example in C.
pub(crate) fn example_in_c(folder: &Path) -> Option<PathBuf> {
    c(&repository().join("examples/plugin-material-c/woven.c"), folder, "woven_c", &[])
}
