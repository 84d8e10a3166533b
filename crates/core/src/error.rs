//! One typed error for the whole workspace: every variant carries the values, names the place, and says what to do.

use std::path::PathBuf;

/// Result with caphy's [`Error`].
pub type Result<T> = std::result::Result<T, Error>;

/// What went wrong, where, with which values, and what to do about it.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The operating system refused a file operation.
    #[error("{path}: cannot {action}: {source}{remedy}", path = path.display(), remedy = remedy(source))]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// What was tried, as a verb: "open", "write".
        action: &'static str,
        /// The system's answer.
        source: std::io::Error,
    },
    /// A file's content is not what its format promises.
    #[error("{path}, {at}: {problem}; {remedy}", path = path.display())]
    Format {
        /// The file.
        path: PathBuf,
        /// Line, byte, array or element inside the file.
        at: String,
        /// What is wrong, with the values found.
        problem: String,
        /// What the user can do.
        remedy: String,
    },
    /// A configuration value cannot be used.
    #[error("configuration `{key}`: {problem}; {remedy}")]
    Config {
        /// Dotted path of the key.
        key: String,
        /// What is wrong, with the value found.
        problem: String,
        /// The valid alternatives.
        remedy: String,
    },
    /// A mesh breaks what an algorithm needs of it.
    #[error("mesh `{mesh}`, {element}: {problem}; {remedy}")]
    Mesh {
        /// Name of the mesh.
        mesh: String,
        /// Which vertex, edge or face.
        element: String,
        /// What is wrong, with the values found.
        problem: String,
        /// What the user can do.
        remedy: String,
    },
    /// An array has the wrong length.
    #[error("{what}: expected {expected} values, got {got}")]
    Length {
        /// Name and shape of the array.
        what: String,
        /// Number of values needed.
        expected: usize,
        /// Number of values given.
        got: usize,
    },
    /// A value is NaN or infinite.
    #[error("{what}: value {value} at index {index} is not finite")]
    NonFinite {
        /// Name of the array.
        what: String,
        /// Flat index of the first bad value.
        index: usize,
        /// The value.
        value: f64,
    },
    /// A parameter lies outside its bounds.
    #[error("parameter `{name}` = {value} {unit} is outside [{lower}, {upper}] {unit}")]
    Parameter {
        /// Parameter name.
        name: String,
        /// Value given.
        value: f64,
        /// Smallest allowed value.
        lower: f64,
        /// Largest allowed value.
        upper: f64,
        /// Unit of all three.
        unit: String,
    },
    /// A plugin does not offer an optional behaviour.
    #[error("`{by}` does not support {what}")]
    Unsupported {
        /// The behaviour.
        what: String,
        /// The plugin.
        by: String,
    },
    /// A loaded library broke the plugin contract.
    #[error("plugin {library}: {problem}", library = library.display())]
    Plugin {
        /// The library's file.
        library: PathBuf,
        /// What is wrong and what to do.
        problem: PluginProblem,
    },
    /// A computation could not be finished.
    #[error("{what}: {problem}; {remedy}")]
    Numerics {
        /// The computation.
        what: String,
        /// What happened, with values.
        problem: String,
        /// What the user can do.
        remedy: String,
    },
}

/// How a loaded library can break the plugin contract.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum PluginProblem {
    /// The system's loader refuses the file.
    #[error("not a library that this machine can load ({reason}); give the path of a built .so, .dylib or .dll")]
    NotALibrary {
        /// The loader's answer.
        reason: String,
    },
    /// A library, but not a plugin.
    #[error("has no symbol `{symbol}`, so it is no caphy plugin; export it with `export_plugin!` or `caphy_plugin.h`")]
    MissingSymbol {
        /// The symbol that was looked for.
        symbol: String,
    },
    /// Built against another version of the interface.
    #[error(
        "speaks version {got} of the plugin interface, this program version {expected}; build it against this version"
    )]
    AbiVersion {
        /// The library's version.
        got: u32,
        /// This program's version.
        expected: u32,
    },
    /// The code of the plugin panicked; the panic was stopped at the border.
    #[error("`{type_name}` panicked in {call}: {message}; report it to the plugin's author")]
    Panic {
        /// The plugin's `type` name.
        type_name: String,
        /// The call that panicked.
        call: String,
        /// The panic's message.
        message: String,
    },
    /// An answer that contradicts the interface: a wrong length, a null pointer, text that is not UTF-8.
    #[error("`{type_name}` gave a malformed answer to {call}: {what}; report it to the plugin's author")]
    Malformed {
        /// The plugin's `type` name.
        type_name: String,
        /// The call.
        call: String,
        /// What is wrong, with the values.
        what: String,
    },
    /// An error of the plugin's own.
    #[error("`{type_name}` failed in {call}: {message}")]
    Failed {
        /// The plugin's `type` name.
        type_name: String,
        /// The call.
        call: String,
        /// The plugin's words.
        message: String,
    },
    /// Two sources offer the same type.
    #[error("offers `{type_name}`, which {other} offers already; rename one of the two")]
    Duplicate {
        /// The name.
        type_name: String,
        /// Who has it.
        other: String,
    },
    /// Loaded after a configuration was read, which could not know its types.
    #[error("loaded after {read} was read, whose types are settled by then; load plugins first")]
    TooLate {
        /// What was read before.
        read: String,
    },
}

