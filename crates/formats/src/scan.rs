//! A scan by its ending, with the colours of its texture on its vertices.

use crate::image::{ColourImage, read_image};
use crate::obj::{ObjMesh, ObjUvs, read_obj};
use crate::ply::read_ply;
use caphy_core::files::Files;
use caphy_core::scan::Scan;
use caphy_core::{Error, Result};
use std::path::{Path, PathBuf};

/// Endings that [`read_scan`] knows.
pub const SCAN_ENDINGS: [&str; 2] = ["ply", "obj"];

/// Reads a scan and, of an OBJ, the textures that its materials name (`mtllib`, `map_Kd`; PNG or JPEG beside it). Each vertex
/// takes the mean of its corners' colours; textures win over vertex colours. Positions are as in the file. Notes say what was
/// found missing.
///
/// # Errors
/// Those of [`read_ply`], [`read_obj`] and [`read_image`]; [`Error::Format`] for other endings; those of `files`.
pub fn read_scan(path: &Path, files: &dyn Files) -> Result<(Scan, Vec<String>)> {
    let bytes = files.read(path)?;
    let ending = path.extension().unwrap_or_default().to_string_lossy().to_lowercase();
    let (mut scan, mut notes) = match ending.as_str() {
        "ply" => (read_ply(path, &bytes)?, Vec::new()),
        "obj" => {
            let mesh = read_obj(path, &bytes)?;
            let (colours, notes) = textured(path, &mesh, files)?;
            (Scan { colours: colours.or(mesh.scan.colours), ..mesh.scan }, notes)
        }
        other => {
            let problem = format!("`.{other}` is no scan");
            return Err(Error::format(path, "ending", problem, format!("give one of {}", SCAN_ENDINGS.join(", "))));
        }
    };
    if ending == "ply" && scan.colours.is_none() {
        let header = &bytes[..bytes.len().min(4096)];
        if header.windows(11).any(|w| w == b"TextureFile") {
            notes
                .push("names a texture, which is not read from PLY: export OBJ, or bake it into vertex colours".into());
        }
    }
    scan.name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    Ok((scan, notes))
}

/// The files beside an OBJ that its colours come from: material files and textures, as far as they are there.
///
/// # Errors
/// Those of [`read_obj`].
pub fn texture_files(path: &Path, files: &dyn Files) -> Result<Vec<PathBuf>> {
    let ending = path.extension().unwrap_or_default().to_string_lossy().to_lowercase();
    if ending != "obj" {
        return Ok(Vec::new());
    }
    let mut found = Vec::new();
    for library in read_obj(path, &files.read(path)?)?.material_files {
        let library = path.with_file_name(library);
        let Ok(text) = files.read(&library) else { continue };
        found.extend(materials(&library, &text).into_iter().filter_map(|m| m.texture));
        found.push(library);
    }
    Ok(found)
}

/// What an MTL file says of one material's colour.
struct Material {
    name: String,
    texture: Option<PathBuf>,
    /// `Kd`, as sRGB.
    plain: [f64; 3],
}

fn materials(path: &Path, text: &[u8]) -> Vec<Material> {
    let mut out: Vec<Material> = Vec::new();
    for line in String::from_utf8_lossy(text).lines() {
        let line = line.trim();
        let (word, rest) = line.split_once(char::is_whitespace).map_or((line, ""), |(w, r)| (w, r.trim()));
        match (word, out.last_mut()) {
            ("newmtl", _) => out.push(Material { name: rest.into(), texture: None, plain: [204.0; 3] }),
            ("map_Kd", Some(material)) => {
                // Options stand before the name and have no blanks in their values.
                let name = if rest.starts_with('-') { rest.split_whitespace().last().unwrap_or("") } else { rest };
                if !name.is_empty() {
                    material.texture = Some(path.with_file_name(name.replace('\\', "/")));
                }
            }
            ("Kd", Some(material)) => {
                let values: Vec<f64> = rest.split_whitespace().filter_map(|v| v.parse().ok()).collect();
                if let [r, g, b] = values[..] {
                    material.plain = [r, g, b].map(|c: f64| 255.0 * c.clamp(0.0, 1.0));
                }
            }
            _ => {}
        }
    }
    out
}

