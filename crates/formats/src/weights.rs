//! Network weights as safetensors: names, shapes, `f32` values, text metadata.

use caphy_core::{Error, Result};
use safetensors::tensor::{Metadata, TensorView};
use safetensors::{Dtype, SafeTensors};
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// Key of the metadata in a safetensors header.
const METADATA: &str = "__metadata__";

/// Writes tensors (name, shape, values in C order) and metadata; the same input gives the same bytes.
///
/// # Errors
/// [`Error::Length`] when values do not fill a shape, [`Error::Numerics`] for a name that occurs twice.
pub fn write_safetensors(tensors: &[(&str, &[usize], &[f32])], metadata: &BTreeMap<String, String>) -> Result<Vec<u8>> {
    let refused = |problem: String| Error::numerics("safetensors file", problem, "give each tensor its own name");
    let mut names = BTreeSet::from([METADATA]);
    let mut bytes = Vec::with_capacity(tensors.len());
    for (name, shape, values) in tensors {
        if !names.insert(name) {
            return Err(refused(format!("tensor `{name}` occurs twice or is reserved")));
        }
        let count = shape.iter().try_fold(1usize, |a, &n| a.checked_mul(n)).unwrap_or(usize::MAX);
        Error::check_length(&format!("tensor `{name}`, shape {shape:?}"), count, values.len())?;
        bytes.push(values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>());
    }
    let views = tensors
        .iter()
        .zip(&bytes)
        .map(|((name, shape, _), data)| {
            TensorView::new(Dtype::F32, shape.to_vec(), data)
                .map(|view| (*name, view))
                .map_err(|e| refused(format!("tensor `{name}`: {e}")))
        })
        .collect::<Result<Vec<_>>>()?;
    let plain = safetensors::serialize(views, None).map_err(|e| refused(e.to_string()))?;
    if metadata.is_empty() {
        return Ok(plain);
    }
    // The library keeps metadata in a hash map and would write it in another order each time: it goes in here, sorted.
    let damaged = || refused("the header that was written cannot be read".into());
    let (length, rest) = plain.split_first_chunk::<8>().ok_or_else(damaged)?;
    let length = usize::try_from(u64::from_le_bytes(*length)).map_err(|_| damaged())?;
    let (header, data) = rest.split_at_checked(length).ok_or_else(damaged)?;
    let header = std::str::from_utf8(header).map_err(|_| damaged())?.trim_end();
    let entries = header.strip_prefix('{').ok_or_else(damaged)?;
    let text = serde_json::to_string(metadata).map_err(|e| refused(e.to_string()))?;
    let comma = if entries == "}" { "" } else { "," };
    let mut header = format!("{{\"{METADATA}\":{text}{comma}{entries}");
    // Data starts at a multiple of 8.
    header += &" ".repeat(header.len().next_multiple_of(8) - header.len());
    let mut out = (header.len() as u64).to_le_bytes().to_vec();
    out.extend(header.as_bytes());
    out.extend(data);
    Ok(out)
}

/// Reads all tensors (name, shape, values in C order), sorted by name. `F64` values are rounded to `f32`.
///
/// # Errors
/// [`Error::Format`]: damaged or cut off, or a tensor of another type.
pub fn read_safetensors(path: &Path, bytes: &[u8]) -> Result<Vec<(String, Vec<usize>, Vec<f32>)>> {
    let file = SafeTensors::deserialize(bytes).map_err(|e| damaged(path, e))?;
    let mut names: Vec<&str> = file.names();
    names.sort_unstable();
    names
        .into_iter()
        .map(|name| {
            let view = file.tensor(name).map_err(|e| damaged(path, e))?;
            let values = match view.dtype() {
                Dtype::F32 => view.data().as_chunks().0.iter().map(|b| f32::from_le_bytes(*b)).collect(),
                Dtype::F64 => view.data().as_chunks().0.iter().map(|b| f64::from_le_bytes(*b) as f32).collect(),
                other => {
                    let problem = format!("type {other:?}");
                    return Err(Error::format(path, format!("tensor `{name}`"), problem, "save it as float32"));
                }
            };
            Ok((name.to_string(), view.shape().to_vec(), values))
        })
        .collect()
}

/// Reads the metadata; empty when the file has none.
///
/// # Errors
/// [`Error::Format`]: damaged or cut off.
pub fn read_safetensors_metadata(path: &Path, bytes: &[u8]) -> Result<BTreeMap<String, String>> {
    let (_, metadata): (usize, Metadata) = SafeTensors::read_metadata(bytes).map_err(|e| damaged(path, e))?;
    Ok(metadata.metadata().iter().flatten().map(|(k, v)| (k.clone(), v.clone())).collect())
}

fn damaged(path: &Path, error: safetensors::SafeTensorError) -> Error {
    let problem: String = error.to_string().chars().take(200).collect();
    Error::format(path, "header", problem, "the file is damaged, cut off or no .safetensors: get it again")
}