/// What to do about an answer of the system that says by itself what is in the way.
fn remedy(source: &std::io::Error) -> &'static str {
    use std::io::ErrorKind;
    match source.kind() {
        ErrorKind::StorageFull | ErrorKind::QuotaExceeded => {
            "; free some space and run again: what was finished is kept"
        }
        ErrorKind::FileTooLarge => "; allow larger files (`ulimit -f`) and run again: what was finished is kept",
        ErrorKind::ReadOnlyFilesystem | ErrorKind::PermissionDenied => "; allow it, or name another place",
        _ => "",
    }
}

impl Error {
    /// An [`Error::Io`] from a path, a verb and the system's error.
    pub fn io(path: impl Into<PathBuf>, action: &'static str, source: std::io::Error) -> Self {
        Self::Io { path: path.into(), action, source }
    }
    /// An [`Error::Format`].
    pub fn format(
        path: impl Into<PathBuf>,
        at: impl Into<String>,
        problem: impl Into<String>,
        remedy: impl Into<String>,
    ) -> Self {
        Self::Format { path: path.into(), at: at.into(), problem: problem.into(), remedy: remedy.into() }
    }
    /// An [`Error::Config`].
    pub fn config(key: impl Into<String>, problem: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self::Config { key: key.into(), problem: problem.into(), remedy: remedy.into() }
    }
    /// An [`Error::Mesh`].
    pub fn mesh(
        mesh: impl Into<String>,
        element: impl Into<String>,
        problem: impl Into<String>,
        remedy: impl Into<String>,
    ) -> Self {
        Self::Mesh { mesh: mesh.into(), element: element.into(), problem: problem.into(), remedy: remedy.into() }
    }
    /// An [`Error::Numerics`].
    pub fn numerics(what: impl Into<String>, problem: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self::Numerics { what: what.into(), problem: problem.into(), remedy: remedy.into() }
    }
    /// An [`Error::Unsupported`].
    pub fn unsupported(what: impl Into<String>, by: impl Into<String>) -> Self {
        Self::Unsupported { what: what.into(), by: by.into() }
    }
    /// An [`Error::Plugin`].
    pub fn plugin(library: impl Into<PathBuf>, problem: PluginProblem) -> Self {
        Self::Plugin { library: library.into(), problem }
    }
    /// `Ok` when `got == expected`, else an [`Error::Length`].
    pub fn check_length(what: &str, expected: usize, got: usize) -> Result<()> {
        if expected == got { Ok(()) } else { Err(Self::Length { what: what.into(), expected, got }) }
    }
    /// `Ok` when all values are finite, else an [`Error::NonFinite`] naming the first that is not.
    pub fn check_finite<T: crate::Real>(what: &str, values: &[T]) -> Result<()> {
        // Without an early exit the common case runs in vector registers: blocks are checked on every call.
        if all_finite(values) {
            return Ok(());
        }
        match values.iter().position(|v| !v.is_finite()) {
            None => Ok(()),
            Some(index) => Err(Self::NonFinite { what: what.into(), index, value: values[index].to_f64() }),
        }
    }
}

crate::simd_kernel! {
    /// Whether no value is NaN or infinite.
    fn all_finite<T>(values: &[T]) -> bool {
        let mut finite = true;
        for value in values {
            finite &= value.is_finite();
        }
        finite
    }
}
