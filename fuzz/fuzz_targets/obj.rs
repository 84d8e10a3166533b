#![no_main]
//! OBJ: a mesh that is read is whole, and comes back from the writer.

use caphy_formats::obj::{read_obj, write_obj};
use libfuzzer_sys::fuzz_target;
use std::path::Path;

fuzz_target!(|data: &[u8]| {
    let file = Path::new("mesh.obj");
    let Some(mesh) = caphy_fuzz::accepted("mesh.obj", read_obj(file, data)) else { return };
    let (vertices, faces) = (mesh.scan.mesh.vertices.len(), mesh.scan.mesh.faces.len());
    mesh.scan.mesh.check("mesh").unwrap();
    assert!(mesh.scan.colours.as_ref().is_none_or(|c| c.len() == vertices));
    if let Some(uvs) = &mesh.uvs {
        assert_eq!(uvs.faces.len(), faces);
        assert!(uvs.faces.iter().flatten().all(|&id| (id as usize) < uvs.coords.len()));
    }
    if let Some(normals) = &mesh.normals {
        assert_eq!(normals.faces.len(), faces);
        assert!(normals.faces.iter().flatten().all(|&id| (id as usize) < normals.vectors.len()));
    }
    let mut end = 0;
    for group in &mesh.groups {
        assert!(end <= group.faces.start && group.faces.start < group.faces.end && group.faces.end <= faces);
        end = group.faces.end;
    }
    let again = read_obj(file, &write_obj(&mesh.scan.mesh, mesh.scan.colours.as_deref()).unwrap()).unwrap();
    assert_eq!(again.scan.mesh.faces, mesh.scan.mesh.faces);
    assert_eq!(again.scan.colours, mesh.scan.colours);
});
