//! PLY scans: ascii and binary of either byte order, any number types, polygons of any size.

mod elements;
mod header;

use caphy_core::Result;
use caphy_core::scan::Scan;
use std::path::Path;

const REWRITE: &str = "write the file again from the program that made it";

/// Reads a scan.
///
/// Vertex properties: `x y z` (any number type) [m]; `red green blue` or `diffuse_red …` (8 or 16 bit, or float in
/// [0, 1], or in [0, 255] when a channel of the file exceeds 2), optional; `label` (0 body, 1 upper, 2 lower, others
/// ignored), optional. Faces: the list `vertex_indices` or `vertex_index` of the element `face`, or `tristrips` (-1
/// starts a new strip); polygons become triangles as in [`read_obj`](crate::obj::read_obj). Other properties and
/// elements are skipped. A file without faces is a point cloud.
///
/// # Errors
/// [`Error::Format`](caphy_core::Error::Format) naming the line or element: damaged header, file cut off, what is no
/// number, position or colour that is not finite, vertex id out of range.
pub fn read_ply(path: &Path, bytes: &[u8]) -> Result<Scan> {
    let (encoding, elements, payload) = header::read(path, bytes)?;
    elements::read(path, encoding, &elements, payload)
}

/// Writes a scan as binary little-endian PLY: float positions, colours and labels where the scan has them.
pub fn write_ply(scan: &Scan) -> Vec<u8> {
    let mesh = &scan.mesh;
    let mut header = format!(
        "ply\nformat binary_little_endian 1.0\ncomment metres, y up\nelement vertex {}\n\
         property float x\nproperty float y\nproperty float z\n",
        mesh.vertices.len()
    );
    // An attribute that does not cover every vertex cannot be written as a column.
    let colours = scan.colours.as_ref().filter(|c| c.len() == mesh.vertices.len());
    let labels = scan.labels.as_ref().filter(|l| l.len() == mesh.vertices.len());
    if colours.is_some() {
        header += "property uchar red\nproperty uchar green\nproperty uchar blue\n";
    }
    if labels.is_some() {
        header += "property uchar label\n";
    }
    header += &format!("element face {}\nproperty list uchar int vertex_indices\nend_header\n", mesh.faces.len());
    let mut out = header.into_bytes();
    out.reserve(16 * mesh.vertices.len() + 13 * mesh.faces.len());
    for (i, v) in mesh.vertices.iter().enumerate() {
        for c in v.iter() {
            out.extend((*c as f32).to_le_bytes());
        }
        if let Some(colours) = colours {
            out.extend(colours[i]);
        }
        if let Some(labels) = labels {
            out.push(labels[i] as u8);
        }
    }
    for face in &mesh.faces {
        out.push(3);
        for id in face {
            out.extend(id.to_le_bytes());
        }
    }
    out
}
