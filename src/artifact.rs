//! What a stage leaves on disk: versioned, content-hashed, written to a temporary name, synced, renamed.
//!
//! Layout: one line of JSON ([`Header`]), a newline, the body in MessagePack. A file whose hash does not match its
//! body is an error, never a result.

use caphy_core::{Error, Result};
use serde::{Deserialize, Serialize, de::DeserializeOwned};
use std::io::Write;
use std::path::Path;

/// Version of the artifact layout; raised when a stage's output type changes.
pub const VERSION: u32 = 4;

/// First line of an artifact.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Header {
    /// Layout version, [`VERSION`].
    pub version: u32,
    /// Name of the stage.
    pub stage: String,
    /// Hash of everything the stage depended on: configuration, code version, inputs.
    pub key: String,
    /// Hash of the body.
    pub content: String,
}

/// Hash of bytes as text.
pub fn hash(bytes: &[u8]) -> String {
    blake3::hash(bytes).to_hex().to_string()
}

/// Writes bytes so that a reader sees the old file or the whole new one, never a part.
pub fn write_atomically(path: &Path, bytes: &[u8]) -> Result<()> {
    write_atomically_with(path, |out| out.write_all(bytes).map_err(|e| Error::io(path, "write", e)))
}

/// As [`write_atomically`], for content that is written as it is made.
///
/// # Errors
/// What `write` gives; [`Error::Io`].
pub fn write_atomically_with(path: &Path, write: impl FnOnce(&mut dyn Write) -> Result<()>) -> Result<()> {
    let folder = path.parent().unwrap_or(Path::new("."));
    std::fs::create_dir_all(folder).map_err(|e| Error::io(folder, "create", e))?;
    let mut name = path.file_name().unwrap_or_default().to_os_string();
    name.push(".tmp");
    let temporary = path.with_file_name(name);
    let failed = |e| Error::io(path, "write", e);
    let file = std::fs::File::create(&temporary).map_err(failed)?;
    let fill = || -> Result<()> {
        let mut file = std::io::BufWriter::new(file);
        write(&mut file)?;
        let file = file.into_inner().map_err(|e| failed(e.into_error()))?;
        file.sync_all().and_then(|()| std::fs::rename(&temporary, path)).map_err(failed)
    };
    if let Err(error) = fill() {
        // Half a file would fill a full disk for nothing.
        std::fs::remove_file(&temporary).ok();
        return Err(error);
    }
    // The rename itself is durable once the folder is synced; not every system can open folders.
    if let Ok(folder) = std::fs::File::open(folder) {
        folder.sync_all().ok();
    }
    Ok(())
}

/// Writes an artifact and returns its content hash.
pub fn save<T: Serialize>(path: &Path, stage: &str, key: &str, value: &T) -> Result<String> {
    let body = rmp_serde::to_vec_named(value)
        .map_err(|e| Error::numerics(format!("artifact of stage {stage}"), e.to_string(), "report this as a defect"))?;
    let header = Header { version: VERSION, stage: stage.into(), key: key.into(), content: hash(&body) };
    let mut bytes = serde_json::to_vec(&header)
        .map_err(|e| Error::numerics(format!("artifact of stage {stage}"), e.to_string(), "report this as a defect"))?;
    bytes.push(b'\n');
    bytes.extend_from_slice(&body);
    write_atomically(path, &bytes)?;
    Ok(header.content)
}

/// Header and body of an artifact, the body checked against its hash.
fn read(path: &Path) -> Result<(Header, Vec<u8>)> {
    let damaged =
        |at: &str, problem: String| Error::format(path, at, problem, "delete the file: the stage will then run again");
    let bytes = std::fs::read(path).map_err(|e| Error::io(path, "read", e))?;
    let end =
        bytes.iter().position(|&b| b == b'\n').ok_or_else(|| damaged("header", "there is no header line".into()))?;
    let header: Header = serde_json::from_slice(&bytes[..end]).map_err(|e| damaged("header", e.to_string()))?;
    let body = bytes[end + 1..].to_vec();
    let content = hash(&body);
    if content != header.content {
        return Err(damaged(
            "body",
            format!("its hash is {content}, the header says {}: damaged or edited", header.content),
        ));
    }
    Ok((header, body))
}

/// The value of an artifact whose key still matches, with its content hash; `None` when there is no file or it belongs to
/// another configuration or version.
pub fn load<T: DeserializeOwned>(path: &Path, stage: &str, key: &str) -> Result<Option<(T, String)>> {
    if !path.exists() {
        return Ok(None);
    }
    let (header, body) = read(path)?;
    if header.version != VERSION || header.stage != stage || header.key != key {
        return Ok(None);
    }
    let value = rmp_serde::from_slice(&body)
        .map_err(|e| Error::format(path, "body", e.to_string(), "delete the file: the stage will then run again"))?;
    Ok(Some((value, header.content)))
}

/// The value of an artifact whatever it was made of, for looking at other runs.
///
/// # Errors
/// [`Error::Io`]; [`Error::Format`] for a file that is damaged, or of another stage or version.
pub fn open<T: DeserializeOwned>(path: &Path, stage: &str) -> Result<T> {
    let (header, _) = read(path)?;
    let remedy = "run its experiment again with this version";
    let wrong = |problem: String| Error::format(path, "header", problem, remedy);
    match load(path, stage, &header.key) {
        Ok(Some((value, _))) => Ok(value),
        Ok(None) => Err(wrong(format!("is a {} of version {}", header.stage, header.version))),
        Err(error) => Err(wrong(format!("does not hold what this version writes: {error}"))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn artifacts_round_trip_and_tampering_is_an_error() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a/stage.caphy");
        let hash = save(&path, "train", "k1", &vec![1.5f64, -2.0]).unwrap();
        let (value, read_hash) = load::<Vec<f64>>(&path, "train", "k1").unwrap().unwrap();
        assert_eq!((value, read_hash), (vec![1.5, -2.0], hash));
        assert!(load::<Vec<f64>>(&path, "train", "k2").unwrap().is_none());
        let mut bytes = std::fs::read(&path).unwrap();
        *bytes.last_mut().unwrap() ^= 1;
        std::fs::write(&path, bytes).unwrap();
        let text = load::<Vec<f64>>(&path, "train", "k1").unwrap_err().to_string();
        assert!(text.contains("damaged or edited"), "{text}");
    }
}