fn textured(path: &Path, mesh: &ObjMesh, files: &dyn Files) -> Result<(Option<Vec<[u8; 3]>>, Vec<String>)> {
    let mut notes = Vec::new();
    let mut known: Vec<(Material, Option<ColourImage>)> = Vec::new();
    for library in &mesh.material_files {
        let library = path.with_file_name(library);
        let Ok(text) = files.read(&library) else {
            notes.push(format!("its material file {} cannot be read: no colours from textures", library.display()));
            continue;
        };
        for material in materials(&library, &text) {
            let image = match &material.texture {
                None => None,
                Some(texture) => match files.read(texture) {
                    Ok(bytes) => Some(read_image(texture, &bytes)?),
                    Err(_) => {
                        notes.push(format!("its texture {} cannot be read", texture.display()));
                        None
                    }
                },
            };
            known.push((material, image));
        }
    }
    if !known.iter().any(|(_, image)| image.is_some()) {
        return Ok((None, notes));
    }
    let Some(ObjUvs { coords, faces: uv_faces }) = &mesh.uvs else {
        notes.push("has a texture, but not every face has texture coordinates: no colours from it".into());
        return Ok((None, notes));
    };
    let mut sums = vec![([0.0f64; 3], 0.0f64); mesh.scan.mesh.vertices.len()];
    let named = |name: &str| known.iter().position(|(m, _)| m.name == name);
    let mut material_of = vec![known.iter().position(|(_, image)| image.is_some()); mesh.scan.mesh.faces.len()];
    for used in &mesh.materials {
        let which = named(&used.name);
        if which.is_none() {
            notes.push(format!("its material `{}` is not defined", used.name));
        }
        material_of[used.faces.clone()].fill(which);
    }
    for ((face, uvs), which) in mesh.scan.mesh.faces.iter().zip(uv_faces).zip(material_of) {
        let Some((material, image)) = which.map(|w| &known[w]) else { continue };
        for (&vertex, &uv) in face.iter().zip(uvs) {
            let colour = image.as_ref().map_or(material.plain, |image| image.at(coords[uv as usize]));
            let (sum, count) = &mut sums[vertex as usize];
            (0..3).for_each(|k| sum[k] += colour[k]);
            *count += 1.0;
        }
    }
    // A vertex of no textured face is grey: nothing shows it, or nobody knows.
    let mean =
        |(sum, count): ([f64; 3], f64)| if count > 0.0 { sum.map(|s| (s / count).round() as u8) } else { [128; 3] };
    Ok((Some(sums.into_iter().map(mean).collect()), notes))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;

    struct Memory(BTreeMap<PathBuf, Vec<u8>>);
    impl Files for Memory {
        fn read(&self, path: &Path) -> Result<Vec<u8>> {
            let missing = || Error::io(path, "read", std::io::Error::from(std::io::ErrorKind::NotFound));
            self.0.get(path).cloned().ok_or_else(missing)
        }
    }

    const OBJ: &str = "mtllib cloth.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nvt 0.25 0.25\nvt 0.75 0.25\nvt 0.25 0.75\nvt 0.75 0.75\n\
        usemtl printed\nf 1/1 2/2 3/3\nusemtl plain\nf 2/2 4/4 3/3\n";

    fn memory() -> Memory {
        let mut png = Vec::new();
        let mut encoder = png::Encoder::new(&mut png, 2, 2);
        encoder.set_color(png::ColorType::Rgb);
        encoder.write_header().unwrap().write_image_data(&[0, 0, 200, 0, 0, 0, 100, 0, 0, 0, 60, 0]).unwrap();
        let mtl = b"newmtl printed\nKd 1 1 1\nmap_Kd -s 1 1 1 a.png\nnewmtl plain\nKd 0 0.4 0\n".to_vec();
        let files = [("s/a.obj", OBJ.as_bytes().to_vec()), ("s/cloth.mtl", mtl), ("s/a.png", png)];
        Memory(files.map(|(p, b)| (p.into(), b)).into_iter().collect())
    }

    #[test]
    fn textures_reach_the_vertices_and_what_is_missing_is_noted() {
        let mut files = memory();
        let (scan, notes) = read_scan(Path::new("s/a.obj"), &files).unwrap();
        assert_eq!((scan.name.as_str(), notes), ("a", vec![]));
        // Corners 2 and 3 are shared with the plain material's green, 0.4 · 255 = 102.
        let expected = [[100, 0, 0], [0, (60 + 102) / 2, 0], [0, 51, 100], [0, 102, 0]];
        assert_eq!(scan.colours.unwrap(), expected);
        assert_eq!(texture_files(Path::new("s/a.obj"), &files).unwrap().len(), 2);
        files.0.remove(Path::new("s/a.png"));
        let (scan, notes) = read_scan(Path::new("s/a.obj"), &files).unwrap();
        assert!(scan.colours.is_none() && notes[0].contains("a.png"), "{notes:?}");
        files.0.remove(Path::new("s/cloth.mtl"));
        let (_, notes) = read_scan(Path::new("s/a.obj"), &files).unwrap();
        assert!(notes[0].contains("cloth.mtl"), "{notes:?}");
        assert!(read_scan(Path::new("s/a.stl"), &files).is_err());
    }
}
